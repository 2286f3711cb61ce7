"""VSC dc lines of a RAW file: as constant powers, and as rows of dc links at the solved voltages."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from ..report import Report
from ..static import StaticGrid, StaticVsc
from .converters import add_load
from .file import RawFile
from .identities import usable
from .record import Record

CONTROL = (
    "VSC line: its control and dc capacitance are not in the file: usual values used; losses are constant, "
    "limits of reactive power are ignored"
)
_SPARE = 1.1  #: current limit by the rated current, of a converter without a rating in the file


def read_vsc_lines(raw: RawFile, grid: StaticGrid, report: Report) -> None:
    """Put VSC dc lines of `raw` into `grid`: their converters as loads, and what a dc link needs."""
    for record in usable(raw.records("VSC dc"), grid, report):
        if record.code("MDC", 1, (0, 1)) == 0 or not _read(record, raw, grid, report):
            report.drop("VSC line out of service", record.where)


def _read(record: Record, raw: RawFile, grid: StaticGrid, report: Report) -> bool:
    """Read a line; return whether it is in service."""
    converters = [raw.part(record, k, "VSC converter") for k in (0, 1)]
    kinds = [c.code("TYPE", 0, (0, 1, 2)) for c in converters]
    if 0 in kinds:
        return False
    if sorted(kinds) != [1, 2]:
        raise converters[0].wrong(
            "TYPE", f"{kinds[0]} and {kinds[1]}", "one voltage end (1), one power end (2)"
        )
    holds, gives = converters[kinds.index(1)], converters[kinds.index(2)]
    volts, power = holds.number("DCSET"), gives.number("DCSET", 0.0)
    if not volts > 0.0:
        raise holds.wrong("DCSET", f"{volts:g}", "above 0 kV at the voltage end")
    current = _current(record, gives, volts, power)
    drawn = volts * current + _losses(holds, current)
    loads = []
    for converter, end, taken in ((gives, "P", -power), (holds, "V", drawn)):
        bus = grid.bus(converter.bus("IBUS"), converter.where).number
        load = add_load(grid, record, bus, "D", end, complex(taken, 0.0), q_free=True)
        load.set_v, load.set_q = _set_points(converter, taken)
        if load.set_v is not None and converter.bus("REMOT", 0) not in (0, bus):
            load.set_v = grid.buses[bus].v
            what = "VSC converter that regulates another bus: holds the stored voltage of its own"
            report.assume(what, converter.where)
        loads.append(load)
    row: dict[str, float | str] = {"vdc_kv": volts, "r_ohm": record.number("RDC", 0.0)}
    for end, converter in (("from", gives), ("to", holds)):
        row[f"{end}_keeps"] = "v" if converter.code("MODE", 1, (1, 2)) == 1 else "q"
        # PWF: 0 reduces the active power alone where a rating is exceeded, 1 the reactive power alone
        row[f"{end}_priority"] = "p" if converter.number("PWF", 1.0) >= 0.5 else "q"
        row[f"{end}_loss_mw"] = _losses(converter, current)
    of_power, of_voltage = ((_rating(c, "SMAX"), _rating(c, "IMAX")) for c in (gives, holds))
    name = record.text("NAME")
    grid.links.append(StaticVsc(name, record.where, (loads[0], loads[1]), row, (of_power, of_voltage)))
    return True


def _set_points(converter: Record, power: float) -> tuple[float | None, float | None]:
    """Return the voltage, pu, that a converter of `power` MW holds, or the Mvar that it gives, else None.

    Neither is there for a setting that no converter has. A power factor below 0 draws reactive power.
    """
    setting = converter.number("ACSET", 1.0)
    if converter.code("MODE", 1, (1, 2)) == 1:
        return setting if setting > 0.0 else None, None
    if not 0.0 < abs(setting) <= 1.0:
        return None, None
    factor = math.sqrt(1.0 - setting * setting)
    return None, math.copysign(abs(power) * factor / abs(setting), setting)


def _rating(converter: Record, name: str) -> float:
    value = converter.number(name, 0.0)
    if not value >= 0.0:
        raise converter.wrong(name, f"{value:g}", "0 (no limit) or above")
    return value


def _current(record: Record, gives: Record, volts: float, power: float) -> float:
    """Return the kA from the voltage to the power end, which gives `power` MW to its bus, at `volts` kV."""
    resistance, current = record.number("RDC", 0.0), 0.0
    for _ in range(100):
        at_end = volts - resistance * current
        if not at_end > 0.0:
            raise record.refused(f"no dc voltage carries {power:g} MW from {volts:g} kV")
        current, last = (power + _losses(gives, current)) / at_end, current
        if abs(current - last) < 1e-14 * (1.0 + abs(current)):
            break
    return current


def _losses(converter: Record, current: float) -> float:
    """MW lost in a converter at `current` kA; its constants are in kW and kW/A."""
    line = converter.number("ALOSS", 0.0) + converter.number("BLOSS", 0.0) * 1000.0 * abs(current)
    return max(converter.number("MINLOSS", 0.0), line) / 1000.0


def vsc_row(link: StaticVsc, grid: StaticGrid, voltages: Mapping[int, complex]) -> tuple[str, dict[str, Any]]:
    """Return what excludes a dc link, "" if nothing does, and its row. voltages : of the buses, pu."""
    currents, ratings = [], []
    for load, (mva, ampere) in zip(link.loads, link.rating, strict=True):
        kv = grid.buses[load.bus].kv
        limits = (mva, math.sqrt(3.0) * kv * ampere / 1000.0)
        ratings.append(min((x for x in limits if x > 0.0), default=0.0))
        currents.append(math.hypot(load.p, load.q) / abs(voltages[load.bus]))  # MVA at 1 pu
    base = max(ratings) or max(currents)
    if not base > 0.0:
        return "it carries nothing and has no rating; set SMAX", {}
    if not float(link.row["r_ohm"]) >= 0.0:
        return "RDC is below 0; set it", {}
    of_power, of_voltage = link.loads
    row: dict[str, Any] = {"from_bus": of_power.bus, "to_bus": of_voltage.bus, "base_mva": base}
    row |= {"P_mw": of_power.p, "from_q_mvar": -of_power.q, "to_q_mvar": -of_voltage.q, **link.row}
    for end, load, rating, current in zip(("from", "to"), link.loads, ratings, currents, strict=True):
        limit = row[f"{end}_i_max_pu"] = rating / base or _SPARE
        if not current < limit * base:
            current_text = f"its current at bus {load.bus} is {current:.6g} MVA at 1 pu"
            return (
                f"{current_text}, not below its rating of {limit * base:.6g}; set a higher SMAX or IMAX",
                {},
            )
    return "", row


def vsc_line_text(link: StaticVsc, name: str, row: Mapping[str, Any]) -> str:
    """Return what becomes of a line, in words."""
    return (
        f"VSC dc line {link.name.strip()!r}: dc link {name}, {row['vdc_kv']:.6g} kV, {row['P_mw']:.6g} MW "
        f"from bus {row['from_bus']} to bus {row['to_bus']}, rated {row['base_mva']:.6g} MVA"
    )
