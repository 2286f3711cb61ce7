"""The shape of a mode where its machines stand: on a map when the case has places of its buses."""

from __future__ import annotations

from cmath import phase
from collections.abc import Mapping
from math import cos, degrees, radians
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from interarea.design.modes.modes import Mode
from interarea.models.case.case import Case
from interarea.models.files import together

from .curves import INK, MUTED, SERIES, STYLE, WIDTH, save_figure
from .mode_shapes import mode_shape_plot

Place = tuple[float, float]  #: longitude, latitude, deg

_LONGEST = 0.5  #: inches, of the largest arrow
_STILL = 0.05  #: of the largest speed; a machine slower than that is a dot
_NAMED = 8  #: machines by name on a map
_LISTED = 3  #: machines without a place by name
_TALL = 7.0  #: inches, largest height of a map
_BESIDE = 2.0  #: inches of its width and height for axes, words and arrows


def shape_plot(mode: Mode, case: Case | None) -> Figure:
    """Draw who swings against whom: on a map if two machines have different places, else as a compass."""
    title = f"{mode.name}: {mode.frequency_hz:.3f} Hz, damping {mode.damping_ratio:.3f}"
    if case is None:
        return mode_shape_plot(mode.shape, dict.fromkeys(mode.shape, 1), title)
    places = places_of(case)
    if len({places[m.bus] for m in case.machines if m.bus in places}) < 2:
        return mode_shape_plot(mode.shape, case.areas, title)
    return mode_map(mode.shape, case, places, title)


def save_shapes(modes: Mapping[str, Mode], case: Case, folder: Path) -> list[Path]:
    """Write one SVG a mode, named after it, into `folder`, which is made."""
    with together():
        return [
            save_figure(shape_plot(mode, case), folder / f"{name.replace(' ', '-')}.svg")
            for name, mode in modes.items()
        ]


def places_of(case: Case) -> dict[int, Place]:
    """Return bus number -> (longitude, latitude) in degrees of the buses whose place is known.

    The windings of a transformer stand in one substation: a bus without a place (of a generator, or the star
    of three windings) has that of the bus at the other side. Longitudes run on over the 180th meridian.
    """
    located = [(b.number, b.longitude_deg, b.latitude_deg) for b in case.buses]
    known = {k: (x, y) for k, x, y in located if x is not None and y is not None}
    if not known:
        return {}
    first = next(iter(known.values()))[0]
    places = {k: (first + (x - first + 180.0) % 360.0 - 180.0, y) for k, (x, y) in known.items()}
    windings = [(b.from_bus, b.to_bus) for b in case.branches if b.kind == "transformer"]
    waiting = [*windings, *((b, a) for a, b in windings)]
    while placed := {b: places[a] for a, b in waiting if a in places and b not in places}:
        places |= placed
    return places


