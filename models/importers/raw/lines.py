"""Lines and switches of a RAW file, and the tables that correct the impedance of transformers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..report import Report
from ..static import StaticBranch, StaticGrid, StaticShunt
from .file import RawFile
from .identities import usable
from .record import Record

ZERO_PU = 1e-4  #: THRSHZ of PSS/E: a line without resistance up to this reactance joins its ends
LEAST_PU = 1e-4  #: reactance that a transformer without impedance gets


@dataclass(frozen=True)
class Correction:
    """Factors on the impedance of a winding against its ratio or its angle."""

    points: tuple[tuple[float, complex], ...]

    def factor(self, ratio: float, angle_deg: float) -> complex:
        """Return the factor, linear between the points and held at the ends."""
        at = [t for t, _ in self.points]
        by_angle = any(t <= 0.0 or t > 3.0 for t in at)
        factors = np.array([f for _, f in self.points])
        where = angle_deg if by_angle else ratio
        return complex(np.interp(where, at, factors.real), np.interp(where, at, factors.imag))


def corrections(raw: RawFile) -> dict[int, Correction]:
    """Return the impedance correction tables by number."""
    tables: dict[int, Correction] = {}
    for group in raw.groups.get("impedance correction", []):
        head = raw.record("impedance correction", group[0], {"I": 0})
        words = (*head.words, *(w for line in group[1:] for w in raw.record("", line, {}).words))
        names = ("T", "Re(F)", "Im(F)") if raw.version >= 34 else ("T", "F")
        step = len(names)
        position = {f"{names[k % step]}{k // step + 1}": k + 1 for k in range(len(words) - 1)}
        values = Record("impedance correction", words, head.where, position)
        points: list[tuple[float, complex]] = []
        for k in range(1, (len(words) - 1) // step + 1):
            t, *factor = (values.number(f"{name}{k}", 0.0) for name in names)
            if t == 0.0 and not any(factor):
                continue
            points.append((t, complex(*factor)))
        if len(points) < 2 or any(b[0] <= a[0] for a, b in pairwise(points)):
            raise head.refused(f"table {head.text('I')}: allowed: at least two points with rising abscissas")
        number = head.whole("I")
        if number in tables:
            raise head.refused(f"table {number} is given twice, allowed: each number once")
        tables[number] = Correction(tuple(points))
    return tables


def read_lines_of(raw: RawFile, grid: StaticGrid, report: Report) -> None:
    """Put branches (to version 26 with the transformers among them) and switches of `raw` into `grid`."""
    threshold = raw.system.get("THRSHZ", ZERO_PU)
    tables = corrections(raw) if raw.version <= 26 else {}
    adjusted = {}
    for record in raw.records("transformer adjustment"):
        number = record.whole("TABLE", 0)
        if number:
            adjusted[record.bus("I"), record.bus("J"), record.identity("CKT")] = (number, record.where)
    for record in usable(raw.records("branch"), grid, report):
        row = _line(record, grid, threshold, report)
        key = (row.first, row.second, row.circuit)
        if key in adjusted:
            apply(row, tables, *adjusted[key], report)
    for record in usable(raw.records("switching device"), grid, report):
        first, second = (grid.bus(record.bus(k), record.where).number for k in ("I", "J"))
        on = record.whole("STAT", 1) == 1
        circuit = record.identity("CKT")
        grid.branches.append(
            StaticBranch(
                (first, second), circuit, first, second, 0.0, 0.0, 0.0, record.where, on=on, joins=True
            )
        )
    report.read["lines"] = sum(not b.transformer for b in grid.branches)
    for record in raw.records("GNE"):
        if record.parts and record.parts[0].words[:1] == ("0",):
            report.drop("generic network element out of service", record.where)
        else:
            raise record.refused("has no model here; remove it or replace it by loads")


def apply(row: StaticBranch, tables: dict[int, Correction], number: int, where: str, report: Report) -> None:
    """Multiply the impedance of `row` by its correction table."""
    if number not in tables:
        report.assume("impedance correction table that is not in the file: ignored", where)
        return
    z = complex(row.r, row.x) * tables[number].factor(row.tap, row.shift)
    row.r, row.x = z.real, z.imag


def _line(record: Record, grid: StaticGrid, threshold: float, report: Report) -> StaticBranch:
    first, second = (grid.bus(record.bus(k), record.where).number for k in ("I", "J"))
    if first == second:
        raise record.refused(f"both ends at bus {first}, allowed: two buses")
    on = record.code("ST", 1, (0, 1)) == 1
    r, x, b = record.number("R", 0.0), record.number("X"), record.number("B", 0.0)
    circuit = record.identity("CKT")
    row = StaticBranch((first, second), circuit, first, second, r, x, b, record.where, on=on)
    ratio = record.number("RATIO", 0.0) if "RATIO" in record.position else 0.0
    if ratio:
        if not ratio > 0.0:
            raise record.wrong("RATIO", f"{ratio:g}", "0 (a line) or above")
        row.transformer, row.tap, row.shift = True, ratio, record.number("ANGLE", 0.0)
        bolster(row, report)
    else:
        row.joins = r == 0.0 and abs(x) <= threshold
    for bus, g_key, b_key in ((first, "GI", "BI"), (second, "GJ", "BJ")):
        shunt = complex(record.number(g_key, 0.0), record.number(b_key, 0.0)) * grid.base_mva
        if shunt:
            name = f"{first}_{second}_{circuit}"
            grid.shunts.append(StaticShunt(bus, "E", name, shunt.real, shunt.imag, record.where, on))
    grid.branches.append(row)
    return row


def bolster(row: StaticBranch, report: Report) -> None:
    """Give a transformer without impedance a small reactance."""
    if math.hypot(row.r, row.x) < LEAST_PU:
        row.x = LEAST_PU
        if row.on:
            report.assume(f"transformer without impedance: x = {LEAST_PU:g} pu", row.where)
