"""Transformers of a RAW file from version 27 on: two windings as a branch, three as a star of branches."""

from __future__ import annotations

import math

from ..report import Report
from ..static import StaticBranch, StaticGrid, StaticShunt
from .file import RawFile
from .identities import usable
from .lines import Correction, apply, bolster, corrections
from .record import Record

_FARTHEST = 1000.0  # of a nominal voltage from the base voltage of its bus, as a factor: kV for V
_OUT = {0: (1, 2, 3), 1: (), 2: (2,), 3: (3,), 4: (1,)}  #: STAT -> windings out of service


def read_transformers(raw: RawFile, grid: StaticGrid, report: Report) -> None:
    """Put the transformers of `raw` into `grid`; windings of a star end at a bus of its own."""
    tables = corrections(raw) if raw.groups.get("transformer") else {}
    count = [0, 0]
    for head in usable(raw.records("transformer"), grid, report):
        impedance = raw.part(head, 0, "transformer impedance")
        windings = [raw.part(head, k, "transformer winding") for k in range(1, len(head.parts))]
        if len(windings) == 2:
            _two(head, impedance, windings, grid, tables, report)
        else:
            _three(head, impedance, windings, grid, tables, report)
        count[len(windings) - 2] += 1
    report.read["transformers of two windings"], report.read["of three"] = count


def _two(
    head: Record,
    impedance: Record,
    windings: list[Record],
    grid: StaticGrid,
    tables: dict[int, Correction],
    report: Report,
) -> None:
    buses = [grid.bus(head.bus(key), head.where).number for key in ("I", "J")]
    if buses[0] == buses[1]:
        raise head.refused(f"both windings at bus {buses[0]}, allowed: two buses")
    on = head.code("STAT", 1, (0, 1)) == 1
    turns = [_turns(head, w, bus, grid) for w, bus in zip(windings, buses, strict=True)]
    z = _impedance(head, impedance, "1-2", windings[0], buses[0], grid, report)
    row = StaticBranch(
        (buses[0], buses[1]),
        head.identity("CKT"),
        buses[0],
        buses[1],
        z.real * turns[1] ** 2,  # the ideal ratio of winding 2 moved to the other side of r + jx
        z.imag * turns[1] ** 2,
        0.0,
        head.where,
        turns[0] / turns[1],
        windings[0].number("ANG", 0.0),
        on,
        True,
    )
    number = windings[0].whole("TAB", 0)
    if number:
        z *= turns[1] ** 2
        tapped = StaticBranch((), "", 0, 0, z.real, z.imag, 0.0, head.where, turns[0], row.shift)
        apply(tapped, tables, number, windings[0].where, report)
        row.r, row.x = tapped.r, tapped.x
    bolster(row, report)
    grid.branches.append(row)
    _magnetising(head, impedance, windings[0], buses[0], "_".join(map(str, buses)), grid, on)


def _three(
    head: Record,
    impedance: Record,
    windings: list[Record],
    grid: StaticGrid,
    tables: dict[int, Correction],
    report: Report,
) -> None:
    status = head.code("STAT", 1, (0, 1, 2, 3, 4))
    buses = _star_buses(head, status, grid, report)
    if status == 0:
        report.drop("transformer of three windings out of service", head.where)
        return
    turns = [_turns(head, w, bus, grid) for w, bus in zip(windings, buses, strict=True)]
    angles = [w.number("ANG", 0.0) for w in windings]
    numbers = [w.whole("TAB", 0) for w in windings]
    z12, z23, z31 = (
        _impedance(head, impedance, pair, windings[k], buses[k], grid, report)
        for k, pair in enumerate(("1-2", "2-3", "3-1"))
    )
    on_pairs = any(numbers) and head.whole("ZCOD", 0) == 1
    factor = [
        _factor(tables, number, turns[k], angles[k], windings[k], report) if number else 1.0
        for k, number in enumerate(numbers)
    ]
    if on_pairs:
        report.assume("correction tables on the pairs (ZCOD 1) used as of windings 1-2, 2-3, 3-1", head.where)
        z12, z23, z31 = z12 * factor[0], z23 * factor[1], z31 * factor[2]
    legs = [(z12 + z31 - z23) / 2, (z12 + z23 - z31) / 2, (z23 + z31 - z12) / 2]
    circuit = head.identity("CKT")
    near = next(bus for bus in buses if bus in grid.buses)
    star = grid.new_bus(near, head.where, f"star {'-'.join(map(str, buses))} {circuit}", star=True)
    for k, (bus, leg) in enumerate(zip(buses, legs, strict=True)):
        if bus not in grid.buses:
            continue
        z = leg if on_pairs else leg * factor[k]
        row = StaticBranch(
            (buses[0], buses[1], buses[2]),
            circuit,
            bus,
            star.number,
            z.real,
            z.imag,
            0.0,
            head.where,
            turns[k],
            angles[k],
            k + 1 not in _OUT[status],
            True,
            k + 1,
        )
        bolster(row, report)
        grid.branches.append(row)
    name = "_".join(map(str, buses))
    _magnetising(head, impedance, windings[0], buses[0], name, grid, status != 4)


