"""Rules of FMI 2.0 on modelDescription.xml that neither the schema nor fmpy nor the toolbox checks."""

from __future__ import annotations

import itertools
import math
import re
from collections import Counter
from pathlib import Path
from typing import Any

from ..finding import Report
from ..open.description import ModelDescription, ScalarVariable, Unknown

_WHERE = "modelDescription.xml"
_RANGES = {"Integer": (-(2**31), 2**31 - 1), "Enumeration": (-(2**31), 2**31 - 1)}


def check_semantics(d: ModelDescription, folder: Path, report: Report) -> None:
    """Add findings about identity, interfaces, values, aliases, ModelStructure and listed files."""
    _identity(d, report)
    for v in d.variables:
        _values(v, report)
        _type(d, v, report)
    _aliases(d, report)
    _structure(d, report)
    _experiment(d, report)
    for name in d.sources:
        if not (folder / "sources" / name).is_file():
            report.add(
                "FMI2 2.2.4 SourceFiles",
                f"{_WHERE} {name}",
                f"sources/{name} is listed but not in the archive",
                "pack the file or take it off the list",
            )
    if not (folder / "documentation" / "index.html").is_file():
        report.notes.append("no documentation/index.html")


def check_units(root: Any, report: Report) -> None:
    """Add findings about units with which no value can be converted."""
    for unit in root.findall("UnitDefinitions/Unit"):
        for part in (*unit.findall("BaseUnit"), *unit.findall("DisplayUnit")):
            factor = float(part.get("factor", "1"))
            if not 0.0 < abs(factor) < math.inf:
                name = unit.get("name", "") + (f", {part.get('name')}" if part.tag == "DisplayUnit" else "")
                report.add(
                    "FMI2 2.2.2 units",
                    f"{_WHERE} unit {name}",
                    f"factor = {factor:g}: no value has one in the base unit",
                    "write the factor of the conversion",
                )


def _identity(d: ModelDescription, report: Report) -> None:
    if not d.guid.strip():
        report.add("FMI2 2.2.1 guid", _WHERE, "the guid is empty", "write the GUID that the binary checks")
    if not d.interfaces:
        report.add(
            "FMI2 2.2.1 interfaces",
            _WHERE,
            "neither ModelExchange nor CoSimulation is declared",
            "declare what the binary implements",
        )
    for interface, attributes in d.interfaces.items():
        identifier = attributes.get("modelIdentifier", "")
        if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", identifier):
            report.add(
                "FMI2 2.2.1 modelIdentifier",
                f"{_WHERE} {interface}",
                f"modelIdentifier {identifier!r} is no C identifier",
                "use letters, digits and _",
            )
        if d.flag(interface, "canSerializeFMUstate") and not d.flag(interface, "canGetAndSetFMUstate"):
            report.add(
                "FMI2 3.3.1, 4.3.1 capabilities",
                f"{_WHERE} {interface}",
                "canSerializeFMUstate without canGetAndSetFMUstate",
                "declare both or none",
            )


def _values(v: ScalarVariable, report: Report) -> None:
    where = f"{_WHERE}:{v.line} {v.name}"
    numbers = {k: v.number(k) for k in ("min", "max", "start", "nominal")}
    for attribute, value in numbers.items():
        if v.type == "Real" and value is not None and not math.isfinite(value):
            report.add("FMI2 2.2.7 values", where, f"{attribute} is {value}", "write a finite number")
    low, high, start, nominal = numbers.values()
    if low is not None and high is not None and low > high:
        report.add("FMI2 2.2.7 min, max", where, f"min {low:g} is above max {high:g}", "exchange them")
    if v.type in ("Real", "Integer", "Enumeration") and start is not None:
        _start(v, start, low, high, report)
    if nominal is not None and nominal <= 0.0:
        report.add(
            "FMI2 2.2.7 nominal",
            where,
            f"nominal is {nominal:g}, it must be positive",
            "write the usual size",
        )


def _start(v: ScalarVariable, start: float, low: float | None, high: float | None, report: Report) -> None:
    where = f"{_WHERE}:{v.line} {v.name}"
    if (low is not None and start < low) or (high is not None and start > high):
        report.add(
            "FMI2 2.2.7 min, max",
            where,
            f"start {start:g} lies outside min {low}, max {high}",
            "correct the start value or the range",
        )
    bounds = _RANGES.get(v.type)
    if bounds and not bounds[0] <= start <= bounds[1]:
        report.add("FMI2 2.2.7 start", where, f"start {start:g} is no 32-bit integer", "use a smaller value")


