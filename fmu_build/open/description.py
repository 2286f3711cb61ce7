"""What modelDescription.xml of an FMI 2.0 FMU says, read without fmpy so that wrong files can be read too."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from .units import Dimension, UnitOf, unit_of

TYPES = ("Real", "Integer", "Boolean", "String", "Enumeration")

#: Default of `initial` by causality and variability (FMI 2.0, table of section 2.2.7).
_DEFAULT_INITIAL = {
    ("parameter", "fixed"): "exact",
    ("parameter", "tunable"): "exact",
    ("output", "constant"): "exact",
    ("local", "constant"): "exact",
}


@dataclass(frozen=True)
class ScalarVariable:
    """One ScalarVariable; numbers stay text until a rule needs them."""

    index: int  #: 1-based, as ModelStructure counts
    name: str
    reference: int
    type: str
    causality: str
    variability: str
    initial: str
    typed: dict[str, str]  #: attributes of the <Real>, <Integer>, ... element
    line: int
    unit: str | None = None  #: its own or that of its declared type
    description: str = ""

    @property
    def start(self) -> str | None:
        """Start value as written."""
        return self.typed.get("start")

    def number(self, attribute: str) -> float | None:
        """Return a numeric attribute of the type element; None if it is not there or no number."""
        try:
            return float(self.typed[attribute])
        except (KeyError, ValueError):
            return None


@dataclass(frozen=True)
class Unknown:
    """One entry of ModelStructure; dependencies None = on everything."""

    index: int
    dependencies: tuple[int, ...] | None


@dataclass(frozen=True)
class ModelDescription:
    """The parts of a modelDescription.xml that the check reads."""

    version: str
    guid: str
    name: str
    interfaces: dict[str, dict[str, str]]  #: "CoSimulation" and/or "ModelExchange" -> attributes
    variables: tuple[ScalarVariable, ...]
    outputs: tuple[Unknown, ...]
    derivatives: tuple[Unknown, ...]
    initial_unknowns: tuple[Unknown, ...]
    experiment: dict[str, str]
    units: dict[str, tuple[str, ...]]  #: unit -> display units
    types: dict[str, tuple[str, dict[str, Any]]]  #: declared type -> (base type, attributes and items)
    sources: tuple[str, ...] = field(default=())
    unit_table: dict[str, UnitOf] = field(default_factory=dict)  #: unit -> what it means
    description: str = ""
    log_categories: tuple[str, ...] = ()
    event_indicators: int = 0

    def flag(self, interface: str, attribute: str) -> bool:
        """Return a Boolean capability of an interface."""
        return self.interfaces.get(interface, {}).get(attribute, "false") in ("true", "1")

    def experiment_s(self, name: str, default: float) -> float:
        """Return a time of the default experiment, s; `default` where none that is a number is given."""
        try:
            value = float(self.experiment.get(name, default))
        except ValueError:
            return default
        return value if math.isfinite(value) else default

    def dimension(self, unit: str) -> Dimension | None:
        """Return the exponents of the base units of a unit, None if they are not known."""
        defined = self.unit_table.get(unit)
        return None if defined is None else defined.exponents

    def unit_of(self, v: ScalarVariable) -> str | None:
        """Return the unit of a variable, its own or that of its declared type."""
        return v.unit


def read_description(root: Any) -> ModelDescription:
    """Return what an FMI 2.0 `modelDescription.xml` says; entries that make no sense are left out."""
    units = {
        u.get("name", ""): tuple(d.get("name", "") for d in u.findall("DisplayUnit"))
        for u in root.findall("UnitDefinitions/Unit")
    }
    types: dict[str, tuple[str, dict[str, Any]]] = {}
    for simple in root.findall("TypeDefinitions/SimpleType"):
        for child in simple:
            if child.tag in TYPES:
                items = [(i.get("name", ""), i.get("value", "")) for i in child.findall("Item")]
                types[simple.get("name", "")] = (child.tag, {**dict(child.attrib), "items": items})
    experiment = root.find("DefaultExperiment")
    sources = {f.get("name", "") for f in root.iter("File")}
    return ModelDescription(
        version=root.get("fmiVersion", ""),
        guid=root.get("guid", ""),
        name=root.get("modelName", ""),
        interfaces={tag: dict(root.find(tag).attrib) for tag in _interfaces(root)},
        variables=tuple(_variables(root, types)),
        outputs=_unknowns(root, "Outputs"),
        derivatives=_unknowns(root, "Derivatives"),
        initial_unknowns=_unknowns(root, "InitialUnknowns"),
        experiment={} if experiment is None else dict(experiment.attrib),
        units=units,
        types=types,
        sources=tuple(sorted(sources)),
        unit_table={u.get("name", ""): unit_of(u) for u in root.findall("UnitDefinitions/Unit")},
        description=root.get("description", ""),
        log_categories=tuple(c.get("name", "") for c in root.findall("LogCategories/Category")),
        event_indicators=_count(root.get("numberOfEventIndicators", "0")),
    )


def _count(text: str, other: int = 0, *, below: int = 10**7) -> int:
    """Return a whole number as written; `other` where it is none, or none that is `below`."""
    text = text.strip()
    known = text.isascii() and text.isdecimal() and len(text) <= 10 and int(text) < below
    return int(text) if known else other


def _counts(text: str) -> tuple[int, ...]:
    """`_count` of each word of a list."""
    words = text.split()
    if text.isascii() and "".join(words).isdecimal() and max(map(len, words)) <= 7:  # as nearly always
        return tuple(map(int, words))
    return tuple(map(_count, words))


def _interfaces(root: Any) -> list[str]:
    return [tag for tag in ("ModelExchange", "CoSimulation") if root.find(tag) is not None]


def _variables(root: Any, types: dict[str, tuple[str, dict[str, Any]]]) -> list[ScalarVariable]:
    variables = []
    for index, e in enumerate(root.findall("ModelVariables/ScalarVariable"), start=1):
        typed = next((c for c in e if c.tag in TYPES), None)
        causality, variability = e.get("causality", "local"), e.get("variability", "continuous")
        initial = e.get("initial") or _DEFAULT_INITIAL.get((causality, variability), "calculated")
        if causality in ("input", "independent"):
            initial = ""
        reference = e.get("valueReference", "")
        attributes = {} if typed is None else dict(typed.attrib)
        declared = types.get(attributes.get("declaredType", ""))
        variables.append(
            ScalarVariable(
                index=index,
                name=e.get("name", ""),
                reference=_count(reference, -1, below=2**32),
                type="" if typed is None else typed.tag,
                causality=causality,
                variability=variability,
                initial=initial,
                typed=attributes,
                line=e.sourceline or 0,
                unit=attributes.get("unit") or (declared[1].get("unit") if declared else None),
                description=e.get("description", ""),
            )
        )
    return variables


def _unknowns(root: Any, section: str) -> tuple[Unknown, ...]:
    unknowns = []
    for e in root.findall(f"ModelStructure/{section}/Unknown"):
        dependencies = e.get("dependencies")
        indices = None
        if dependencies is not None:
            indices = _counts(dependencies)
        unknowns.append(Unknown(_count(e.get("index", "")), indices))
    return tuple(unknowns)
