"""The controls of a case in the layout of the C plant: groups of one device and structure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..case.case import Case, CaseError
from ..case.control_schema import Control, control_model, control_numbers
from ..case.hvdc_schema import Hvdc
from ..case.vsc_schema import Vsc
from ..devices.c_expression import parameter_rows
from ..devices.language.device import AT_BUS, KINDS, OF_CONVERTER, OF_LINK, OF_MACHINE, OF_SVC
from ..devices.language.expression import Node
from ..devices.language.structure import Model
from ..devices.rest import BEYOND, RestPoint, rest_of
from ..errors import DeviceError
from .coupling import AtRest, Coupling, coupling_of, model_at_bus, output_and_signals
from .machine_tables import NETWORK, MachinePoint, State
from .vsc_link import link_modulations

SHORTEST_S = 1e-6  #: least value a time constant may be set to
#: order of states, inputs and parameters
NUMBERED = ("exciter", "stabilizer", "compensator", "limiter", "governor", *AT_BUS)
#: what a device sees at the operating point, in the order of R_* of plant/numbers/layout.h
SEEN = ("vt", "vd", "vq", "id", "iq", "pe", "ifd", "vc", "vs", "pm", "efd", "out")


@dataclass(frozen=True)
class Parameter:
    """One number of a device that a user may change without losing the equilibrium."""

    name: str
    row: int
    unit: str
    description: str
    low: float
    high: float
    value: float


@dataclass(frozen=True)
class Device:
    """A control at its equilibrium; `output`: the states and inputs that determine its output."""

    word: str  #: exciter, stabilizer, ...
    place: int  #: of its machine or, after all machines, of the device at a bus
    prefix: str
    rest: RestPoint
    states: tuple[State, ...]
    output: frozenset[str]

    @property
    def key(self) -> str:
        """Name of its kind."""
        return self.rest.instance.model.device.key

    @property
    def has(self) -> int:
        """Its structure."""
        return self.rest.instance.has

    def column(self) -> list[float]:
        """Its column of the group's table."""
        return [self.rest.instance.values[row] for row in parameter_rows(self.rest.instance.model)]

    def parameters(self) -> Iterator[Parameter]:
        """Parameters that a user may change: active ones without effect on the structure; none of converters
        or links.

        These have several set-points, of which the plant would recompute only one.
        """
        if self.word in (*OF_CONVERTER, *OF_LINK):
            return
        instance = self.rest.instance
        device, used = instance.model.device, instance.used() - self._coupling_names()
        for row, p in enumerate(device.parameters):
            value = instance.values[p.name]
            conditions = [c for c in instance.model.bits if p.name in c.names]
            if p.name not in used or any(
                c.args[0] != Node("name", name=p.name) or c.op not in (">", "!=") for c in conditions
            ):
                continue
            if conditions and not value > 0.0:
                continue  # what is absent stays so
            low = max(p.low, SHORTEST_S) if p.open or conditions else p.low
            yield Parameter(f"{self.prefix}.{p.name}", row, _unit(p.unit), p.text, low, p.high, value)

    def coupling(self) -> Coupling:
        """Return how the output of a device at a bus follows from its state."""
        return coupling_of(self.rest.instance)

    def _coupling_names(self) -> set[str]:
        """Of a device at a bus the names in its output: the port is made with their values."""
        device = self.rest.instance.model.device
        lines = (line for line in device.lines if self.word in AT_BUS and line.name == device.output)
        return {name for line in lines if not line.element for name in line.node.names}


def _unit(unit: str) -> str:
    return {"MVA": "1"}.get(unit, unit)


@dataclass(frozen=True)
class Unrest:
    """A control without an equilibrium: its device, parameters and input values.

    `word` is the control of a machine, "control" of a device at a bus.
    """

    row: str  #: name of its machine, or its own at a bus
    word: str
    model: Model
    numbers: dict[str, float | str]
    seen: dict[str, float]
    output: float | None
    who: str
    error: DeviceError


