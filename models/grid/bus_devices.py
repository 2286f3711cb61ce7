"""Ports of the C plant: loads that are not constant impedance, devices at buses, machines with a port.

These saturate or have X''d != X''q.

A port connects a non-linear element to the linear network (plant/network/port.h); rows as `P_*` of
plant/numbers/layout.h.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..case.case import Case
from ..case.schema import Load, Machine, Saturation
from .coupling import device_port_buses
from .network import load_power

ROWS = 23
LOAD, MACHINE, DEVICE = 1, 2, 3
LOWEST_PU = {"current": 0.5, "power": 0.7}  #: below, such a share of a load is constant impedance
_SATURATION = {"none": 0, "total": 1, "incremental": 2}


@dataclass(frozen=True)
class AirGap:
    """Flux linkage and saturation of a machine at the operating point, per unit on its base."""

    psi_ad: float
    psi_aq: float
    factor: float  #: S = psi_I/psi_at, 0 without saturation
    isd: float
    isq: float


def has_port(machine: Machine) -> bool:
    """Return whether `machine` saturates or differs in X''d and X''q."""
    return machine.model == "round_rotor" and (
        saturation_of(machine) is not None or machine.Xd2 != machine.Xq2
    )


def saturation_of(machine: Machine) -> Saturation | None:
    """Return the saturation of `machine`, None if it has none."""
    saturation = machine.saturation
    return None if saturation is None or saturation.use == "none" else saturation


def saturation_factor(machine: Machine, flux: float) -> float:
    r"""Return :math:`S = \psi_I/\psi_{at}` at the air-gap flux `flux`, 0 without saturation; K_s = 1/(1 + S).

    [Kundur1994, sec. 3.8.2]

    >>> from interarea.models.case.case import load_case
    >>> round(1.0 / (1.0 + saturation_factor(load_case("kundur-manual").machine("G1"), 1.0)), 4)
    0.9623
    """
    s = saturation_of(machine)
    return 0.0 if s is None else s.Asat * math.exp(s.Bsat * (flux - s.psiT1)) / flux


def air_gap(machine: Machine, voltage: complex, current: complex, delta: float) -> AirGap:
    """Return the air-gap flux of `machine` at a terminal phasor (machine base) and rotor angle."""
    gap = (voltage + complex(machine.Ra, machine.number("Xl")) * current) * np.exp(-1j * delta)
    factor = saturation_factor(machine, abs(gap))
    Xl = machine.number("Xl")
    return AirGap(
        psi_ad=float(gap.real),
        psi_aq=float(gap.imag),
        factor=factor,
        isd=factor * float(gap.real) / (machine.number("Xd") - Xl),
        isq=factor * float(gap.imag) / (machine.number("Xq") - Xl),
    )


def port_loads(case: Case) -> list[int]:
    """Return the positions of the loads that need a port."""
    return [k for k, q in enumerate(case.loads) if q.in_service and not q.is_constant_impedance]


def port_table(
    case: Case,
    load_volts: npt.ArrayLike,
    order: list[int],
    gaps: list[AirGap | None],
    devices: Sequence[Sequence[float]] = (),
) -> npt.NDArray[np.float64]:
    """Return the ports of the C plant, (ports, rows).

    load_volts : initial voltage magnitude of each load, pu.
    order : position in the case of each machine of the plant; gaps : its air gap, in that order, None for
        machines without a port. devices : rows of the ports of devices at buses (`device_ports`).
    """
    volts = np.asarray(load_volts, dtype=float)
    table = [_load_row(case, k, float(volts[k])) for k in port_loads(case)]
    table += [[DEVICE, *row] for row in devices]
    for k, (position, gap) in enumerate(zip(order, gaps, strict=True)):
        if gap is not None:
            table.append(_machine_row(case.machines[position], k, gap))
    padded = [[*row, *[0.0] * (ROWS - len(row))] for row in table]
    return np.array(padded, dtype=float).reshape(len(table), ROWS)


def port_rest(
    case: Case, voltages: npt.NDArray[np.complex128], gaps: Sequence[AirGap | None], angles: Sequence[float]
) -> npt.NDArray[np.float64]:
    """Return the initial voltages of the ports, (2, ports): real and imaginary parts.

    With constant power other solutions exist, at low voltage; the plant starts from this one.
    voltages : (buses,); gaps, angles : of each machine its air gap, if it has a port, and its rotor angle.
    """
    place = {bus.number: k for k, bus in enumerate(case.buses)}
    at = [voltages[place[case.loads[k].bus]] for k in port_loads(case)]
    at += [voltages[place[bus]] for bus in device_port_buses(case)]
    for gap, angle in zip(gaps, angles, strict=True):
        if gap is not None:
            at.append(complex(gap.psi_ad, gap.psi_aq) * np.exp(1j * angle))
    return np.array([np.real(at), np.imag(at)], dtype=float)


def _load_row(case: Case, k: int, volt: float) -> list[float]:
    load = case.loads[k]
    power = load_power(case, load)
    # a load that rests below such a voltage keeps its characteristic a little further down
    low = {key: min(value, 0.9 * volt) / volt for key, value in LOWEST_PU.items()}
    row = [LOAD, k, 1.0, power.real, power.imag, 1.0 / volt, low["current"], low["power"]]
    for letter in "PQ":
        row += _mix(load, letter, low)
    return row


def _mix(load: Load, letter: str, low: dict[str, float]) -> list[float]:
    """Shares of constant current, constant power, an exponent; the exponent; where it ends."""
    mix = getattr(load, f"{letter}_zip")
    exponent = getattr(load, f"{letter}_exponent")
    if mix is not None:
        return [mix[1], mix[2], 0.0, 2.0, low["current"]]
    if exponent in (0.0, 1.0, 2.0):
        return [float(exponent == 1.0), float(exponent == 0.0), 0.0, 2.0, low["current"]]
    return [0.0, 0.0, 1.0, exponent, low["current" if exponent >= 1.0 else "power"]]


def _machine_row(m: Machine, k: int, gap: AirGap) -> list[float]:
    Xl, Xd, Xq, Xd2, Xq2 = (m.number(key) for key in ("Xl", "Xd", "Xq", "Xd2", "Xq2"))
    s = saturation_of(m)
    shape = (0.0, 0.0, 0.0) if s is None else (s.Asat, s.Bsat, s.psiT1)
    flux = math.hypot(gap.psi_ad, gap.psi_aq)
    slope = 0.0 if s is None else s.Bsat * gap.factor * flux
    kind = 0 if s is None else _SATURATION[s.use]
    row = [MACHINE, k, 1.0, kind, Xd2 - Xl, Xq2 - Xl, 1.0 / (Xd - Xl), 1.0 / (Xq - Xl), *shape]
    saliency = 0.0 if Xd2 == Xq2 else 1.0 / (Xd2 - Xl) - 1.0 / (Xq2 - Xl)
    return [*row, gap.psi_ad, gap.psi_aq, gap.isd, gap.isq, slope, saliency]
