"""Devices at a bus whose states set a current into the network: the state, and its current.

A device's output is a state, or a number times a state plus a number; rows of its port as `P_*` of
plant/numbers/layout.h, equations in plant/machine/bus_device.h.
"""

from __future__ import annotations

import cmath
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from ..case.case import Case
from ..case.hvdc_schema import Hvdc
from ..case.schema import Converter, Svc
from ..case.vsc_schema import Vsc
from ..devices.instance import Instance
from ..devices.language.device import KINDS, OF_CONVERTER, OF_LINK, OF_SVC, Device
from ..devices.language.expression import evaluate
from ..devices.language.structure import Model
from ..devices.library import device_model
from ..errors import DeviceError
from .dc_link import LinkPoint, link_ports
from .network import branch_stamp
from .vsc_link import CONVERTER, VscPoint, point_of_link, vsc_ports

NOTHING, SUSCEPTANCE, CURRENT, SOURCE = 0, 1, 2, 6  #: CouplingKind, beside CONVERTER
COUPLINGS = {"svc": SUSCEPTANCE, "statcom": CURRENT, "converter": CONVERTER, "source": SOURCE}
LOCKED = ("delta", "e")  #: states of a REGC_C: its voltage's angle and size
COUPLING = 6  #: P_COUPLING - 1, in the rows of `device_ports`
LOW_PU = 0.1  #: below, a current falls with the voltage: one that holds at zero volts has no solution
_STATES = ("lag", "integrator")  #: elements whose output is a state


@dataclass(frozen=True)
class BusPoint:
    """Equilibrium of a device at a bus: measured voltage, voltage at its bus and power or current there,
    pu."""

    seen: float
    own: float
    q: float  #: reactive power into the network, base of the case
    p: float = 0.0  #: active power into the network, base of the case
    angle: float = 0.0  #: of its bus, rad
    #: voltage of the bus that a plant control regulates; voltage and current at the end of the branch that it
    #: measures, pu of the case; None: its own
    regulated: complex | None = None
    measured: tuple[complex, complex] | None = None

    def _measured(self, share: float, drop: complex) -> dict[str, float]:
        """What a plant control sees; `drop` : of the voltage by the current, pu of its base."""
        turn = cmath.rect(1.0, self.angle)
        own = self.own * turn
        volts = own if self.regulated is None else self.regulated
        at, current = self.measured or (own, self.current(1.0) * turn)
        power = at * current.conjugate() / share
        less = abs(volts - drop * current / share)
        return {"vreg": abs(volts), "vdrop": less, "pbr": power.real, "qbr": power.imag}

    def source(self, share: float, impedance: complex) -> complex:
        """Return the voltage behind a source's `impedance` relative to the angle of its bus, pu of its
        base."""
        return self.own + impedance * self.current(share)

    def current(self, share: float) -> complex:
        """Return the current into the network relative to the angle of the bus, pu of its base."""
        return complex(self.p, -self.q) / self.own / share

    def output(self, kind: str, share: float, impedance: complex = 0.0) -> float:
        """Return the output of the device, pu of its base; for a source its angle, rad.

        share : its base over that of the case. impedance : of a source, pu of its base.
        """
        if kind == "source":
            return self.angle + cmath.phase(self.source(share, impedance))
        power = self.p if kind == "converter" else self.q
        return power / self.own ** (2 if COUPLINGS[kind] == SUSCEPTANCE else 1) / share

    def signals(self, kind: str, share: float, impedance: complex = 0.0) -> dict[str, float]:
        """Return the input values of the device; for a converter also its reactive current, for a source its
        voltage.

        impedance : of a source; for a converter that of its plant control, pu of its base.
        """
        if kind not in OF_CONVERTER:
            return {"vt": self.seen, "vs": 0.0}
        p, q = self.p / share, self.q / share
        if kind == "converter":
            direction = cmath.rect(min(1.0, self.own / LOW_PU), self.angle)
            own = {"iq": q / self.own, "vr": direction.real, "vi": direction.imag}
            own |= self._measured(share, impedance)
        else:
            turn = cmath.rect(1.0, self.angle)
            v, i = self.own * turn, self.current(share) * turn
            own = {"e": abs(self.source(share, impedance)), "theta": self.angle}
            own |= {"vr": v.real, "vi": v.imag, "ir": i.real, "ii": i.imag}
        return {"vt": self.seen, "p": p, "q": q, "p_mod": 0.0, "q_mod": 0.0, **own}