class StartError(CaseError):
    """Controls without an equilibrium at the operating point."""

    def __init__(self, unrest: list[Unrest]) -> None:
        more = f" (and {len(unrest) - 1} more: interarea modes CASE --margins)" if len(unrest) > 1 else ""
        super().__init__(f"{unrest[0].error}{more}")
        self.unrest = tuple(unrest)


@dataclass(frozen=True)
class Group:
    """Devices of one kind and structure, next to each other in the plant's tables and states."""

    key: str
    has: int
    devices: tuple[Device, ...]

    @property
    def table(self) -> npt.NDArray[np.float64]:
        """Rows that the case gives, (rows, devices)."""
        return np.array([d.column() for d in self.devices], dtype=float).T


def modulation(key: str) -> str:
    """Return the name part of the input of an SVC, STATCOM or series capacitor."""
    return "x_mod" if key == "tcsc" else "v_mod"


@dataclass(frozen=True)
class Input:
    """An input of the plant: `word` of a row acts at `place`; as many more as there are once or twice: on the
    second or third input of that place."""

    row: str  #: name of the machine, or of the device at a bus
    word: str  #: vs, v_mod, x_mod, p_mod or q_mod; of an end of a dc link with _from or _to
    place: int

    @property
    def name(self) -> str:
        """Name of the input."""
        return f"{self.row}_{self.word}"


@dataclass(frozen=True)
class Controls:
    """All controls of a case at their equilibrium."""

    devices: tuple[Device, ...]  #: kind by kind as NUMBERED, in the order of the machines
    groups: tuple[Group, ...]  #: in the order in which their states are numbered
    seen: npt.NDArray[np.float64]  #: (len(SEEN), machines and then devices at buses)

    def of(self, word: str) -> tuple[Device, ...]:
        """Return the devices of one kind."""
        return tuple(d for d in self.devices if d.word == word)

    @property
    def inputs(self) -> tuple[Input, ...]:
        """The signals from outside, in the order of the inputs."""
        places = self.seen.shape[1]
        result: list[Input] = []
        for d in self.devices:
            if d.word == "exciter":
                result.append(Input(d.prefix.removesuffix(".exciter"), "vs", d.place))
            elif d.word in OF_CONVERTER:
                result += [Input(d.prefix, "p_mod", d.place), Input(d.prefix, "q_mod", places + d.place)]
            elif d.word in OF_LINK:
                words = link_modulations(d.rest.instance.values).values()
                result += [Input(d.prefix, word, k * places + d.place) for k, word in enumerate(words)]
            elif d.word in AT_BUS:
                result.append(Input(d.prefix, modulation(d.key), d.place))
        return tuple(result)

    @property
    def at_buses(self) -> tuple[Device, ...]:
        """The devices at buses, in the order of the case."""
        return tuple(sorted((d for d in self.devices if d.word in AT_BUS), key=lambda d: d.place))

    def outputs(self, word: str) -> tuple[frozenset[str], ...]:
        """Return the states and inputs that determine the output of each machine's device."""
        output_of = {d.place: d.output for d in self.of(word)}
        return tuple(output_of.get(k, frozenset()) for k in range(self.seen.shape[1]))

    def states(self) -> list[State]:
        """Return the states, group by group and quantity by quantity."""
        return [d.states[j] for g in self.groups for j in range(len(g.devices[0].states)) for d in g.devices]

    def running(self) -> tuple[tuple[Group, int], ...]:
        """Return the groups in the order of execution, each with the position of its first state."""
        first, place = 0, {}
        for g in self.groups:
            place[id(g)] = first
            first += len(g.devices) * len(g.devices[0].states)
        order = list(KINDS)
        return tuple(
            (g, place[id(g)]) for g in sorted(self.groups, key=lambda g: order.index(g.devices[0].word))
        )


