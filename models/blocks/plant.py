"""The plant as a block: its variables and the numbers that the C sources read."""

from __future__ import annotations

import html
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..case.case import Case, CaseError
from ..case.checks import check_events, target_index
from ..case.events import slot_count
from ..case.tables import SOLVER_STEP_S
from ..devices.document import devices_html
from ..devices.emit import decisions
from ..devices.header import devices_file, signature
from ..devices.language.device import AT_BUS, NO_LIMIT
from ..devices.language.structure import Model
from ..devices.library import devices_with
from ..grid.bus_devices import port_rest, port_table
from ..grid.control_tables import Group, Parameter
from ..grid.coupling import device_ports
from ..grid.equilibrium import OperatingPoint, operating_point
from ..grid.machine_tables import in_plant_order, machine_table
from ..grid.network import load_power
from ..grid.network_tables import Form, is_reduced, network_pattern, network_tables
from ..grid.series import events_of_halves
from ..grid.sparse_pattern import SparsePattern
from .plant_shown import Shown, shown_of, shown_tables
from .plant_variables import (
    EVENT_CODES,
    WAVE_CODES,
    event_variables,
    input_variables,
    parameter_variable,
    state_variables,
)
from .variables import STEP_PARAMETER, Block, VariableTable

_C_FOLDER = Path(__file__).resolve().parents[1] / "c"
SOURCES = tuple(
    _C_FOLDER / name
    for name in (
        "plant/plant.c",
        "plant/start/tables.c",
        "plant/flow/flow.c",
        "plant/flow/held.c",
        "plant/flow/tile_4.c",
        "plant/flow/tile_8.c",
        "plant/flow/tangent.c",
        "plant/events/event.c",
        "plant/events/wave.c",
        "plant/events/relay.c",
        "plant/events/topology.c",
        "plant/events/sparse_stage.c",
        "plant/network/sparse_factor.c",
        "plant/network/sparse_4.c",
        "plant/network/sparse_port.c",
        "plant/start/failure.c",
        "plant/network/port.c",
        "plant/start/rest.c",
        "block/random.c",
        "block/record.c",
    )
)


def plant_sources(case: Case | None = None) -> tuple[Path, ...]:
    """Return the C files of the plant and the generated header of its devices.

    case : the case of the plant; those without devices of their own share one header, that of the package's.
    """
    if case is None or not case.own_devices:
        return (*SOURCES, devices_file())
    return (*SOURCES, devices_file(case.own_devices.values(), case.device_keys))


#: what FMUs stepped side by side need besides (block/block_group.h)
GROUP_SOURCES = tuple(
    _C_FOLDER / f"plant/lanes/{name}.c"
    for name in ("lanes_2", "lanes_4", "lanes_8", "alike_4", "alike_8", "plant_group")
)

#: kinds of a scenario that are another one without an end
_SAME_AS = {"vref_step": "vref_pulse", "pm_step": "pm_pulse", "load_noise": "load_step"}

_STEP_TEXT = (
    "longest Runge-Kutta step inside a communication step (co-simulation; in model exchange the importer "
    "integrates); it must stay well below 2.78 over the fastest pole, about 2.4 shortest time constants"
)


def default_step_s(point: OperatingPoint) -> float:
    """Return the start value of `solver.step`, s: 1 ms, or the shortest time constant where that is shorter.

    The fastest pole of a grid lies near the inverse of the shortest time constant, and the classical
    Runge-Kutta method is stable up to 2.78 of those. What bounds the step before that, where no time
    constant is short, is the accuracy when limits are reached: 2e-8 pu of dw at 1 ms and 1e-6 at 5 ms in
    the worst of three faults of the 68-bus grid without stabilizers, 95 switches in 3 s.
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
        "Accuracy is of fourth order, also where limits of exciters, stabilizers and governors are reached "
        "or left: such steps are divided there. Halve the step to check the error.</p>"
        "<p>In model exchange each condition of a limiter, gate or other switch is an event indicator. After "
        "the first request of indicators, limiters switch in event mode only; without one they switch by "
        "themselves.</p>"
    )


def _controls(point: OperatingPoint) -> dict[str, str]:
    """What the FMU's documentation says about the controls in use."""
    models = {d.key: d.rest.instance.model for d in point.controls.devices}
    return {"Controls": devices_html(model.device for model in models.values())} if models else {}