def mode_map(shape: Mapping[str, complex], case: Case, places: Mapping[int, Place], title: str) -> Figure:
    """Draw the speeds of machines as arrows at their places, turned so that the largest points right.

    shape : machine -> complex speed entry of the right eigenvector. places : bus number -> longitude and
    latitude, deg; machines at other buses are named below the map. Degrees of longitude are as long as those
    of latitude are in the middle of the map.
    """
    leader = max(shape.values(), key=abs)
    at = {m.name: places[m.bus] for m in case.machines if m.bus in places and m.name in shape}
    rotated = {m: shape[m] / leader for m in sorted(at, key=lambda m: -abs(shape[m]))}  # the small on top
    ends = [(b.from_bus, b.to_bus) for b in case.branches]
    lines = [(places[a], places[b]) for a, b in ends if a in places and b in places]
    spots = np.array([*places.values()])
    low, high = spots.min(axis=0), spots.max(axis=0)
    squeeze = max(cos(radians(0.5 * (low[1] + high[1]))), 0.05)
    wide, tall = max((high[0] - low[0]) * squeeze, 1e-3), max(high[1] - low[1], 1e-3)
    inch = max(wide / (WIDTH - _BESIDE), tall / (_TALL - _BESIDE))  # degrees of latitude
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, tall / inch + _BESIDE), layout="constrained")
        axes: Any = figure.subplots()
        axes.set_aspect(1.0 / squeeze)
        axes.grid(visible=False)
        axes.add_collection(LineCollection(lines, colors=MUTED, linewidths=0.4, alpha=0.6, zorder=1))
        _arrows(axes, rotated, at)
        _names(axes, rotated, at, 0.25 * inch, squeeze)
        room = 1.15 * _LONGEST * inch
        axes.set_xlim(low[0] - room / squeeze, high[0] + room / squeeze)
        axes.set_ylim(low[1] - room, high[1] + room)
        axes.set_xlabel("longitude, degrees")
        axes.set_ylabel("latitude, degrees")
        axes.set_title(title)
        missing = [m for m in shape if m not in at]
        words = _below(max(shape, key=lambda m: abs(shape[m])), missing, shape)
        figure.supxlabel(words, x=0.01, ha="left", size=7.5, color=MUTED)
    return figure


def _arrows(axes: Any, rotated: Mapping[str, complex], at: Mapping[str, Place]) -> None:
    """Machines with the largest in one colour, against it in the other, at rest as dots."""
    moving = [m for m in rotated if abs(rotated[m]) > _STILL]
    for colour, label, machines in (
        (MUTED, f"below {100 * _STILL:g} %", [m for m in rotated if m not in set(moving)]),
        (SERIES[0], "with the largest", [m for m in moving if rotated[m].real >= 0.0]),
        (SERIES[1], "against it", [m for m in moving if rotated[m].real < 0.0]),
    ):
        if not machines:
            continue
        spots = np.array([at[m] for m in machines])
        axes.scatter(*spots.T, s=6.0, color=colour, linewidths=0, zorder=2, label=label)
        if colour == MUTED:
            continue
        arrows = np.array([rotated[m] for m in machines]) * _LONGEST
        axes.quiver(
            *spots.T, arrows.real, arrows.imag, color=colour, angles="uv", units="inches",
            scale_units="inches", scale=1.0, width=0.018, headwidth=4.5, headlength=5, headaxislength=4.5,
            edgecolor="white", linewidth=0.3, zorder=3,
        )  # fmt: skip
    axes.legend(loc="best", fontsize=7.5, markerscale=2.0)


def _names(
    axes: Any, rotated: Mapping[str, complex], at: Mapping[str, Place], gap: float, squeeze: float
) -> None:
    """Name the first machines that are a `gap` of degrees apart."""
    placed: list[Place] = []
    for machine in rotated:
        x, y = at[machine]
        if len(placed) == _NAMED or any(np.hypot((x - a) * squeeze, y - b) < gap for a, b in placed):
            continue
        placed.append((x, y))
        right = rotated[machine].real < 0.0  # on the side that the arrow leaves free
        axes.annotate(
            machine, (x, y), xytext=(4 if right else -4, 0), textcoords="offset points", size=7, color=INK,
            ha="left" if right else "right", va="center", zorder=4,
        )  # fmt: skip


def _below(largest: str, missing: list[str], shape: Mapping[str, complex]) -> str:
    """What the arrows are, and who is not on the map."""
    text = f"arrows: speeds of the machines; length: size, direction: phase, that of {largest} to the right"
    if missing:
        first = sorted(missing, key=lambda m: -abs(shape[m]))[:_LISTED]
        rest = f" and {len(missing) - _LISTED} more" if len(missing) > _LISTED else ""
        listed = (f"{m} ({abs(shape[m]):.2f}, {degrees(phase(shape[m])):+.0f}°)" for m in first)
        text += f"\nno place in the case: {', '.join(listed)}{rest}"
    return text
