"""Drawings that are not curves: the one-line diagram with its power flow, the generalised plant."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch, FancyBboxPatch

from interarea.models.grid.powerflow import PowerFlow

from .curves import INK, MUTED, SERIES, STYLE, WIDTH


def one_line_diagram(flow: PowerFlow, position_of: Mapping[int, Sequence[float]]) -> Figure:
    """Draw the network with voltages and active power flows of a solved case.

    position_of : bus number -> (x, y) of its bar in drawing units; every bus of the case must be in it.
    """
    case = flow.case
    figure, axes = _canvas(WIDTH * 3.6 / 11.4)
    with mpl.rc_context(STYLE):
        circuits: dict[tuple[int, int], list[Any]] = defaultdict(list)
        for branch in case.branches:
            if branch.in_service:
                circuits[branch.from_bus, branch.to_bus].append(branch)
        for (a, b), parallel in circuits.items():
            (xa, ya), (xb, yb) = position_of[a], position_of[b]
            for k in range(len(parallel)):
                offset = 0.16 * (k - (len(parallel) - 1) / 2)
                axes.plot([xa, xb], [ya + offset, yb + offset], color=INK, linewidth=1.0, zorder=1)
            power = sum(flow.flow(branch.name, a) for branch in parallel).real * case.base_mva
            lean = -0.22 * np.sign((yb - ya) * (xb - xa))  # off a line that slopes
            middle = ((xa + xb) / 2 + lean, (ya + yb) / 2 + 0.16)
            arrow = "→" if (power > 0) == (xb > xa) else "←"
            text = f"{arrow} {abs(power):.0f}" if abs(xb - xa) > 0.3 else f"{abs(power):.0f}"
            axes.text(*middle, text, ha="center", va="bottom", fontsize=7.5, color=SERIES[0])
        for bus in case.buses:
            x, y = position_of[bus.number]
            axes.plot([x, x], [y - 0.28, y + 0.28], color=INK, linewidth=2.6, solid_capstyle="butt", zorder=3)
            v = flow.voltage(bus.number)
            label = f"{abs(v):.3f}\n{np.degrees(np.angle(v)):.1f}°".replace("-", "−")
            axes.text(x, y - 0.34, label, ha="center", va="top", fontsize=6.5, color=MUTED)
            axes.text(x, y + 0.32, str(bus.number), ha="center", va="bottom", fontsize=8, weight="bold")
        for machine, power in zip(case.machines, flow.generation, strict=True):
            x, y = position_of[machine.bus]
            side = -1.0 if x < np.mean([p[0] for p in position_of.values()]) else 1.0
            colour = SERIES[(machine.area - 1) % len(SERIES)]
            axes.plot([x, x + 0.32 * side], [y, y], color=INK, linewidth=1.0, zorder=1)
            axes.add_patch(Circle((x + 0.54 * side, y), 0.22, fill=False, edgecolor=colour, linewidth=1.6))
            axes.text(x + 0.54 * side, y, machine.name, ha="center", va="center", fontsize=7.5, color=colour)
            words = f"{power.real * case.base_mva:.0f} MW"
            axes.text(x + 0.54 * side, y + 0.26, words, ha="center", va="bottom", fontsize=7, color=SERIES[0])
        for load in case.loads:
            x, y = position_of[load.bus]
            _arrow(axes, (x, y - 0.75), (x, y - 1.15))
            axes.text(x, y - 1.18, f"{load.P_mw:.0f} MW", ha="center", va="top", fontsize=7, color=SERIES[0])
        axes.autoscale_view()
    return figure


def generalised_plant_diagram() -> Figure:
    """Draw the loop of the mixed-sensitivity design: G, K, weight W1 on the outputs, W2 on the control."""
    figure, axes = _canvas(WIDTH * 2.3 / 8.4)
    with mpl.rc_context(STYLE):
        boxes = {"K(s)": (2.0, 0.0), "G(s)": (4.0, 0.0), "W₂(s)": (4.0, 1.0), "W₁(s)": (7.0, 0.0)}
        for text, (x, y) in boxes.items():
            box = FancyBboxPatch((x - 0.5, y - 0.28), 1.0, 0.56, "round,pad=0.02", fill=False, edgecolor=INK)
            axes.add_patch(box)
            axes.text(x, y, text, ha="center", va="center")
        axes.add_patch(Circle((5.5, 0.0), 0.14, fill=False, edgecolor=INK))
        for start, end in (
            ((2.52, 0.0), (3.48, 0.0)),
            ((4.52, 0.0), (5.36, 0.0)),
            ((5.5, 0.7), (5.5, 0.14)),
            ((5.64, 0.0), (6.48, 0.0)),
            ((7.52, 0.0), (8.4, 0.0)),
            ((3.0, 1.0), (3.48, 1.0)),
            ((4.52, 1.0), (8.4, 1.0)),
            ((1.0, 0.0), (1.48, 0.0)),
        ):
            _arrow(axes, start, end)
        axes.plot([3.0, 3.0], [0.0, 1.0], color=INK, linewidth=1.0)
        axes.plot([6.0, 6.0, 1.0, 1.0], [0.0, -0.8, -0.8, 0.0], color=INK, linewidth=1.0)
        for x, y, text in (
            (2.95, -0.22, "u"),
            (5.72, 0.55, "w"),
            (8.55, 0.0, "z₁"),
            (8.55, 1.0, "z₂"),
            (3.6, -0.66, "y = (Δω₂, Δω₄)"),
        ):
            axes.text(x, y, text, ha="center", va="center")
        axes.autoscale_view()
    return figure


def _canvas(height: float) -> tuple[Figure, Axes]:
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, height), layout="constrained")
        axes = figure.subplots()
        axes.set_axis_off()
        axes.set_aspect("equal")
    return figure, axes


def _arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float]) -> None:
    axes.add_patch(
        FancyArrowPatch(
            start, end, arrowstyle="-|>", mutation_scale=8, color=INK, linewidth=1.0, shrinkA=0, shrinkB=0
        )
    )