def plant_block(
    case: Case,
    *,
    event_slots: int = 8,
    show: Sequence[str] | None = None,
    more: Sequence[str] = (),
    network: Form | None = None,
    point: OperatingPoint | None = None,
) -> Block:
    """Return the plant of `case` as a block with `event_slots` slots for events, after those of its own.

    Inputs `G1_vs` .. (pu, at the exciter's summing point), then `svc1_v_mod` .. of devices at buses;
    outputs per machine `G1_dw` (pu speed deviation),
    `G1_delta` (rad, against the centre of inertia), `G1_pe` (pu on the base of the case), `G1_vt` (pu), then
    `tie_p`; locals: bus voltages, field voltages, mechanical powers; parameters: gains, times and limits
    of the controls, which keep the equilibrium, `solver.step` (start: the case's `solver_step_s`, else
    `default_step_s`) and the event slots, the first of which hold the events of the case, such as its
    relays. A slot that is set anew while the plant runs counts from the next event on. `show`: patterns of
    the outputs wanted, see `shown_of`, which also says what a large grid shows without; `more`: of outputs
    beside those. `network`: solve it so whatever that costs; else the cheaper
    form is taken. `point`: of the case in the plant's order, where it is known.

    Raises
    ------
    CaseError : anything in the case that the plant does not model; see `operating_point`.
    """
    if not 0 <= event_slots <= 1000:
        raise CaseError(f"{case.name}: event_slots = {event_slots}, allowed: 0 to 1000")
    original, case = case, in_plant_order(case)
    point = operating_point(case) if point is None else point
    step_s = default_step_s(point) if case.solver_step_s is None else case.solver_step_s
    groups = point.controls.running()
    place = {
        id(d): (g, k) for g, (group, _) in enumerate(groups, start=1) for k, d in enumerate(group.devices)
    }
    parameters = [(*place[id(d)], parameter) for d in point.controls.devices for parameter in d.parameters()]
    # of no group: the FMI layer reads it, the plant does not
    parameters.append((0, 0, Parameter(STEP_PARAMETER, 0, "s", _STEP_TEXT, *SOLVER_STEP_S, value=step_s)))
    shown = shown_of(case, show, more)
    variables = state_variables(point) + input_variables(point) + [s.variable for s in shown]
    variables += [parameter_variable(parameter) for *_, parameter in parameters]
    event_slots += _own_slots(case) + 2 * len(case.tcscs)  # a trip and a closing of each line more
    variables += event_variables(event_slots, _slot_values(case, case.events, 1))
    return Block(
        kind="plant",
        name=_identifier(case.name),
        description=case.title or case.name,
        table=VariableTable(variables),
        data=_data(case, point, parameters, event_slots, shown, network),
        sources=plant_sources(case),
        event_indicators=sum(decisions(d.rest.instance.model) for group, _ in groups for d in group.devices),
        documentation={
            "Integration": _integration(point, step_s),
            "Events": event_numbers_html(case),
            **_controls(point),
        },
        provenance={"case": case.name, "case hash": original.hash, "source": case.source},
    )


def event_parameters(case: Case, events: Iterable[Any]) -> dict[str, float | int]:
    """Return start values of the parameters `event[k].*` for `events` of models.events.

    k counts on from the events of the case, whose slots stay as they are.

    Raises
    ------
    CaseError : a target that does not exist (with the nearest names).
    """
    case = in_plant_order(case)
    return _slot_values(case, list(events), _own_slots(case) + 1)


def _own_slots(case: Case) -> int:
    return slot_count(events_of_halves(case, case.events))


