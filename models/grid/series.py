"""Variable series capacitors in the plant: each is a node that represents its line's current.

With the series current I = (Vf - Vt)/z of a line, z = r + j(x - xc), a node m of the voltage Vm = -j I obeys

    0 = j Vf - j Vt + z Vm,    If = j Vm,    It = -j Vm :

two branches without admittance to ground, +j between f and m, -j between t and m, and z to ground at m.
Eliminating m gives the line. The variable part is then linear in the state: -j xc at m, a device at a bus.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from ..case.case import Case, CaseError
from ..case.control_schema import Control
from ..case.schema import Branch, Bus, Shunt, Svc, Tcsc
from .network import ComplexArray, bus_index

LEAST_CURRENT_PU = 1e-6  #: of a line at rest: without one its node has no voltage to start from


def compensated(case: Case) -> Case:
    """Return `case` with the initial values of its series capacitors in the reactances of their lines."""
    at = {row.branch: row for row in case.tcscs}
    if not at:
        return case
    branches = tuple(
        b.model_copy(update={"x": b.x - at[b.name].x0_pu}) if b.name in at else b for b in case.branches
    )
    return case.model_copy(update={"branches": branches, "tcscs": ()})


def far_half(branch: str) -> str:
    """Return the name of the branch from the `to` end of a line to its node."""
    return f"{branch} to its capacitor"


def has_series_nodes(case: Case) -> bool:
    """Whether the series capacitors of `case` are nodes."""
    return {row.name for row in case.tcscs} <= {row.name for row in case.svcs}


def series_nodes(case: Case) -> dict[str, int]:
    """Return series capacitor -> number of its node; empty before `with_series_nodes`."""
    names = {row.name for row in case.tcscs}
    return {svc.name: svc.bus for svc in case.svcs if svc.name in names}


def with_series_nodes(case: Case) -> Case:
    """Return `case` with a node, two branches and a device in place of each line with a capacitor."""
    if not case.tcscs or has_series_nodes(case):
        return case
    first = max(bus.number for bus in case.buses) + 1
    at = {row.branch: (row, first + k) for k, row in enumerate(case.tcscs)}
    buses, branches, shunts, svcs = [], list(case.branches), list(case.shunts), list(case.svcs)
    tie = case.tie
    for k, line in enumerate(case.branches):
        if line.name not in at:
            continue
        row, node = at[line.name]
        buses.append(Bus(number=node, name=f"current of {line.name}"))
        end = {"to": node, "x": 1.0, "b": 2.0 + line.b}
        branches[k] = Branch.model_validate({"name": line.name, "from": line.from_bus, **end})
        end = {"to": node, "x": -1.0, "b": -2.0 + line.b}
        branches.append(Branch.model_validate({"name": far_half(line.name), "from": line.to_bus, **end}))
        to_ground = complex(line.r, line.x - line.b) * case.base_mva  # both branches bring half of b there
        shunts.append(
            Shunt(name=f"{row.name} of {line.name}", bus=node, P_mw=to_ground.real, Q_mvar=to_ground.imag)
        )
        svcs.append(_device(case, row, node))
        if tie is not None and line.name in tie.branches and tie.from_bus == line.to_bus:
            renamed = tuple(far_half(name) if name == line.name else name for name in tie.branches)
            tie = tie.model_copy(update={"branches": renamed})
    changed = {"buses": (*case.buses, *buses), "branches": tuple(branches), "shunts": tuple(shunts)}
    return case.model_copy(update={**changed, "svcs": tuple(svcs), "tie": tie})


def without_series_nodes(case: Case) -> Case:
    """Return the argument of `with_series_nodes`."""
    nodes, lines = series_nodes(case), {row.branch: row.name for row in case.tcscs}
    halves = {b.name: b for b in case.branches}
    ground = {s.bus: complex(s.P_mw, s.Q_mvar) / case.base_mva for s in case.shunts}
    branches = tuple(
        _whole(b, halves[far_half(b.name)], ground[nodes[lines[b.name]]]) if b.name in lines else b
        for b in case.branches[: len(case.branches) - len(nodes)]
    )
    tie = case.tie
    if tie is not None:
        original = {far_half(name): name for name in lines}
        tie = tie.model_copy(update={"branches": tuple(original.get(n, n) for n in tie.branches)})
    remaining: dict[str, Any] = {
        "buses": case.buses[: len(case.buses) - len(nodes)],
        "shunts": case.shunts[: len(case.shunts) - len(nodes)],
        "svcs": case.svcs[: len(case.svcs) - len(nodes)],
    }
    return case.model_copy(update={**remaining, "branches": branches, "tie": tie})


def _whole(near: Branch, far: Branch, ground: complex) -> Branch:
    """The line of two halves and the shunt of its node."""
    charging = 0.5 * (near.b + far.b)
    changed = {"to_bus": far.from_bus, "r": ground.real, "x": ground.imag + charging, "b": charging}
    return near.model_copy(update=changed)


def _device(case: Case, row: Tcsc, node: int) -> Svc:
    values = {"T": row.T_s, "XMIN": row.x_min_pu, "XMAX": row.x_max_pu}
    control = Control(kind="tcsc", **values)  # type: ignore[arg-type]
    return Svc(name=row.name, bus=node, base_mva=case.base_mva, control=control)


def node_voltages(case: Case, voltages: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """Return the voltages of the nodes and P + jQ of the devices there, in the order of `tcscs`.

    case : with its nodes. voltages : (buses, or more) of the real buses, which come first.

    Raises
    ------
    CaseError : a line without current.
    """
    index, branches = bus_index(case), {b.name: b for b in case.branches}
    z_of = {s.bus: complex(s.P_mw, s.Q_mvar) / case.base_mva for s in case.shunts}
    at, power = [], []
    nodes = series_nodes(case)
    for row in case.tcscs:
        near, far = branches[row.branch], branches[far_half(row.branch)]
        z = z_of[nodes[row.name]] + 0.5j * (near.b + far.b) - 1j * row.x0_pu
        current = (voltages[index[near.from_bus]] - voltages[index[far.from_bus]]) / z
        if not abs(current) >= LEAST_CURRENT_PU:
            raise CaseError(
                f"{case.name}: tcscs.{row.name}: its line {row.branch!r} carries {abs(current):.2g} pu at "
                f"the equilibrium, allowed: at least {LEAST_CURRENT_PU:g}; change the dispatch, or "
                "remove the device"
            )
        at.append(-1j * current)
        power.append(-1j * row.x0_pu * abs(current) ** 2)
    return np.array(at, dtype=complex), np.array(power, dtype=complex)


def events_of_halves(case: Case, events: Iterable[Any]) -> list[Any]:
    """Return `events` with a second event, of the far half, after each that switches a line with a
    capacitor."""
    lines: Mapping[str, str] = {row.branch: far_half(row.branch) for row in case.tcscs}
    result = []
    for event in events:
        result.append(event)
        branch: str = getattr(event, "branch", "")
        if branch in lines:
            result.append(event.model_copy(update={"branch": lines[branch]}))
    return result
