"""Comparison of the alternatives of a design: one table row each, and four figures.

Root loci over latency, gain of the controllers, sensitivity of the loops, effort against damping: the basis
for a choice between controllers that all pass.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import control
import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from interarea.design.certificates.closed_loop import closed_loop_matrix
from interarea.design.delay.curves import delayed_loop, rightmost_roots
from interarea.design.linear.linearise import select, speeds_in_rad
from interarea.design.linear.matrices import decays
from interarea.design.linear.norms import response
from interarea.design.robust.operating_points import FamilyCertificate
from interarea.models.files import together

from ..plots.curves import (
    DASHES,
    INK,
    MUTED,
    SERIES,
    STYLE,
    label_columns,
    new_figure,
    save_figure,
)
from .design_file import DesignTable, judge
from .family import family_plants

#: s; common latency of every signal along the root loci
LATENCIES_S = tuple(np.round(np.arange(0.0, 0.301, 0.025), 3).tolist())
Array = npt.NDArray[np.float64]
_OMEGA = np.geomspace(0.1, 100.0, 300)


@dataclass(frozen=True)
class Alternative:
    """One controller (speeds in rad/s) with its verdict over the family."""

    name: str
    system: control.StateSpace
    verdict: FamilyCertificate

    def cells(self) -> tuple[str, ...]:
        """Return the row of the table."""
        v = self.verdict
        unstable = sum(not row.stable for row in v.rows)
        return (
            self.name,
            str(v.order),
            f"{v.worst_swing:.4f}",
            f"{v.inter_area:.4f}",
            "-" if np.isnan(v.effort) else f"{v.effort:.4f}",
            f"{v.fastest_pole:.1f}",
            str(unstable),
            "yes" if v.passed else "no",
        )


#: files of `save_comparison`
FIGURES = ("root-loci.png", "controller-gain.png", "sensitivity.png", "effort-damping.png")
HEADER = ("alternative", "order", "worst swing", "inter-area", "effort", "fastest pole", "unstable", "passes")


def compare(
    table: DesignTable, systems: Mapping[str, control.StateSpace], cache: Path
) -> tuple[Alternative, ...]:
    """Evaluate every controller on the family of a design, with exact latency."""
    return tuple(Alternative(name, K, judge(table, K, cache)) for name, K in systems.items())


def save_comparison(
    table: DesignTable, alternatives: tuple[Alternative, ...], cache: Path, folder: Path
) -> tuple[Path, ...]:
    """Draw the four figures at the design's first operating point into `folder`; return their files."""
    name, plant = next(iter(family_plants(table, cache).items()))
    G = speeds_in_rad(plant.searched, table.grid.omega_b)  # of a large one its model
    figures = (
        root_locus_figure(G, alternatives, name),
        gain_figure(alternatives),
        sensitivity_figure(G, alternatives, name),
        effort_figure(alternatives, table.ask.effort, table.ask.worst_swing),
    )
    with together():
        return tuple(
            save_figure(figure, folder / name) for figure, name in zip(figures, FIGURES, strict=True)
        )