def controls_at_rest(
    case: Case, points: tuple[MachinePoint, ...], buses: tuple[AtRest, ...] = ()
) -> Controls:
    """Return the equilibrium of the controls of `case` for machines at `points` and devices at `buses`.

    Raises
    ------
    StartError : devices without an equilibrium there: the limit that excludes each, by how much, the remedy.
    """
    seen, starts = rests_of(case, points, buses)
    unrest = [rest for _, _, rest in starts if isinstance(rest, Unrest)]
    if unrest:
        raise StartError(unrest)
    devices: list[Device] = []
    inputs = [_reach(case, k) for k in range(len(points))]
    network = frozenset({NETWORK})
    inputs += [
        {"vt": network, "vs": frozenset({f"{s.name}_{modulation(s.control.kind)}"})} for s in case.svcs
    ]
    inputs += [
        dict.fromkeys(("vt", "p", "q", "vr", "vi", "ir", "ii", "vreg", "vdrop", "pbr", "qbr"), network)
        | {key: frozenset({f"{c.name}_{key}"}) for key in ("p_mod", "q_mod")}
        for c in case.converters
    ]
    inputs += [_link_reach(row) for row in case.links]
    for k, word, rest in starts:
        assert isinstance(rest, RestPoint)
        device = _device(row_name(case, k, word), k, word, rest, inputs[k])
        devices.append(device)
        inputs[k][KINDS[word].output] = device.output
        if word in ("stabilizer", "limiter"):  # the exciter adds them to the FMU's input
            inputs[k]["vs"] |= device.output | {f"{case.machines[k].name}_vs"}
    devices.sort(key=lambda d: (NUMBERED.index(d.word), d.place))
    keys = list(dict.fromkeys((d.word, d.key, d.has) for d in devices))
    groups = tuple(
        Group(key, has, tuple(d for d in devices if (d.word, d.key, d.has) == (word, key, has)))
        for word, key, has in keys
    )
    return Controls(tuple(devices), groups, seen)


def row_name(case: Case, place: int, word: str) -> str:
    """Return the name of a control: `G1.exciter`, or that of the device at a bus."""
    machines = len(case.machines)
    return (
        f"{case.machines[place].name}.{word}" if word in OF_MACHINE else case.at_buses[place - machines].name
    )


def table_of(kind: str) -> str:
    """Return the table of a case whose rows have devices of a kind."""
    if kind in OF_MACHINE:
        return "machines"
    return "svcs" if kind in OF_SVC else "converters" if kind in OF_CONVERTER else f"{kind}s"


def rests_of(
    case: Case,
    points: tuple[MachinePoint, ...],
    buses: tuple[AtRest, ...] = (),
    *,
    room: float = BEYOND,
) -> tuple[npt.NDArray[np.float64], list[tuple[int, str, RestPoint | Unrest]]]:
    """Return the input values of the devices at every place, and the equilibrium or problem of each device.

    room : as in `rest_of`.
    """
    seen, own = np.zeros((len(SEEN), len(points) + len(buses))), case.own_devices
    rests: list[tuple[int, str, RestPoint | Unrest]] = []
    for k, point in enumerate(points):
        row = {key: float(getattr(point, key)) for key in ("vt", "vd", "vq", "id", "iq", "pe", "pm", "efd")}
        row |= {"ifd": row["efd"], "vc": row["vt"], "vs": 0.0, "out": 0.0}
        seen[:, k] = [row[key] for key in SEEN]
        for word in OF_MACHINE:
            control: Control | None = getattr(case.machines[k], word)
            model = None if control is None else control_model(word, control, own)
            if control is None or model is None:
                continue
            rest = _rest(case, k, model, control, row, room)
            rests.append((k, word, rest))
            if isinstance(rest, RestPoint):
                key = KINDS[word].output
                seen[SEEN.index(key if key in SEEN else "out"), k] = row[key] = rest.output
    for k, (row_at, bus) in enumerate(zip(case.at_buses, buses, strict=True), start=len(points)):
        model = model_at_bus(row_at, own)
        kind, share = model.device.kind, row_at.base_mva / case.base_mva
        who = f"{case.name}: {table_of(kind)}.{row_at.name}.control"
        numbers = control_numbers(model, row_at.control, row_at.base_mva, case.frequency_hz)
        output, signals = output_and_signals(bus, kind, share, numbers)
        rest = _rest_of(model, numbers, signals, output, who, row_at.name, "control", room)
        rests.append((k, kind, rest))
        for key, value in _seen_at_bus(kind, bus.seen, output, signals).items():
            seen[SEEN.index(key), k] = value
    return seen, rests


