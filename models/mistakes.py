"""What pydantic refused in a table, a line for each mistake: key, value, what is allowed, what was meant."""

from __future__ import annotations

import difflib
import re
import types
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError

from .documents import is_time

Location = tuple[int | str, ...]


def suggestion(name: object, known: Iterable[object]) -> str:
    """Return the clause that names the keys closest to `name`, else the keys there are.

    >>> suggestion("latncy_s", ["latency_s", "loss"])
    "did you mean 'latency_s'?"
    """
    names = sorted({str(k) for k in known})
    close = difflib.get_close_matches(str(name), names, n=3, cutoff=0.5)
    if close:
        return "did you mean " + " or ".join(map(repr, close)) + "?"
    if not names:
        return "there are none"
    return f"there are: {', '.join(names[:12])}{', ...' if len(names) > 12 else ''}"


def mistakes(
    error: ValidationError,
    model: Any,
    *,
    path_of: Callable[[Location], Sequence[str]] | None = None,
    hidden: Sequence[str] = (),
    times: bool = False,
) -> list[str]:
    """Return a line for each failure of a pydantic `error`, the first of each place.

    model : the annotation that was validated, in which allowed keys are found. path_of : words of a location
        where they are not those of the model. hidden : keys that no file has. times : words such as
        "100 ms" were turned into seconds before.
    """
    lines: dict[str, list[str]] = {}
    rows = error.errors()
    places = {row["loc"][:k] for row in rows for k in range(len(row["loc"]))}
    for row in rows:
        if row["type"] == "too_short" and row["loc"] in places:
            continue  # counted without the parts that are wrong themselves
        words, known = _followed(model, row["loc"])
        key = ".".join(words if path_of is None else path_of(row["loc"]))
        if key not in lines:  # the members of a union each say why they are not meant
            lines[key] = _lines_of(key, row, [k for k in known if k not in hidden], times)
    return [line for message in lines.values() for line in message]


