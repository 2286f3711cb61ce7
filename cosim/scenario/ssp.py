"""A system structure (SSP 1.0 and 1.1, co-simulation FMUs) as the table of a scenario.

Nested systems are flattened: an FMU is named by its path with underscores, a connection goes from FMU to
FMU. Values of a system override those of its elements (SSP 1.0, 5.3.4).
"""

from __future__ import annotations

import hashlib
import re
import shutil
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from interarea.fmu_build.check.ssp import STRUCTURE
from interarea.fmu_build.check.ssp_bindings import SSD, SSM, SSV
from interarea.fmu_build.finding import Report
from interarea.fmu_build.open.archive import built_by_this_package, unpack_checked
from interarea.fmu_build.open.xml import read_xml
from interarea.fmu_build.write.cache import default_cache
from interarea.models.documents import require_regular
from interarea.models.files import new_folder

from ..errors import ScenarioError

_FMU = "application/x-fmu-sharedlibrary"
_SET = "application/x-ssp-parameter-set"
_STEP = "{https://open-simulation-platform.com/SSP/OSPAnnotations}FixedStepAlgorithm"
Value = float | int | bool | str
End = tuple[str, str]  #: path of an element ("" : the structure itself), connector


def table_of_ssp(path: Path) -> tuple[dict[str, Any], Path]:
    """Return the table of a scenario that runs the archive `path`, and the folder in which its files are.

    They are unpacked into the cache, once by content. FMUs of other tools get a process each.

    Raises
    ------
    ScenarioError : an archive or structure that cannot be read; a component that is no co-simulation FMU; a
        connection that converts units or transforms; no stop time, a start other than 0.
    """
    require_regular(path, "a system structure (SSP)", ScenarioError)
    report = Report(path.name)
    folder = _unpacked(path, report)
    if not (folder / STRUCTURE).is_file():
        raise ScenarioError(f"{path}: has no {STRUCTURE}, allowed: a system structure (SSP)")
    root = read_xml(folder / STRUCTURE, STRUCTURE, report)
    system = None if root is None else root.find(f"{SSD}System")
    if root is None or system is None:
        why = report.findings[0].line() if report.findings else f"{STRUCTURE} has no System"
        raise ScenarioError(f"{path}: {why}")
    structure = _Structure(path, folder)
    structure.system(system, "")
    return {**structure.table(), **_experiment(root, path)}, folder


def _unpacked(path: Path, report: Report) -> Path:
    """Return the folder in the cache with the files of an archive, unpacked where one is missing."""
    with path.open("rb") as content:
        folder = default_cache() / "ssp" / hashlib.file_digest(content, "sha256").hexdigest()[:16]
    if not _whole(path, folder):
        folder.parent.mkdir(parents=True, exist_ok=True)
        fresh = new_folder(folder.parent)
        if not unpack_checked(path, fresh, report):
            raise ScenarioError(f"{path}: {report.findings[0].line()}")
        shutil.rmtree(folder, ignore_errors=True)
        try:
            fresh.rename(folder)
        except OSError:
            if not _whole(path, folder):  # else another process was quicker
                raise
    return folder


def _whole(path: Path, folder: Path) -> bool:
    """Whether every file of the archive lies in the folder with its content."""
    if not folder.is_dir():
        return False
    with zipfile.ZipFile(path) as archive:
        return all(
            (folder / entry.filename).is_file()
            and zlib.crc32((folder / entry.filename).read_bytes()) == entry.CRC
            for entry in archive.infolist()
            if not entry.is_dir()
        )


def _experiment(root: Any, path: Path) -> dict[str, Any]:
    """Return stop_s and, where the structure states one, step_s."""
    experiment = root.find(f"{SSD}DefaultExperiment")
    stop = None if experiment is None else experiment.get("stopTime")
    if stop is None:
        raise ScenarioError(f"{path}: no stopTime, allowed: a DefaultExperiment that has one")
    if float(experiment.get("startTime", 0.0)) != 0.0:
        raise ScenarioError(f"{path}: startTime = {experiment.get('startTime')}, allowed: 0")
    step = next((e.get("baseStepSize") for e in experiment.iter(_STEP)), None)
    return {"stop_s": float(stop)} | ({} if step is None else {"step_s": float(step)})


