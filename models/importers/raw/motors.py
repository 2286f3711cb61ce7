"""Induction machines of a RAW file as loads: the Q that goes with their power follows from their circuit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

from ...errors import CaseError
from ..report import Report
from ..static import StaticGrid, StaticLoad
from .file import RawFile
from .identities import usable
from .record import Record

_ABSENT = 900.0  #: PSS/E writes 999 where there is no second cage
_ELECTRIC, _SHAFT = 2, 1  #: codes PC of the power that PSET gives
_IDLE = 1e-9  #: slip of a machine that gives no power


def read_motors(raw: RawFile, grid: StaticGrid, report: Report) -> None:
    """Put the induction machines of `raw` into `grid`."""
    for record in usable(raw.records("induction machine"), grid, report):
        bus = grid.bus(record.bus("I"), record.where)
        if record.code("STAT", 1, (0, 1)) == 0:
            report.drop("induction machine out of service", record.where)
            continue
        power = _drawn(record, bus.v, bus.kv, grid.base_mva)
        load = StaticLoad(
            bus.number, "M", record.identity("ID"), power.real, power.imag, record.where, follows=0.0
        )
        grid.loads.append(load)
        report.assume("induction machine modelled as a load of constant P and Q", record.where)


def _drawn(record: Record, volts: float, kv: float, base_mva: float) -> complex:
    """P + jQ in MW that the machine takes at its stored voltage; above 0 for a motor."""
    base = record.number("MBASE", base_mva)
    if not base > 0.0:
        raise record.wrong("MBASE", f"{base:g}", "above 0")
    rated = record.number("RATEKV", 0.0) or kv
    volts *= kv / rated if rated > 0.0 and kv > 0.0 else 1.0
    circuit = _Circuit.read(record, volts)
    of_shaft = record.code("PC", 1, (_SHAFT, _ELECTRIC)) == _SHAFT
    target = record.number("PSET", 0.0) / base
    if abs(target) < 1e-12:
        return circuit.power(_IDLE)[0] * base
    sign = 1.0 if target > 0.0 else -1.0

    def short(slip: float) -> float:
        electric, shaft = circuit.power(slip)
        return sign * (target - (shaft if of_shaft else electric.real))

    high = _first_slip(short, sign)
    if short(high) > 0.0:
        most = (target - sign * short(high)) * base
        raise CaseError(
            f"{record.where}: induction machine record: PSET = {record.text('PSET')}, allowed: at most "
            f"{most:.4g} MW, its pull-out power at the stored voltage"
        )
    return circuit.power(_bisected(short, sign * _IDLE, high))[0] * base


@dataclass(frozen=True)
class _Circuit:
    """The equivalent circuit of an induction machine at its terminal voltage, pu of its own base."""

    volts: float
    stator: complex
    gap: complex
    r1: float
    x1: float
    cage: tuple[float, float, float] | None  #: R2, X2, X3 of the second one

    @classmethod
    def read(cls, record: Record, volts: float) -> _Circuit:
        stator = complex(record.number("RA", 0.0), record.number("XA", 0.0))
        gap = 1j * record.number("XM", 2.5)
        r1, x1 = record.number("R1", _ABSENT), record.number("X1", _ABSENT)
        r2, x2, x3 = (record.number(k, d) for k, d in (("R2", _ABSENT), ("X2", _ABSENT), ("X3", 0.0)))
        if not (0.0 < r1 < _ABSENT):
            raise record.wrong("R1", f"{r1:g}", "above 0 (the resistance of the rotor)")
        return cls(volts, stator, gap, r1, x1, (r2, x2, x3) if r2 < _ABSENT else None)

    def power(self, slip: float) -> tuple[complex, float]:
        """P + jQ that the machine takes, and the power at its shaft."""
        rotor = complex(self.r1 / slip, self.x1)
        if self.cage is not None:
            r2, x2, x3 = self.cage
            cage = complex(r2 / slip, x2)
            rotor = rotor * cage / (rotor + cage) + 1j * x3
        current = self.volts / (self.stator + self.gap * rotor / (self.gap + rotor))
        in_rotor = current * self.gap / (self.gap + rotor)
        return self.volts * current.conjugate(), abs(in_rotor) ** 2 * rotor.real * (1.0 - slip)


def _first_slip(short: Callable[[float], float], sign: float) -> float:
    """The first slip on the way to 1 with nothing short of the power wanted, else that of the pull-out."""
    slips = [sign * _IDLE * 1.1**k for k in range(218)]
    for low, high in pairwise(slips):
        if short(high) <= 0.0:
            return high
        if short(high) > short(low) and abs(low) > 1e-6:
            return low
    return slips[-1]


def _bisected(short: Callable[[float], float], low: float, high: float) -> float:
    """The slip between `low`, where power is short, and `high`, where it is not, from which it is not."""
    for _ in range(200):
        middle = 0.5 * (low + high)
        if short(middle) <= 0.0:
            high = middle
        else:
            low = middle
    return high
