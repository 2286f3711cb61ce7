"""What of a grid takes part: joined nodes, isolated and dead parts, the island that is kept."""

from __future__ import annotations

from collections import Counter
from typing import TypeVar

from ..case.checks import connected_parts
from ..errors import CaseError
from .report import Report
from .static import ISOLATED, SLACK, StaticBus, StaticGrid, StaticLoad, StaticShunt, StaticUnit

Row = TypeVar("Row", StaticShunt, StaticLoad, StaticUnit)


def settle(grid: StaticGrid, report: Report, island: int | str | None = None) -> None:
    """Leave in `grid` what is in service: joins nodes, drops isolated parts, keeps one island or all.

    island : a bus of the island to keep; "all": each with a slack bus; None: the largest of these.

    Raises
    ------
    CaseError : no bus with a slack, an `island` that is no bus in service.
    """
    _drop_isolated(grid, report)
    _join(grid, report)
    _keep_island(grid, report, island)


def _drop_isolated(grid: StaticGrid, report: Report) -> None:
    dead = {number for number, bus in grid.buses.items() if bus.kind == ISOLATED}
    for number in dead:
        report.drop("isolated bus (type 4)", grid.buses.pop(number).where)
    grid.shunts = _in_service("shunt", grid.shunts, dead, report)
    grid.loads = _in_service("load", grid.loads, dead, report)
    grid.units = _in_service("unit", grid.units, dead, report)
    retained = []
    for branch in grid.branches:
        at_dead = branch.first in dead or branch.second in dead
        if at_dead:
            if branch.on:
                report.assume("branch in service at an isolated bus: treated as out of service", branch.where)
            continue
        if branch.joins and not branch.on:
            report.drop("open switch or line without impedance", branch.where)
            continue
        retained.append(branch)
    grid.branches[:] = retained


def _in_service(what: str, rows: list[Row], dead: set[int], report: Report) -> list[Row]:
    for row in rows:
        if row.on and row.bus in dead:
            report.assume(f"{what} in service at an isolated bus: treated as out of service", row.where)
        elif not row.on:
            report.drop(f"{what} out of service", row.where)
    return [row for row in rows if row.on and row.bus not in dead]


def _join(grid: StaticGrid, report: Report) -> None:
    """Make one node of the ends of each closed branch without impedance."""
    root = {number: number for number in grid.buses}

    def find(number: int) -> int:
        while root[number] != number:
            root[number] = root[root[number]]
            number = root[number]
        return number

    order = {number: k for k, number in enumerate(grid.buses)}
    for branch in grid.branches:
        if not branch.joins:
            continue
        a, b = find(branch.first), find(branch.second)
        if a != b:
            one, other = sorted((a, b), key=lambda n: (-grid.buses[n].kind, order[n]))
            root[other] = one
            report.read["nodes joined by a switch or a line without impedance"] += 1
    grid.alias = {number: find(number) for number in grid.buses if find(number) != number}
    for branch in grid.branches:
        if branch.joins and branch.b:
            grid.shunts.append(
                StaticShunt(
                    branch.first, "B", f"{branch.name[-1]}_{branch.circuit}", 0.0, branch.b * grid.base_mva,
                    branch.where,
                )
            )  # fmt: skip
    grid.branches[:] = [b for b in grid.branches if not b.joins]
    _move_to_nodes(grid, report)


def _move_to_nodes(grid: StaticGrid, report: Report) -> None:
    """Let all that stood at a joined bus stand at the node that is left; name branches that it swallows."""
    for branch in grid.branches:
        branch.first = grid.alias.get(branch.first, branch.first)
        branch.second = grid.alias.get(branch.second, branch.second)
    inside = [b for b in grid.branches if b.first == b.second]
    for branch in inside:
        report.drop("branch parallel to a closed switch, both ends at one node", branch.where)
    grid.branches[:] = [b for b in grid.branches if b.first != b.second]
    _rewire(grid.shunts, grid.alias)
    _rewire(grid.loads, grid.alias)
    _rewire(grid.units, grid.alias)
    for number in grid.alias:
        del grid.buses[number]


