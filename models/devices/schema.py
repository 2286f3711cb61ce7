"""The form of a device file: a JSON Schema for editors, and the words of its diagram for the reference."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from .document import ELEMENTS, OPTIONS
from .language.device import FBASE, KINDS, MBASE, UNITS

_TEXT: dict[str, Any] = {"type": "string"}
_NUMBER: dict[str, Any] = {"type": "number"}


def device_schema() -> dict[str, Any]:
    """Return the JSON Schema of a device file; expressions, which only its reader checks, are text here."""
    parameter: dict[str, tuple[dict[str, Any], str]] = {
        "unit": ({"enum": list(UNITS), "default": "1"}, "unit of the value"),
        "min": (_NUMBER, "least value; with `min = 0` a time constant may be 0, which omits its part"),
        "above": (_NUMBER, "lower bound in place of `min`; the value itself is not allowed"),
        "max": (_NUMBER, "largest value"),
        "default": ({**_NUMBER, "examples": [0.02]}, "value of rows without it; `inf` or `-inf`: no limit"),
        "text": (_TEXT, "meaning"),
    }
    computed: dict[str, tuple[dict[str, Any], str]] = {
        "when": ({"type": ["number", "string"], "examples": [0.0]}, "value, or word, that requests it"),
        "value": (_TEXT, "expression of parameters, inputs and the output at the equilibrium"),
    }
    top: dict[str, tuple[dict[str, Any], str]] = {
        "name": (
            {**_TEXT, "pattern": "^[A-Za-z][A-Za-z0-9_]{0,23}$"},
            "in lower case the `kind` of a row",
        ),
        "kind": ({"enum": sorted(KINDS)}, "kind of device; determines its signals"),
        "title": (_TEXT, "one line"),
        "sources": ({"type": "array", "items": _TEXT}, "sources of the diagram"),
        "oracle": ({**_TEXT, "examples": ["PSS/E time record"]}, "reference of its validation"),
        "notes": ({**_TEXT, "examples": ["limits act after the lag"]}, "notes for users"),
        "references": (
            {"type": "array", "items": _TEXT, "examples": [["pref", "p0 = pe"]]},
            "set-points: one is solved at rest, `NAME = expression` fixes one; default: of the kind",
        ),
        "diagram": (
            {**_TEXT, "examples": ["efd = lag(vref + vs - vc, TA, K=KA)"]},
            "one line per signal, in any order: `name = expression  # meaning`",
        ),
        "dyr": (
            {"type": "object", "additionalProperties": _TEXT, "examples": [{"MYAVR": "TR - KA; TB = 0"}]},
            "PSS/E records of this device: fields in order. `-`: ignored; `-NAME`: ignored, and reported by "
            "an import if it is not 0; `0` or `0:NAME`: must be 0 (`0:BUS`: or its own bus); after `;`: "
            "fixed parameters",
        ),
        "computed": (
            {"type": "object", "additionalProperties": {"$ref": "#/$defs/Computed"}},
            "parameters that can be computed at the equilibrium",
        ),
        "parameters": (
            {"type": "object", "additionalProperties": {"$ref": "#/$defs/Parameter"}},
            "parameters by name, which are keys of a row in a case",
        ),
        "check": (
            {"type": "object", "additionalProperties": _TEXT, "examples": [{"EMIN <= EMAX": "swap them"}]},
            "comparison of parameters = remedy if it does not hold",
        ),
    }
    return {
        "type": "object",
        "additionalProperties": False,
        "properties": _described(top),
        "required": ["name", "kind", "diagram"],
        "$defs": {
            "Parameter": {
                "type": "object",
                "description": "A parameter of the device.",
                "additionalProperties": False,
                "properties": _described(parameter),
            },
            "Computed": {
                "type": "object",
                "description": "A parameter that is computed from the operating point on request.",
                "additionalProperties": False,
                "properties": _described(computed),
                "required": ["when", "value"],
            },
        },
    }


def _described(rules: dict[str, tuple[dict[str, Any], str]]) -> dict[str, Any]:
    return {key: {**rule, "description": words} for key, (rule, words) in rules.items()}


def diagram_words() -> Iterator[str]:
    """Lines in Markdown: elements and functions of diagrams, and signals of each kind."""
    yield from ("## Elements and functions", "")
    yield from (
        "An element has states and needs its own line. A function may be part of any expression, as "
        "`+ - * /` and `**2` to `**4`. Times and gains of elements are expressions of parameters.",
        "",
        "| call | result |",
        "|---|---|",
        *(f"| `{call}` | {text} |" for call, text in (ELEMENTS | OPTIONS).items()),
        "",
        "## Signals",
        "",
        f"`{MBASE}`, the base of the machine in MVA, and `{FBASE}`, the nominal frequency in Hz, are "
        "constants in every device.",
        "",
        "| kind | output | set-point | inputs |",
        "|---|---|---|---|",
    )
    for name, kind in sorted(KINDS.items()):
        seen = "; ".join(f"`{signal}` {text}" for signal, text in kind.inputs.items())
        solved = ", ".join(f"`{r}`" for r in kind.references) or "none"
        yield f"| `{name}` | `{kind.output}`: {kind.text} | {solved} | {seen} |"
    yield ""
