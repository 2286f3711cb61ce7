"""A grid of PSS/E: the network from a RAW file of version 23 to 36, dynamic data from a DYR file."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..case.case import Case, case_of, devices_of
from ..case.document import with_device_texts
from ..case.hvdc_schema import Hvdc
from ..devices.language.device import USUAL_HZ
from ..devices.library import keys_of
from ..errors import CaseError
from ..grid.dc_link import link_point
from ..grid.powerflow import solve_powerflow
from .document import case_name, document_of, load_exponents, unit_names
from .dynamics import PLANT_CONTROL, SOURCE, Dynamics, machine_dynamics, read_dynamics, replaced
from .dyr import DyrRecord
from .imported import AS_FILED, Imported, ImportOptions
from .load_records import take_load_records
from .places import read_places
from .raw.converters import read_converters
from .raw.dc_links import link_rows, said, take_links
from .raw.file import RawFile, read_raw
from .raw.lines import read_lines_of
from .raw.motors import read_motors
from .raw.multi_terminal import read_multi_terminal
from .raw.nodes import read_nodes
from .raw.rawx import is_rawx, read_rawx
from .raw.record import Record
from .raw.transformers import read_transformers
from .raw.vsc_links import read_vsc_lines
from .report import Report
from .static import StaticGrid, StaticLink
from .stored import decide_units_at_load_buses, solve_stored
from .topology import settle, slacks_of

_ROUNDS, _STILL_DEG = 50, 1e-6  #: of the extinction angles of dc links


def import_psse(
    raw: str | Path,
    dyr: str | Path | None = None,
    options: ImportOptions = AS_FILED,
    *,
    name: str | None = None,
) -> Imported:
    """Return the grid of a PSS/E RAW (version 23 to 36) or RAWX and DYR file, each plain, gzip or xz.

    Without `dyr` the machines have no dynamic data (model power_flow). RAW and DYR do not tell how loads
    follow the voltage: the two exponents do, constant impedance (2) when not given.

    Raises
    ------
    CaseError : a file that cannot be read, equipment or a model without counterpart, a value that the case
        refuses; with file and line.
    PowerFlowError : no solution beside the stored voltages, nor from a flat start.
    """
    path = Path(raw)
    report = Report(options.strict)
    provided = with_device_texts({"devices": tuple(options.devices)}, Path(), str(path))
    own = devices_of(provided["devices"], str(path))
    file = read_rawx(path) if is_rawx(path) else read_raw(path)
    grid = static_grid(file, report, options.frequency_hz)
    if options.coordinates is not None:
        read_places(Path(options.coordinates), grid)
    out = {(unit.home, unit.identity) for unit in grid.units if not unit.on}
    settle(grid, report, options.island)
    decide_units_at_load_buses(grid, report)
    solution = solve_stored(grid, slacks_of(grid, report), report)
    names = unit_names(grid)
    dynamics = Dynamics({}, {}, {})
    records: tuple[DyrRecord, ...] = ()
    machine_of: dict[tuple[int, str], str] = {}
    if dyr is not None:
        machine_of = {(u.home, u.identity): n for u, n in zip(grid.units, names, strict=True)}
        out |= {key for key in _all_units(file) if key not in machine_of}
        read = replaced(read_dynamics(Path(dyr), own), options.leave_out, options.replace, report)
        records = read.records
        take_load_records(records, grid.loads, report)
        dynamics = machine_dynamics(
            read,
            machine_of,
            out,
            report,
            converters_as_current=options.converters == "current",
            own=own,
        )
        if len(dynamics.no_machines) == len(names):
            raise CaseError(f"{dyr}: no machine model for any unit of {path.name}, allowed: at least one")
        _compare_reactances(grid, names, dynamics, report)
        _take_impedances(grid, names, dynamics)
        grid.source += f" and {Path(dyr).name}"
    links, vscs, where = take_links(grid, solution.voltages, report, as_power=options.dc_lines == "power")
    exponents = load_exponents(options.P_exponent, options.Q_exponent, grid, report, str(path))
    document = document_of(
        grid,
        solution,
        name=name or case_name(path, report),
        exponents=exponents,
        constant={names.index(n): exponent for n, exponent in dynamics.constant.items()},
        converters={names.index(n) for n in dynamics.converters},
        svcs={names.index(n) for n in dynamics.svcs},
    )
    _take_rows(document, dynamics)
    _take_measured(records, grid, document, machine_of)
    document |= {"hvdcs": link_rows(links, solution.voltages), "vscs": vscs}
    document["devices"] = provided["devices"]
    lines = {name: unit.where for name, unit in zip(names, grid.units, strict=True)} | dynamics.where | where
    case = _case_with_lines(document, str(path), lines)
    return Imported(_settled(case, links, report), report, solution)


def _settled(case: Case, links: Mapping[str, StaticLink], report: Report) -> Case:
    """The case with the dc voltages of the file at the solution of its own power flow.

    The links' reactive power is not that of the file, so voltages and extinction angles move with it.
    """
    if not links:
        return case
    try:
        for _ in range(_ROUNDS):
            flow = solve_powerflow(case)
            voltages = dict(zip((bus.number for bus in case.buses), flow.voltages.tolist(), strict=True))
            rows = link_rows(links, voltages)
            moved = max(
                abs(row["gamma_deg"] - was.gamma_deg)
                for row, was in zip(rows.values(), case.hvdcs, strict=True)
            )
            if moved <= _STILL_DEG:
                break
            case = case.model_copy(update={"hvdcs": tuple(Hvdc(name=n, **row) for n, row in rows.items())})
        else:
            raise CaseError(f"{case.name}: extinction angles of its dc links still move by {moved:.3g} deg")
    except CaseError as error:
        raise CaseError(f"{error}; keep dc lines as constant powers (--dc-lines power)") from None
    for (name, link), row in zip(links.items(), case.hvdcs, strict=True):
        u = (abs(voltages[row.rectifier_bus]), abs(voltages[row.inverter_bus]))
        alpha = math.degrees(link_point(row, *u).alpha)
        report.lines.append(said(link, name, rows[name], alpha))
    return case


def _take_rows(document: dict[str, Any], dynamics: Dynamics) -> None:
    """Put what the DYR file says of each machine, converter and SVC into its row."""
    tables = {"converters": dynamics.converters, "svcs": dynamics.svcs, "machines": dynamics.rows}
    for table, rows in tables.items():
        for key, row in rows.items():
            document[table][key] |= row


def _take_measured(
    records: Iterable[DyrRecord],
    grid: StaticGrid,
    document: dict[str, Any],
    machine_of: Mapping[tuple[int, str], str],
) -> None:
    """Put into the rows of converters where their plant controls measure."""
    converters = document.get("converters", {})
    for record in records:
        name = machine_of.get((record.bus, record.identity))
        if record.model == PLANT_CONTROL and name in converters:
            _take_place(record, grid, document["branches"], converters[name])


def _take_place(record: DyrRecord, grid: StaticGrid, branches: Iterable[str], row: dict[str, Any]) -> None:
    """Put into a converter's row where its plant control measures: IREG, then FB TB CKT of a branch."""
    fields = Record(record.model, record.fields, record.where, {"IREG": 0, "FB": 1, "TB": 2, "CKT": 3})
    regulated, first, second = (fields.whole(key) for key in ("IREG", "FB", "TB"))
    if regulated not in (0, record.bus):
        row["regulates"] = grid.alias.get(regulated, regulated)
        if row["regulates"] not in grid.buses:
            raise CaseError(
                f"{record.where}: REPCA1 regulates bus {regulated}, which is not in service; give 0 for "
                "its own bus"
            )
    if not first and not second:
        return
    circuit = fields.identity("CKT")
    for name, branch in zip(branches, grid.branches, strict=True):
        if branch.on and branch.circuit == circuit and branch.name in ((first, second), (second, first)):
            end = branch.first if branch.name[0] == first else branch.second
            row |= {"measures": name, "measures_from": end}
            return
    raise CaseError(
        f"{record.where}: REPCA1 measures branch {first}-{second} {circuit!r}, allowed: a line or "
        "transformer of two windings in service with an impedance; give 0 0 for its own power"
    )