@dataclass(frozen=True)
class Coupling:
    """The output is scale times the state plus bias, pu of the device's base."""

    state: str
    scale: float
    bias: float
    second: str = ""  #: state of the reactive current of a converter
    gain: tuple[float, float] = (-2.0, -1.0)  #: voltages between which its active current rises from 0
    taken: tuple[float, float, float] = (1e3, 0.0, -1e3)  #: voltage above which, how much, not below
    direction: bool = False  #: whether a converter sees the direction of its voltage, a source components
    shunt: float = 0.0  #: of a converter behind an impedance: its active current less by the voltage
    plant: bool = False  #: whether a converter sees what a plant control measures
    values: Mapping[str, float] = field(default_factory=dict)  #: those of its device, other than of an SVC


AtRest = BusPoint | LinkPoint | VscPoint  #: a device at a bus, or between two, at rest


def output_and_signals(
    bus: AtRest, kind: str, share: float, numbers: Mapping[str, float | str]
) -> tuple[float, dict[str, float]]:
    """Return the output of a device at its equilibrium, and its input values and other states, pu of its
    base."""
    if isinstance(bus, BusPoint) and kind == "source":
        behind = complex(float(numbers["Re"]), float(numbers["Xe"]))
        return bus.output(kind, share, behind), bus.signals(kind, share, behind)
    if isinstance(bus, BusPoint) and kind == "converter":
        signals, y = bus.signals(kind, share, drop_of(numbers)), behind_impedance(numbers)
        signals["iq"] -= y.imag * bus.own
        if is_locked(numbers):
            behind = bus.source(share, complex(float(numbers["Re"]), float(numbers["Xe"])))
            signals |= {"theta": bus.angle, "delta": bus.angle + cmath.phase(behind), "e": abs(behind)}
        return bus.output(kind, share) + y.real * bus.own, signals
    return bus.output(kind, share), bus.signals(kind, share)


def model_at_bus(row: Svc | Converter | Hvdc | Vsc, own: Mapping[str, Model]) -> Model:
    """Return the device of a row; DeviceError if there is none of that name."""
    kinds = OF_SVC if isinstance(row, Svc) else OF_CONVERTER if isinstance(row, Converter) else OF_LINK
    return device_model(row.control.kind, kinds, own)


def voltage_sources(case: Case) -> tuple[str, ...]:
    """Return the names of the converters that are voltage sources with their own angles."""
    own = case.own_devices
    return tuple(row.name for row in case.converters if model_at_bus(row, own).device.kind == "source")


def coupled_states(device: Device, numbers: Mapping[str, float | str]) -> tuple[str, ...]:
    """Return the names of the states that set the current; `numbers` : parameters of the device.

    Raises
    ------
    DeviceError : as `coupled_state`, or an output of a converter that is not a state.
    """
    lines = {line.name: line for line in device.lines}
    if is_locked(numbers):
        return LOCKED
    also = KINDS[device.kind].also
    if not also:
        return (coupled_state(device),)
    for name in device.outputs:
        if lines[name].element not in _STATES:
            raise DeviceError(
                f"{device.file}: {name} = {lines[name].node} sets a current into the network, allowed: a "
                "lag or an integrator; add a lag after it"
            )
    return device.outputs


def coupled_state(device: Device) -> str:
    """Return the name of the state that sets the current.

    Raises
    ------
    DeviceError : the output is neither a state nor a number times one plus a number.
    """
    lines = {line.name: line for line in device.lines}
    line = lines[device.output]
    if line.element in _STATES:
        return line.name
    used = [name for name in dict.fromkeys(line.node.names) if name not in device.constants]
    if not line.element and len(used) == 1 and used[0] in lines and lines[used[0]].element in _STATES:
        at = [
            evaluate(line.node, {**dict.fromkeys(device.constants, 1.0), used[0]: x}) for x in (0.0, 1.0, 2.0)
        ]
        if at[2] - at[1] == at[1] - at[0]:
            return used[0]
    raise DeviceError(
        f"{device.file}: {device.output} = {line.node} sets a current into the network, allowed: a lag or an "
        "integrator, or a number times one plus a number; add a lag after it"
    )


