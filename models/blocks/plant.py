"""The plant as a block: its variables and the numbers that the C sources read."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..case.case import Case, CaseError
from ..case.event_targets import check_events, target_index
from ..case.tables import SOLVER_STEP_S
from ..devices.document import devices_html
from ..devices.header import library_header, signature
from ..devices.language.device import NO_LIMIT
from ..devices.library import library
from ..grid.bus_devices import port_table
from ..grid.control_tables import Group, Parameter
from ..grid.equilibrium import OperatingPoint, operating_point
from ..grid.machine_tables import in_plant_order, machine_table, network_states
from ..grid.network import branch_stamp, bus_index, load_power, machine_bus_index, shunt_admittance
from .variables import STEP_PARAMETER, Block, Enumeration, Variable, VariableTable

_HERE = Path(__file__).resolve().parents[1] / "c"
SOURCES = tuple(
    _HERE / name
    for name in (
        "plant/plant.c",
        "plant/tables.c",
        "plant/flow.c",
        "plant/tangent.c",
        "plant/event.c",
        "plant/topology.c",
        "plant/failure.c",
        "plant/port.c",
        "plant/rest.c",
        "block/record.c",
    )
)


def plant_sources() -> tuple[Path, ...]:
    """Return the C files of the plant and the generated header of its devices."""
    return (*SOURCES, library_header())


#: what FMUs stepped side by side need besides (block/block_group.h)
GROUP_SOURCES = tuple(_HERE / f"plant/{name}.c" for name in ("lanes_2", "lanes_4", "lanes_8", "plant_group"))

#: Value of each kind in the FMI enumeration; plant/event.h counts alike.
EVENT_CODES = {
    "none": 0,
    "bus_fault": 1,
    "branch_trip": 2,
    "branch_reclose": 3,
    "vref_pulse": 4,
    "load_step": 5,
    "pm_pulse": 6,
    "machine_trip": 7,
    "shunt_switch": 8,
}
_EVENT_WORDS = {
    "none": "slot not in use",
    "bus_fault": "three-phase fault at a bus through r + jx",
    "branch_trip": "branch opens at start, closes at end",
    "branch_reclose": "branch closes at start",
    "vref_pulse": "voltage set-point of a machine raised by size",
    "load_step": "size + j size_q added to a load at its operating voltage, of its characteristic",
    "pm_pulse": "mechanical power of a machine raised by size (machine base)",
    "machine_trip": "machine disconnected at start",
    "shunt_switch": "shunt switched in (size = 1) or out (size = 0), back at end",
}
#: kinds of a scenario that are another one without an end
_SAME_AS = {"vref_step": "vref_pulse", "pm_step": "pm_pulse"}
EVENT_REALS = ("start", "end", "size", "size_q", "r", "x")


_STEP_TEXT = (
    "longest Runge-Kutta step inside a communication step (co-simulation; in model exchange the importer "
    "integrates); it must stay well below 2.78 over the fastest pole, about 2.4 shortest time constants"
)


def default_step_s(point: OperatingPoint) -> float:
    """Return the start value of `solver.step`, s: 1 ms, or the shortest time constant where that is shorter.

    The fastest pole of a grid lies near the inverse of the shortest time constant, and the classical
    Runge-Kutta method is stable up to 2.78 of those. What bounds the step before that, where no time
    constant is short, is the accuracy when limits are reached: about 1e-7 pu of dw through a fault at
    1 ms (2e-6 at worst), 1e-5 to 3e-4 at 10 ms, though 1e-8 as long as no limit is reached.
    """
    return max(min(0.001, shortest_time_s(point)), SOLVER_STEP_S[0])


def shortest_time_s(point: OperatingPoint) -> float:
    """Return the shortest time constant of the controls and of the machines' dampers, s."""
    machines = [m for m in point.case.machines if not m.has_constant_emf]
    dampers = [m.number(key) for m in machines for key in ("Td02", "Tq02")]
    return min([s.time_s for s in point.states] + dampers, default=math.inf)


def _integration(point: OperatingPoint, step_s: float) -> str:
    """What the FMU's documentation says about its steps."""
    shortest = shortest_time_s(point)
    return (
        f"<p>In co-simulation the plant takes Runge-Kutta steps of at most <code>{STEP_PARAMETER}</code>, "
        f"{step_s:g} s unless set otherwise. The shortest time constant of this grid is {shortest:g} s: "
        f"steps up to about {2.4 * shortest:.2g} s are stable, less if a parameter makes a control faster. "
        "Accuracy is of fourth order while no limit of an exciter or stabilizer is reached and of first "
        "order when one is: compare with half the step where it matters.</p>"
    )


