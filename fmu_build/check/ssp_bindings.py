"""Parameter bindings of components and systems (SSP 1.0, 5.3.4, 7): sets, mappings, names, types, units."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from ..finding import Report
from ..open.description import ModelDescription, ScalarVariable
from ..open.units import Dimension, Units, unit_definitions
from ..open.xml import obeys_schema, read_xml

SSD = "{http://ssp-standard.org/SSP1/SystemStructureDescription}"
SSC = "{http://ssp-standard.org/SSP1/SystemStructureCommon}"
SSV = "{http://ssp-standard.org/SSP1/SystemStructureParameterValues}"
SSM = "{http://ssp-standard.org/SSP1/SystemStructureParameterMapping}"
_SET = "application/x-ssp-parameter-set"
_VALUES = "ssp/schema/SystemStructureParameterValues.xsd"
_MAPPING = "ssp/schema/SystemStructureParameterMapping.xsd"
LOOSE = {
    ("Integer", "Real"),
    ("Enumeration", "Integer"),
    ("Integer", "Enumeration"),
    ("Enumeration", "Real"),
}
#: transformation of a mapping -> types of values that it takes
_TAKES = {
    "LinearTransformation": ("Real", "Integer"),
    "BooleanMappingTransformation": ("Boolean",),
    "IntegerMappingTransformation": ("Integer",),
    "EnumerationMappingTransformation": ("Enumeration",),
}


@dataclass(frozen=True)
class Connector:
    """A connector of an element or a system; type and unit are those of the FMU where it states none."""

    name: str
    kind: str
    type: str | None
    unit: str | None
    dimension: Dimension | None = None


@dataclass
class Scope:
    """What a binding can name: connectors, the variables of an FMU, what lies in the elements of a system.

    description : of the FMU of a component; None of a system, and where it is not known.
    known : whether all names are known: not of a component that was not read.
    """

    connectors: Mapping[str, Connector] = field(default_factory=dict)
    description: ModelDescription | None = None
    elements: dict[str, Scope] = field(default_factory=dict)
    known: bool = True

    def find(self, name: str) -> tuple[Scope, str] | str:
        """Return the scope in which `name` lies and its name there, or why there is none."""
        inside = [e for e in self.elements if name.startswith(f"{e}.")]
        if inside:
            element = max(inside, key=len)
            return self.elements[element].find(name[len(element) + 1 :])
        if self.description is not None:
            if name in {v.name for v in self.description.variables}:
                return self, name
            return "the FMU has no such variable"
        if name in self.connectors or not self.known:
            return self, name
        head = name.partition(".")[0]
        return f"there is no element {head!r}" if head != name else "there is no such parameter or connector"


@dataclass(frozen=True)
class _Entry:
    """One entry of a mapping."""

    target: str
    transformation: str
    own_units: bool


class Bindings:
    """Checks bindings of one archive in `folder`; units : of the structure."""

    def __init__(self, folder: Path, report: Report, units: Units) -> None:
        self.folder, self.report, self.units = folder, report, units

    def of(self, holder: Any, scope: Scope, where: str) -> None:
        """Check every parameter binding of a component or system."""
        for binding in holder.findall(f"{SSD}ParameterBindings/{SSD}ParameterBinding"):
            if binding.get("type", _SET) != _SET:
                self.report.notes.append(
                    f"{where}: a parameter set of type {binding.get('type')} was not read"
                )
            else:
                self._binding(binding, scope, where)

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

    def unit_is_defined(self, unit: str | None, where: str, units: Units) -> None:
        """Add a finding for a unit that is not among `units`."""
        if unit is not None and unit not in units.names:
            self.report.add("SSP units", where, f"unit {unit} is not defined", "define it in Units")

    # -- private --------------------------------------------------------------------------

    def _binding(self, binding: Any, scope: Scope, where: str) -> None:
        """Every parameter of a set, mapped where there is a mapping, is one that can be set."""
        mapping = self._mapping(binding, where)
        root = self._part(binding, where, _VALUES, f"{SSV}ParameterSet", f"{SSD}ParameterValues")
        if root is None:
            return
        units = unit_definitions(root, SSV + "Units", SSC)
        prefix = binding.get("prefix", "")
        values = root.findall(f"{SSV}Parameters/{SSV}Parameter")
        names = [prefix + p.get("name", "") for p in values]
        self._once(names, where, "parameter", "is given twice in one set")
        for source in sorted(set(mapping or ()) - set(names)):
            self.report.add(
                *("SSP parameters", f"{where} mapping of {source}"),
                "the parameter set has no such parameter",
                "correct the source of the mapping",
            )
        for source, parameter in zip(names, values, strict=True):
            value = next((t for t in parameter if isinstance(t.tag, str)), None)
            entries = [_Entry(source, "", False)] if mapping is None else mapping.get(source, [])
            for entry in entries:
                self._entry(value, entry, scope, units, f"{where} parameter {entry.target}")

    def _once(self, names: list[str], where: str, what: str, message: str) -> None:
        for name, times in Counter(names).items():
            if times > 1:
                self.report.add("SSP parameters", f"{where} {what} {name}", message, "keep one of them")

    def _mapping(self, binding: Any, where: str) -> dict[str, list[_Entry]] | None:
        """Return source -> entries of a binding's mapping; None where names stay as they are."""
        mapped = binding.find(f"{SSD}ParameterMapping")
        if mapped is None:
            return None
        root = self._part(mapped, where, _MAPPING, f"{SSM}ParameterMapping")
        mapping: dict[str, list[_Entry]] = {}
        if root is None:
            return mapping  # said already; which names were meant nobody knows
        entries = root.findall(f"{SSM}MappingEntry")
        for entry in entries:
            change = [t.tag.rpartition("}")[2] for t in entry if isinstance(t.tag, str)]
            transformation = next((t for t in change if t in _TAKES), "")
            own_units = entry.get("suppressUnitConversion", "false") in ("true", "1")
            target = _Entry(entry.get("target", ""), transformation, own_units)
            mapping.setdefault(entry.get("source", ""), []).append(target)
        self._once([e.get("target", "") for e in entries], where, "mapping to", "has two sources")
        return mapping

    def _entry(self, value: Any, entry: _Entry, scope: Scope, units: Units, place: str) -> None:
        """One value goes to a parameter that there is, that can be set, of its type and dimension."""
        target = scope.find(entry.target)
        if isinstance(target, str):
            self.report.add("SSP parameters", place, target, "correct the name")
            return
        kind = None if value is None else value.tag.rpartition("}")[2]
        if entry.transformation and kind is not None and kind not in _TAKES[entry.transformation]:
            self.report.add(
                "SSP parameters",
                place,
                f"{entry.transformation} of {kind}",
                f"it takes {' or '.join(_TAKES[entry.transformation])}",
            )
        inside, name = target
        if (d := inside.description) is not None:
            v = next(v for v in d.variables if v.name == name)
            self._settable(v, place)
            of_target = Connector(name, v.causality, v.type, d.unit_of(v), d.dimension(d.unit_of(v) or ""))
            self._item(value, v, d, place)
        elif name in inside.connectors:
            of_target = inside.connectors[name]
            if of_target.kind not in ("parameter", "input", "inout"):
                self.report.add(
                    "SSP parameters",
                    place,
                    f"{of_target.kind}, which cannot be set",
                    "set a parameter or input",
                )
        else:
            return
        if value is not None:
            self._value(value, of_target, entry, units, place)

    def _settable(self, v: ScalarVariable, place: str) -> None:
        constant = v.variability == "constant"
        if constant or (v.causality not in ("parameter", "input") and v.initial not in ("exact", "approx")):
            self.report.add(
                "SSP parameters",
                place,
                f"{'constant' if constant else v.causality}, which cannot be set",
                "set a parameter or input",
            )

    def _item(self, value: Any, v: ScalarVariable, d: ModelDescription, place: str) -> None:
        """The value of an Enumeration is one of its items."""
        declared = d.types.get(v.typed.get("declaredType", ""))
        if (
            value is None
            or v.type != "Enumeration"
            or declared is None
            or not value.tag.endswith("}Enumeration")
        ):
            return
        items = [name for name, _ in declared[1]["items"]]
        if value.get("value") not in items:
            self.report.add(
                "SSP parameters", place, f"is {value.get('value')!r}", f"give one of {', '.join(items)}"
            )

    def _value(self, value: Any, target: Connector, entry: _Entry, units: Units, place: str) -> None:
        """A value has the type of its target and a unit of its dimension."""
        kind, unit = value.tag.rpartition("}")[2], value.get("unit")
        mapped = entry.transformation.endswith("MappingTransformation")
        if target.type and kind != target.type and (kind, target.type) not in LOOSE and not mapped:
            self.report.add(
                *("SSP parameters", place),
                f"is {kind}, the variable is {target.type}",
                "use the type of the FMU",
            )
        defined = units if units.names else self.units
        self.unit_is_defined(unit, place, defined)
        if entry.own_units or not unit or not target.unit or unit == target.unit:
            return
        if defined.dimension(unit) != target.dimension:
            self.report.add(
                *("SSP units", place),
                f"has unit {unit}, the variable {target.unit}",
                "use a unit of the same dimension",
            )

    def _part(self, holder: Any, where: str, schema: str, tag: str, inline: str = "") -> Any | None:
        """Return the root of an SSV or SSM, given inside the structure or as a file of its own."""
        if holder.get("source"):
            file = self.file(holder.get("source"), where)
            if file is None:
                return None
            name = file.relative_to(self.folder.resolve()).as_posix()
            root = read_xml(file, name, self.report)
        else:  # the schema of the structure lets anything stand here
            name, root = where, holder.find(f"{inline}/{tag}" if inline else tag)
        return root if root is not None and obeys_schema(root, schema, name, self.report) else None
