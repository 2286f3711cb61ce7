"""Operating points of a design, selected from the grid by their effect on its inter-area modes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import pi
from pathlib import Path

import numpy as np

from interarea.design.modes.loop_choice import signals_of
from interarea.design.modes.loop_points import LoopPoint
from interarea.design.modes.modes import Mode
from interarea.design.robust.operating_points import inter_area_band
from interarea.models.case.case import Case
from interarea.models.errors import InterareaError
from interarea.models.grid.powerflow import solve_powerflow

from ..designs.design_tables import PointTable
from ..designs.family import at_point
from .choices import ENOUGH
from .clock import Clock
from .weak_modes import WeakModes, modes_of_grid

#: branches whose outage is tried, points that these are to give, and those that go into the design
TRIED, USABLE, CHOSEN = 40, 12, 4
#: relative change of an eigenvalue below which another load or tie flow is no point of its own
MOVED = 0.01
LOADS = (1.05, 0.9)  #: factors on all loads and the power of all machines
TIE_SHARE = 0.25  #: of the flow over the tie, where a case names one
_EDGE = 0.97  # of the inter-area band's lower end, from where more is asked of it


@dataclass(frozen=True)
class TriedPoint:
    """A change to the grid and its effect on the modes without control.

    least : damping ratio of the worst inter-area mode there. moved : largest relative change of any such
    mode's eigenvalue; 0 where a stabilizer is out. modes : all that were found. problem : reason why it
    cannot be a point.
    """

    point: PointTable
    least: float = 1.0
    moved: float = 0.0
    modes: tuple[Mode, ...] = ()
    problem: str = ""


def tried_points(
    weak: WeakModes,
    cache: Path,
    clock: Clock,
    *,
    progress: Callable[[float], object] = lambda share: None,
) -> tuple[TriedPoint, ...]:
    """Try other loads and tie flows, and outages of local stabilizers and of the branches that swing most.

    The time limits their number.
    """
    others = [PointTable(name=f"load {100 * (k - 1):+.0f} %", load_scale=k) for k in LOADS]
    others += _tie_points(weak.case)
    without = [f"no stabilizer at {machine}" for machine in weak.stabilized]
    others += [PointTable(name=name, vary=(name,)) for name in without]
    rows: list[TriedPoint] = []
    for k, point in enumerate(others):
        progress(k / (USABLE + len(others)))
        rows.append(_tried(weak, point, cache))
    for name in _swinging_branches(weak)[:TRIED]:
        usable = sum(not row.problem for row in rows if row.point.out)
        if usable == USABLE:
            break
        if clock.over("operating points"):
            clock.leave(f"outages of branches after the first {usable}")
            break
        progress((len(others) + usable) / (USABLE + len(others)))
        rows.append(_tried(weak, PointTable(name=f"{name} out", out=(name,)), cache))
    progress(1.0)
    return tuple(sorted(rows, key=lambda row: not row.point.out))


def chosen_points(tried: Sequence[TriedPoint]) -> tuple[PointTable, ...]:
    """Return the points of a design: the grid as it is, outages with least damping or largest change, the
    rest.

    Outages are those of branches and of local stabilizers.
    """
    usable = [row for row in tried if not row.problem]
    same = {(round(row.least, 3), round(row.moved, 2)): row for row in reversed(usable) if _outage(row)}
    outages = list(same.values())[::-1]  # of circuits in parallel or in series one
    worst = sorted(outages, key=lambda row: row.least)[: CHOSEN // 2]
    rest = [row for row in outages if row not in worst]
    most = sorted(rest, key=lambda row: -row.moved)[: CHOSEN - len(worst)]
    others = [row for row in usable if not _outage(row) and row.moved >= MOVED]
    return (PointTable(name="base"), *(row.point for row in (*worst, *most, *others)))


def keeping_what_is_there(
    weak: WeakModes, points: Sequence[PointTable], tried: Sequence[TriedPoint], worst_swing: float
) -> tuple[PointTable, ...]:
    """Require the damping of the local stabilizers at each point where it exceeds the requirement.

    Minus the loss allowed to any mode, and at most `ENOUGH`. Without stabilizers the points do not change.
    worst_swing : least damping ratio of any swing, required everywhere.
    """
    if not weak.stabilized:
        return tuple(points)
    least = {row.point.name: row.least for row in tried} | {"base": weak.weakest.damping_ratio}
    low, high = (2.0 * pi * hz for hz in inter_area_band({m.name: m for m in weak.all_modes.modes}))
    adjusted: list[PointTable] = []
    for point in points:
        required = round(min(least[point.name] - weak.choices.given_away, ENOUGH), 4)
        if required > weak.required_damping:
            more = round(required - weak.required_damping, 4)
            nodes = ((_EDGE * low, 0.0), (low, more), (high, more), (high / _EDGE, 0.0))
            rounded = tuple((round(at, 3), value) for at, value in nodes)
            point = point.model_copy(update={"more": rounded, "ask": (worst_swing, required)})
        adjusted.append(point)
    return tuple(adjusted)


def _outage(row: TriedPoint) -> bool:
    return bool(row.point.out or row.point.vary)


def _swinging_branches(weak: WeakModes) -> list[str]:
    """Return the branches in service by how much their power swings in the targets, the most first."""
    modes = weak.all_modes.modes
    aimed = [modes.index(mode) for mode in weak.targets]
    right = np.array([mode.right for mode in modes]).T
    value = np.array([mode.eigenvalue for mode in modes])
    rows = [s for s in signals_of(weak.plant, right, value, weak.case.areas, aimed) if s.kind == "power"]
    swings = np.abs(np.array([row.shows[aimed] for row in rows]))
    share = (swings / np.maximum(swings.max(axis=0), 1e-300)).max(axis=1)
    return [rows[k].name.removeprefix("power_") for k in np.argsort(-share, kind="stable")]


def _tie_points(case: Case) -> list[PointTable]:
    """Return more and less flow over the tie, where the case names one and loads at both of its sides."""
    if case.tie is None:
        return []
    total = solve_powerflow(case).tie_p * case.base_mva
    step = round(TIE_SHARE * abs(total), -1)
    return [
        PointTable(name=f"tie {sign * step:+.0f} MW", tie_flow_mw=sign * step) for sign in (1.0, -1.0) if step
    ]


def _tried(weak: WeakModes, point: PointTable, cache: Path) -> TriedPoint:
    try:
        grid = modes_of_grid(at_point(weak.case, point), cache)
        there = LoopPoint(point.name, grid.plant, grid.all_modes.modes)
        same = grid.plant.nstates == weak.plant.nstates  # not where a stabilizer is out
        pairs = [(target, there.like(target)) for target in weak.targets if same]
    except InterareaError as error:
        return TriedPoint(point, problem=str(error).splitlines()[0])
    if not grid.growth.stable:
        return TriedPoint(point, problem="unstable without control")
    moves = [abs(m.eigenvalue - t.eigenvalue) / abs(t.eigenvalue) for t, m in pairs if m is not None]
    return TriedPoint(
        point,
        least=min((m.damping_ratio for m in grid.inter_area), default=1.0),
        moved=max(moves, default=0.0),
        modes=grid.all_modes.modes,
    )
