"""Dc lines of thyristors and FACTS devices of a RAW file as what they take from their buses at rest."""

from __future__ import annotations

import math

from ..report import Report
from ..static import StaticBranch, StaticGrid, StaticLink, StaticLoad
from .file import RawFile
from .identities import usable
from .record import Record

_INJECTION = 0.0  #: exponent with which such power follows the voltage in the dynamics: not at all


def read_converters(raw: RawFile, grid: StaticGrid, report: Report) -> None:
    """Put two-terminal dc lines and FACTS devices of `raw` into `grid` as injections."""
    for record in usable(raw.records("two-terminal dc"), grid, report):
        if record.whole("MDC", 0) == 0:
            report.drop("blocked dc line", record.where)
            continue
        _two_terminal(record, raw, grid, report)
    for record in usable(raw.records("FACTS"), grid, report):
        _facts(record, grid, report)


def add_load(
    grid: StaticGrid, record: Record, bus: int, letter: str, end: str, power: complex, *, q_free: bool = False
) -> StaticLoad:
    """Add what a converter takes, MW and Mvar; q_free : its Q follows from the stored voltages."""
    bus = grid.bus(bus, record.where).number
    load = StaticLoad(bus, letter, f"{record.text('NAME')}_{end}", power.real, power.imag, record.where)
    load.follows, load.q_free = _INJECTION, q_free
    grid.loads.append(load)
    return load


def _two_terminal(record: Record, raw: RawFile, grid: StaticGrid, report: Report) -> None:
    rectifier, inverter = (raw.part(record, k, "dc converter") for k in (0, 1))
    mode = record.code("MDC", 0, (0, 1, 2))
    resistance, compounding = record.number("RDC", 0.0), record.number("RCOMP", 0.0)
    setting, volts = record.number("SETVL", 0.0), record.number("VSCHD", 0.0)
    if not volts > 0.0:
        raise record.wrong("VSCHD", f"{volts:g}", "above 0 kV")
    if mode == 2:
        current = abs(setting) / 1000.0
    else:  # the power is that of the rectifier, a negative one that of the inverter
        slope = resistance - compounding if setting > 0.0 else -compounding
        inside = volts * volts + 4.0 * slope * abs(setting)
        if not inside >= 0.0:
            raise record.wrong("SETVL", f"{setting:g}", f"a power that {volts:g} kV can carry")
        current = 2.0 * abs(setting) / (volts + math.sqrt(inside))
    at_inverter = volts - compounding * current
    at_rectifier = at_inverter + resistance * current
    loads = []
    for converter, end, dc_volts, sign in (
        (rectifier, "R", at_rectifier, 1.0),
        (inverter, "I", at_inverter, -1.0),
    ):
        number = converter.bus("IP")
        bus = grid.bus(number, converter.where)
        q = reactive_power(converter, bus.v, dc_volts, current, sign, report)
        loads.append(add_load(grid, record, number, "D", end, complex(sign * dc_volts * current, q)))
    order = {"idc_ka": current} if mode == 2 else {"P_mw": at_rectifier * current}
    row = {"vdc_kv": volts, "r_ohm": resistance, **order, "margin": record.number("DELTI", 0.0)}
    row |= {
        f"{end}_{key}": value
        for end, converter in (("rectifier", rectifier), ("inverter", inverter))
        for key, value in _of_link(converter).items()
    }
    grid.links.append(
        StaticLink(
            record.text("NAME"), record.where, (loads[0], loads[1]), (at_rectifier, at_inverter), current, row
        )
    )


def _of_link(converter: Record) -> dict[str, float]:
    """What of a converter a link needs; `rc_ohm`, `xcap_ohm` are no keys of its row."""
    return {
        "bridges": converter.whole("NB"),
        "kv": converter.number("EBAS") * converter.number("TR", 1.0) / converter.number("TAP", 1.0),
        "xc_ohm": converter.number("XC"),
        "rc_ohm": converter.number("RC", 0.0),
        "xcap_ohm": converter.number("XCAP", 0.0),
    }


def reactive_power(
    converter: Record, volts: float, dc_volts: float, current: float, sign: float, report: Report
) -> float:
    """Return the Mvar that a line-commutated converter takes, from its commutation overlap.

    volts : at its bus, pu. dc_volts, current : kV, kA. sign : 1 for a rectifier, -1 for an inverter.
    """
    bridges, x, r = converter.whole("NB"), converter.number("XC"), converter.number("RC", 0.0)
    tap = converter.number("TAP", 1.0)
    line = volts * converter.number("EBAS") * converter.number("TR", 1.0) / tap if tap > 0.0 else 0.0
    if not line > 0.0 or bridges < 1:
        raise converter.refused("NB, EBAS, TR, TAP give no voltage at the bridge, allowed: above 0")
    ideal = bridges * 3.0 * math.sqrt(2.0) / math.pi * line
    start = (dc_volts + bridges * (3.0 / math.pi * x + 2.0 * sign * r) * current) / ideal
    if start > 1.0:
        report.assume("dc line whose angles the stored voltage does not allow: angle 0 used", converter.where)
        start = 1.0
    angle = math.acos(start)
    end = start - math.sqrt(2.0) * x * current / line
    overlap = math.acos(max(end, -1.0)) - angle
    if overlap <= 1e-9:
        return abs(dc_volts * current) * math.tan(angle)
    ratio = (2.0 * overlap + math.sin(2.0 * angle) - math.sin(2.0 * (angle + overlap))) / (
        math.cos(2.0 * angle) - math.cos(2.0 * (angle + overlap))
    )
    return abs(dc_volts * current * ratio)


def _facts(record: Record, grid: StaticGrid, report: Report) -> None:
    mode = record.whole("MODE", 1)
    first, second = record.bus("I"), record.bus("J", 0)
    if mode == 0:
        report.drop("FACTS device out of service", record.where)
        return
    grid.bus(first, record.where)
    if second == 0:
        _shunt_part(record, add_load(grid, record, first, "F", "S", 0j, q_free=True), grid, report)
        report.assume("shunt FACTS device modelled as a constant Q", record.where)
        return
    grid.bus(second, record.where)
    if mode == 1:
        power = complex(record.number("PDES", 0.0), record.number("QDES", 0.0))
        add_load(grid, record, second, "F", "J", -power)
        load = add_load(grid, record, first, "F", "I", complex(power.real, 0.0), q_free=True)
        _shunt_part(record, load, grid, report)
        report.assume("series FACTS device modelled as its scheduled power at both ends", record.where)
    elif mode == 2:
        name = record.text("NAME")
        grid.branches.append(
            StaticBranch((first, second), name, first, second, 0.0, 0.0, 0.0, record.where, joins=True)
        )
        _shunt_part(record, add_load(grid, record, first, "F", "S", 0j, q_free=True), grid, report)
    else:
        raise record.wrong(
            "MODE", str(mode), "0, 1 or 2 (other modes of the series element are not supported)"
        )


def _shunt_part(record: Record, load: StaticLoad, grid: StaticGrid, report: Report) -> None:
    """Have the shunt part hold its voltage within its rating where the stored voltages are no solution."""
    held, load.most_mva = record.number("VSET", 1.0), record.number("SHMX", 9999.0)
    if not load.most_mva >= 0.0:
        raise record.wrong("SHMX", f"{load.most_mva:g}", "0 MVA at 1 pu or above")
    load.set_v = held if held > 0.0 else None
    if "FCREG" in record.position and record.bus("FCREG", 0) not in (0, load.bus):
        load.set_v = grid.buses[load.bus].v
        report.assume(
            "FACTS device that regulates another bus: holds the stored voltage of its own", record.where
        )
