"""Check an FMU, SSP or IEEE/CIGRE DLL: archive, schema, semantic rules, binaries, and their behaviour."""

from __future__ import annotations

import zipfile
from pathlib import Path

from interarea.models.documents import require_regular
from interarea.models.files import temporary_folder

from ..finding import CheckError, Finding, Report
from ..open.archive import unpack_checked
from ..open.description import read_description
from ..open.ports import DLL_SUFFIXES
from ..open.xml import obeys_schema, read_xml
from .binary import check_binaries
from .delegated import fmpy_rules, toolbox_rules
from .load import TIMEOUT_S, check_running, run_topics
from .real_code import INTERFACE, TOPICS, check_library
from .semantics import check_semantics, check_units
from .ssp import STRUCTURE, check_ssp

__all__ = ["CheckError", "Finding", "Report", "check_file"]

_DESCRIPTION = "modelDescription.xml"
_SCHEMAS = {
    "1": "schema/fmi1/fmiModelDescription.xsd",
    "2": "schema/fmi2/fmi2ModelDescription.xsd",
    "3": "schema/fmi3/fmi3ModelDescription.xsd",
}


def check_file(path: Path | str, *, run: bool = True, timeout_s: float = TIMEOUT_S) -> Report:
    """Check the FMU, SSP or IEEE/CIGRE DLL at `path` and return what was found.

    Parameters
    ----------
    run : load the binary for this machine (in a process of its own) and check how it behaves;
        False for archives whose code must not run.
    timeout_s : a binary that takes longer for all its topics hangs, seconds.

    Raises
    ------
    CheckError : no such file, or neither a zip archive nor a library.
    """
    path = Path(path)
    require_regular(path, "an FMU, SSP or DLL", CheckError)
    report = Report(str(path))
    if path.suffix.lower() in DLL_SUFFIXES:
        if not check_library(path, report):
            return report
        if run:
            todo = [[INTERFACE, str(path.resolve()), topic] for topic in TOPICS]
            run_topics(todo, path.parent, report, timeout_s)
        else:
            report.not_run.append("as was asked for")
        return report
    if not zipfile.is_zipfile(path):
        raise CheckError(
            f"{path}: is no zip archive, so neither FMU nor SSP; a DLL ends in {', '.join(DLL_SUFFIXES)}"
        )
    with temporary_folder() as scratch:
        folder = scratch / "fmu"
        folder.mkdir()
        if not unpack_checked(path, folder, report):
            return report
        if (folder / STRUCTURE).is_file():
            check_ssp(folder, report, lambda fmu: _inner(fmu, run=run, timeout_s=timeout_s))
        else:
            check_fmu(path, folder, report, run=run, timeout_s=timeout_s)
    return report


def _inner(path: Path, *, run: bool, timeout_s: float) -> Report:
    """Check one FMU of an SSP; its description is kept for the rules between the two."""
    report = Report(path.name)
    with temporary_folder() as folder:
        if not zipfile.is_zipfile(path):
            report.add("archive", path.name, "is no zip archive, so no FMU", "pack an FMU")
        elif unpack_checked(path, folder, report):
            check_fmu(path, folder, report, run=run, timeout_s=timeout_s)
            if (folder / _DESCRIPTION).is_file():
                report.facts["description"] = read_xml(folder / _DESCRIPTION, _DESCRIPTION, Report(""))
    return report


def check_fmu(path: Path, folder: Path, report: Report, *, run: bool, timeout_s: float) -> None:
    """Check an unpacked FMU; `path` is its archive."""
    file = folder / _DESCRIPTION
    if not file.is_file():
        descriptions = sorted(p.relative_to(folder).as_posix() for p in folder.rglob(_DESCRIPTION))
        where = f"; there is {descriptions[0]}" if descriptions else ""
        report.add("FMI2 2.1 archive", _DESCRIPTION, f"is not at the root{where}", "pack it there")
        return
    root = read_xml(file, _DESCRIPTION, report)
    if root is None:
        return
    version = str(root.get("fmiVersion", ""))
    schema = _SCHEMAS.get(version[:1])
    if schema is None:
        report.add("FMI version", _DESCRIPTION, f"fmiVersion is {version!r}", "write 1.0, 2.0 or 3.0")
        return
    valid = obeys_schema(root, schema, _DESCRIPTION, report)
    if not version.startswith("1"):
        toolbox_rules(path, _DESCRIPTION, report)
    if valid:
        fmpy_rules(folder, _DESCRIPTION, report)
    if version != "2.0":
        report.notes.append(
            f"FMI {version}: only archive and description were checked; the rest is for FMI 2.0"
        )
        report.not_run.append(f"FMI {version}")
        return
    description = read_description(root)
    report.facts["guid"] = description.guid
    report.facts["interfaces"] = sorted(description.interfaces)
    if valid:
        check_units(root, report)
    check_semantics(description, folder, report)
    check_binaries(description, folder, report)
    if run:
        check_running(description, folder, report, timeout_s=timeout_s)
    else:
        report.notes.append("the binary was not run")
        report.not_run.append("as was asked for")
