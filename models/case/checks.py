"""Rules that concern a case as a whole: ids, references, one slack, one connected network."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from ..errors import CaseError, nearest
from .tables import CaseTables


def check_whole(case: CaseTables) -> None:
    """Check ids, references, slack and connection of `case`; ValueError with one line otherwise."""
    for table in ("buses", "branches", "shunts", "loads", "machines"):
        ids = [str(row.number if table == "buses" else row.name) for row in getattr(case, table)]
        twice = [key for key, count in Counter(ids).items() if count > 1]
        if twice:
            raise ValueError(f"{table}: id {twice[0]!r} is given twice, allowed: once")
    _check_references(case)
    _check_slack(case)
    _check_connection(case)
    machines = [m.name for m in case.machines]
    for name in case.swing or ():
        if name not in machines:
            raise ValueError(f"swing: machine {name!r} does not exist; {nearest(name, machines)}")
    if case.swing is not None and case.swing[0] == case.swing[1]:
        raise ValueError(f"swing = {list(case.swing)}, allowed: two machines")


def _check_references(case: CaseTables) -> None:
    known = {bus.number for bus in case.buses}
    for branch in case.branches:
        for key, number in (("from", branch.from_bus), ("to", branch.to_bus)):
            _bus(number, f"branches.{branch.name}.{key}", known)
        if branch.from_bus == branch.to_bus:
            raise ValueError(f"branches.{branch.name}: from = to = {branch.to_bus}, allowed: two buses")
    for table in ("shunts", "loads", "machines"):
        for row in getattr(case, table):
            _bus(row.bus, f"{table}.{row.name}.bus", known)
    if case.tie is None:
        return
    branches = {b.name: b for b in case.branches}
    for name in case.tie.branches:
        if name not in branches:
            raise ValueError(f"tie.branches: branch {name!r} does not exist; {nearest(name, branches)}")
        if case.tie.from_bus not in (branches[name].from_bus, branches[name].to_bus):
            raise ValueError(f"tie.from = {case.tie.from_bus}: branch {name!r} does not end there")


def _bus(number: int, key: str, known: set[int]) -> None:
    if number not in known:
        some = ", ".join(str(k) for k in sorted(known, key=lambda k: abs(k - number))[:3])
        raise ValueError(f"{key} = {number}: no such bus, allowed: the numbers under buses (nearest: {some})")


def _check_slack(case: CaseTables) -> None:
    slacks = [m.name for m in case.machines if m.slack]
    if len(slacks) != 1:
        got = f"{len(slacks)} ({', '.join(slacks)})" if slacks else "none"
        raise ValueError(f"machines: slack = true at {got}, allowed: exactly one machine")
    for bus in {m.bus for m in case.machines}:
        here = [m for m in case.machines if m.bus == bus]
        for other in here[1:]:
            if other.V_pu != here[0].V_pu:
                raise ValueError(
                    f"machines.{other.name}.V_pu = {other.V_pu:g} but {here[0].name} at the same bus {bus} "
                    f"has {here[0].V_pu:g}, allowed: one voltage per bus"
                )


def islands_of(case: CaseTables) -> list[set[int]]:
    """Return the connected sets of buses, the slack's first, under the branches in service."""
    links = [(b.from_bus, b.to_bus) for b in case.branches if b.in_service]
    return connected_parts([case.slack.bus, *(bus.number for bus in case.buses)], links)


def connected_parts(buses: Iterable[int], links: Iterable[tuple[int, int]]) -> list[set[int]]:
    """Return the sets of buses that links connect, each where its first bus stands in `buses`."""
    neighbours: dict[int, list[int]] = {bus: [] for bus in buses}
    for one, other in links:
        neighbours[one].append(other)
        neighbours[other].append(one)
    found: list[set[int]] = []
    seen: set[int] = set()
    for bus in neighbours:
        if bus in seen:
            continue
        island, todo = {bus}, [bus]
        while todo:
            for other in neighbours[todo.pop()]:
                if other not in island:
                    island.add(other)
                    todo.append(other)
        seen |= island
        found.append(island)
    return found


def require_dynamics(case: CaseTables) -> None:
    """Raise CaseError unless every machine of `case` has dynamic data."""
    bare = [m.name for m in case.machines if m.model == "power_flow"]
    if bare:
        raise CaseError(
            f"{case.name}: machines {', '.join(bare[:10])} have no dynamic data (model power_flow), "
            "allowed: round_rotor, classical or infinite_bus; a DYR file or the tables of the case give them"
        )


def _check_connection(case: CaseTables) -> None:
    parts = islands_of(case)
    if len(parts) == 1:
        return
    for machine in case.machines:
        if {machine.bus} in parts:
            raise ValueError(f"machines.{machine.name}: isolated, bus {machine.bus} has no branch in service")
    cut = ", ".join(str(b) for b in sorted(parts[1])[:10])
    raise ValueError(
        f"branches: buses {cut} have no path in service to the slack at bus {case.slack.bus}, "
        "allowed: one connected network"
    )
