"""What a study is: its TOML, the only source of what is designed, run, drawn and judged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from interarea.design.synthesis.study_designs import SPECIFICATIONS as DESIGNS
from interarea.design.synthesis.study_designs import StudySpec

from ..errors import ScenarioError, nearest
from ..scenario.names import CONTROLLER_NAMES
from ..toml_file import read_toml

SPECIFICATIONS = Path(__file__).resolve().parent / "thesis"  #: folder of the bundled studies
PREFIX = "study_"
KEYS = (
    "title",
    "case",
    "published",
    "stop_s",
    "step_s",
    "remote",
    "local",
    "swing",
    "controllers",
    "sensitivity",
    "reduction",
    "disturbance",
    "latency",
    "margin",
    "scenario",
    "figure",
)
#: kind of figure -> its keys beside key, section, title, kind; those in brackets may be missing
FIGURE_KINDS: Mapping[str, tuple[str, ...]] = {
    "one_line": (),
    "participation": ("mode",),
    "mode_shape": ("mode",),
    "singular_values": ("reduction",),
    "hankel_values": (),
    "generalised_plant": (),
    "bode": ("controller",),
    "sensitivity": ("function",),
    "swing": ("runs", "[marks]", "[span_s]", "[micro]"),
    "control": ("runs",),
    "latencies": ("wiring", "reference"),
    "latency_damping": (),
}
_FIGURE_KEYS = ("key", "section", "title", "kind")


def study_names() -> list[str]:
    """Return the names of the bundled studies."""
    return sorted(p.stem.removeprefix(PREFIX) for p in SPECIFICATIONS.glob(f"{PREFIX}*.toml"))


def load_study(name: str) -> Mapping[str, Any]:
    """Return the TOML of a bundled study or of a file; `claims`, a path relative to it, as an absolute one.

    Raises
    ------
    ScenarioError : neither bundled nor a file, no TOML, a table is missing, or a figure of what is not there.
    """
    path = Path(name) if name.endswith(".toml") else SPECIFICATIONS / f"{PREFIX}{name}.toml"
    if not path.is_file():
        raise ScenarioError(
            f"study {name!r} is neither bundled nor a TOML file; {nearest(name, study_names())}"
        )
    spec = read_toml(path, "study", ScenarioError)
    missing = [key for key in KEYS if key not in spec]
    if missing:
        raise ScenarioError(f"{path}: {', '.join(missing)} missing; study_thesis.toml shows a whole study")
    for what in (*spec["controllers"], spec["sensitivity"], spec["latency"]["controller"]):
        _among(f"{path}: controller", what, CONTROLLER_NAMES)
    for what in (spec["sensitivity"], spec["latency"]["controller"]):
        _among(f"{path}: controller", what, spec["controllers"])
    for order, outputs in spec["reduction"].items():
        _among(f"{path}: reduction.{order}", outputs, ("difference", "signals"))
    runs = [row["name"] for row in spec["scenario"]] + latency_names(spec)
    for row in spec["figure"]:
        _check_figure(f"{path}: figure {row.get('key', '?')}", row, spec, runs)
    design_specs(spec)
    if "claims" in spec:
        spec["claims"] = str(path.parent / spec["claims"])
    return spec


def design_specs(spec: Mapping[str, Any]) -> dict[str, StudySpec]:
    """Return the specifications that a study's table `design` changes, by controller.

    Raises
    ------
    ScenarioError : no such controller or key, or a value that does not fit; the first one is named.
    """
    given = spec.get("design", {})
    for name in given:
        _among("study: design", name, DESIGNS)
    made: dict[str, StudySpec] = {}
    for name, table in given.items():
        kind = DESIGNS[name]
        for key in table:
            _among(f"study: design.{name}: key", key, [f.name for f in fields(kind)])
        try:
            made[name] = TypeAdapter(kind).validate_python(dict(table))
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(map(str, first["loc"]))
            raise ScenarioError(
                f"study: design.{name}.{where} = {first['input']!r}: {first['msg']}"
            ) from None
    return made


def latency_names(spec: Mapping[str, Any]) -> list[str]:
    """Return the names of the runs with latency."""
    latency = spec["latency"]
    return [
        latency_name(latency["controller"], wiring, value)
        for wiring in ("synchronous", "non-synchronous")
        for value in latency["values_s"]
    ]


def latency_name(controller: str, wiring: str, value_s: float) -> str:
    """Return the name of one run with latency, such as wdc-synchronous-100ms."""
    return f"{controller}-{wiring}-{round(1e3 * value_s)}ms"


def _check_figure(where: str, row: Mapping[str, Any], spec: Mapping[str, Any], runs: Sequence[str]) -> None:
    missing = [key for key in _FIGURE_KEYS if key not in row]
    if missing:
        raise ScenarioError(f"{where}: {', '.join(missing)} missing")
    _among(f"{where}: kind", row["kind"], FIGURE_KINDS)
    known = FIGURE_KINDS[row["kind"]]
    asked = [key for key in known if not key.startswith("[")]
    for key in asked:
        if key not in row:
            raise ScenarioError(f"{where}: {key} missing, a figure of kind {row['kind']!r} needs it")
    for key in row:
        _among(f"{where}: key", key, (*_FIGURE_KEYS, *(k.strip("[]") for k in known)))
    for run in [*row.get("runs", {}).values(), *([row["reference"]] if "reference" in row else [])]:
        _among(f"{where}: run", run, runs)
    for key, allowed in (
        ("controller", spec["controllers"]),
        ("reduction", spec["reduction"]),
        ("function", ("S", "KS")),
        ("wiring", ("synchronous", "non-synchronous")),
    ):
        if key in row:
            _among(f"{where}: {key}", row[key], allowed)


def _among(what: str, name: str, known: Any) -> None:
    if name not in known:
        raise ScenarioError(f"{what} = {name!r}; {nearest(name, known)}")