def _controls(point: OperatingPoint) -> dict[str, str]:
    """What the FMU's documentation says about the controls in use."""
    keys = dict.fromkeys(d.key for d in point.controls.devices)
    return {"Controls": devices_html(library()[key].device for key in keys)} if keys else {}


def plant_block(case: Case, *, event_slots: int = 8) -> Block:
    """Return the plant of `case` as a block with `event_slots` slots for events.

    Inputs `G1_vs` .. (pu, at the exciter's summing point); outputs per machine `G1_dw` (pu speed deviation),
    `G1_delta` (rad, against the centre of inertia), `G1_pe` (pu on the base of the case), `G1_vt` (pu), then
    `tie_p`; locals: bus voltages, field voltages, mechanical powers; parameters: gains, times and limits
    of the controls, which keep the equilibrium, `solver.step` (start: the case's `solver_step_s`, else
    `default_step_s`) and the event slots. A slot that is set anew while the plant runs counts from the next
    event on.

    Raises
    ------
    CaseError : anything in the case that the plant does not model; see `operating_point`.
    """
    if not 0 <= event_slots <= 1000:
        raise CaseError(f"{case.name}: event_slots = {event_slots}, allowed: 0 to 1000")
    original, case = case, in_plant_order(case)
    point = operating_point(case)
    step_s = default_step_s(point) if case.solver_step_s is None else case.solver_step_s
    groups = point.controls.running()
    place = {
        id(d): (g, k) for g, (group, _) in enumerate(groups, start=1) for k, d in enumerate(group.devices)
    }
    parameters = [(*place[id(d)], parameter) for d in point.controls.devices for parameter in d.parameters()]
    # of no group: the FMI layer reads it, the plant does not
    parameters.append((0, 0, Parameter(STEP_PARAMETER, 0, "s", _STEP_TEXT, *SOLVER_STEP_S, value=step_s)))
    variables = _states(point) + _inputs(point) + _outputs(case) + _locals(case)
    variables += [_parameter_variable(parameter) for *_, parameter in parameters]
    variables += _event_variables(event_slots)
    return Block(
        kind="plant",
        name=_identifier(case.name),
        description=case.title or case.name,
        table=VariableTable(variables),
        data=_data(case, point, parameters, event_slots),
        sources=plant_sources(),
        documentation={"Integration": _integration(point, step_s)} | _controls(point),
        provenance={"case": case.name, "case hash": original.hash, "source": case.source},
    )


def event_parameters(case: Case, events: Iterable[Any]) -> dict[str, float | int]:
    """Return start values of the parameters `event[k].*` (k from 1) for `events` of models.events.

    Raises
    ------
    CaseError : a target that does not exist (with the nearest names), trips that cut the network in pieces.
    """
    events, case = list(events), in_plant_order(case)
    check_events(case, events)
    values: dict[str, float | int] = {}
    for k, event in enumerate(events, start=1):
        code = EVENT_CODES[_SAME_AS.get(event.kind, event.kind)]
        end = getattr(event, "end_s", None)
        size, size_q = _event_size(case, event)
        values |= {
            f"event[{k}].kind": code,
            f"event[{k}].target": target_index(case, event) + 1,
            f"event[{k}].start": event.start_s,
            f"event[{k}].end": NO_LIMIT if end is None else end,
            f"event[{k}].size": size,
            f"event[{k}].size_q": size_q,
            f"event[{k}].r": getattr(event, "r_pu", 0.0),
            f"event[{k}].x": getattr(event, "x_pu", 0.0),
        }
    return values


def _event_size(case: Case, event: Any) -> tuple[float, float]:
    if event.kind == "shunt_switch":
        return (1.0 if event.to == "in" else 0.0), 0.0
    if event.kind != "load_step":
        return float(getattr(event, "size_pu", 0.0)), 0.0
    if event.size_pu is None:
        return event.p_pu or 0.0, event.q_pu or 0.0
    change = event.size_pu * load_power(case, case.loads[target_index(case, event)])
    return change.real, change.imag


def _identifier(name: str) -> str:
    text = re.sub(r"\W", "_", name)
    return text if text[:1].isalpha() else f"case_{text}"


