"""Judge printed statements by numbers of `study.json`, by rules that stand in data and not in code.

A statement names its evidence (name -> path into study.json) and its parts, comparisons of that evidence.
It agrees where every part holds, in part where some do, and differs where none does. A path is made of keys
and list positions between slashes; ``key=value&key=value`` takes the row of a list that has these entries,
``@x`` of rows [x, y] the y at the nearest x. A number that is null ("never settled", "never unstable") counts
as infinite.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from string import Formatter
from typing import Any, Literal

from interarea.models.documents import parse_python

from ..errors import ScenarioError

Verdict = Literal["agrees", "partly", "differs"]
Number = float | int | bool | None

_COMPARE: dict[type[ast.cmpop], Callable[[Any, Any], bool]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}
_COMBINE: dict[type[ast.operator], Callable[[Any, Any], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}


@dataclass(frozen=True)
class Judgement:
    """One printed statement beside ours; `parts` says of each comparison whether it holds."""

    where: str
    says: str
    verdict: Verdict
    ours: str
    why: str
    evidence: Mapping[str, Number]
    parts: Mapping[str, bool]


def judge(statement: Mapping[str, Any], study: Mapping[str, Any]) -> Judgement:
    """Judge a statement of a file such as `published.toml`: where, says, evidence, parts, ours, why.

    Raises
    ------
    ScenarioError : a path that leads nowhere, a part that is no comparison, a text that names no evidence.
    """
    where = f"statement {statement['check']!r}"
    evidence = {name: number_at(study, path, where) for name, path in statement["evidence"].items()}
    parts = {part: holds(part, evidence, where) for part in statement["parts"]}
    count = sum(parts.values())
    verdict: Verdict = "agrees" if count == len(parts) else "partly" if count else "differs"
    why = statement.get("why", "") if verdict != "agrees" or statement.get("always") else ""
    try:
        ours, why = (_Text().vformat(text, (), evidence) for text in (statement["ours"], why))
    except (KeyError, ValueError) as error:
        raise ScenarioError(
            f"{where}: ours, why: {error} is no evidence or no format; named: {', '.join(evidence)}"
        ) from None
    return Judgement(statement["where"], statement["says"], verdict, ours, why, evidence, parts)


def number_at(study: Any, path: str, where: str) -> Number:
    """Return the number, truth value or null at a path of study.json.

    Raises
    ------
    ScenarioError : nothing is there; names the part of the path and what is known.
    """
    value = study
    for word in path.split("/"):
        try:
            value = _step(value, word)
        except (KeyError, IndexError, TypeError, ValueError, StopIteration):
            known = ", ".join(map(str, value)) if isinstance(value, Mapping) else f"a list of {_size(value)}"
            raise ScenarioError(f"{where}: {path!r}: {word!r} is not there, known: {known}") from None
    if value is not None and not isinstance(value, bool | int | float):
        raise ScenarioError(f"{where}: {path!r} is {type(value).__name__}, allowed: a number or true, false")
    return value


def _step(value: Any, word: str) -> Any:
    if isinstance(value, Mapping):
        return value[word]
    if word.startswith("@"):
        at = float(word[1:])
        return min(value, key=lambda row: abs(row[0] - at))[1]
    if "=" in word:
        requested = [entry.partition("=")[::2] for entry in word.split("&")]
        return next(row for row in value if all(str(row[key]) == text for key, text in requested))
    return value[int(word)]


def _size(value: Any) -> int:
    return len(value) if isinstance(value, Sequence) else 0


def holds(part: str, evidence: Mapping[str, Number], where: str) -> bool:
    """Return whether a comparison such as ``ftc > 1.02 * cc`` holds; null counts as infinite.

    Raises
    ------
    ScenarioError : not a comparison of numbers and named evidence.
    """
    try:
        return bool(_value(parse_python(part, mode="eval").body, evidence))
    except (KeyError, SyntaxError, ValueError) as error:
        raise ScenarioError(
            f"{where}: {part!r}: {error}; allowed: comparisons, + - * /, abs(), not, numbers and "
            f"{', '.join(evidence)}"
        ) from None


def _value(node: ast.expr, evidence: Mapping[str, Number]) -> Any:
    match node:
        case ast.Compare(left=left, ops=ops, comparators=comparators):
            values = [_value(n, evidence) for n in (left, *comparators)]
            pairs = zip(ops, values, values[1:], strict=False)
            return all(_COMPARE[type(op)](a, b) for op, a, b in pairs)
        case ast.BinOp(left=left, op=op, right=right):
            return _COMBINE[type(op)](_value(left, evidence), _value(right, evidence))
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            return not _value(operand, evidence)
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return -_value(operand, evidence)
        case ast.Call(func=ast.Name(id="abs"), args=[argument], keywords=[]):
            return abs(_value(argument, evidence))
        case ast.Name(id=name):
            value = evidence[name]
            return math.inf if value is None else value
        case ast.Constant(value=int() | float() as value):
            return value
    raise ValueError(f"{ast.unparse(node)} is no comparison")


class _Text(Formatter):
    """Formats beside Python's own: ``s`` of settling, ``ms`` of latencies, ``%``, ``yes|no`` of truths."""

    def format_field(self, value: Any, format_spec: str) -> str:
        if "|" in format_spec:
            return format_spec.split("|")[0 if value else 1]
        if format_spec == "s":
            return "not within the run" if value is None else f"{value:.2f} s"
        if format_spec == "ms":
            return "none found" if value is None else f"{1e3 * value:.1f} ms"
        if format_spec == "%":
            return f"{100.0 * value:.2g} %"
        if format_spec == "deg":
            return f"{math.degrees(value):.0f}°"
        return "–" if value is None else super().format_field(value, format_spec).lstrip()