def _slot_values(case: Case, events: Sequence[Any], first: int) -> dict[str, float | int]:
    check_events(case, events)
    events = events_of_halves(case, events)
    each = [(event, wave) for event in events for wave in getattr(event, "waves", (("steady", 0.0, 1.0),))]
    values: dict[str, float | int] = {}
    for k, (event, (wave, frequency_hz, share)) in enumerate(each, start=first):
        acts = getattr(event, "steady", event)
        kind = _SAME_AS.get(acts.kind, acts.kind)
        end = getattr(event, "end_s", None)
        size, size_q = _event_size(case, acts)
        values |= {
            f"event[{k}].kind": EVENT_CODES[kind],
            f"event[{k}].target": target_index(case, event) + 1,
            f"event[{k}].wave": WAVE_CODES[wave],
            f"event[{k}].seed": getattr(event, "seed", 0),
            f"event[{k}].start": event.start_s,
            f"event[{k}].end": NO_LIMIT if end is None else end,
            f"event[{k}].size": share * size,
            f"event[{k}].size_q": share * size_q,
            f"event[{k}].r": getattr(event, "r_pu", 0.0),
            f"event[{k}].x": getattr(event, "x_pu", 0.0),
            f"event[{k}].rise": getattr(event, "rise_s", 0.0),
            f"event[{k}].threshold": getattr(event, "threshold_hz", 0.0),
            f"event[{k}].delay": getattr(event, "delay_s", 0.0),
            f"event[{k}].breaker": getattr(event, "breaker_s", 0.0),
            f"event[{k}].filter": getattr(event, "filter_s", 0.0),
            f"event[{k}].frequency": frequency_hz,
        }
    return values


def _event_size(case: Case, event: Any) -> tuple[float, float]:
    if event.kind == "shunt_switch":
        return (1.0 if event.to == "in" else 0.0), 0.0
    if event.kind not in ("load_step", "frequency_shed"):
        return float(getattr(event, "size_pu", 0.0)), 0.0
    if event.size_pu is None:
        return event.p_pu or 0.0, event.q_pu or 0.0
    share = event.size_pu if event.kind == "load_step" else -event.size_pu
    change = share * load_power(case, case.loads[target_index(case, event)])
    return change.real, change.imag


def _identifier(name: str) -> str:
    text = re.sub(r"\W", "_", name)
    return text if text[:1].isalpha() else f"case_{text}"


def _parameter_arrays(parameters: list[tuple[int, int, Parameter]]) -> dict[str, Any]:
    """Return where in the tables of devices each parameter stands, with its range and name."""
    tables, devices, rows = zip(*parameters, strict=True) if parameters else ((), (), ())
    return {
        "parameter.table": _int(tables),
        "parameter.device": _int(devices),
        "parameter.row": _int(p.row for p in rows),
        "parameter.range": np.array([[p.low for p in rows], [p.high for p in rows]], dtype=float),
        "parameter.names": _lines(p.name for p in rows),
    }


def has_sparse_network(case: Case, point: OperatingPoint) -> bool:
    """Whether the plant of `case` solves its network by sparse factors, and not by a dense product."""
    return _ports_and_pattern(case, point)[1] is not None


def _ports_and_pattern(
    case: Case, point: OperatingPoint, network: Form | None = None
) -> tuple[npt.NDArray[np.float64], SparsePattern | None]:
    at_buses = point.controls.at_buses
    couplings = [(d.word, d.coupling()) for d in at_buses]
    devices = device_ports(case, couplings, point.state_names, [d.rest.signals for d in at_buses])
    ports = port_table(case, point.load_volts, list(range(len(case.machines))), list(point.gaps), devices)
    return ports, network_pattern(case, ports, network)


def _data(
    case: Case,
    point: OperatingPoint,
    parameters: list[tuple[int, int, Parameter]],
    slots: int,
    shown: Sequence[Shown],
    network: Form | None,
) -> dict[str, Any]:
    ports, pattern = _ports_and_pattern(case, point, network)
    seen = shown_tables(case, shown, ports)
    ties = len(case.tie.branches) if case.tie else 0
    sixth = sum(m.model == "round_rotor" for m in case.machines)
    counts = [len(case.machines), sixth, len(case.buses), len(case.branches), len(case.loads)]
    groups = point.controls.running()
    after = ("exciter", *AT_BUS)  # these take inputs
    before = sum(group.devices[0].word not in after for group, _ in groups)
    counts += [len(groups), before, ties, slots]
    counts += [len(case.shunts), len(parameters), len(ports)]
    if pattern is None:
        counts += [0, 0, 0, 0]
    else:
        reduced = is_reduced(pattern, len(case.machines), len(ports), network)
        counts += [len(pattern.row), pattern.fill, pattern.first, int(reduced)]
    counts += [len(seen["tie.branch"]) - ties, len(case.at_buses)]
    arrays: dict[str, Any] = {
        "plant.counts": _int(counts),
        "plant.base": np.array([case.omega_b, case.base_mva]),
        "machine.table": machine_table(case, point.machines),
        "bus.names": _lines(str(b.number) for b in case.buses),
        "branch.names": _lines(b.name for b in case.branches),
        "machine.names": _lines(case.places),
        "port.table": ports,
        "port.rest": port_rest(
            case, point.power_flow.voltages, point.gaps, [m.delta for m in point.machines]
        ),
        "state.machine": _int(_machine_of_states(case, point)),
        "output.state": _int(_states_of_outputs(case, point, shown)),
        **_parameter_arrays(parameters),
    }
    first = len(point.states) - len(point.controls.states())
    arrays |= seen | network_tables(case, point.load_volts, ports, pattern)
    return arrays | _group_arrays(point, groups, first, case.own_devices)


