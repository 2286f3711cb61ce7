"""The figure of a run: the swing it is judged by, the machines' speeds, the controls."""

from __future__ import annotations

import html
import io
import textwrap
from typing import TYPE_CHECKING, Any, Protocol

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from interarea.models.case.events import instants

from ..plots.curves import DASHES, MUTED, SERIES, STYLE, new_figure
from .accumulators import DRAWN, Curves
from .ringdown import speeds_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes

    from interarea.models.case.case import Case

    from ..scenario.scenario import Scenario
    from ..trajectory import Trajectory
    from .ringdown import Swing


class Ran(Protocol):
    """What is drawn: a trajectory with its case and scenario."""

    @property
    def trajectory(self) -> Trajectory: ...
    @property
    def case(self) -> Case: ...
    @property
    def scenario(self) -> Scenario: ...
    @property
    def swing(self) -> Swing: ...
    @property
    def summary(self) -> str: ...


def run_plot(run: Ran) -> Figure:
    """Draw a run: the speed difference it is judged by, speeds of the machines, controls if there are any.

    Disturbances and the times without a signal are shaded.
    """
    curves, controls = run.trajectory, run.trajectory.reals_of("controller")
    if len(curves.time_s) > DRAWN:
        drawn = Curves(len(curves.time_s))
        drawn.add(curves, [*speeds_of(run.case), *controls])
        curves = drawn.trajectory
    swing = run.swing.of(curves)
    rows = 3 if controls else 2
    start, end = float(curves.time_s[0]), float(curves.time_s[-1])
    figure, axes = new_figure(rows, 1, height=1.4 * rows + 0.8, sharex=True)
    with mpl.rc_context(STYLE):
        axes[0].plot(curves.time_s, 1e3 * swing, color=SERIES[0], label=run.swing.name)
        axes[0].set_ylabel(f"{run.swing.name}\n(10⁻³ pu)")
        _draw_speeds(axes[1], curves, [m.name for m in run.case.machines])
        for k, control in enumerate(controls):
            colour, dash = SERIES[k % len(SERIES)], DASHES[k % len(DASHES)]
            label = control.split(".", 1)[1]
            axes[2].plot(curves.time_s, curves[control], color=colour, linestyle=dash, label=label)
        if controls:
            axes[2].set_ylabel("control (pu)")
            axes[2].legend(**_BESIDE)
        spans, shades = _spans(run, end), (MUTED, SERIES[1], SERIES[2], SERIES[4])
        for axis in axes:
            for k, (_, when) in enumerate(spans):
                for one in when:
                    axis.axvspan(*one, color=shades[k % len(shades)], alpha=0.18, linewidth=0.0, zorder=0)
        if spans:
            patches = [
                Patch(color=shades[k % len(shades)], alpha=0.18, linewidth=0.0) for k in range(len(spans))
            ]
            axes[0].legend(patches, [label for label, _ in spans], **_BESIDE)
        axes[-1].set_xlabel("time (s)")
        axes[-1].set_xlim(start, end)
        axes[-1].xaxis.set_major_locator(MaxNLocator(10, integer=end - start >= 5.0))
        title = run.scenario.title or run.scenario.name
        figure.suptitle(textwrap.fill(title, 90), fontsize=9, x=0.01, ha="left")
    return figure


def _draw_speeds(axis: Axes, curves: Trajectory, machines: Sequence[str]) -> None:
    """Draw the speeds of the machines, of more than `_MOST` those that go furthest."""
    speeds = {name: 1e3 * np.asarray(curves[f"plant.{name}_dw"]) for name in machines}
    names, title = list(speeds), None
    if len(names) > _MOST:
        furthest = set(sorted(names, key=lambda n: -float(np.abs(speeds[n]).max()))[:_MOST])
        names, title = [n for n in names if n in furthest], f"{_MOST} of {len(names)}, the largest deviations"
    for k, name in enumerate(names):
        colour, dash = SERIES[k % len(SERIES)], DASHES[(k + k // len(SERIES)) % len(DASHES)]
        axis.plot(curves.time_s, speeds[name], color=colour, linestyle=dash, linewidth=1.0, label=name)
    axis.set_ylabel("speed deviation\n(10⁻³ pu)")
    axis.legend(**_BESIDE, ncols=1 + (len(names) - 1) // 8, title=title, title_fontsize=7)


_MOST = 24  #: machines whose speeds can be told apart
_BESIDE: Any = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0), "fontsize": 7, "borderaxespad": 0.2}


def run_html(run: Ran) -> str:
    """Return the summary of a run and its figure as an HTML fragment."""
    drawn = io.StringIO()
    run_plot(run).savefig(drawn, format="svg")
    return f"<p><b>{html.escape(run.summary)}</b></p>{drawn.getvalue().partition('?>')[2]}"


def _spans(run: Ran, end_s: float) -> list[tuple[str, list[tuple[float, float]]]]:
    """Return what is shaded: disturbances first, then the outages of each channel; label, times (s)."""
    events = [(times[0], times[-1]) for times in (instants(e) for e in run.scenario.event) if times]
    short = 0.002 * end_s  # what lasts an instant is drawn as a line
    spans = [("disturbance", [(a, max(b, a + short)) for a, b in events if a < end_s])]
    for name, channel in run.scenario.channels.items():
        outages = [(a, min(b, end_s)) for a, b in channel.outages_s if a < end_s]
        spans.append((f"{name} lost", outages))
    return [(label, when) for label, when in spans if when]
