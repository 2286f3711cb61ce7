"""Devices at a bus whose states set a current into the network: which state, and what the plant makes of it.

A device's output is a state, or a number times a state plus a number; rows of its port as `P_*` of
plant/numbers/layout.h, equations in plant/machine/bus_device.h.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..case.case import Case
from ..case.schema import Svc
from ..devices.instance import Instance
from ..devices.language.device import AT_BUS, Device
from ..devices.language.expression import evaluate
from ..devices.language.structure import Model
from ..devices.library import device_model
from ..errors import DeviceError

NOTHING, SUSCEPTANCE, CURRENT = 0, 1, 2  #: CouplingKind
COUPLINGS = {"svc": SUSCEPTANCE, "statcom": CURRENT}
LOW_PU = 0.1  #: below, a current falls with the voltage: one that holds at zero volts has no solution
_STATES = ("lag", "integrator")  #: elements whose output is a state


@dataclass(frozen=True)
class BusPoint:
    """A device at a bus at rest: voltage that it sees, voltage at its bus and what it gives there, pu."""

    seen: float
    own: float
    q: float  #: reactive power into the network, base of the case

    def output(self, kind: str, share: float) -> float:
        """Return what the device gives, pu of its base; `share`: its base over that of the case."""
        return self.q / self.own ** (2 if COUPLINGS[kind] == SUSCEPTANCE else 1) / share


@dataclass(frozen=True)
class Coupling:
    """The output is scale times the state plus bias, pu of the device's base."""

    state: str
    scale: float
    bias: float


def svc_model(svc: Svc, own: Mapping[str, Model]) -> Model:
    """Return the device of a row; DeviceError where there is none of that name."""
    return device_model(svc.control.kind, AT_BUS, own)


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
        "integrator, or a number times one plus a number; put a lag behind it"
    )


def coupling_of(instance: Instance) -> Coupling:
    """Return how the output follows from the state.

    Raises
    ------
    DeviceError : as `coupled_state`, or a lag without time.
    """
    device = instance.model.device
    state = coupled_state(device)
    if state not in instance.state_names:
        raise DeviceError(
            f"{device.name}: {state} is a lag without time, but sets a current; give it a time above 0"
        )
    if state == device.output:
        return Coupling(state, 1.0, 0.0)
    node = next(line.node for line in device.lines if line.name == device.output)
    bias = float(evaluate(node, instance.values | {state: 0.0}))
    return Coupling(state, float(evaluate(node, instance.values | {state: 1.0})) - bias, bias)


def device_port_buses(case: Case) -> list[int]:
    """Return the number of the bus of each port of `device_ports`, in its order."""
    return [bus for svc in case.svcs for bus in dict.fromkeys((svc.bus, svc.seen_bus))]


def device_ports(
    case: Case, couplings: list[tuple[str, Coupling]], state_names: tuple[str, ...], outputs: list[float]
) -> list[list[float]]:
    """Return the rows of the ports of devices at buses, without the kind of port.

    couplings : kind and coupling of each; outputs : of each at rest, pu of its base. A device that sees
    another bus than its own has a second port there, which injects nothing.
    """
    index = {bus.number: k for k, bus in enumerate(case.buses)}
    rows: list[list[float]] = []
    for k, (svc, (kind, c), output) in enumerate(zip(case.svcs, couplings, outputs, strict=True)):
        share, here = svc.base_mva / case.base_mva, svc.seen_bus == svc.bus
        state = state_names.index(f"{svc.name}.{c.state}")
        row = [state, share * c.scale, share * c.bias, COUPLINGS[kind], share * output]
        rows.append([k, 1.0, index[svc.bus], *row, (k + 1.0) * here, LOW_PU])
        if not here:
            rows.append([k, 1.0, index[svc.seen_bus], state, 0.0, 0.0, NOTHING, 0.0, k + 1.0, LOW_PU])
    return rows


def bus_points(
    case: Case, q: npt.NDArray[np.float64], voltages: npt.NDArray[np.complex128]
) -> tuple[BusPoint, ...]:
    """Return the devices at buses at rest. q : (svcs,) into the network, pu; voltages : (buses,)."""
    index = {bus.number: k for k, bus in enumerate(case.buses)}
    size = np.abs(voltages)
    return tuple(
        BusPoint(float(size[index[s.seen_bus]]), float(size[index[s.bus]]), float(q[k]))
        for k, s in enumerate(case.svcs)
    )