def _take_impedances(grid: StaticGrid, names: Sequence[str], dynamics: Dynamics) -> None:
    """Put the impedance of each unit that is a voltage source into its row."""
    sources = keys_of(SOURCE)
    for unit, name in zip(grid.units, names, strict=True):
        control = dynamics.converters.get(name, {}).get("control", {})
        if control.get("kind") in sources or 1.0 in (control.get("REGCB"), control.get("REGCC")):
            control |= {"Re": max(unit.r, 0.0), "Xe": unit.x}


def _compare_reactances(grid: StaticGrid, names: Sequence[str], dynamics: Dynamics, report: Report) -> None:
    """Note an X''d of the DYR that is not the RAW's, or is below the leakage reactance."""
    for unit, name in zip(grid.units, names, strict=True):
        row = dynamics.rows.get(name, {})
        if "Xd2" not in row:
            if row and not unit.x > 0.0:
                raise CaseError(
                    f"{unit.where}: ZX = {unit.x:g}, allowed: above 0, the reactance of GENCLS of "
                    f"{dynamics.where[name]}; give it (field ZX of the unit)"
                )
            continue
        if abs(row["Xd2"] - unit.x) > 1e-6:
            report.assume("X''d of the DYR used; ZX of the RAW differs", unit.where)
        if row["Xd2"] < row["Xl"]:
            report.assume("X''d below the leakage reactance Xl: used unchanged", dynamics.where[name])


def _case_with_lines(document: dict[str, Any], where: str, lines: Mapping[str, str]) -> Case:
    """The case of `document`; an error of a machine names its line, `lines`: machine -> file:line."""
    try:
        return case_of(document, where=where)
    except CaseError as error:
        machine = re.search(r"(?:machines|converters|svcs|hvdcs|vscs)\.(\w+)", str(error))
        line = lines.get(machine.group(1)) if machine else None
        raise CaseError(f"{error} (given at {line})" if line else str(error)) from None


def static_grid(file: RawFile, report: Report, frequency_hz: float | None = None) -> StaticGrid:
    """Return everything that `file` holds, in service or not; `frequency_hz` if it has no frequency."""
    for note in file.notes:
        where, _, what = note.rpartition(": ") if ": " in note else ("", "", note)
        report.assume(what, where)
    for section, (count, line) in file.aside.items():
        report.drop(f"{section} record: ignored", f"{file.path}:{line}", count)
    if file.frequency_hz is None and frequency_hz is None:
        report.assume(f"no frequency in the file: {USUAL_HZ:g} Hz", f"{file.path}:1")
    source = f"{file.path.name} (PSS/E {file.version})"
    grid = StaticGrid(file.base_mva, file.frequency_hz or frequency_hz or USUAL_HZ, source)
    readers = (
        read_nodes,
        read_lines_of,
        read_transformers,
        read_converters,
        read_vsc_lines,
        read_multi_terminal,
        read_motors,
    )
    try:
        for read in readers:
            read(file, grid, report)
    except CaseError as error:  # a record out of place may be one of another version
        version = next((note for note in file.notes if "says version" in note), "")
        raise CaseError(f"{error} ({version})" if version else str(error)) from None
    return grid


def _all_units(file: RawFile) -> set[tuple[int, str]]:
    return {(record.bus("I"), record.identity("ID")) for record in file.records("generator")}
