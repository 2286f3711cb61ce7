"""Figures of modes: who takes part, who swings against whom."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from .curves import MUTED, SERIES, STYLE, new_figure


def participation_plot(
    participation: Mapping[str, float], machines: Sequence[str], *, count: int = 12
) -> Figure:
    """Draw the `count` largest participation factors of a mode, coloured by machine.

    participation : state name (`G1.delta`) -> factor; machines : names in colour order.
    """
    ranked = sorted(((abs(v), k) for k, v in participation.items()), key=lambda t: (-t[0], t[1]))[:count]
    values, names = [v for v, _ in ranked], [k for _, k in ranked]
    figure, axes = new_figure(height=0.7 + 0.19 * len(names))
    with mpl.rc_context(STYLE):
        owner = [next((m for m in machines if n.startswith(f"{m}.")), "") for n in names]
        colours = [SERIES[machines.index(m) % len(SERIES)] if m else MUTED for m in owner]
        axes.barh(names, values, color=colours, height=0.7)
        axes.invert_yaxis()
        axes.grid(axis="y", visible=False)
        axes.set_xlabel("participation factor (magnitude)")
        seen = [m for m in machines if m in owner]
        for machine in seen:
            axes.barh([names[0]], [0.0], color=SERIES[machines.index(machine) % len(SERIES)], label=machine)
        axes.legend(loc="lower right", ncols=len(seen))
    return figure


MANY_ARROWS = 6  #: more than this, and the names go round the rim
MOST_NAMES, NAMED = 60, 24  #: names that have room there; of more machines so many of the largest are named


def mode_shape_plot(shape: Mapping[str, complex], area_of: Mapping[str, int], title: str) -> Figure:
    """Draw the mode shape as a compass: one arrow per machine, scaled so that the longest is 1.

    shape : machine -> complex speed entry of the right eigenvector; area_of : machine -> area number. Of more
    than `MOST_NAMES` machines the `NAMED` largest have their names.
    """
    scale = max(abs(v) for v in shape.values())
    leader = max(shape.values(), key=abs)
    rotated = {m: v / leader * abs(leader) / scale for m, v in shape.items()}
    with mpl.rc_context(STYLE):
        many = len(rotated) > MANY_ARROWS
        figure = Figure(figsize=(4.6, 4.6) if many else (3.4, 3.1), layout="constrained")
        axes: Any = figure.subplots(subplot_kw={"projection": "polar"})
        axes.set_ylim(0, 1.3 if many else 1.18)
        axes.set_yticks([0.5, 1.0], labels=["", ""])
        axes.set_xticks(np.radians([0, 90, 180, 270]))
        axes.tick_params(axis="x", labelsize=7, pad=1)
        axes.spines["polar"].set_visible(False)
        areas = sorted(set(area_of.values()))
        placed: list[complex] = []
        named = list(rotated)
        if len(named) > MOST_NAMES:
            named = sorted(rotated, key=lambda m: -abs(rotated[m]))[:NAMED]
        gap = min(0.2, 6.2 / len(named))
        angles = rim_angles([float(np.angle(rotated[m])) for m in named], gap) if many else []
        rim = dict(zip(named, angles, strict=False))
        for machine, value in rotated.items():
            k = areas.index(area_of[machine])
            colour = SERIES[k % len(SERIES)]
            angle, radius = float(np.angle(value)), abs(value)
            axes.plot([angle, angle], [0, radius], color=colour, linewidth=1.8)
            if radius > 0.03:
                arrow = {"arrowstyle": "-|>", "color": colour, "linewidth": 1.8, "shrinkA": 0, "shrinkB": 0}
                axes.annotate("", xy=(angle, radius), xytext=(angle, 0.9 * radius), arrowprops=arrow)
            if machine not in named:
                continue
            spot = complex(1.22 * np.exp(1j * rim[machine])) if many else _free_spot(value, placed)
            placed.append(spot)
            if many:
                axes.plot([angle, rim[machine]], [radius, 1.14], color=colour, linewidth=0.4)
            axes.text(
                float(np.angle(spot)),
                abs(spot),
                machine,
                color=colour,
                weight="bold",
                size=7 if many else None,
                ha="center",
                va="center",
            )
        for k, area in enumerate(areas):
            axes.plot([], [], color=SERIES[k % len(SERIES)], label=f"area {area}")
        figure.legend(loc="outside lower center", ncols=min(len(areas), 3), fontsize=8)
        axes.set_title(title, loc="center", pad=10)
    return figure


def _free_spot(value: complex, placed: Sequence[complex]) -> complex:
    """Return a place for a label near the tip `value`, at least 0.16 from those already set."""
    direction = value / abs(value) if abs(value) > 1e-9 else 1.0 + 0j
    for turn in (0.0, 0.22, -0.22, 0.44, -0.44, 0.66, -0.66):
        spot = complex(direction * (abs(value) + 0.13) * np.exp(1j * turn / max(abs(value), 0.35)))
        if all(abs(spot - p) > 0.2 for p in placed):
            return spot
    return complex(direction * (abs(value) + 0.13))


def rim_angles(angles: Sequence[float], gap: float) -> list[float]:
    """Return places on the rim, rad, near `angles` and at least `gap` apart, in the same order round.

    Arrows that are too close form a cluster, which is spread evenly about its mean; clusters that then
    touch are joined, until none do.

    >>> [round(a, 6) for a in rim_angles([0.0, 0.0, 2.0], 0.2)]
    [-0.1, 0.1, 2.0]

    Raises
    ------
    ValueError : a gap that leaves no room for all of them.
    """
    if not 0.0 < gap * len(angles) <= 2.0 * math.pi:
        raise ValueError(f"{len(angles)} names {gap:g} rad apart do not fit round a circle of 2 pi")
    order = sorted(range(len(angles)), key=lambda k: angles[k])
    # begin after the widest empty sector, so that no cluster lies across the cut
    ordered = [angles[k] for k in order]
    holes = [(ordered[(k + 1) % len(ordered)] - ordered[k]) % (2.0 * math.pi) for k in range(len(ordered))]
    cut = max(range(len(holes)), key=holes.__getitem__) + 1 if len(ordered) > 1 else 0
    order = order[cut:] + order[:cut]
    line = [angles[k] + (2.0 * math.pi if angles[k] < angles[order[0]] else 0.0) for k in order]
    clusters = [[value] for value in line]
    joined = True
    while joined:
        joined = False
        for k in range(len(clusters) - 1):
            if _ends(clusters[k + 1], gap)[0] - _ends(clusters[k], gap)[1] < gap * (1.0 - 1e-9):
                clusters[k : k + 2] = [clusters[k] + clusters[k + 1]]
                joined = True
                break
    places = [0.0] * len(angles)
    position = 0
    for cluster in clusters:
        first, _ = _ends(cluster, gap)
        for step in range(len(cluster)):
            places[order[position]] = first + step * gap
            position += 1
    return places


def _ends(cluster: Sequence[float], gap: float) -> tuple[float, float]:
    """First and last place of a cluster spread about its mean; one arrow keeps its angle."""
    mean, half = sum(cluster) / len(cluster), gap * (len(cluster) - 1) / 2.0
    return mean - half, mean + half