def _states_of_outputs(case: Case, point: OperatingPoint, shown: Sequence[Shown]) -> list[int]:
    """Of each output the state that it is, -1 where it is none; read by the FMI layer."""
    places = {name: k for k, name in enumerate(point.state_names)}
    outputs = [s for s in shown if s.variable.role == "output"]
    return [places[f"{case.machines[s.of].name}.slip"] if s.kind == "dw" else -1 for s in outputs]


def _machine_of_states(case: Case, point: OperatingPoint) -> list[int]:
    position = {name: k for k, name in enumerate(case.places)}
    return [position[name.split(".")[0]] for name in point.state_names]


def _group_arrays(
    point: OperatingPoint, groups: tuple[tuple[Group, int], ...], first: int, own: Mapping[str, Model]
) -> dict[str, Any]:
    """Groups of devices in the order in which they run; `first`: place of the first state of a device."""
    numbers = {key: k for k, key in enumerate(devices_with(own))}
    provided = [group.table.ravel() for group, _ in groups]
    return {
        "group.device": _int(numbers[group.key] for group, _ in groups),
        "group.count": _int(len(group.devices) for group, _ in groups),
        "group.has": np.array([float(group.has) for group, _ in groups]),
        "group.state": _int(first + place for _, place in groups),
        "device.machine": _int(d.place for group, _ in groups for d in group.devices),
        "device.table": np.concatenate(provided) if provided else np.zeros(0),
        "device.signature": _int([signature(own.values())]),
        "input.machine": _int(i.place for i in point.controls.inputs),
        "machine.rest": point.controls.seen,
        "state.rest": point.x0,
    }


def _int(values: Iterable[int]) -> npt.NDArray[np.int32]:
    return np.array([int(v) for v in values], dtype=np.int32)


def _lines(names: Iterable[str]) -> bytes:
    """One name a line, zero at the end, as C reads it."""
    return "\n".join(names).encode("ascii", "replace") + b"\0"


#: what an event acts on -> rows of the case, and which kinds of event act on it
_ACTS_ON = {
    "bus": ("buses", "bus_fault"),
    "branch": ("branches", "branch_trip, branch_reclose"),
    "machine": ("machines", "vref_pulse, pm_pulse, machine_trip, frequency_trip"),
    "load": ("loads", "load_step, frequency_shed"),
    "shunt": ("shunts", "shunt_switch"),
    "device": ("at_buses", "device_trip, hvdc_block"),
}


def event_numbers(case: Case) -> dict[str, list[str]]:
    """Return what there is to act on -> names in the order of their numbers, which begin at 1.

    case : with its machines as the plant has them (`in_plant_order`).
    """
    return {
        what: [str(row.number if what == "bus" else row.name) for row in getattr(case, table)]
        for what, (table, _) in _ACTS_ON.items()
    }


def event_numbers_html(case: Case) -> str:
    """Return the table as HTML."""
    rows = "".join(_row(what, names) for what, names in event_numbers(case).items() if names)
    return (
        "<p><code>event[k].target</code> is the number, from 1, of what an event slot acts on.</p>"
        f"<table><tr><th>kind</th><th>target</th><th>numbers</th></tr>{rows}</table>"
    )


def _row(what: str, names: Sequence[Any]) -> str:
    listed = ", ".join(f"{k}&nbsp;=&nbsp;{html.escape(name)}" for k, name in enumerate(names, start=1))
    return f"<tr><td>{_ACTS_ON[what][1]}</td><td>{what}</td><td>{listed}</td></tr>"
