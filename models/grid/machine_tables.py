"""Machines of a case in the layout of the C plant, and the description of a state.

Row orders are those of the enumerations in plant/numbers/layout.h.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..case.case import Case
from ..case.schema import Machine
from .coupling import coupled_states, model_at_bus
from .series import with_series_nodes


@dataclass(frozen=True)
class State:
    """One continuous state: value at the operating point, dependencies of its derivative, time constant.

    In `depends_on`, `NETWORK` means all `network_states`.
    """

    name: str
    start: float
    unit: str
    description: str
    depends_on: frozenset[str]
    time_s: float = math.inf  #: of a lag or lead-lag; a machine's own stand in its table


@dataclass(frozen=True)
class MachinePoint:
    """Operating point of one machine, per unit on its own base; angles in rad."""

    delta: float
    eq1: float
    ed1: float
    eq2: float
    ed2: float
    efd: float
    pm: float
    vt: float
    vd: float
    vq: float
    id: float
    iq: float

    @property
    def pe(self) -> float:
        """Active power at the terminals."""
        return self.vd * self.id + self.vq * self.iq


NETWORK = "*"  #: in place of the names of `network_states`, which on a large grid are thousands
#: states through which a machine acts on the network
NETWORK_KEYS = {"round_rotor": ("delta", "eq2", "ed2"), "classical": ("delta",), "infinite_bus": ("delta",)}
MACHINE_KEYS = ("Ra", "Xl", "Xd", "Xd1", "Xd2", "Xq", "Xq1", "Xq2", "Td01", "Td02", "Tq01", "Tq02", "H", "D")


def machine_table(case: Case, points: Sequence[MachinePoint]) -> npt.NDArray[np.float64]:
    """Return the machine table of the C plant, (rows, machines)."""
    columns = [
        [
            m.base_mva / case.base_mva,
            *(_number(m, key) for key in MACHINE_KEYS),
            *_saturation(m),
            p.efd,
            p.pm,
            p.vt,
        ]
        for m, p in zip(case.machines, points, strict=True)
    ]
    return np.array(columns).T


def _saturation(m: Machine) -> list[float]:
    """Rows M_BY_SPEED .. M_SAT_Q2 of plant/numbers/layout.h."""
    s = m.flux_saturation
    by_speed = float(m.torque_by_speed)
    if s is None:
        return [by_speed, *[0.0] * 6]
    A, B = s.coefficients
    q = (m.number("Xq") - m.number("Xl")) / (m.number("Xd") - m.number("Xl")) if s.axes == "both" else 0.0
    on_q = (0.0, q) if m.one_q_winding else (q, 0.0)
    return [by_speed, 1.0 if s.shape == "quadratic" else 2.0, A, B, float(s.of == "transient_emf"), *on_q]


def _number(m: Machine, key: str) -> float:
    """A constant EMF has its Xd1 on both axes and nothing else but what moves it."""
    if m.has_constant_emf:
        if key == "H" and m.model == "infinite_bus":
            return math.inf
        key = {"Xd2": "Xd1", "Xq2": "Xd1"}.get(key, key)
        return m.number(key) if key in ("Ra", "H", "D", "Xd1") else 0.0
    if key == "Tq01" and m.one_q_winding:
        return 1.0  # nothing drives ed1
    return m.number(key)


def network_states(case: Case) -> frozenset[str]:
    """Return the states that determine every current and voltage of the network."""
    own = case.own_devices
    at_buses = frozenset(
        f"{row.name}.{state}"
        for row in case.at_buses
        for state in coupled_states(model_at_bus(row, own).device, row.control.parameters)
    )
    return at_buses | frozenset(f"{m.name}.{key}" for m in case.machines for key in NETWORK_KEYS[m.model])


def in_plant_order(case: Case) -> Case:
    """Return `case` in the order of the plant: constant EMFs after other machines, nodes for series
    capacitors."""
    case = with_series_nodes(case)
    machines = tuple(sorted(case.machines, key=lambda m: m.has_constant_emf))
    return case if machines == case.machines else case.model_copy(update={"machines": machines})