@dataclass
class _Structure:
    """What was read so far of the archive `path`, unpacked in `folder`."""

    path: Path
    folder: Path
    files: dict[str, str] = field(default_factory=dict)  #: path of a component -> its FMU
    kinds: dict[End, str] = field(default_factory=dict)  #: end -> kind of the connector
    units: dict[End, str | None] = field(default_factory=dict)
    source_of: dict[End, End] = field(default_factory=dict)
    values: dict[End, Value] = field(default_factory=dict)

    def system(self, system: Any, where: str) -> None:
        """Read a system, what is in it, and last its own values, which override those inside."""
        self.connectors(system, where)
        holder = system.find(f"{SSD}Elements")
        for element in holder if holder is not None else ():
            if not isinstance(element.tag, str):
                continue
            place = f"{where}.{element.get('name', '')}".removeprefix(".")
            if element.tag == f"{SSD}System":
                self.system(element, place)
            elif element.tag == f"{SSD}Component":
                self.component(element, place)
            else:
                raise self.error(place, f"is a {element.tag.rpartition('}')[2]}", "systems and FMUs")
        for connection in system.findall(f"{SSD}Connections/{SSD}Connection"):
            self.connection(connection, where)
        self.bindings(system, where)

    def component(self, component: Any, where: str) -> None:
        """Read a component that is a co-simulation FMU."""
        kind, interface = component.get("type", _FMU), component.get("implementation", "any")
        if kind != _FMU or interface == "ModelExchange":
            raise self.error(where, f"is {kind}, {interface}", f"{_FMU} for co-simulation")
        self.files[where] = self.file(component.get("source", ""), where).as_posix()
        self.connectors(component, where)
        self.bindings(component, where)

    def connectors(self, element: Any, where: str) -> None:
        """Note kind and unit of each connector."""
        for c in element.findall(f"{SSD}Connectors/{SSD}Connector"):
            end = where, c.get("name", "")
            self.kinds[end] = c.get("kind", "")
            self.units[end] = next((t.get("unit") for t in c if isinstance(t.tag, str)), None)

    def connection(self, connection: Any, where: str) -> None:
        """Note a connection; refuse what would change the value on its way."""
        ends = []
        for side in ("start", "end"):
            element, name = connection.get(f"{side}Element"), connection.get(f"{side}Connector", "")
            place = where if not element else f"{where}.{element}".removeprefix(".")
            ends.append((place, name))
            if ends[-1] not in self.kinds:
                raise self.error(place or "structure", f"has no connector {name!r}", "one that is declared")
        start, end = ends
        text = f"connection {_shown(start)} -> {_shown(end)}"
        if any(isinstance(t.tag, str) and t.tag.endswith("Transformation") for t in connection):
            raise self.error(text, "has a transformation", "none; put it into an FMU")
        units = {self.units[start], self.units[end]} - {None}
        if len(units) > 1 and connection.get("suppressUnitConversion", "false") not in ("true", "1"):
            raise self.error(text, f"goes from {self.units[start]} to {self.units[end]}", "the same unit")
        if end in self.source_of:
            raise self.error(
                text, f"is given in addition to one of {_shown(self.source_of[end])}", "one source"
            )
        self.source_of[end] = start

    def bindings(self, holder: Any, where: str) -> None:
        """Note the values of every parameter binding of a component or system."""
        for binding in holder.findall(f"{SSD}ParameterBindings/{SSD}ParameterBinding"):
            if binding.get("type", _SET) != _SET:
                raise self.error(where, f"has parameters of type {binding.get('type')}", _SET)
            root = self.part(binding, where, f"{SSD}ParameterValues/{SSV}ParameterSet")
            mapped = binding.find(f"{SSD}ParameterMapping")
            mapping = None if mapped is None else self.part(mapped, where, f"{SSM}ParameterMapping")
            prefix = binding.get("prefix", "")
            for parameter in root.findall(f"{SSV}Parameters/{SSV}Parameter"):
                name = prefix + parameter.get("name", "")
                typed = next((t for t in parameter if isinstance(t.tag, str)), None)
                if typed is None:
                    raise self.error(where, f"parameter {name} has no value", "one")
                for target, factor, offset in self.targets(mapping, name, where):
                    end = self.end_of(target, where)
                    self.same_unit(typed.get("unit"), end)
                    value = self.value(typed, f"{where} parameter {name}".strip())
                    self.values[end] = factor * float(value) + offset if (factor, offset) != (1, 0) else value

    def targets(self, mapping: Any, name: str, where: str) -> Iterator[tuple[str, float, float]]:
        """Yield where a mapping puts the value of `name`, with a factor and an offset."""
        if mapping is None:
            yield name, 1.0, 0.0
            return
        for entry in mapping.findall(f"{SSM}MappingEntry"):
            if entry.get("source") != name:
                continue
            factor, offset = 1.0, 0.0
            for change in (t for t in entry if isinstance(t.tag, str)):
                kind = change.tag.rpartition("}")[2]
                if kind == "LinearTransformation":
                    factor, offset = float(change.get("factor", 1.0)), float(change.get("offset", 0.0))
                elif kind.endswith("Transformation"):
                    raise self.error(where, f"maps {name} by {kind}", "LinearTransformation")
            yield entry.get("target", ""), factor, offset

    def end_of(self, name: str, where: str) -> End:
        """Return the end that a binding at `where` names: below it the longest path of an element."""
        below = f"{where}." if where else ""
        places = [*self.files, *{place for place, _ in self.kinds}]
        inside = [p for p in places if p.startswith(below) and name.startswith(f"{p[len(below) :]}.")]
        if where in self.files or not inside:
            return where, name
        place = max(inside, key=len)
        return place, name[len(place) - len(below) + 1 :]

    def same_unit(self, unit: str | None, end: End) -> None:
        """Refuse a value in another unit than its connector's."""
        own = self.units.get(end)
        if unit is not None and own is not None and unit != own:
            raise self.error(f"value of {_shown(end)}", f"is in {unit}", f"{own}, as its connector")

    def value(self, typed: Any, where: str) -> Value:
        """Return the value of an element of a parameter set."""
        kind, text = typed.tag.rpartition("}")[2], typed.get("value", "")
        try:
            if kind == "Boolean":
                return {"true": True, "1": True, "false": False, "0": False}[text]
            return float(text) if kind == "Real" else int(text) if kind == "Integer" else text
        except (KeyError, ValueError):
            raise self.error(where, f"{text!r}", f"a value of type {kind}") from None

    def table(self) -> dict[str, Any]:
        """Return the FMUs with their start values, and the connections, as a scenario has them."""
        names = {place: _named(place) for place in self.files}
        if len(set(names.values())) < len(names):
            raise self.error("names of FMUs", ", ".join(names), "names that differ after . is replaced by _")
        fmus: dict[str, dict[str, Any]] = {}
        for place, name in names.items():
            file = self.files[place]
            fmus[name] = {"file": file, "start": {}, "isolate": not built_by_this_package(Path(file))}
        for (place, variable), value in self.values.items():
            if place in names:
                fmus[names[place]]["start"][variable] = value
        connections = []
        for end in self.source_of:
            if end[0] not in names:
                continue
            start = self.origin(end)
            if start[0] in names:
                connections.append([f"{names[start[0]]}.{start[1]}", f"{names[end[0]]}.{end[1]}"])
            elif start in self.values:  # a value of a system that one of its connectors hands on
                fmus[names[end[0]]]["start"][end[1]] = self.values[start]
        return {"name": self.path.stem[:64], "fmus": fmus, "connections": connections}

    def origin(self, end: End) -> End:
        """Return where what reaches an end comes from, through the connectors of systems."""
        seen = {end}
        while end in self.source_of:
            end = self.source_of[end]
            if end[0] in self.files:
                return end
            if end in seen:
                raise self.error(_shown(end), "is connected to itself", "an FMU as the source")
            seen.add(end)
        return end

    def part(self, holder: Any, where: str, inline: str) -> Any:
        """Return the root of a parameter set or mapping, inside the structure or a file of its own."""
        source = holder.get("source")
        report = Report(self.path.name)
        root = holder.find(inline) if not source else read_xml(self.file(source, where), source, report)
        if root is None:
            why = report.findings[0].line() if report.findings else "is empty"
            raise self.error(where, f"its parameter set or mapping {why}", "one that can be read")
        return root

    def file(self, source: str, where: str) -> Path:
        """Return a file of the archive."""
        target = (self.folder / unquote(source)).resolve()
        if not (target.is_relative_to(self.folder.resolve()) and target.is_file()):
            raise self.error(where, f"source {source!r} is not in the archive", "a file that it holds")
        return target

    def error(self, where: str, got: str, allowed: str) -> ScenarioError:
        return ScenarioError(f"{self.path}: {where}: {got}, allowed: {allowed}")


def _named(place: str) -> str:
    """Return an identifier for a component; a scenario has its own plant and controller."""
    name = re.sub(r"\W", "_", place)
    return f"fmu_{name}" if not name.isidentifier() or name in ("plant", "controller") else name


def _shown(end: End) -> str:
    return f"{end[0]}.{end[1]}".removeprefix(".")