def root_locus_figure(G: control.StateSpace, alternatives: tuple[Alternative, ...], point: str) -> Figure:
    """Draw the exact roots near the axis while the latency of every signal rises to 300 ms."""
    columns = min(len(alternatives), 3)
    rows = -(-len(alternatives) // columns)
    figure, axes = new_figure(rows, columns, height=0.5 + 2.4 * rows, sharex=True, sharey=True, squeeze=False)
    shade = mpl.colors.LinearSegmentedColormap.from_list(  # without the yellow that white swallows
        "latency", mpl.colormaps["viridis"](np.linspace(0.0, 0.85, 64))
    )
    with mpl.rc_context(STYLE):
        for axis, one in zip(axes.ravel(), alternatives, strict=False):
            for latency in LATENCIES_S:
                late = dict.fromkeys(one.system.input_labels, latency)
                z = rightmost_roots(delayed_loop(G, one.system, late), right_of=-3.0)
                z = z[(z.imag >= -1e-9) & (z.imag < 12.0) & (z.real > -3.0)]
                axis.plot(z.real, z.imag, ".", ms=4, color=shade(latency / LATENCIES_S[-1]))
            for zeta in (0.1, 0.2, 0.3):
                radius = np.array([0.0, 12.0])
                axis.plot(-zeta * radius, np.sqrt(1 - zeta**2) * radius, color=MUTED, lw=0.9, ls=":")
            axis.axvline(0.0, color=INK, lw=0.8)
            axis.set(xlim=(-3.0, 0.6), ylim=(0.0, 12.0), title=one.name)
        label_columns(axes, len(alternatives), "Re (1/s)")
        for axis in axes[:, 0]:
            axis.set_ylabel("Im (rad/s)")
        scale = mpl.cm.ScalarMappable(mpl.colors.Normalize(0.0, 1e3 * LATENCIES_S[-1]), shade)
        bar = figure.colorbar(scale, ax=axes.ravel().tolist(), shrink=0.8, label="latency (ms)")
        bar.outline.set_visible(False)
        figure.suptitle(f"{point}: roots over latency; dotted: damping 0.1, 0.2, 0.3", fontsize=9)
    return figure


def gain_figure(alternatives: tuple[Alternative, ...]) -> Figure:
    """Draw the largest singular value of every controller, pu per rad/s."""
    return _magnitudes(
        {
            a.name: np.linalg.norm(response(a.system, _OMEGA), 2, axis=(1, 2)).astype(float)
            for a in alternatives
        },
        "largest gain of K (pu s/rad)",
        logarithmic=True,
    )


def sensitivity_figure(G: control.StateSpace, alternatives: tuple[Alternative, ...], point: str) -> Figure:
    """Draw the largest singular value of (I - G K)^-1 without latency or loss, stable loops only."""
    curves = {}
    for one in alternatives:
        if decays(np.linalg.eigvals(closed_loop_matrix(G, one.system))):
            picked = select(G, list(one.system.output_labels), list(one.system.input_labels))
            loop = response(picked, _OMEGA) @ response(one.system, _OMEGA)
            S = np.linalg.inv(np.eye(loop.shape[1]) - loop)
            curves[one.name] = np.linalg.norm(S, 2, axis=(1, 2)).astype(float)
    return _magnitudes(curves, f"{point}: largest gain of S")


def effort_figure(alternatives: tuple[Alternative, ...], effort_cap: float, worst_swing: float) -> Figure:
    """Draw effort against the worst damping over the family; the asked corner is shaded."""
    figure, axes = new_figure()
    with mpl.rc_context(STYLE):
        for k, one in enumerate(alternatives):
            v = one.verdict
            if not np.isfinite(v.effort):
                continue
            color = SERIES[k % len(SERIES)]
            axes.plot(v.effort, v.worst_swing, "o", color=color, label=one.name)
            axes.plot(v.effort, v.inter_area, "^", color=color, mfc="none")
        right = effort_cap if np.isfinite(effort_cap) else axes.get_xlim()[1]
        axes.set_xlim(0.0, 1.05 * max(right, axes.get_xlim()[1]))
        axes.set_ylim(0.0, 1.1 * axes.get_ylim()[1])
        axes.fill_between([0.0, right], worst_swing, axes.get_ylim()[1], color=MUTED, alpha=0.12, lw=0)
        axes.set_xlabel("effort (pu s/rad)")
        axes.set_ylabel("damping ratio over the family")
        axes.set_title("dots: worst swing mode; triangles: inter-area; shaded: requirements")
        axes.legend()
    return figure


def _magnitudes(curves: Mapping[str, Array], ylabel: str, *, logarithmic: bool = False) -> Figure:
    figure, axes = new_figure()
    with mpl.rc_context(STYLE):
        for k, (name, values) in enumerate(curves.items()):
            color, dashes = SERIES[k % len(SERIES)], DASHES[k % len(DASHES)]
            axes.semilogx(_OMEGA, values, label=name, color=color, linestyle=dashes)
        if logarithmic:
            axes.set_yscale("log")
        axes.set_xlim(float(_OMEGA[0]), float(_OMEGA[-1]))
        axes.set_xlabel("frequency (rad/s)")
        axes.set_ylabel(ylabel)
        axes.legend()
    return figure
