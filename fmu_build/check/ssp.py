"""Check a system structure (SSP 1.0, 1.1): schemas, FMUs inside, connectors, parameters, connections."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from ..finding import Finding, Report
from ..open.description import ModelDescription, ScalarVariable, read_description
from ..open.units import Units, unit_definitions
from ..open.xml import obeys_schema, read_xml

SSD = "{http://ssp-standard.org/SSP1/SystemStructureDescription}"
SSC = "{http://ssp-standard.org/SSP1/SystemStructureCommon}"
SSV = "{http://ssp-standard.org/SSP1/SystemStructureParameterValues}"
SSM = "{http://ssp-standard.org/SSP1/SystemStructureParameterMapping}"
STRUCTURE = "SystemStructure.ssd"
_FMU = "application/x-fmu-sharedlibrary"
_SCHEMAS = {
    "1.0": "ssp/schema/SystemStructureDescription.xsd",
    "1.1": "ssp/schema/SystemStructureDescription11.xsd",
}
_VALUES = "ssp/schema/SystemStructureParameterValues.xsd"
_MAPPING = "ssp/schema/SystemStructureParameterMapping.xsd"
#: What a connector may be connected to as a source, inside its component and seen from outside.
_KINDS = {"input", "output", "parameter", "calculatedParameter", "inout"}
_LOOSE = {
    ("Integer", "Real"),
    ("Enumeration", "Integer"),
    ("Integer", "Enumeration"),
    ("Enumeration", "Real"),
}

#: Checks an FMU file below the archive and returns what it found and the root of its description.
CheckFmu = Callable[[Path], Report]


@dataclass(frozen=True)
class Connector:
    """A connector of an element or a system."""

    name: str
    kind: str
    type: str | None
    unit: str | None


def check_ssp(folder: Path, report: Report, check_fmu: CheckFmu) -> None:
    """Check the unpacked system structure in `folder`; `check_fmu` gives the findings of one FMU inside."""
    root = read_xml(folder / STRUCTURE, STRUCTURE, report)
    if root is None:
        return
    version = root.get("version", "")
    if version not in _SCHEMAS:
        report.add("SSP version", STRUCTURE, f"version is {version!r}", "write 1.0 or 1.1")
        return
    obeys_schema(root, _SCHEMAS[version], STRUCTURE, report)
    check = _Check(folder, report, check_fmu, unit_definitions(root, SSD + "Units", SSC))
    system = root.find(f"{SSD}System")
    if system is not None:
        check.system(system, system.get("name", "system"))
    experiment = root.find(f"{SSD}DefaultExperiment")
    if experiment is not None:
        _experiment(experiment, report)
    report.facts["components"] = check.components
    check.note_once()


def _experiment(experiment: Any, report: Report) -> None:
    try:
        start, stop = float(experiment.get("startTime", 0.0)), float(experiment.get("stopTime", "inf"))
    except ValueError:
        return  # the schema says so already
    if not start < stop:
        report.add(
            "SSP DefaultExperiment", STRUCTURE, "stopTime does not lie after startTime", "correct the times"
        )


class _Check:
    """One archive under check; FMUs are looked at once each."""

    def __init__(self, folder: Path, report: Report, check_fmu: CheckFmu, units: Units) -> None:
        self.folder, self.report, self.check_fmu, self.units = folder, report, check_fmu, units
        self.components = 0
        self.users: dict[Path, list[str]] = {}  #: of each FMU its components
        self.fmus: dict[Path, ModelDescription | None] = {}

    def system(self, system: Any, where: str) -> dict[str, Connector]:
        """Check a system and everything in it; return its own connectors."""
        own = self.connectors(system, where)
        elements: dict[str, dict[str, Connector]] = {}
        holder = system.find(f"{SSD}Elements")
        for element in holder if holder is not None else ():
            if not isinstance(element.tag, str):
                continue
            name = element.get("name", "")
            place = f"{where}.{name}"
            if name in elements:
                self.report.add("SSP names", place, "two elements have this name", "rename one")
            if element.tag == f"{SSD}System":
                elements[name] = self.system(element, place)
            elif element.tag == f"{SSD}Component":
                self.components += 1
                elements[name] = self.component(element, place)
            else:
                elements[name] = self.connectors(element, place)
        self.connections(system, where, own, elements)
        return own

    def connectors(self, element: Any, where: str) -> dict[str, Connector]:
        """Read connectors; names are unique and units are defined."""
        by_name: dict[str, Connector] = {}
        for c in element.findall(f"{SSD}Connectors/{SSD}Connector"):
            name = c.get("name", "")
            typed = next((t for t in c if isinstance(t.tag, str) and t.tag.startswith((SSC, SSD))), None)
            kind = c.get("kind", "")
            unit = None if typed is None else typed.get("unit")
            if name in by_name:
                self.report.add("SSP names", f"{where}.{name}", "two connectors have this name", "rename one")
            if kind not in _KINDS:
                self.report.add(
                    "SSP connectors", f"{where}.{name}", f"kind is {kind!r}", "write a kind of SSP"
                )
            self.unit_is_defined(unit, f"{where}.{name}", self.units)
            base = None if typed is None else typed.tag.rpartition("}")[2]
            by_name[name] = Connector(name, kind, base, unit)
        return by_name

    def unit_is_defined(self, unit: str | None, where: str, units: Units) -> None:
        if unit is not None and unit not in units.names:
            self.report.add("SSP units", where, f"unit {unit} is not defined", "define it in Units")

    def component(self, component: Any, where: str) -> dict[str, Connector]:
        """Check the source of a component against its connectors and parameter bindings."""
        connectors = self.connectors(component, where)
        file = self.file(component.get("source", ""), where)
        description = None
        if file is not None and component.get("type", _FMU) == _FMU:
            description = self.fmu(file)
        if file is None or description is None:
            return connectors
        self.users.setdefault(file, []).append(where)
        implementation = component.get("implementation", "any")
        if implementation != "any" and implementation not in description.interfaces:
            self.report.add(
                "SSP implementation",
                where,
                f"asks for {implementation}, the FMU has {', '.join(description.interfaces)}",
                "ask for an interface that the FMU has",
            )
        self.against_fmu(connectors, description, where)
        for binding in component.findall(f"{SSD}ParameterBindings/{SSD}ParameterBinding"):
            self.binding(binding, description, where)
        return connectors

    def file(self, source: str, where: str) -> Path | None:
        """Return the file of a relative URI inside the archive, with a finding when there is none."""
        parts = urlsplit(source)
        if parts.scheme or parts.netloc or parts.path.startswith("/"):
            self.report.notes.append(f"{where}: {source} lies outside the archive and was not looked at")
            return None
        target = (self.folder / unquote(parts.path)).resolve()
        if not target.is_relative_to(self.folder.resolve()):
            self.report.add("SSP source", where, f"{source} leaves the archive", "use a path inside")
        elif not target.is_file():
            self.report.add("SSP source", where, f"{source!r} is not in the archive", "pack the file")
        else:
            return target
        return None

    def fmu(self, file: Path) -> ModelDescription | None:
        """Check an FMU once and return its description if it can be read."""
        if file not in self.fmus:
            report = self.check_fmu(file)
            name = file.relative_to(self.folder.resolve()).as_posix()
            self.report.findings += [
                Finding(f.rule, f"{name}: {f.where}", f.message, f.fix) for f in report.findings
            ]
            self.report.notes += [f"{name}: {note}" for note in report.notes]
            self.report.not_run += [f"{name}: {why}" for why in report.not_run]
            self.report.facts.setdefault("fmus", {})[name] = {
                k: v for k, v in report.facts.items() if k != "description"
            }
            root = report.facts.get("description")
            self.fmus[file] = read_description(root) if root is not None else None
        return self.fmus[file]

    def note_once(self) -> None:
        """Note components that share an FMU of which a process can hold one instance only."""
        for file, users in self.users.items():
            d = self.fmus[file]
            once = d is not None and any(
                d.flag(i, "canBeInstantiatedOnlyOncePerProcess") for i in d.interfaces
            )
            if once and len(users) > 1:
                name = file.relative_to(self.folder.resolve()).as_posix()
                self.report.notes.append(
                    f"{', '.join(users)}: {name} can be instantiated only once per process; each needs a "
                    "process of its own"
                )

    def against_fmu(self, connectors: dict[str, Connector], d: ModelDescription, where: str) -> None:
        """Connectors are variables of the FMU, of the same causality, type and dimension."""
        variables = {v.name: v for v in d.variables}
        for c in connectors.values():
            place = f"{where}.{c.name}"
            v = variables.get(c.name)
            if v is None:
                self.report.add(
                    "SSP connectors", place, "the FMU has no such variable", "name one of its variables"
                )
                continue
            if c.kind != v.causality:
                self.report.add(
                    "SSP connectors",
                    place,
                    f"is {c.kind}, the variable is {v.causality}",
                    "use the causality of the FMU",
                )
            if c.type is not None and c.type != v.type:
                self.report.add(
                    "SSP connectors",
                    place,
                    f"is {c.type}, the variable is {v.type}",
                    "use the type of the FMU",
                )
            unit = d.unit_of(v)
            if c.unit is not None and unit is not None and c.unit != unit:
                own, theirs = self.units.dimension(c.unit), d.dimension(unit)
                if own is None or theirs is None or own != theirs:
                    self.report.add(
                        "SSP units",
                        place,
                        f"has unit {c.unit}, the variable {unit}",
                        "use a unit of the same dimension",
                    )

    def binding(self, binding: Any, d: ModelDescription, where: str) -> None:
        """Every parameter of a set is a variable that can be set, of that type and dimension."""
        mapping = self.mapping(binding, where)
        root = self.part(binding, where, _VALUES, f"{SSV}ParameterSet", f"{SSD}ParameterValues")
        if root is None:
            return
        units = unit_definitions(root, SSV + "Units", SSC)
        variables = {v.name: v for v in d.variables}
        for parameter in root.findall(f"{SSV}Parameters/{SSV}Parameter"):
            source = binding.get("prefix", "") + parameter.get("name", "")
            value = next((t for t in parameter if isinstance(t.tag, str)), None)
            for name in [source] if mapping is None else mapping.get(source, []):
                place = f"{where} parameter {name}"
                v = variables.get(name)
                if v is None:
                    self.report.add(
                        "SSP parameters", place, "the FMU has no such variable", "correct the name"
                    )
                    continue
                self.parameter(value, v, d, units, place)

    def mapping(self, binding: Any, where: str) -> dict[str, list[str]] | None:
        """Return source -> targets of a binding's mapping; None where names stay as they are."""
        mapped = binding.find(f"{SSD}ParameterMapping")
        root = None if mapped is None else self.part(mapped, where, _MAPPING, f"{SSM}ParameterMapping")
        if root is None:
            return None
        mapping: dict[str, list[str]] = {}
        for entry in root.findall(f"{SSM}MappingEntry"):
            mapping.setdefault(entry.get("source", ""), []).append(entry.get("target", ""))
        return mapping

    def parameter(self, value: Any, v: ScalarVariable, d: ModelDescription, units: Any, place: str) -> None:
        """A variable can be set, to a value of its type in a unit of its dimension."""
        if v.causality not in ("parameter", "input") and v.initial not in ("exact", "approx"):
            self.report.add(
                "SSP parameters",
                place,
                f"a {v.causality} that cannot be set",
                "set a parameter or input",
            )
        if value is None:
            return
        kind, unit = value.tag.rpartition("}")[2], value.get("unit")
        if kind != v.type and (kind, v.type) not in _LOOSE:
            self.report.add(
                "SSP parameters",
                place,
                f"is {kind}, the variable is {v.type}",
                "use the type of the FMU",
            )
        self.unit_is_defined(unit, place, units if units.names else self.units)
        of_fmu = d.unit_of(v)
        if unit and of_fmu and unit != of_fmu and units.dimension(unit) != d.dimension(of_fmu):
            self.report.add(
                "SSP units",
                place,
                f"has unit {unit}, the variable {of_fmu}",
                "use a unit of the same dimension",
            )

    def part(self, holder: Any, where: str, schema: str, tag: str, inline: str = "") -> Any | None:
        """Return the root of an SSV or SSM, given inside the structure or as a file of its own."""
        if holder.get("source"):
            file = self.file(holder.get("source"), where)
            if file is None:
                return None
            name = file.relative_to(self.folder.resolve()).as_posix()
            root = read_xml(file, name, self.report)
            return root if root is not None and obeys_schema(root, schema, name, self.report) else None
        return holder.find(f"{inline}/{tag}") if inline else holder.find(tag)

    def connections(
        self, system: Any, where: str, own: dict[str, Connector], elements: dict[str, dict[str, Connector]]
    ) -> None:
        """Ends exist, point the right way, have one source, and types and dimensions that go together."""
        fed: dict[tuple[str | None, str], str] = {}
        for c in system.findall(f"{SSD}Connections/{SSD}Connection"):
            ends = [(c.get(f"{side}Element"), c.get(f"{side}Connector", "")) for side in ("start", "end")]
            text = " -> ".join(f"{element or where}.{name}" for element, name in ends)
            result = []
            for element, name in ends:
                result.append((own if element is None else elements.get(element, {})).get(name))
                if result[-1] is None:
                    self.report.add(
                        "SSP connections", text, f"there is no {element or where}.{name}", "correct the names"
                    )
            start, end = result
            if start is None or end is None:
                continue
            self.connection(text, start, end, from_element=bool(ends[0][0]), to_element=bool(ends[1][0]))
            if ends[1] in fed:
                self.report.add(
                    "SSP connections", text, f"the target is also fed by {fed[ends[1]]}", "keep one of them"
                )
            fed[ends[1]] = text.split(" -> ")[0]
        self.note_open(where, elements, fed.keys())

    def note_open(
        self, where: str, elements: dict[str, dict[str, Connector]], fed: Collection[tuple[str | None, str]]
    ) -> None:
        """Note the inputs of elements that nothing feeds."""
        for element, connectors in elements.items():
            inputs = [c.name for c in connectors.values() if c.kind == "input"]
            open_ends = [name for name in inputs if (element, name) not in fed]
            if open_ends:
                self.report.notes.append(f"{where}.{element}: nothing feeds {', '.join(open_ends[:6])}")

    def connection(
        self, text: str, start: Connector, end: Connector, *, from_element: bool, to_element: bool
    ) -> None:
        """Both ends point the right way, and their types and dimensions go together."""
        inner, outer = {"input", "parameter", "inout"}, {"output", "calculatedParameter", "inout"}
        gives, takes = outer if from_element else inner, inner if to_element else outer
        if start.kind not in gives or end.kind not in takes:
            self.report.add(
                "SSP connections",
                text,
                f"goes from {start.kind} to {end.kind}",
                "connect an output to an input",
            )
        if start.type and end.type and start.type != end.type and (start.type, end.type) not in _LOOSE:
            self.report.add(
                "SSP connections", text, f"goes from {start.type} to {end.type}", "connect the same type"
            )
        if start.unit and end.unit and start.unit != end.unit:
            one, other = self.units.dimension(start.unit), self.units.dimension(end.unit)
            if one is None or other is None or one != other:
                self.report.add(
                    "SSP units",
                    text,
                    f"goes from {start.unit} to {end.unit}",
                    "connect the same dimension",
                )
