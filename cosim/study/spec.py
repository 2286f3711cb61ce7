"""What a study is: its TOML, the only source of what is designed, run, drawn and judged."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from interarea.design.synthesis.study_designs import SPECIFICATIONS as DESIGNS
from interarea.design.synthesis.study_designs import StudySpec
from interarea.models.case.case import load_case
from interarea.models.documents import in_seconds
from interarea.models.errors import Collected
from interarea.models.mistakes import mistakes

from ..errors import ScenarioError
from ..scenario.named import study_file
from ..scenario.names import beside, wrong_names
from ..toml_file import read_toml
from .tables import ClaimsTable, StudyTable

SPECIFICATIONS = Path(__file__).resolve().parent / "thesis"  #: folder of the bundled studies
PREFIX = "study_"


def load_study(name: str) -> Mapping[str, Any]:
    """Return the TOML of a bundled study or of a file, checked (`tables.StudyTable`), times in seconds.

    `case` and `claims`, where they are files, are relative to it, and absolute here.

    Raises
    ------
    ScenarioError : neither bundled nor a file, no TOML, or a line for each mistake in it.
    """
    path = study_file(name)
    provided = read_toml(path, "study", ScenarioError)
    if isinstance(provided.get("case"), str):
        provided["case"] = str(beside(path.parent, provided["case"]))
    collected = Collected()
    spec = provided
    with collected:
        spec = in_seconds(provided, lambda: load_case(str(provided.get("case", ""))).frequency_hz)
    try:
        StudyTable.model_validate(spec)
    except ValidationError as error:
        collected.lines += [
            f"{path}: {_by_key(line, spec)}" for line in mistakes(error, StudyTable, times=True)
        ]
    collected.lines += [line for line in _wrong_names(spec, str(path)) if line not in collected.lines]
    if "claims" in spec and isinstance(spec["claims"], str):
        spec["claims"] = str(path.parent / spec["claims"])
        with collected:
            read_claims(Path(spec["claims"]))
    collected.end(ScenarioError)
    return spec


def _by_key(line: str, spec: Mapping[str, Any]) -> str:
    """Return a mistake with the name of its figure or scenario in place of its number."""
    match = re.match(r"(figure|scenario) (\d+)(?:[.:] ?)?", line)
    if match is None:
        return line
    row = spec[match[1]][int(match[2]) - 1]
    provided = row.get("key", row.get("name")) if isinstance(row, Mapping) else None
    return f"{match[1]} {provided or match[2]}: {line[match.end() :]}"


def _wrong_names(spec: Mapping[str, Any], where: str) -> list[str]:
    """Return a line for each event whose target the case does not have, and for each signal it lacks."""
    tables = spec.get("disturbance")
    events = dict(tables) if isinstance(tables, Mapping) else {}
    margin = spec.get("margin")
    named = {f"disturbance.{name}": rows for name, rows in events.items()}
    named |= {"margin.events": margin.get("events")} if isinstance(margin, Mapping) else {}
    lines: list[str] = []
    for place, rows in named.items():
        document = {"case": spec.get("case"), "event": rows}
        lines += [line.replace(": event ", f": {place} ", 1) for line in wrong_names(document, where, Path())]
    paths = {key: {"signal": spec[key]} for key in ("remote", "local") if key in spec}
    for line in wrong_names({"case": spec.get("case"), "channels": paths}, where, Path()):
        lines.append(re.sub(r"channels\.(\w+)\.signal", r"\1", line))
    return list(dict.fromkeys(lines))


def design_specs(spec: Mapping[str, Any]) -> dict[str, StudySpec]:
    """Return the specifications that a study's table `design` changes, by controller; of a checked study."""
    return {
        name: TypeAdapter(DESIGNS[name]).validate_python(dict(table))
        for name, table in spec.get("design", {}).items()
    }


def read_claims(path: Path) -> dict[str, Any]:
    """Return what a publication prints: a TOML file of tables, each of which may be missing.

    Raises
    ------
    ScenarioError : no such file, no TOML, or a line for each mistake in it.
    """
    if not path.is_file():
        raise ScenarioError(f"{path}: no such file of claims; name a TOML file, or leave `claims` out")
    provided = read_toml(path, "claims", ScenarioError)
    try:
        ClaimsTable.model_validate(provided)
    except ValidationError as error:
        raise ScenarioError(*(f"{path}: {line}" for line in mistakes(error, ClaimsTable))) from None
    return provided
