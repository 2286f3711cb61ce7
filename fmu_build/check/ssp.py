"""Check a system structure (SSP 1.0, 1.1): schemas, FMUs inside, connectors, parameters, connections."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..finding import Finding, Report
from ..open.description import ModelDescription, read_description
from ..open.units import Units, unit_definitions
from ..open.xml import obeys_schema, read_xml
from .ssp_bindings import LOOSE, SSC, SSD, Bindings, Connector, Scope

STRUCTURE = "SystemStructure.ssd"
_FMU = "application/x-fmu-sharedlibrary"
_SCHEMAS = {
    "1.0": "ssp/schema/SystemStructureDescription.xsd",
    "1.1": "ssp/schema/SystemStructureDescription11.xsd",
}
#: What a connector may be connected to as a source, inside its component and seen from outside.
_KINDS = {"input", "output", "parameter", "calculatedParameter", "inout"}
Elements = Mapping[str, Mapping[str, Connector]]
#: Checks an FMU file below the archive and returns what it found and the root of its description.
CheckFmu = Callable[[Path], Report]


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
        self.bindings = Bindings(folder, report, units)
        self.components = 0
        self.users: dict[Path, list[str]] = {}  #: of each FMU its components
        self.fmus: dict[Path, ModelDescription | None] = {}

    def system(self, system: Any, where: str) -> Scope:
        """Check a system and everything in it; return what it has inside."""
        scope = Scope(self.connectors(system, where))
        holder = system.find(f"{SSD}Elements")
        for element in holder if holder is not None else ():
            if not isinstance(element.tag, str):
                continue
            name = element.get("name", "")
            place = f"{where}.{name}"
            if name in scope.elements:
                self.report.add("SSP names", place, "two elements have this name", "rename one")
            if element.tag == f"{SSD}System":
                scope.elements[name] = self.system(element, place)
            elif element.tag == f"{SSD}Component":
                self.components += 1
                scope.elements[name] = self.component(element, place)
            else:
                scope.elements[name] = Scope(self.connectors(element, place), known=False)
        self.bindings.of(system, scope, where)
        elements = {name: element.connectors for name, element in scope.elements.items()}
        self.connections(system, where, scope.connectors, elements)
        return scope

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
            self.bindings.unit_is_defined(unit, f"{where}.{name}", self.units)
            base = None if typed is None else typed.tag.rpartition("}")[2]
            by_name[name] = Connector(name, kind, base, unit, self.units.dimension(unit or ""))
        return by_name

    def component(self, component: Any, where: str) -> Scope:
        """Check the source of a component against its connectors and parameter bindings."""
        connectors = self.connectors(component, where)
        file = self.bindings.file(component.get("source", ""), where)
        description = None
        if file is not None and component.get("type", _FMU) == _FMU:
            description = self.fmu(file)
        if file is None or description is None:
            return Scope(connectors, known=False)
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
        scope = Scope(_of_fmu(connectors, description), description)
        self.bindings.of(component, scope, where)
        return scope

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

    def connections(
        self,
        system: Any,
        where: str,
        own: Mapping[str, Connector],
        elements: Elements,
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
            if c.get("suppressUnitConversion", "false") not in ("true", "1"):
                self.dimensions(text, start, end)
            if ends[1] in fed:
                self.report.add(
                    "SSP connections", text, f"the target is also fed by {fed[ends[1]]}", "keep one of them"
                )
            fed[ends[1]] = text.split(" -> ")[0]
        self.note_open(where, elements, fed.keys())

    def note_open(
        self,
        where: str,
        elements: Elements,
        fed: Collection[tuple[str | None, str]],
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
        if start.type and end.type and start.type != end.type and (start.type, end.type) not in LOOSE:
            self.report.add(
                "SSP connections", text, f"goes from {start.type} to {end.type}", "connect the same type"
            )

    def dimensions(self, text: str, start: Connector, end: Connector) -> None:
        """Units of both ends, their own or those of the FMU, have the same dimension."""
        if not start.unit or not end.unit or start.unit == end.unit:
            return
        if start.dimension is None or start.dimension != end.dimension:
            self.report.add(
                *("SSP units", text, f"goes from {start.unit} to {end.unit}"), "connect the same dimension"
            )


def _of_fmu(connectors: Mapping[str, Connector], d: ModelDescription) -> dict[str, Connector]:
    """Return connectors with the types and units of their FMU where they state none."""
    variables = {v.name: v for v in d.variables}
    completed = dict(connectors)
    for name, c in connectors.items():
        if (v := variables.get(name)) is None:
            continue
        unit = d.unit_of(v)
        if c.unit is None and unit is not None:
            c = replace(c, unit=unit, dimension=d.dimension(unit))
        completed[name] = replace(c, type=c.type or v.type)
    return completed