def _type(d: ModelDescription, v: ScalarVariable, report: Report) -> None:
    where = f"{_WHERE}:{v.line} {v.name}"
    name = v.typed.get("declaredType")
    if name is not None and name in d.types:
        base, attributes = d.types[name]
        if base != v.type:
            report.add(
                "FMI2 2.2.7 declaredType",
                where,
                f"declaredType {name} is a {base}, the variable a {v.type}",
                "declare a type of the variable's own base type",
            )
        elif (
            base == "Enumeration"
            and v.start is not None
            and v.start not in (values := [value for _, value in attributes["items"]])
        ):
            report.add(
                "FMI2 2.2.7 start",
                where,
                f"start {v.start} is none of the values {', '.join(values)} of {name}",
                "use a value of the enumeration",
            )
    display, unit = v.typed.get("displayUnit"), d.unit_of(v)
    if display is not None and unit is None:
        report.add(
            "FMI2 2.2.2 units", where, f"displayUnit {display} without a unit", "give the variable its unit"
        )


def _aliases(d: ModelDescription, report: Report) -> None:
    """Variables of one value reference are one variable."""
    kind = {"Enumeration": "Integer"}
    key = {v.index: (kind.get(v.type, v.type), v.reference) for v in d.variables}
    for _, group in itertools.groupby(
        sorted(d.variables, key=lambda v: key[v.index]), lambda v: key[v.index]
    ):
        members = list(group)
        names = ", ".join(v.name for v in members[:4])
        where = f"{_WHERE} {names}"
        if len(members) == 1:
            continue
        starts = {v.number("start") for v in members if v.start is not None and v.type != "String"}
        if len(starts) > 1:
            report.add(
                "FMI2 2.2.7 aliases",
                where,
                f"share value reference {members[0].reference} but have different start values",
                "give them value references of their own, or one start value",
            )
        if len({d.unit_of(v) for v in members}) > 1:
            report.add(
                "FMI2 2.2.7 aliases",
                where,
                f"share value reference {members[0].reference} but have different units",
                "give aliases the same unit",
            )
        settable = [v for v in members if v.causality in ("input", "parameter")]
        if len(settable) > 1:
            report.add(
                "FMI2 2.2.7 aliases",
                where,
                f"{len(settable)} of the aliases can be set",
                "at most one alias may be an input or parameter",
            )


def _structure(d: ModelDescription, report: Report) -> None:
    count = len(d.variables)
    sections = {
        "Outputs": d.outputs,
        "Derivatives": d.derivatives,
        "InitialUnknowns": d.initial_unknowns,
    }
    for section, unknowns in sections.items():
        where = f"{_WHERE} ModelStructure/{section}"
        indices = [u.index for u in unknowns]
        times = Counter(indices)
        for index in sorted(index for index in times if times[index] > 1):
            report.add("FMI2 2.2.8 " + section, where, f"index {index} is listed twice", "list it once")
        _indices(unknowns, count, where, report)
        if section != "Derivatives" and indices != sorted(indices):
            report.add(
                "FMI2 2.2.8 " + section,
                where,
                "the entries are not in the order of their indices",
                "sort them",
            )


def _indices(unknowns: tuple[Unknown, ...], count: int, where: str, report: Report) -> None:
    """Entries and what they depend on are variables, of which there are `count`."""
    rule, remedy = "FMI2 2.2.8 indices", "indices run from 1 to the number of variables"
    for unknown in unknowns:
        if not 1 <= unknown.index <= count:
            report.add(rule, where, f"index {unknown.index}; there are {count} variables", remedy)
    wrong = sorted({k for u in unknowns for k in u.dependencies or () if not 1 <= k <= count})
    if wrong:
        report.add(rule, where, f"dependencies name {wrong[:5]}; there are {count} variables", remedy)


def _experiment(d: ModelDescription, report: Report) -> None:
    values = {}
    for name, text in d.experiment.items():
        try:
            values[name] = float(text)
        except ValueError:
            continue
    where = f"{_WHERE} DefaultExperiment"
    rule = "FMI2 2.2.5 DefaultExperiment"
    if values.get("stopTime", math.inf) <= values.get("startTime", 0.0):
        report.add(rule, where, "stopTime does not lie after startTime", "correct the times")
    for name in ("stepSize", "tolerance"):
        if name in values and not values[name] > 0.0:
            report.add(rule, where, f"{name} is {values[name]:g}", "it must be positive")