def _states(point: OperatingPoint) -> list[Variable]:
    states = [
        Variable(s.name, "state", s.description, unit=s.unit, start=s.start, nominal=1.0)
        for s in point.states
    ]
    order = {name: k for k, name in enumerate((*point.state_names, *point.input_names))}
    rate = {"rad": "rad/s", "pu": "pu/s"}
    derivatives = [
        Variable(
            f"der({s.name})",
            "derivative",
            f"rate of {s.name}",
            unit=rate[s.unit],
            derivative_of=s.name,
            depends_on=tuple(sorted(s.depends_on, key=order.__getitem__)),
        )
        for s in point.states
    ]
    return states + derivatives


def _inputs(point: OperatingPoint) -> list[Variable]:
    return [
        Variable(name, "input", "added at the exciter's summing point", unit="pu", start=0.0)
        for name in point.input_names
    ]


def _outputs(case: Case) -> list[Variable]:
    network = tuple(sorted(network_states(case)))
    angles = tuple(f"{m.name}.delta" for m in case.machines)
    outputs = []
    for m in case.machines:
        outputs += [
            _output(f"{m.name}_dw", "pu", "speed deviation", (f"{m.name}.slip",)),
            _output(f"{m.name}_delta", "rad", "rotor angle to the centre of inertia", angles),
            _output(f"{m.name}_pe", "pu", "active power at the terminals, base of the case", network),
            _output(f"{m.name}_vt", "pu", "terminal voltage", network),
        ]
    if case.tie is not None:
        text = (
            f"active power from bus {case.tie.from_bus} over {', '.join(case.tie.branches)}, base of the case"
        )
        outputs.append(_output("tie_p", "pu", text, network))
    return outputs


def _output(name: str, unit: str, description: str, depends_on: tuple[str, ...]) -> Variable:
    return Variable(name, "output", description, unit=unit, depends_on=depends_on)


def _locals(case: Case) -> list[Variable]:
    values = [
        Variable(f"bus{bus.number}.v", "local", f"voltage magnitude of bus {bus.number}", unit="pu")
        for bus in case.buses
    ]
    for m in case.machines:
        values.append(Variable(f"{m.name}.Efd", "local", "field voltage", unit="pu"))
        values.append(Variable(f"{m.name}.Pm", "local", "mechanical power, machine base", unit="pu"))
    return values


def _parameter_variable(parameter: Parameter) -> Variable:
    return Variable(
        parameter.name,
        "parameter",
        parameter.description,
        unit=parameter.unit,
        start=parameter.value,
        min=parameter.low,
        max=parameter.high,
    )


def _event_variables(slots: int) -> list[Variable]:
    items = tuple((name, code, _EVENT_WORDS[name]) for name, code in EVENT_CODES.items())
    kind = Enumeration("EventKind", items)
    texts = {
        "start": ("s", "start time", 0.0),
        "end": ("s", "end time; 1e30: no end", NO_LIMIT),
        "size": ("pu", "size of the step", 0.0),
        "size_q": ("pu", "reactive part of a load step", 0.0),
        "r": ("pu", "fault resistance", 0.0),
        "x": ("pu", "fault reactance", 1e-4),
    }
    variables = []
    for k in range(1, slots + 1):
        for key, (unit, text, start) in texts.items():
            name = f"event[{k}].{key}"
            variables.append(Variable(name, "parameter", text, unit=unit, start=start, tunable=True))
        name = f"event[{k}].kind"
        variables.append(
            Variable(
                name,
                "parameter",
                "what happens",
                type="Enumeration",
                start=0,
                enumeration=kind,
                tunable=True,
            )
        )
        text = (
            "number of the bus, branch, machine, load or shunt in the case, from 1; classical machines last"
        )
        name = f"event[{k}].target"
        variables.append(Variable(name, "parameter", text, type="Integer", start=1, tunable=True))
    return variables


