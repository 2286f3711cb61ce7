"""The form of a device file: a JSON Schema for editors, and the words of its diagram for the reference."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from .document import ELEMENTS, OPTIONS
from .language.device import FBASE, KINDS, MBASE, UNITS

_TEXT: dict[str, Any] = {"type": "string"}
_NUMBER: dict[str, Any] = {"type": "number"}


def device_schema() -> dict[str, Any]:
    """Return the JSON Schema of a device file; what only its reader can see (expressions) is text here."""
    parameter: dict[str, tuple[dict[str, Any], str]] = {
        "unit": ({"enum": list(UNITS), "default": "1"}, "of the value"),
        "min": (_NUMBER, "least value; with `min = 0` a time may be 0: then its part is not there"),
        "above": (_NUMBER, "in place of `min`: the value itself is not allowed"),
        "max": (_NUMBER, "largest value"),
        "default": ({**_NUMBER, "examples": [0.02]}, "for rows without it; `inf` or `-inf`: an absent limit"),
        "text": (_TEXT, "what it is"),
    }
    computed: dict[str, tuple[dict[str, Any], str]] = {
        "when": ({"type": ["number", "string"], "examples": [0.0]}, "the value, or word, that asks for it"),
        "value": (_TEXT, "expression of parameters, inputs and the output at rest"),
    }
    top: dict[str, tuple[dict[str, Any], str]] = {
        "name": (
            {**_TEXT, "pattern": "^[A-Za-z][A-Za-z0-9_]{0,23}$"},
            "in small letters the `kind` of a row",
        ),
        "kind": ({"enum": sorted(KINDS)}, "decides which signals there are"),
        "title": (_TEXT, "in a line what it is"),
        "sources": ({"type": "array", "items": _TEXT}, "where the diagram comes from"),
        "oracle": ({**_TEXT, "examples": ["PSS/E time record"]}, "what it was held against"),
        "notes": ({**_TEXT, "examples": ["limits act after the lag"]}, "what a user has to know"),
        "references": (
            {"type": "array", "items": _TEXT, "examples": [["pref", "p0 = pe"]]},
            "set-points: one is solved for at rest, `NAME = expression` is fixed there; default: of the kind",
        ),
        "diagram": (
            {**_TEXT, "examples": ["efd = lag(vref + vs - vc, TA, K=KA)"]},
            "a line for each signal, in any order: `name = expression  # what it is`",
        ),
        "dyr": (
            {"type": "object", "additionalProperties": _TEXT, "examples": [{"MYAVR": "TR - KA; TB = 0"}]},
            "records of PSS/E that are this device: fields in order, `-` ignored, `-NAME` ignored "
            "and named by an import where it is not 0, `0` or `0:NAME` must be 0 (`0:BUS`: or its "
            "own bus); after `;` what is fixed",
        ),
        "computed": (
            {"type": "object", "additionalProperties": {"$ref": "#/$defs/Computed"}},
            "parameters that are computed at rest when they are given so",
        ),
        "parameters": (
            {"type": "object", "additionalProperties": {"$ref": "#/$defs/Parameter"}},
            "by name; the keys of a row in a case",
        ),
        "check": (
            {"type": "object", "additionalProperties": _TEXT, "examples": [{"EMIN <= EMAX": "swap them"}]},
            "comparison of parameters = what to do when it does not hold",
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
                "description": "A number of the device.",
                "additionalProperties": False,
                "properties": _described(parameter),
            },
            "Computed": {
                "type": "object",
                "description": "A parameter that follows from the operating point when it is given so.",
                "additionalProperties": False,
                "properties": _described(computed),
                "required": ["when", "value"],
            },
        },
    }


def _described(rules: dict[str, tuple[dict[str, Any], str]]) -> dict[str, Any]:
    return {key: {**rule, "description": words} for key, (rule, words) in rules.items()}


def diagram_words() -> Iterator[str]:
    """Lines in Markdown: what a diagram can be drawn with, and which signals each kind has."""
    yield from ("## Elements and functions", "")
    yield from (
        "An element has states and a line of its own; a function may stand in any expression, beside "
        "`+ - * /` and `**2` to `**4`. Times and gains of elements are expressions of parameters.",
        "",
        "| word | what it gives |",
        "|---|---|",
        *(f"| `{call}` | {text} |" for call, text in (ELEMENTS | OPTIONS).items()),
        "",
        "## Signals",
        "",
        f"`{MBASE}`, the base of the machine in MVA, and `{FBASE}`, the nominal frequency in Hz, are known "
        "to every device.",
        "",
        "| kind | it gives | set-point | it sees |",
        "|---|---|---|---|",
    )
    for name, kind in sorted(KINDS.items()):
        seen = "; ".join(f"`{signal}` {text}" for signal, text in kind.inputs.items())
        solved = ", ".join(f"`{r}`" for r in kind.references) or "none"
        yield f"| `{name}` | `{kind.output}`: {kind.text} | {solved} | {seen} |"
    yield ""
