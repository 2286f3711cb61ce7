"""Induction machines of a RAW file as loads: the Q that goes with their power follows from their circuit."""

from __future__ import annotations

from itertools import pairwise

from ...errors import CaseError
from ..report import Report
from ..static import StaticGrid, StaticLoad
from .file import RawFile
from .record import Record

_ABSENT = 900.0  #: PSS/E writes 999 where there is no second cage
_ELECTRIC, _SHAFT = 2, 1  #: codes PC of the power that PSET gives


def read_motors(raw: RawFile, grid: StaticGrid, report: Report) -> None:
    """Put the induction machines of `raw` into `grid`."""
    for record in raw.records("induction machine"):
        bus = grid.bus(record.bus("I"), record.where)
        if record.code("STAT", 1, (0, 1)) == 0:
            report.drop("induction machine out of service", record.where)
            continue
        power = _drawn(record, bus.v, bus.kv, grid.base_mva)
        load = StaticLoad(
            bus.number, "M", record.identity("ID"), power.real, power.imag, record.where, follows=0.0
        )
        grid.loads.append(load)
        report.assume("induction machine taken as a load of constant P and Q", record.where)


def _drawn(record: Record, volts: float, kv: float, base_mva: float) -> complex:
    """P + jQ in MW that the machine takes at its stored voltage; above 0 for a motor."""
    base = record.number("MBASE", base_mva)
    if not base > 0.0:
        raise record.wrong("MBASE", f"{base:g}", "above 0")
    rated = record.number("RATEKV", 0.0) or kv
    volts *= kv / rated if rated > 0.0 and kv > 0.0 else 1.0
    code = record.code("PC", 1, (_SHAFT, _ELECTRIC))
    target = record.number("PSET", 0.0) / base
    stator = complex(record.number("RA", 0.0), record.number("XA", 0.0))
    gap = 1j * record.number("XM", 2.5)
    r1, x1 = record.number("R1", _ABSENT), record.number("X1", _ABSENT)
    r2, x2, x3 = (record.number(k, d) for k, d in (("R2", _ABSENT), ("X2", _ABSENT), ("X3", 0.0)))
    if not (0.0 < r1 < _ABSENT):
        raise record.wrong("R1", f"{r1:g}", "above 0 (the resistance of the rotor)")

    def power(slip: float) -> tuple[complex, float]:
        rotor = complex(r1 / slip, x1)
        if r2 < _ABSENT:
            cage = complex(r2 / slip, x2)
            rotor = rotor * cage / (rotor + cage) + 1j * x3
        current = volts / (stator + gap * rotor / (gap + rotor))
        in_rotor = current * gap / (gap + rotor)
        return volts * current.conjugate(), abs(in_rotor) ** 2 * rotor.real * (1.0 - slip)

    def wanted(slip: float) -> float:
        electric, shaft = power(slip)
        return electric.real if code == _ELECTRIC else shaft

    idle = 1e-9
    if abs(target) < 1e-12:
        return power(idle)[0] * base
    sign = 1.0 if target > 0.0 else -1.0
    slips = [sign * idle * 1.1**k for k in range(218)]  # to a slip of 1
    for low, high in pairwise(slips):
        if (wanted(high) - target) * sign >= 0.0:
            break
        if (wanted(high) - wanted(low)) * sign < 0.0 and abs(low) > 1e-6:
            high = low
            break
    if (wanted(high) - target) * sign < 0.0:
        raise CaseError(
            f"{record.where}: induction machine record: PSET = {record.text('PSET')}, allowed: at most "
            f"{wanted(high) * base:.4g} MW, its pull-out power at the stored voltage"
        )
    low = sign * idle
    for _ in range(200):
        middle = 0.5 * (low + high)
        if (wanted(middle) - target) * sign >= 0.0:
            high = middle
        else:
            low = middle
    return power(high)[0] * base
