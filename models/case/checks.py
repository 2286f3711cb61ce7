"""Rules that concern a case as a whole: ids, references, one slack in each network, events' targets."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from ..errors import CaseError, nearest
from .document import ROW_TABLES

if TYPE_CHECKING:  # names are looked up in an `outline` too, before pydantic's models are loaded
    from .schema import Branch, Converter, Machine
    from .tables import CaseTables


#: table of dc links -> keys of its buses
_LINKS = {"hvdcs": ("rectifier_bus", "inverter_bus"), "vscs": ("from_bus", "to_bus")}


def check_whole(case: CaseTables) -> None:
    """Check ids, references, slack and connection of `case`; ValueError with one line otherwise."""
    for table, key in ROW_TABLES.items():
        ids = [str(getattr(row, key)) for row in getattr(case, table)]
        twice = [one for one, count in Counter(ids).items() if count > 1]
        if twice:
            raise ValueError(f"{table}: id {twice[0]!r} is given twice, allowed: once")
    _check_references(case)
    _check_voltages(case)
    _check_svcs(case)
    _check_tcscs(case)
    _check_slacks(case)
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
    for table in ("shunts", "loads", "machines", "svcs", "converters"):
        for row in getattr(case, table):
            _bus(row.bus, f"{table}.{row.name}.bus", known)
    for svc in case.svcs:
        _bus(svc.seen_bus, f"svcs.{svc.name}.regulates", known)
    _check_links(case, known)
    branches = {b.name: b for b in case.branches}
    for row in case.converters:
        _check_measured(row, branches, known)
    if case.tie is None:
        return
    for name in case.tie.branches:
        if name not in branches:
            raise ValueError(f"tie.branches: branch {name!r} does not exist; {nearest(name, branches)}")
        if case.tie.from_bus not in (branches[name].from_bus, branches[name].to_bus):
            raise ValueError(f"tie.from = {case.tie.from_bus}: branch {name!r} does not end there")


def _check_measured(row: Converter, branches: Mapping[str, Branch], known: set[int]) -> None:
    """Check where the plant control of a converter measures."""
    where, control = f"converters.{row.name}", row.control.parameters
    if row.measures_from is not None and row.measures is None:
        raise ValueError(f"{where}: measures_from without measures, allowed: both, or none")
    if row.regulates is None and row.measures is None:
        return
    if row.control.kind == "wecc_converter" and control.get("PLANT") != 1.0:
        raise ValueError(
            f"{where}: regulates or measures without a plant control, allowed: with PLANT = 1; leave them out"
        )
    if row.regulates is not None:
        _bus(row.regulates, f"{where}.regulates", known)
    if row.measures is None:
        if control.get("plant_VCFLAG") == 1.0:
            raise ValueError(
                f"{where}: plant_VCFLAG = 1 takes the drop of a branch's current off the voltage of bus "
                f"{row.regulates}, but there is no branch; give measures, or set plant_VCFLAG to 0"
            )
        return
    branch = branches.get(row.measures)
    if branch is None:
        raise ValueError(
            f"{where}.measures: branch {row.measures!r} does not exist; {nearest(row.measures, branches)}"
        )
    if not branch.in_service:
        raise ValueError(
            f"{where}.measures: branch {row.measures!r} is out of service, allowed: one in service"
        )
    if row.measures_from not in (None, branch.from_bus, branch.to_bus):
        raise ValueError(
            f"{where}.measures_from = {row.measures_from}: branch {row.measures!r} does not end there, "
            f"allowed: {branch.from_bus} or {branch.to_bus}"
        )


def _check_links(case: CaseTables, known: set[int]) -> None:
    for table, keys in _LINKS.items():
        for row in getattr(case, table):
            for key in keys:
                _bus(getattr(row, key), f"{table}.{row.name}.{key}", known)


def _bus(number: int, key: str, known: set[int]) -> None:
    if number not in known:
        own_nearest = ", ".join(str(k) for k in sorted(known, key=lambda k: abs(k - number))[:3])
        raise ValueError(
            f"{key} = {number}: no such bus, allowed: the numbers under buses (nearest: {own_nearest})"
        )


def _check_voltages(case: CaseTables) -> None:
    for bus in {m.bus for m in case.machines}:
        at_bus = [m for m in case.machines if m.bus == bus]
        for other in at_bus[1:]:
            if other.V_pu != at_bus[0].V_pu:
                raise ValueError(
                    f"machines.{other.name}.V_pu = {other.V_pu:g} but {at_bus[0].name} at the same bus {bus} "
                    f"has {at_bus[0].V_pu:g}, allowed: one voltage per bus"
                )


def _check_svcs(case: CaseTables) -> None:
    machines = {m.name: m.bus for m in case.machines}
    regulating: dict[int, Any] = {}
    svcs = {svc.name for svc in case.svcs}
    for row in case.converters:
        if row.name in machines or row.name in svcs:
            raise ValueError(
                f"converters.{row.name}: a machine or an SVC has that name too, allowed: another name"
            )
    _check_link_names(case, {*machines, *svcs, *(row.name for row in case.converters)})
    for svc in case.svcs:
        if svc.name in machines:
            raise ValueError(f"svcs.{svc.name}: a machine has that name too, allowed: another name")
        if svc.control.kind == "tcsc":
            raise ValueError(
                f"svcs.{svc.name}.control.kind = 'tcsc': a series capacitor stands in a branch, "
                "allowed: a row of the table tcscs"
            )
        if svc.V_pu is None:
            continue
        if svc.bus in machines.values():
            raise ValueError(
                f"svcs.{svc.name}.V_pu = {svc.V_pu:g}: a machine holds the voltage of bus {svc.bus}, "
                "allowed: Q_mvar in its place"
            )
        other = regulating.setdefault(svc.bus, svc)
        if other.V_pu != svc.V_pu:
            raise ValueError(
                f"svcs.{svc.name}.V_pu = {svc.V_pu:g} but {other.name} at the same bus {svc.bus} has "
                f"{other.V_pu:g}, allowed: one voltage per bus"
            )


def _check_link_names(case: CaseTables, taken: set[str]) -> None:
    for table in _LINKS:
        for link in getattr(case, table):
            if link.name in taken:
                raise ValueError(
                    f"{table}.{link.name}: a machine or a device has that name too, allowed: another name"
                )
            taken.add(link.name)


def _check_tcscs(case: CaseTables) -> None:
    from .schema import LEFT_OF_LINE

    others: tuple[Any, ...] = (*case.machines, *case.svcs, *case.converters, *case.links)
    taken, branches = {row.name for row in others}, {b.name: b for b in case.branches}
    of: dict[str, str] = {}
    for row in case.tcscs:
        where = f"tcscs.{row.name}"
        if row.name in taken:
            raise ValueError(f"{where}: a machine or a device has that name too, allowed: another name")
        line = branches.get(row.branch)
        if line is None:
            raise ValueError(
                f"{where}.branch: branch {row.branch!r} does not exist; {nearest(row.branch, branches)}"
            )
        if row.branch in of:
            raise ValueError(
                f"{where}.branch = {row.branch!r}: {of[row.branch]} stands there, allowed: one a line"
            )
        of[row.branch] = row.name
        if line.tap != 1.0 or line.shift_deg or not line.x > 0.0:
            raise ValueError(
                f"{where}.branch = {row.branch!r}, allowed: a line, without tap and shift, x above 0"
            )
        if not line.in_service:
            raise ValueError(
                f"{where}.branch = {row.branch!r} is out of service, allowed: one in service; "
                f'take {row.name} out too ({where} = "none")'
            )
        most = (1.0 - LEFT_OF_LINE) * line.x
        if not row.x_max_pu <= most:
            raise ValueError(
                f"{where}.x_max_pu = {row.x_max_pu:g} leaves less than {LEFT_OF_LINE:g} of the line's "
                f"{line.x:g}, allowed: at most {most:g}"
            )


def islands_of(case: CaseTables) -> list[set[int]]:
    """Return the connected sets of buses, each where its first bus stands, under the branches in service."""
    links = [(b.from_bus, b.to_bus) for b in case.branches if b.in_service]
    return connected_parts((bus.number for bus in case.buses), links)


def connected_parts(buses: Iterable[int], links: Iterable[tuple[int, int]]) -> list[set[int]]:
    """Return the sets of buses that links connect, each where its first bus stands in `buses`."""
    neighbours: dict[int, list[int]] = {bus: [] for bus in buses}
    for one, other in links:
        neighbours[one].append(other)
        neighbours[other].append(one)
    components: list[set[int]] = []
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
        components.append(island)
    return components


def require_dynamics(case: CaseTables) -> None:
    """Raise CaseError unless every machine of `case` has dynamic data."""
    bare = [m.name for m in case.machines if m.model == "power_flow"]
    if bare:
        raise CaseError(
            f"{case.name}: machines {', '.join(bare[:10])}{', ...' if len(bare) > 10 else ''} have no "
            "dynamic data (model power_flow), allowed: round_rotor, classical or infinite_bus; a DYR file "
            "(--dyr FILE beside the RAW file) or the tables of the case give them"
        )


def require_one_network(case: CaseTables, what: str) -> None:
    """Raise CaseError where `case` has parts that no branch connects; `what` takes them one by one."""
    parts = islands_of(case)
    if len(parts) > 1:
        first = ", ".join(f"bus {min(part)} of {len(part)}" for part in parts[:3])
        raise CaseError(
            f"{case.name}: {len(parts)} parts that no branch connects ({first}), allowed: one, since {what}; "
            "take one of them, as `interarea import --island BUS` does"
        )


def _check_slacks(case: CaseTables) -> None:
    slacks = [m for m in case.machines if m.slack]
    if not slacks:
        raise ValueError("machines: slack = true at none, allowed: one machine in each connected network")
    parts = islands_of(case)
    for machine in case.machines:
        if {machine.bus} in parts and len(parts) > 1 and not machine.slack:
            raise ValueError(f"machines.{machine.name}: isolated, bus {machine.bus} has no branch in service")
    for part in parts:
        _check_slack_of(part, slacks)


def _check_slack_of(part: set[int], slacks: list[Machine]) -> None:
    of_part = [m.name for m in slacks if m.bus in part]
    if not of_part:
        cut = ", ".join(str(b) for b in sorted(part)[:10])
        raise ValueError(
            f"branches: buses {cut} have no path in service to the slack at bus {slacks[0].bus}, "
            "allowed: one connected network, or a slack in each"
        )
    if len(of_part) > 1:
        raise ValueError(
            f"machines: slack = true at {len(of_part)} ({', '.join(of_part)}), allowed: one machine in each "
            "connected network"
        )


def target_index(case: CaseTables, event: Any) -> int:
    """Return the position of the event's target among the rows of its table in `case`; -1: it is all of them.

    Raises
    ------
    CaseError : no such target (with the nearest names), a bus with none or several loads, a Vref event at a
        machine with constant excitation, a relay whose threshold is the rated frequency.
    """
    if event.kind.startswith("frequency"):
        _check_threshold(case, event)
    kind, event = event.kind, getattr(event, "steady", event)
    if event.kind == "load_noise":
        return -1
    if hasattr(event, "load") and event.bus is not None:
        return _load_at(case, kind, event.bus)
    if event.kind == "bus_fault":
        numbers = [bus.number for bus in case.buses]
        if event.bus not in numbers:
            raise CaseError(
                f"{case.name}: {event.kind}: bus {event.bus} does not exist; {nearest(event.bus, numbers)}"
            )
        return numbers.index(event.bus)
    table = next(t for t in ("branch", "machine", "load", "shunt", "device") if hasattr(event, t))
    rows: Any = (
        (*case.svcs, *case.tcscs, *case.converters, *case.hvdcs, *case.vscs)
        if table == "device"
        else getattr(case, {"branch": "branches"}.get(table, f"{table}s"))
    )
    names = list(
        dict.fromkeys(row.name for row in rows)
    )  # in the plant a series capacitor is among the SVCs too
    name = getattr(event, table)
    _require_target(case, kind, table, name, names)
    if event.kind.startswith("vref") and _excitation(case.machines[names.index(name)]) == "constant":
        raise CaseError(
            f"{case.name}: {kind}: machine {name!r} has constant excitation, so no voltage set-point, "
            "allowed: a machine whose exciter regulates"
        )
    return names.index(name)


def _require_target(case: CaseTables, kind: str, table: str, name: str, names: list[str]) -> None:
    links = [row.name for table in _LINKS for row in getattr(case, table)]
    fit = links if kind == "hvdc_block" else names
    if name in fit:
        return
    if name in names:
        allowed = ", ".join(fit) or "none in this case"
        raise CaseError(f"{case.name}: {kind}: {table} {name!r} is no dc link, allowed: {allowed}")
    raise CaseError(f"{case.name}: {kind}: {table} {name!r} does not exist; {nearest(name, fit)}")


def _excitation(machine: Any) -> Any:
    exciter = getattr(machine, "exciter", None)  # an outline has none where the file has none
    return "constant" if exciter is None else exciter.kind


def _check_threshold(case: CaseTables, event: Any) -> None:
    rated = case.frequency_hz
    if not 0.0 < abs(event.threshold_hz - rated) < rated:
        raise CaseError(
            f"{case.name}: {event.kind}: threshold_hz = {event.threshold_hz:g}, allowed: below the rated "
            f"{rated:g} Hz (under-frequency) or above it and below {2.0 * rated:g} (over-frequency)"
        )


def _load_at(case: CaseTables, kind: str, bus: int) -> int:
    at_bus = [k for k, load in enumerate(case.loads) if load.bus == bus]
    if len(at_bus) != 1:
        buses = sorted({load.bus for load in case.loads})
        raise CaseError(
            f"{case.name}: {kind}: bus {bus} has {len(at_bus)} loads, allowed: one load ({buses}), "
            "or load = NAME"
        )
    return at_bus[0]


def check_events(case: CaseTables, events: Iterable[Any]) -> None:
    """Check that every target exists; what trips cut off is the plant's concern (plant/events/topology.c).

    Raises
    ------
    CaseError : as `target_index`.
    """
    for event in events:
        target_index(case, event)