def _lines_of(key: str, row: Any, known: Sequence[str], times: bool) -> list[str]:
    provided, context = row["input"], row.get("ctx", {})
    message = row["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
    own = str(row["loc"][-1]) if row["loc"] else key
    match row["type"]:
        case "value_error":
            return [_placed(key, own, text) for text in message.split("\n")]
        case "control":  # a device's row: the message begins with the key in it
            return [f"{key}{message}"]
        case "missing":
            return [f"{key} is missing"]
        case "extra_forbidden" | "unexpected_keyword_argument":  # of a table, of a dataclass
            return [f"{key} = {provided!r}: no such key; {suggestion(own, known)}"]
        case "union_tag_not_found":
            return [f"{key}.kind is missing"]
        case "union_tag_invalid":
            return [_one_of(f"{key}.kind", context["tag"], context["expected_tags"])]
        case "literal_error":
            return [_one_of(key, provided, context["expected"])]
        case "model_type" | "model_attributes_type" | "dict_type" | "mapping_type":
            near = [repr(k) for k in known if k.startswith(f"{own}_")]
            hint = f"; did you mean {' or '.join(near)}?" if near else ""
            return [f"{key} = {provided!r}, allowed: a table{hint}"]
    return [f"{key} = {provided!r}, allowed: {_in_words(times and is_time(own), provided, message)}"]


def _placed(key: str, own: str, text: str) -> str:
    """Return a text of a rule with its place, the key that it begins with said once."""
    if key and text.startswith(f"{own} "):
        return f"{key.removesuffix(own)}{text}"
    return f"{key}: {text}" if key else text


def _in_words(time: bool, provided: object, message: str) -> str:
    """Return what is allowed as who writes files says it."""
    number = _NUMBER.fullmatch(provided.strip()) if isinstance(provided, str) else None
    if message.startswith("a valid number") and isinstance(provided, str) and time and not number:
        return 'seconds as a number, or words such as "8 cycles", "100 ms", "1.5 s"'
    for begin, allowed in _ALLOWED.items():
        if message.startswith(begin):
            return f"{allowed}, without quotes: {number[0]}" if number and "number" in allowed else allowed
    return _COUNTED.sub("", message).replace(" after validation", "")


#: how pydantic's messages begin -> what is allowed
_ALLOWED = {
    "a valid integer": "a whole number",
    "a valid number": "a number",
    "a valid boolean": "true or false, without quotes",
    "a valid string": "a text in quotes",
    "a valid tuple": "a list in brackets",
    "a valid list": "a list in brackets",
    "String should match pattern '^[A-Za-z][": "a letter, then letters, digits and _",
    "String should match pattern '^[A-Za-z_]": "a letter or _, then letters, digits and _",
    "String should match pattern '^[A-Za-z0-9][": "a letter or digit, then letters, digits and _ . -",
    r"String should match pattern '^\S": "a text without blanks at its ends",
    "String should match pattern '^[-+]?": "a printed number, such as 0.12",
}
_COUNTED = re.compile(r"^(Tuple|List|String|Dictionary|Value) should have ")
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")


def _one_of(key: str, provided: object, allowed: str) -> str:
    """Return the line of a word that is none of those `allowed`, and which of them is close."""
    words = [w.strip(" '") for w in allowed.replace(" or ", ",").split(",")]
    near = difflib.get_close_matches(str(provided), words, 1)
    return f"{key} = {provided!r}, allowed: {allowed}" + (f"; did you mean {near[0]!r}?" if near else "")


def _followed(model: Any, location: Location) -> tuple[list[str], list[str]]:
    """Return a location in the words of the file, and the keys that stand beside its last part."""
    models, words, known = _members(model), list[str](), list[str]()
    for k, part in enumerate(location):
        known = _keys(models) or known
        there = [m for t in models for m in _inside(t, part)]
        form = [t for t in models if _is_table(t) and (part in _kinds(t) or part == t.__name__)]
        if there or (not form and k == len(location) - 1 and not _is_form(part)):
            _add(words, part)
        models = there or form or models
    return words, known


def _add(words: list[str], part: int | str) -> None:
    """Add a part of a location to its words; a row of a list by its number, the first is 1."""
    if isinstance(part, int) and words:
        words[-1] += f" {part + 1}"
    else:
        words.append(str(part))


def _is_table(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, BaseModel)


def _keys(models: Sequence[Any]) -> list[str]:
    keys = [f.alias or name for t in models if _is_table(t) for name, f in t.model_fields.items()]
    return keys + [f.name for t in models if is_dataclass(t) and isinstance(t, type) for f in fields(t)]


def _is_form(part: int | str) -> bool:
    """Whether a part of a location names one form of several that a value may have."""
    return isinstance(part, str) and (part in ("str", "float", "int", "bool") or "[" in part)


def _members(annotation: Any) -> list[Any]:
    """Return the plain types of an annotation."""
    origin = get_origin(annotation)
    if origin is Annotated:
        return _members(get_args(annotation)[0])
    if origin in (Union, types.UnionType):
        return [m for part in get_args(annotation) for m in _members(part)]
    return [annotation]


def _inside(kind: Any, part: int | str) -> list[Any]:
    """Return the types at `part` of a type, none where it has no such part."""
    if _is_table(kind):
        for name, field in kind.model_fields.items():
            if part in (name, field.alias):
                return _members(field.annotation)
        return []
    inner = get_args(kind)
    if get_origin(kind) is Literal or not inner:
        return []
    if isinstance(part, int):
        return _members(inner[min(part, len(inner) - 1)] if inner[-1] is not Ellipsis else inner[0])
    origin = get_origin(kind)
    return _members(inner[1]) if isinstance(origin, type) and issubclass(origin, Mapping) else []


def _kinds(table: type[BaseModel]) -> tuple[Any, ...]:
    """Return what `kind` may be in a table, by which one of several tables is chosen."""
    field = table.model_fields.get("kind")
    return () if field is None else get_args(field.annotation)