def coupling_of(instance: Instance) -> Coupling:
    """Return how the output follows from the state.

    Raises
    ------
    DeviceError : as `coupled_state`, or a lag without time.
    """
    device = instance.model.device
    states = coupled_states(device, instance.values)
    state = states[0]
    for name in states:
        if name not in instance.state_names:
            raise DeviceError(
                f"{device.name}: {name} is a lag without time, but sets a current; give it a time above 0"
            )
    if device.kind in OF_LINK:
        return Coupling(state, 1.0, 0.0, values=instance.values)
    seen = frozenset[str]().union(*instance.depends_on()[0].values())
    sees = bool({"vr", "vi", "ir", "ii"} & seen)
    if device.kind == "source":
        return Coupling(state, 1.0, 0.0, states[1], direction=sees, values=instance.values)
    if len(states) > 1:
        shunt = behind_impedance(instance.values).real
        plant = bool({"vreg", "vdrop", "pbr", "qbr"} & seen)
        numbers = _port_numbers(instance)
        return Coupling(state, 1.0, 0.0, states[1], *numbers, sees, shunt, plant, instance.values)
    if state == device.output:
        return Coupling(state, 1.0, 0.0)
    node = next(line.node for line in device.lines if line.name == device.output)
    bias = float(evaluate(node, instance.values | {state: 0.0}))
    return Coupling(state, float(evaluate(node, instance.values | {state: 1.0})) - bias, bias)


def drop_of(numbers: Mapping[str, float | str]) -> complex:
    """Return the compensation impedance of a plant control, pu of its base."""
    if numbers.get("plant_VCFLAG") != 1.0:
        return 0j
    return complex(float(numbers["plant_Rc"]), float(numbers["plant_Xc"]))


def is_locked(numbers: Mapping[str, float | str]) -> bool:
    """Return whether a converter is a voltage source in the frame of a phase-locked loop (REGC_C)."""
    return numbers.get("REGCC") == 1.0


def behind_impedance(numbers: Mapping[str, float | str]) -> complex:
    """Return the admittance in series with a converter's voltage (REGC_B), pu of its base; 0: a current
    source."""
    if numbers.get("REGCB") != 1.0:
        return 0j
    return 1.0 / complex(float(numbers["Re"]), float(numbers["Xe"]))


def _port_numbers(instance: Instance) -> tuple[tuple[float, float], tuple[float, float, float]]:
    """Voltages of the gain of the active current; voltage, gain and least value of the reactive one."""
    at, no = instance.values, Coupling("", 1.0, 0.0)
    y = behind_impedance(at)
    if y:
        return no.gain, (0.0, -y.imag, no.taken[2])
    gain = (at["Lvpnt0"], at["Lvpnt1"]) if {"Lvpnt0", "Lvpnt1"} <= at.keys() else no.gain
    taken = no.taken
    if {"Volim", "Khv"} <= at.keys() and at["Khv"] > 0.0:
        taken = (at["Volim"], at["Khv"], at.get("Iolim", taken[2]))
    return gain, taken


def device_port_buses(case: Case) -> list[int]:
    """Return the number of the bus of each port of `device_ports`, in its order."""
    buses: list[int] = []
    for row in case.at_buses:
        buses += dict.fromkeys((row.bus, row.seen_bus))
        if isinstance(row, Converter):
            buses += _measuring_buses(case, row)
    return buses


def _measuring_buses(case: Case, row: Converter) -> tuple[int, ...]:
    """The bus that a plant control regulates, and both ends of its branch, the measured one first."""
    if row.measures is None:
        return () if row.regulates is None else (row.regulates,)
    branch = case.branch(row.measures)
    ends = (branch.from_bus, branch.to_bus)
    return (row.regulates or row.bus, *(ends if row.measures_from in (None, ends[0]) else ends[::-1]))


def _measured_branch(case: Case, row: Converter) -> tuple[int, complex, complex]:
    """Number of the branch that a plant control measures, its admittances seen from the measured end."""
    k = next(k for k, b in enumerate(case.branches) if b.name == row.measures)
    stamp = branch_stamp(case.branches[k])
    first = 0 if row.measures_from in (None, case.branches[k].from_bus) else 1
    return k, complex(stamp[first, first]), complex(stamp[first, 1 - first])


def _measuring_ports(case: Case, row: Converter, k: int, index: Mapping[int, int]) -> list[list[float]]:
    """Rows of the ports behind that of device `k`, at which only its plant control measures."""
    ports: list[list[float]] = []
    for kind, bus in enumerate(_measuring_buses(case, row), start=1):
        ports.append([k, 1.0, index[bus], 0.0, 0.0, 0.0, NOTHING, 0.0, 0.0, LOW_PU, 0.0, 0.0, kind])
    if row.measures is not None:
        branch, own, mutual = _measured_branch(case, row)
        ports[1] += [own.real, own.imag, mutual.real, mutual.imag, branch]
    return ports


