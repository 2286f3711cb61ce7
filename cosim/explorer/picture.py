"""The prepared picture of a page: what a browser without WebAssembly, or without scripts, shows."""

from __future__ import annotations

import html

import numpy as np

from ..results.run import Run
from ..run.run import run_scenario
from .subject import Subject

_WIDTH, _HEIGHT = 760, 240
_LEFT, _TOP, _BOTTOM = 64, 28, 34
_POINTS = 400


def picture_of(subject: Subject) -> str:
    """Return an SVG of the page's start, the speed difference over time, and how the run ends in words."""
    run = run_scenario(subject.scenario, cache=subject.cache)
    time = np.linspace(0.0, float(run.trajectory.time_s[-1]), _POINTS)
    name, values = run.swing.name, run.swing.of(run.trajectory)
    millihertz = 1e3 * run.case.frequency_hz * np.interp(time, run.trajectory.time_s, values)
    most = max(float(np.max(np.abs(millihertz))), 1e-3)
    x = _LEFT + (_WIDTH - _LEFT - 12) * time / time[-1]
    middle = (_TOP + _HEIGHT - _BOTTOM) / 2
    y = middle - (_HEIGHT - _TOP - _BOTTOM) / 2 * millihertz / (1.05 * most)
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
    words = html.escape(f"{run.summary}. Speed difference {name}, mHz, over {time[-1]:g} s.")
    ticks = "".join(
        f'<text x="{_LEFT + (_WIDTH - _LEFT - 12) * t / time[-1]:.0f}" y="{_HEIGHT - 12}">{t:g} s</text>'
        for t in np.linspace(0.0, time[-1], 5)
    )
    return (
        f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" aria-label="{words}">'
        f'<path d="M{_LEFT} {middle:.1f}H{_WIDTH - 12}" class="axis"/>{ticks}'
        f'<text x="8" y="18" class="label">mHz, ± {_rounded(most)}</text>'
        f'<polyline points="{points}"/></svg><p>{html.escape(_sentence(run))}</p>'
    )


def _rounded(value: float) -> str:
    return f"{value:.3g}"


def _sentence(run: Run) -> str:
    return f"Initial run: {run.summary}."