def _seen_at_bus(kind: str, volts: float, output: float, signals: Mapping[str, float]) -> dict[str, float]:
    """What a device at a bus sees at rest, where plant/flow/flow.h has it."""
    at = {"vt": volts, "out": output}
    if kind in OF_CONVERTER:
        at |= {"pe": signals["p"], "ifd": signals["q"]}
        at |= {"vd": signals.get("vr", 0.0), "vq": signals.get("vi", 0.0)}
        at |= {
            "id": signals.get("ir", signals.get("pbr", 0.0)),
            "iq": signals.get("ii", signals.get("qbr", 0.0)),
        }
        at |= {"efd": signals.get("vreg", 0.0), "pm": signals.get("vdrop", 0.0)}
    elif kind == "hvdc":
        at |= {"pe": signals["vdi"]}
    elif kind == "vsc":
        at |= {"pe": signals["p1"], "vd": signals["v2"], "vq": signals["p2"]}
    return at


def _rest(
    case: Case, k: int, model: Model, control: Control, row: dict[str, float], room: float
) -> RestPoint | Unrest:
    m, word = case.machines[k], model.device.kind
    seen = {name: row.get(name, 0.0) for name in KINDS[word].inputs}
    who = f"{case.name}: machines.{m.name}.{word}"
    output = row[KINDS[word].output] if model.device.references else None
    numbers = control_numbers(model, control, m.base_mva, case.frequency_hz)
    return _rest_of(model, numbers, seen, output, who, m.name, word, room)


def _rest_of(
    model: Model, numbers: dict[str, float | str], seen: dict[str, float], output: float | None, who: str,
    row: str, word: str, room: float,
) -> RestPoint | Unrest:  # fmt: skip
    try:
        rest = rest_of(model, numbers, seen, output, who, room=room)
        if model.device.kind in AT_BUS:
            coupling_of(rest.instance)
    except DeviceError as error:
        return Unrest(row, word, model, numbers, seen, output, who, error)
    return rest


def _reach(case: Case, k: int) -> dict[str, frozenset[str]]:
    """Which states and inputs each signal of machine `k` depends on."""
    m = case.machines[k]
    network = frozenset({NETWORK})
    rotor = frozenset({f"{m.name}.eq1", f"{m.name}.eq2", f"{m.name}.ed2"})
    return {
        "slip": frozenset({f"{m.name}.slip"}),
        "ifd": network | (rotor if m.model == "round_rotor" else frozenset()),
        "vs": frozenset({f"{m.name}_vs"}),
        "pm": frozenset(),
        **dict.fromkeys(("vt", "vd", "vq", "id", "iq", "pe", "vc"), network),
    }


def _link_reach(row: Hvdc | Vsc) -> dict[str, frozenset[str]]:
    """Which states and inputs each signal of a dc link depends on."""
    words = link_modulations(row.control.parameters)
    inputs = {key: frozenset({f"{row.name}_{word}"}) for key, word in words.items()}
    return dict.fromkeys(("vdr", "vdi", "v1", "p1", "v2", "p2"), frozenset({NETWORK})) | inputs


def _device(prefix: str, k: int, word: str, rest: RestPoint, inputs: dict[str, frozenset[str]]) -> Device:
    rates, reached = rest.instance.depends_on()

    def place(names: frozenset[str]) -> frozenset[str]:
        result: frozenset[str] = frozenset()
        for name in names:
            result |= frozenset({f"{prefix}.{name[2:]}"}) if name.startswith("x.") else inputs[name]
        return result

    texts = rest.instance.state_texts()
    states = tuple(
        State(
            f"{prefix}.{s.name}", start, "pu", texts[s.name], place(rates[s.name]), rest.instance.time_of(s)
        )
        for s, start in zip(rest.instance.states, rest.states, strict=True)
    )
    return Device(word, k, prefix, rest, states, place(reached))