def device_ports(
    case: Case,
    couplings: list[tuple[str, Coupling]],
    state_names: tuple[str, ...],
    signals: list[Mapping[str, float]],
) -> list[list[float]]:
    """Return the rows of the ports of devices at buses, without the kind of port.

    couplings : kind and coupling of each; signals : initial values of each, pu of its base. A device that
    measures another bus than its own has a second port there, which injects nothing.
    """
    index = {bus.number: k for k, bus in enumerate(case.buses)}
    rows: list[list[float]] = []
    for k, (svc, (kind, c), at_rest) in enumerate(zip(case.at_buses, couplings, signals, strict=True)):
        share, own_bus = svc.base_mva / case.base_mva, svc.seen_bus == svc.bus
        if isinstance(svc, Hvdc):
            states = {name: state_names.index(f"{svc.name}.{name}") for name in ("idc", "iord", "xr", "xi")}
            places = index[svc.rectifier_bus], index[svc.inverter_bus]
            rows += link_ports(svc, k, places, states, c.values, at_rest, share, LOW_PU)
            continue
        if isinstance(svc, Vsc):
            states = {name: state_names.index(f"{svc.name}.{name}") for name in ("ip1", "iq1", "ip2", "iq2")}
            places, numbers = (index[svc.from_bus], index[svc.to_bus]), [LOW_PU, *c.gain, *c.taken]
            rows += vsc_ports(k, places, states, at_rest, share, numbers)
            continue
        state = state_names.index(f"{svc.name}.{c.state}")
        output = share * at_rest[KINDS[kind].output]
        row = [state, share * c.scale, share * c.bias, COUPLINGS[kind], output]
        rows.append([k, 1.0, index[svc.bus], *row, (k + 1.0) * own_bus, LOW_PU])
        sees = 4.0 * c.direction if kind == "source" else c.direction + 2.0 * c.plant
        drop = drop_of(c.values) / share
        if kind == "source" or is_locked(c.values):
            rows[-1][COUPLING] = SOURCE
            y = share / complex(c.values["Re"], c.values["Xe"])
            most = share * c.values["Imax"] if kind == "source" else 0.0  # of REGC_C its orders' limit
            rows[-1] += [state_names.index(f"{svc.name}.{c.second}"), 0.0]
            rows[-1] += [y.real, y.imag, most, 0.0, 0.0, sees, 0.0, 0.0, drop.real, drop.imag]
        elif c.second:
            level, slope, least = c.taken
            rows[-1] += [state_names.index(f"{svc.name}.{c.second}"), share * at_rest[c.second]]
            rows[-1] += [*c.gain, level, share * slope, share * least, sees]
            rows[-1] += [0.0, share * c.shunt, drop.real, drop.imag]
        if isinstance(svc, Converter):
            rows += _measuring_ports(case, svc, k, index)
        if not own_bus:
            rows.append([k, 1.0, index[svc.seen_bus], state, 0.0, 0.0, NOTHING, 0.0, k + 1.0, LOW_PU])
    return rows


def _measured_at(
    case: Case, row: Svc | Converter, voltages: npt.NDArray[np.complex128], index: Mapping[int, int]
) -> tuple[complex | None, tuple[complex, complex] | None]:
    """What a plant control sees elsewhere: voltage of the regulated bus; voltage, current of the branch."""
    if not isinstance(row, Converter):
        return None, None
    at = [complex(voltages[index[number]]) for number in _measuring_buses(case, row)]
    if row.measures is None:
        return at[0] if at else None, None
    _, own, mutual = _measured_branch(case, row)
    return at[0], (at[1], own * at[1] + mutual * at[2])


def bus_points(
    case: Case, power: npt.NDArray[np.complex128], voltages: npt.NDArray[np.complex128]
) -> tuple[AtRest, ...]:
    """Return the equilibria of the devices at buses.

    power : P + jQ of each into the network, pu; voltages : (buses,).
    """
    index = {bus.number: k for k, bus in enumerate(case.buses)}
    size = np.abs(voltages)
    return tuple(
        point_of_link(s, float(size[index[s.bus]]), float(size[index[s.seen_bus]]))
        if isinstance(s, (Hvdc, Vsc))
        else BusPoint(
            float(size[index[s.seen_bus]]),
            float(size[index[s.bus]]),
            float(s_k.imag),
            float(s_k.real),
            float(np.angle(voltages[index[s.bus]])),
            *_measured_at(case, s, voltages, index),
        )
        for s, s_k in zip(case.at_buses, power, strict=True)
    )
