"""A grid of MATPOWER: the tables of a case file of version 2."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from ..case.case import case_of
from ..devices.language.device import USUAL_HZ
from ..errors import CaseError
from .document import case_name, document_of, load_exponents
from .imported import AS_FILED, Imported, ImportOptions
from .m_file import MFile, read_m_file
from .places import read_places
from .raw.text import read_lines
from .report import Report
from .static import StaticBranch, StaticBus, StaticGrid, StaticLoad, StaticShunt, StaticUnit
from .stored import decide_units_at_load_buses, solve_stored
from .topology import settle, slacks_of

_COLUMNS = {"bus": 13, "gen": 8, "branch": 11, "dcline": 9}
#: columns that are read and must be finite; limits, costs and ratings may be Inf
_READ = {
    "bus": (0, 1, 2, 3, 4, 5, 6, 7, 8, 9),
    "gen": (0, 1, 2, 5, 6, 7),
    "branch": (0, 1, 2, 3, 4, 8, 9, 10),
    "dcline": (0, 1, 2, 3, 4, 5, 6),
}
_LEAST_PU = 1e-7  #: impedance below which a branch joins its ends


@dataclass(frozen=True)
class _Row:
    values: tuple[float, ...]
    where: str

    def bus(self, column: int, grid: StaticGrid) -> int:
        """Return column `column` as the number of a bus of `grid`."""
        return grid.bus(self.whole(column), self.where).number

    def whole(self, column: int) -> int:
        """Return column `column` as a whole number."""
        if self.values[column] != int(self.values[column]):
            raise CaseError(
                f"{self.where}: column {column + 1} is {self.values[column]:g}, allowed: a whole number"
            )
        return int(self.values[column])


def import_matpower(
    path: str | Path, options: ImportOptions = AS_FILED, *, name: str | None = None
) -> Imported:
    """Return the grid of a MATPOWER `.m` file; its machines have no dynamic data (model power_flow).

    Reactive limits, costs and ratings play no part. MATPOWER says neither the frequency nor how loads follow
    the voltage: 60 Hz and constant impedance when not given. Options of DYR files have no effect.

    Raises
    ------
    CaseError : not version 2, a table that is missing or cut short, a value the case refuses; each with file
        and line.
    PowerFlowError : no solution beside the stored voltages, nor from a flat start.
    """
    path = Path(path)
    report = Report(options.strict)
    file = read_m_file(path, read_lines(path))
    base_mva = _base_mva(file)
    tables = {table: _table(file, table) for table in _COLUMNS}
    if options.frequency_hz is None:
        report.assume(f"no frequency in the file: {USUAL_HZ:g} Hz", str(path))
    grid = StaticGrid(base_mva, options.frequency_hz or USUAL_HZ, f"{path.name} (MATPOWER)")
    _buses(tables["bus"], grid)
    _units(tables["gen"], grid, report)
    _branches(tables["branch"], grid, report)
    _dc_lines(tables["dcline"], grid, report)
    for what, rows in (("buses", grid.buses), ("branches", grid.branches), ("units", grid.units)):
        report.read[what] = len(rows)
    _tell(file, report)
    if options.coordinates is not None:
        read_places(Path(options.coordinates), grid)
    settle(grid, report, options.island)
    decide_units_at_load_buses(grid, report)
    solution = solve_stored(grid, slacks_of(grid, report), report)
    exponents = load_exponents(options.P_exponent, options.Q_exponent, grid, report, str(path))
    document = document_of(grid, solution, name=name or case_name(path, report), exponents=exponents)
    return Imported(case_of(document, where=str(path)), report, solution)


def _base_mva(file: MFile) -> float:
    """The base of a case file of version 2; other versions are refused."""
    version = file.scalars.get("version")
    if version not in ("2", 2.0):
        got = "none" if version is None else str(version)
        raise CaseError(f"{file.path}: MATPOWER case version {got}, allowed: 2 (mpc.version = '2')")
    base_mva = file.scalars.get("baseMVA")
    if not isinstance(base_mva, float):
        raise CaseError(f"{file.path}{_fields(file, 'baseMVA')}, allowed: a number of MVA")
    if not base_mva > 0.0:
        raise CaseError(f"{file.path}: mpc.baseMVA = {base_mva:g}, allowed: above 0")
    return base_mva


def _fields(file: MFile, name: str) -> str:
    """What a file has of a field that is wanted in another form, or not at all."""
    line = file.other.get(name) or next(iter(file.lines.get(name, ())), None)
    if name in file.scalars:
        return f": mpc.{name} = {str(file.scalars[name])[:40]!r}"
    return f": mpc.{name} is missing" if line is None else f":{line}: mpc.{name} has another form"


def _table(file: MFile, table: str) -> list[_Row]:
    if table not in file.tables:
        if table != "dcline":
            allowed = "a case with bus, gen and branch, each a table of numbers"
            raise CaseError(f"{file.path}{_fields(file, table)}, allowed: {allowed}")
        return []
    rows: list[_Row] = []
    for line, values in zip(file.lines[table], file.tables[table].tolist(), strict=True):
        where = f"{file.path}:{line}"
        if len(values) < _COLUMNS[table]:
            raise CaseError(f"{where}: mpc.{table}: {len(values)} columns, allowed: >= {_COLUMNS[table]}")
        for column in _READ[table]:
            if not math.isfinite(values[column]):
                raise CaseError(
                    f"{where}: mpc.{table}: column {column + 1} is {values[column]:g}, allowed: a finite "
                    "number"
                )
        rows.append(_Row(tuple(values), where))
    return rows


def _tell(file: MFile, report: Report) -> None:
    """Say what of `file` was done and what plays no part."""
    report.read["statements that change a table: executed"] = len(file.changes)
    for name, line in file.twice.items():
        report.assume(f"mpc.{name} is given twice: the later one used", f"{file.path}:{line}")
    for name, rows in file.lines.items():
        if name not in _COLUMNS and rows:
            report.drop(f"mpc.{name}: ignored", f"{file.path}:{rows[0]}")
    for name, line in file.other.items():
        report.drop(f"mpc.{name}: ignored", f"{file.path}:{line}")


def _buses(rows: list[_Row], grid: StaticGrid) -> None:
    for row in rows:
        v = row.values
        number = row.whole(0)
        if number in grid.buses:
            raise CaseError(f"{row.where}: bus {number} is given twice, allowed: once")
        if v[1] not in (1, 2, 3, 4):
            raise CaseError(f"{row.where}: bus {number} has type {v[1]:g}, allowed: 1, 2, 3, 4")
        if not v[7] > 0.0:
            raise CaseError(f"{row.where}: bus {number} has Vm = {v[7]:g}, allowed: above 0 pu")
        bus = StaticBus(number, row.where, "", max(v[9], 0.0), int(v[1]), max(row.whole(6), 1), v[7], v[8])
        grid.buses[number] = bus
        if v[2] or v[3]:
            grid.loads.append(StaticLoad(number, "L", "1", v[2], v[3], row.where))
        if v[4] or v[5]:
            grid.shunts.append(StaticShunt(number, "C", "1", v[4], v[5], row.where))


def _units(rows: list[_Row], grid: StaticGrid, report: Report) -> None:
    count: dict[int, int] = {}
    for row in rows:
        v, on = row.values, row.values[7] > 0.0
        if not on and row.whole(0) not in grid.buses:
            report.drop("unit out of service at a bus that does not exist", row.where)
            continue
        bus = row.bus(0, grid)
        count[bus] = count.get(bus, 0) + 1
        if on and not v[5] > 0.0:
            raise CaseError(f"{row.where}: generator at bus {bus} has Vg = {v[5]:g}, allowed: above 0 pu")
        base = v[6] if v[6] > 0.0 else grid.base_mva
        unit = StaticUnit(bus, str(count[bus]), v[1], v[2], v[5], base, 0.0, 0.0, row.where, on)
        grid.units.append(unit)


def _branches(rows: list[_Row], grid: StaticGrid, report: Report) -> None:
    count: dict[frozenset[int], int] = {}
    for row in rows:
        v, on = row.values, row.values[10] > 0.0
        if not on and not {row.whole(0), row.whole(1)} <= grid.buses.keys():
            report.drop("branch out of service at a bus that does not exist", row.where)
            continue
        first, second = row.bus(0, grid), row.bus(1, grid)
        if first == second:
            raise CaseError(f"{row.where}: branch from bus {first} to itself, allowed: two buses")
        pair = frozenset((first, second))
        count[pair] = count.get(pair, 0) + 1
        branch = StaticBranch((first, second), str(count[pair]), first, second, v[2], v[3], v[4], row.where)
        branch.on, branch.transformer = on, bool(v[8] or v[9])
        branch.tap, branch.shift = v[8] or 1.0, v[9]
        if not branch.tap > 0.0:
            raise CaseError(f"{row.where}: branch {first}-{second} has ratio {v[8]:g}, allowed: 0 or above")
        if abs(complex(branch.r, branch.x)) < _LEAST_PU:
            branch.joins = not branch.transformer
            if branch.transformer:
                branch.x = _LEAST_PU
                report.assume(f"transformer without impedance: x = {_LEAST_PU:g} pu", row.where)
        grid.branches.append(branch)


def _dc_lines(rows: list[_Row], grid: StaticGrid, report: Report) -> None:
    """Dc lines as constant powers; the Q that holds their voltages is what the stored voltages leave over."""
    for k, row in enumerate(rows, 1):
        v = row.values
        if not v[2] > 0.0:
            report.drop("dc line out of service", row.where)
            continue
        for end, bus, taken in (("F", row.bus(0, grid), v[3]), ("T", row.bus(1, grid), -v[4])):
            load = StaticLoad(bus, "D", f"{k}{end}", taken, 0.0, row.where, follows=0.0, q_free=True)
            grid.loads.append(load)
        report.assume("dc line modelled as constant P and Q at both ends", row.where)