def _rewire(rows: list[Row], alias: dict[int, int]) -> None:
    for row in rows:
        row.bus = alias.get(row.bus, row.bus)


def _keep_island(grid: StaticGrid, report: Report, island: int | str | None) -> None:
    parts = live_islands(grid)
    sourced = {unit.bus for unit in grid.units}
    swings = {n for n, bus in grid.buses.items() if bus.kind == SLACK and n in sourced}
    chosen = _chosen(grid, island, parts, swings, sourced)
    _report_left_out(grid, report, [part for part in parts if not part <= chosen], swings)
    if len(chosen) < len(grid.buses):
        _leave_only(grid, chosen)


def _chosen(
    grid: StaticGrid, island: int | str | None, parts: list[set[int]], swings: set[int], sourced: set[int]
) -> set[int]:
    """Return the buses to keep; `island` as in `settle`."""
    if isinstance(island, str) and island != "all":
        raise CaseError(f"{grid.source}: island = {island!r}, allowed: the number of a bus, or all")
    if island == "all" and swings:
        return set().union(*(part for part in parts if swings & part))
    if isinstance(island, int):
        expected = [{grid.alias.get(island, island)}]
        missing = f"island = {island}, allowed: the number of a bus in service"
    else:
        expected = [swings, sourced]
        missing = "no unit in service, allowed: at least one, with a slack bus"
    chosen = _largest_with(expected, parts)
    if not chosen:
        raise CaseError(f"{grid.source}: {missing}")
    return chosen


def _largest_with(swing_parts: list[set[int]], parts: list[set[int]]) -> set[int]:
    """The largest part with a bus of the first set that any part has one of; none if there is no such set."""
    for buses in swing_parts:
        alive = [part for part in parts if buses & part]
        if alive:
            return max(alive, key=len)
    return set()


def _report_left_out(grid: StaticGrid, report: Report, parts: list[set[int]], swings: set[int]) -> None:
    order = {number: k for k, number in enumerate(grid.buses)}
    for part in parts:
        first = grid.buses[min(part, key=order.__getitem__)]
        kind = "with a slack bus of its own" if swings & part else "without a slack bus"
        size = f"island of {len(part)} buses {kind} (bus {first.number})" if len(part) > 1 else f"bus {kind}"
        report.drop(size, first.where)


def _leave_only(grid: StaticGrid, chosen: set[int]) -> None:
    grid.buses = {n: bus for n, bus in grid.buses.items() if n in chosen}
    grid.branches[:] = [b for b in grid.branches if b.first in chosen and b.second in chosen]
    grid.shunts = [row for row in grid.shunts if row.bus in chosen]
    grid.loads = [row for row in grid.loads if row.bus in chosen]
    grid.units = [row for row in grid.units if row.bus in chosen]


def live_islands(grid: StaticGrid) -> list[set[int]]:
    """Return the sets of buses that branches in service connect."""
    return connected_parts(grid.buses, [(b.first, b.second) for b in grid.branches if b.on])


def slacks_of(grid: StaticGrid, report: Report) -> list[StaticBus]:
    """Return the bus that is to balance each island: the first of type 3 with a unit, else that of the
    largest unit."""
    rating: Counter[int] = Counter()
    for unit in grid.units:
        rating[unit.bus] += int(1000.0 * unit.base)
    if not rating:
        raise CaseError(f"{grid.source}: no unit in service in the island, allowed: at least one")
    return [_slack_of(grid, report, part, rating) for part in live_islands(grid)]


def _slack_of(grid: StaticGrid, report: Report, part: set[int], rating: Counter[int]) -> StaticBus:
    sourced = [number for number in rating if number in part]
    swings = [bus for n, bus in grid.buses.items() if bus.kind == SLACK and n in part and n in rating]
    if swings:
        for other in swings[1:]:
            report.assume("another slack bus: holds its stored power", other.where)
        return max(swings, key=lambda bus: rating[bus.number]) if len(swings) > 1 else swings[0]
    bus = grid.buses[max(sourced, key=lambda number: rating[number])]
    report.assume(f"no slack bus: bus {bus.number}, which has the largest units, is used", bus.where)
    return bus