def _data(
    case: Case,
    point: OperatingPoint,
    parameters: list[tuple[int, int, Parameter]],
    slots: int,
) -> dict[str, Any]:
    index = bus_index(case)
    branches = case.tie.branches if case.tie else ()
    tie = [next(k for k, b in enumerate(case.branches) if b.name == name) for name in branches]
    ends = [int(case.branches[k].from_bus != case.tie.from_bus) for k in tie] if case.tie else []
    sixth = sum(m.model == "round_rotor" for m in case.machines)
    counts = [len(case.machines), sixth, len(case.buses), len(case.branches), len(case.loads)]
    groups = point.controls.running()
    before = sum(group.devices[0].word != "exciter" for group, _ in groups)
    counts += [len(groups), before, len(tie), slots]
    ports = port_table(case, point.load_volts, list(range(len(case.machines))), list(point.gaps))
    counts += [len(case.shunts), len(parameters), len(ports)]
    shunts = np.array([shunt_admittance(case, s) for s in case.shunts], dtype=complex)
    at_bus = np.zeros(len(case.buses), dtype=complex)
    for shunt, value in zip(case.shunts, shunts, strict=True):
        if shunt.in_service:
            at_bus[index[shunt.bus]] += value
    stamps = np.array([branch_stamp(b).ravel() for b in case.branches], dtype=complex).reshape(-1, 4)
    loads = [load_power(case, row) * row.in_service for row in case.loads]
    arrays: dict[str, Any] = {
        "plant.counts": _int(counts),
        "plant.base": np.array([case.omega_b, case.base_mva]),
        "machine.table": machine_table(case, point.machines),
        "machine.bus": machine_bus_index(case),
        "branch.from": _int(index[b.from_bus] for b in case.branches),
        "branch.to": _int(index[b.to_bus] for b in case.branches),
        "branch.status": _int(b.in_service for b in case.branches),
        "branch.table": np.stack([stamps.real, stamps.imag], axis=2).reshape(len(stamps), 8).T,
        "bus.shunt": np.array([at_bus.real, at_bus.imag]),
        "shunt.bus": _int(index[s.bus] for s in case.shunts),
        "shunt.status": _int(s.in_service for s in case.shunts),
        "shunt.table": np.array([shunts.real, shunts.imag]),
        "load.bus": _int(index[row.bus] for row in case.loads),
        "load.table": np.array([np.real(loads), np.imag(loads), point.load_volts], dtype=float),
        "bus.names": _lines(str(b.number) for b in case.buses),
        "branch.names": _lines(b.name for b in case.branches),
        "machine.names": _lines(m.name for m in case.machines),
        "port.table": ports,
        "state.machine": _int(_machine_of_states(case, point)),
        "output.state": _int(_states_of_outputs(case, point)),
        "tie.branch": _int(tie),
        "tie.end": _int(ends),
        "parameter.table": _int(table for table, _, _ in parameters),
        "parameter.device": _int(k for _, k, _ in parameters),
        "parameter.row": _int(p.row for *_, p in parameters),
        "parameter.range": np.array(
            [[p.low for *_, p in parameters], [p.high for *_, p in parameters]], dtype=float
        ),
        "parameter.names": _lines(p.name for *_, p in parameters),
    }
    first = len(point.states) - len(point.controls.states())
    return arrays | _group_arrays(point, groups, first)


def _states_of_outputs(case: Case, point: OperatingPoint) -> list[int]:
    """Of each output the state that it is, -1 where it is none; read by the FMI layer."""
    state_of = {f"{m.name}_dw": point.state_names.index(f"{m.name}.slip") for m in case.machines}
    return [state_of.get(variable.name, -1) for variable in _outputs(case)]


def _machine_of_states(case: Case, point: OperatingPoint) -> list[int]:
    position = {m.name: k for k, m in enumerate(case.machines)}
    return [position[name.split(".")[0]] for name in point.state_names]


def _group_arrays(point: OperatingPoint, groups: tuple[tuple[Group, int], ...], first: int) -> dict[str, Any]:
    """Groups of devices in the order in which they run; `first`: place of the first state of a device."""
    numbers = {key: k for k, key in enumerate(library())}
    given = [group.table.ravel() for group, _ in groups]
    return {
        "group.device": _int(numbers[group.key] for group, _ in groups),
        "group.count": _int(len(group.devices) for group, _ in groups),
        "group.has": _int(group.has for group, _ in groups),
        "group.state": _int(first + place for _, place in groups),
        "device.machine": _int(d.machine for group, _ in groups for d in group.devices),
        "device.table": np.concatenate(given) if given else np.zeros(0),
        "device.signature": _int([signature()]),
        "input.machine": _int(d.machine for d in point.controls.of("exciter")),
        "machine.rest": point.controls.seen,
        "state.rest": point.x0,
    }


def _int(values: Iterable[int]) -> npt.NDArray[np.int32]:
    return np.array([int(v) for v in values], dtype=np.int32)


def _lines(names: Iterable[str]) -> bytes:
    """One name a line, zero at the end, as C reads it."""
    return "\n".join(names).encode("ascii", "replace") + b"\0"