def _star_buses(head: Record, status: int, grid: StaticGrid, report: Report) -> list[int]:
    """The buses of three windings; that of one out of service may be missing, which is reported."""
    buses = [head.bus(key) for key in ("I", "J", "K")]
    for k, bus in enumerate(buses, 1):
        if k not in _OUT[status]:
            grid.bus(bus, head.where)
        elif bus not in grid.buses:
            report.drop("winding out of service at a bus that does not exist", head.where)
    if len(set(buses)) < 3:
        raise head.refused(f"windings at buses {buses}, allowed: three buses")
    return buses


def _factor(
    tables: dict[int, Correction], number: int, ratio: float, angle: float, winding: Record, report: Report
) -> complex:
    unit = StaticBranch((), "", 0, 0, 1.0, 0.0, 0.0, winding.where, ratio, angle)
    apply(unit, tables, number, winding.where, report)
    return complex(unit.r, unit.x)


def _turns(head: Record, winding: Record, bus: int, grid: StaticGrid) -> float:
    """The ratio of a winding in pu of the bus base voltage."""
    code = head.code("CW", 1, (1, 2, 3))
    kv = _base_kv(bus, winding, grid)
    if code == 2:
        if not kv > 0.0:
            raise head.refused(f"CW = 2 but bus {bus} has no base voltage, allowed: a BASKV above 0")
        ratio = winding.number("WINDV", kv) / kv
    else:
        ratio = winding.number("WINDV", 1.0)
        nominal = winding.number("NOMV", 0.0)
        if code == 3 and nominal > 0.0 and kv > 0.0:
            ratio *= nominal / kv
    if not ratio > 0.0:
        raise winding.wrong("WINDV", f"{ratio:g}", "a ratio above 0")
    return ratio


def _base_kv(bus: int, winding: Record, grid: StaticGrid) -> float:
    """The base voltage of a winding's bus; its own nominal one where that bus is not in the file."""
    return grid.buses[bus].kv if bus in grid.buses else winding.number("NOMV", 0.0) or 1.0


def _nominal_ratio(winding: Record, bus: int, grid: StaticGrid) -> float:
    """The nominal voltage of a winding over the base voltage of its bus; 1 where either is not known."""
    kv, nominal = _base_kv(bus, winding, grid), winding.number("NOMV", 0.0)
    if not (kv > 0.0 and nominal > 0.0):
        return 1.0
    if not kv / _FARTHEST <= nominal <= kv * _FARTHEST:
        raise winding.wrong("NOMV", f"{nominal:g}", f"within a factor {_FARTHEST:g} of {kv:g} kV of its bus")
    return nominal / kv


def _impedance(
    head: Record, record: Record, pair: str, winding: Record, bus: int, grid: StaticGrid, report: Report
) -> complex:
    """The impedance between two windings in pu of the grid's base and the bus base voltages."""
    code = head.code("CZ", 1, (1, 2, 3))
    r, x = record.number(f"R{pair}", 0.0), record.number(f"X{pair}", None if pair == "1-2" else 0.0)
    if code == 1:
        return complex(r, x)
    base = record.number(f"SBASE{pair}", grid.base_mva)
    if not base > 0.0:
        raise record.wrong(f"SBASE{pair}", f"{base:g}", "above 0 MVA")
    if code == 3:  # watts of the load loss test, and the size of the impedance
        r = r / (1e6 * base)
        if not abs(r) <= abs(x):
            raise record.wrong(f"R{pair}", record.text(f"R{pair}"), "losses below the impedance")
        x = math.copysign(math.sqrt(x * x - r * r), x)
    scale = grid.base_mva / base
    ratio = _nominal_ratio(winding, bus, grid)
    if abs(ratio - 1.0) > 1e-6:
        report.assume(
            "impedance on the winding's own base (CZ 2, 3) referred to NOMV, not to BASKV", winding.where
        )
        scale *= ratio**2
    return complex(r, x) * scale


def _magnetising(
    head: Record, impedance: Record, winding: Record, bus: int, name: str, grid: StaticGrid, on: bool
) -> None:
    g, b = head.number("MAG1", 0.0), head.number("MAG2", 0.0)
    if not (g or b):
        return
    if head.code("CM", 1, (1, 2)) == 2:  # watts of the no-load test, and the size of its current
        base = impedance.number("SBASE1-2", grid.base_mva)
        g /= 1e6 * base
        if not abs(g) <= abs(b):
            raise head.wrong("MAG1", head.text("MAG1"), "losses below those of MAG2")
        b = -math.sqrt(b * b - g * g)
        scale = base / grid.base_mva / _nominal_ratio(winding, bus, grid) ** 2
        g, b = g * scale, b * scale
    identity = f"{name}_{head.identity('CKT')}"
    grid.shunts.append(StaticShunt(bus, "M", identity, g * grid.base_mva, b * grid.base_mva, head.where, on))
