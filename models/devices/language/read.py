"""Read a device file: limits first, then TOML, then every line checked against the others."""

from __future__ import annotations

import keyword
import math
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...documents import DocumentError, parse_toml
from ...errors import nearest, reason
from ..errors import DeviceError
from .device import (
    ELEMENTS,
    KINDS,
    MBASE,
    NO_LIMIT,
    UNITS,
    Check,
    Computed,
    Device,
    DyrModel,
    Line,
    Parameter,
)
from .expression import (
    COMPARISONS,
    FUNCTIONS,
    NAME,
    ZERO,
    Node,
    is_constant,
    names_of,
    number,
    parse,
    replaced,
)

LARGEST_FILE, MOST_LINES, MOST_STATES, LARGEST_EXPRESSION = 65536, 200, 40, 2000
_KEYS = {
    "name", "kind", "title", "sources", "oracle", "notes", "references", "diagram", "dyr", "computed",
    "parameters", "check",
}  # fmt: skip
_CALLS = FUNCTIONS | {name: (count, count) for name, (count, _) in ELEMENTS.items()} | {"ramp": (5, 5)}
_RESERVED = frozenset({MBASE, "none"})


def read_device(path: str | Path) -> Device:
    """Return the device of a file.

    Raises
    ------
    DeviceError : the file cannot be read, or is wrong anywhere.
    """
    return device_of(device_text(path), str(path))


def device_text(path: str | Path) -> str:
    """Return what a device file holds; DeviceError : it cannot be read, or is too long."""
    try:
        if Path(path).exists() and not Path(path).is_file():  # a pipe would wait for ever
            raise DeviceError(f"{path}: is no file, allowed: the TOML file of a device")
        with Path(path).open("rb") as file:
            raw = file.read(LARGEST_FILE + 1)
    except OSError as error:
        raise DeviceError(f"{path}: the device file cannot be read: {reason(error)}") from None
    if len(raw) > LARGEST_FILE:
        raise DeviceError(f"{path}: longer than {LARGEST_FILE} bytes, which no device needs")
    try:
        return raw.decode("utf-8").replace("\r\n", "\n")
    except UnicodeDecodeError:
        raise DeviceError(f"{path}: the device file is not UTF-8 text") from None


def device_of(text: str, file: str) -> Device:
    """Return the device that `text` describes; `file` names it in errors.

    Raises
    ------
    DeviceError : anything wrong, with the line where one is to blame.
    """
    if len(text.encode("utf-8", "replace")) > LARGEST_FILE:
        raise DeviceError(f"{file}: longer than {LARGEST_FILE} bytes, which no device needs")
    try:
        raw = parse_toml(text)
    except DocumentError as error:
        raise DeviceError(f"{file}: {error}") from None
    return _Reader(raw, text, file).device()


class _Reader:
    """One file while it is read."""

    def __init__(self, raw: dict[str, Any], text: str, file: str) -> None:
        self.raw, self.text, self.file = raw, text, file
        self.rows = text.splitlines()

    def fail(self, what: str, line: int = 0) -> DeviceError:
        return DeviceError(f"{self.file}{f':{line}' if line else ''}: {what}")

    def line_of(self, key: str, section: str = "") -> int:
        """Number of the line that defines `key`, 0 when it cannot be told."""
        here = not section
        for k, row in enumerate(self.rows, start=1):
            if row.startswith("["):
                here = row.strip() == f"[{section}]"
            if here and row.split("=")[0].strip().strip("\"'") == key:
                return k
        return 0

    def word(self, key: str, default: str | None = None) -> str:
        value = self.raw.get(key, default)
        if not isinstance(value, str) or len(value) > 20000:
            raise self.fail(f"{key} = {str(value)[:40]!r}, allowed: a text", self.line_of(key))
        return value

    def table(self, key: str) -> dict[str, Any]:
        value = self.raw.get(key, {})
        if not isinstance(value, dict) or len(value) > 100:
            raise self.fail(f"{key} must be a table of at most 100 entries", self.line_of(key))
        return value

    def device(self) -> Device:
        for key in self.raw:
            if key not in _KEYS:
                raise self.fail(
                    f"{key[:40]}: no such key here, {nearest(key[:40], _KEYS)}", self.line_of(key)
                )
        name, kind = self.word("name"), self.word("kind")
        # C tells devices from their parameters by a double _
        if not NAME.fullmatch(name) or "__" in name or name.endswith("_"):
            raise self.fail(
                f"name = {name[:40]!r}, allowed: a letter, then letters, digits, single _ between them (24)",
                self.line_of("name"),
            )
        if kind not in KINDS:
            raise self.fail(f"kind = {kind[:40]!r}, {nearest(kind[:40], KINDS)}", self.line_of("kind"))
        self.kind = KINDS[kind]
        self.references, fixed_text = self.read_references()
        self.parameters = self.read_parameters()
        self.constants = frozenset(self.parameters) | {MBASE}
        self.known = self.constants | set(self.kind.inputs) | set(self.references)
        lines = self.read_diagram()
        at_rest = self.constants | set(self.kind.inputs) | {self.kind.output}
        fixed = tuple((key, self.expression(t, "references", at_rest)) for key, t in fixed_text.items())
        computed = self.read_computed(at_rest)
        checks = tuple(self.read_check(text, remedy) for text, remedy in self.table("check").items())
        dyr = tuple(self.read_dyr(model, row) for model, row in self.table("dyr").items())
        self.check_use(lines, [n for _, n in fixed] + [c.value for c in computed.values()])
        return Device(
            name, kind, self.word("title", ""), self.texts("sources"), self.word("oracle", ""),
            self.word("notes", ""), lines, tuple(self.parameters.values()), self.references, fixed,
            computed, checks, dyr, self.file, self.text,
        )  # fmt: skip

    def texts(self, key: str) -> tuple[str, ...]:
        value = self.raw.get(key, [])
        if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
            raise self.fail(f"{key}: allowed: a list of texts", self.line_of(key))
        return tuple(value)

    def name_of(self, name: str, line: int) -> str:
        if not NAME.fullmatch(name):
            raise self.fail(
                f"{name[:40]!r} is no name, allowed: a letter, then letters, digits, _ (24)", line
            )
        if keyword.iskeyword(name) or name in _RESERVED:
            raise self.fail(f"{name} is a reserved word; use another name, such as {name[:22]}_", line)
        return name

    def expression(self, text: Any, section: str, known: frozenset[str] | set[str]) -> Node:
        where = f"{self.file}:{self.line_of(str(text), section) or self.line_of(section)}"
        if isinstance(text, bool) or not isinstance(text, str | int | float):
            raise DeviceError(f"{where}: [{section}] {str(text)[:40]!r}, allowed: an expression as a text")
        node = parse(str(text), where)
        for name in names_of(node):
            if name not in known:
                raise DeviceError(f"{where}: {name} is not known in [{section}]; {nearest(name, known)}")
        return node

    def read_references(self) -> tuple[tuple[str, ...], dict[str, str]]:
        solved, fixed = [], {}
        for text in self.texts("references") if "references" in self.raw else self.kind.references:
            name, sign, value = text.partition("=")
            solved.append(self.name_of(name.strip(), self.line_of("references")))
            if sign:
                fixed[name.strip()] = value.strip()
        return tuple(solved), fixed

    # ------------------------------------------------------------ parameters

    def read_parameters(self) -> dict[str, Parameter]:
        found = {}
        for name, row in self.table("parameters").items():
            line = self.line_of(name, "parameters")
            self.name_of(name, line)
            if name in self.kind.inputs or name in self.references or name == self.kind.output:
                raise self.fail(
                    f"{name} is a signal of a {self.raw['kind']}; name the parameter otherwise", line
                )
            if not isinstance(row, dict):
                raise self.fail(f"{name}: allowed: a table with unit, min or above, default, text", line)
            for key in row:
                if key not in ("unit", "min", "above", "max", "default", "text"):
                    raise self.fail(f"{name}.{key[:40]}: allowed: unit, min, above, max, default, text", line)
            unit, text = row.get("unit", "1"), row.get("text", "")
            if unit not in UNITS:
                raise self.fail(f"{name}.unit = {str(unit)[:40]!r}, allowed: {', '.join(UNITS)}", line)
            if not isinstance(text, str):
                raise self.fail(f"{name}.text, allowed: a text", line)
            numbers = {k: self.number(row[k], f"{name}.{k}", line) for k in row if k not in ("unit", "text")}
            low = numbers.get("min", numbers.get("above", -NO_LIMIT))
            high, default = numbers.get("max", NO_LIMIT), numbers.get("default")
            open_ = "above" in row
            inside = default is None or (low <= default <= high and not (open_ and default == low))
            if not inside and abs(default or 0.0) < NO_LIMIT:
                raise self.fail(f"{name}.default = {default:g} is outside its own range", line)
            found[name] = Parameter(name, unit, text, low, high, open_, default)
        return found

    def number(self, value: Any, what: str, line: int) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or value != value:
            raise self.fail(f"{what} = {str(value)[:40]!r}, allowed: a number", line)
        if math.isinf(value):
            return math.copysign(NO_LIMIT, value)
        if not abs(value) <= NO_LIMIT:
            raise self.fail(f"{what} = {str(value)[:40]}, allowed: at most 1e30 or inf", line)
        return float(value)

    # ------------------------------------------------------------ diagram

    def read_diagram(self) -> tuple[Line, ...]:
        rows = self.word("diagram").splitlines()
        if len(rows) > MOST_LINES:
            raise self.fail(f"diagram: {len(rows)} lines, allowed: {MOST_LINES}")
        start = next((k for k, row in enumerate(self.rows, start=1) if row.startswith("diagram")), 0)
        if start and self.rows[start - 1].rstrip().endswith(("'''", '"""')):
            start += 1  # TOML drops the end of the line that opens a text
        lines: list[Line] = []
        for k, row in enumerate(rows, start=start):
            code, _, comment = row.partition("#")
            if code.strip():
                lines += self.read_line(code, comment.strip(), k)
        twice = [n for n, count in Counter(line.name for line in lines).items() if count > 1]
        for line in lines:
            if line.name in twice or line.name in self.known:
                raise self.fail(f"{line.name} is defined twice, allowed: once", line.number)
        constant = {
            line.name: line.node
            for line in lines
            if not line.element and is_constant(line.node, self.constants | {p.name for p in lines})
        }
        lines = self.fold(lines, constant)
        known = self.known | {line.name for line in lines}
        for line in lines:
            for name in names_of(line.node):
                if name not in known:
                    raise self.fail(f"{name} is not known here, {nearest(name, known)}", line.number)
        if self.kind.output not in known:
            raise self.fail(f"no line gives {self.kind.output}, the output of a {self.raw['kind']}")
        return tuple(lines)

    def fold(self, lines: list[Line], constant: dict[str, Node]) -> list[Line]:
        """Put lines of parameters only into the lines that use them."""
        solved: dict[str, Node] = {}
        sizes: dict[str, int] = {}
        for _ in range(len(constant)):
            for name, node in constant.items():
                if name in solved:
                    continue
                size = self.bounded(name, node, sizes)
                if is_constant(put := replaced(node, solved), self.constants):
                    solved[name], sizes[name] = put, size
        for line in lines:
            self.bounded(line.name, line.node, sizes, line.number)
        return [
            Line(line.name, replaced(line.node, solved), line.comment, line.number)
            for line in lines
            if line.name not in solved or line.name == self.kind.output
        ]

    def bounded(self, name: str, node: Node, sizes: Mapping[str, int], line: int = 0) -> int:
        """Return the size of an expression with lines of parameters put in, before they are."""
        size = _size(node, sizes)
        if size > LARGEST_EXPRESSION:
            raise self.fail(
                f"{name} has {size} parts with the lines of parameters put in, allowed: {LARGEST_EXPRESSION}",
                line,
            )
        return size

    def read_line(self, code: str, comment: str, k: int) -> list[Line]:
        name, sign, text = code.partition("=")
        if not sign:
            raise self.fail(f"{code.strip()[:40]!r}: allowed: name = expression", k)
        name = self.name_of(name.strip(), k) if name.strip() != self.kind.output else self.kind.output
        node = parse(text, f"{self.file}:{k}", _CALLS)
        if node.op == "ramp":
            return self.ramp(name, node, comment, k)
        self.check_element(node, k, top=True)
        return [Line(name, node, comment, k)]

    def check_element(self, node: Node, k: int, *, top: bool, chooses: bool = False) -> None:
        if node.op in ELEMENTS or node.op == "ramp":
            if not top:
                raise self.fail(
                    f"{node.op} has a state and needs a line of its own: name = {node.op}(...)", k
                )
            options = ELEMENTS[node.op][1]
            keys = [key for key, _ in node.options]
            for key in keys:
                if key not in options:
                    raise self.fail(f"{node.op}() has no option {key[:40]}, {nearest(key[:40], options)}", k)
            if len(set(keys)) != len(keys):
                raise self.fail(f"{node.op}() has an option twice", k)
            self.check_constants(node, k)
        elif node.options:
            raise self.fail(f"{node.op}() takes no options", k)
        elif node.op in COMPARISONS and not chooses:
            raise self.fail(f"{node}: a comparison, allowed: as what pick() chooses by", k)
        for j, part in enumerate((*node.args, *(part for _, part in node.options))):
            choice = node.op == "pick" and j == 0
            if choice and part.op not in COMPARISONS:
                raise self.fail(f"pick() chooses by a comparison such as A > 0, not by {part}", k)
            self.check_element(part, k, top=False, chooses=choice)

    def check_constants(self, node: Node, k: int) -> None:
        """Times and gains of an element hold parameters only; lines of parameters are put in later."""
        fixed = [*node.args[1:], *(p for key, p in node.options if key in ("K", "T", "rate_min", "rate_max"))]
        signals = set(self.kind.inputs) | set(self.references)
        for part in fixed:
            for name in names_of(part):
                if name in signals:
                    raise self.fail(f"{node.op}(): {part} holds the signal {name}, allowed: parameters", k)

    def ramp(self, name: str, node: Node, comment: str, k: int) -> list[Line]:
        """[(1 + s T1)/(1 + s T2)^M]^N as eight places for a lead-lag, the leads in the first ones."""
        u, T1, T2, M, N = node.args
        lines = []
        for j in range(8):
            lead = Node("pick", (Node(">", (N, number(j))), T1, ZERO))
            lag = Node("pick", (Node(">", (Node("*", (M, N)), number(j))), T2, ZERO))
            own = name if j == 7 else f"{name}_{j + 1}"
            lines.append(Line(own, Node("leadlag", (u, lead, lag)), comment, k))
            u = Node("name", name=own)
        return lines

    # ------------------------------------------------------------ the rest

    def read_computed(self, known: frozenset[str] | set[str]) -> dict[str, Computed]:
        found = {}
        for name, row in self.table("computed").items():
            line = self.line_of(name, "computed")
            if name not in self.parameters:
                raise self.fail(
                    f"computed.{name[:40]} is no parameter, {nearest(name[:40], self.parameters)}", line
                )
            if not isinstance(row, dict) or set(row) != {"when", "value"}:
                raise self.fail(f"computed.{name}: allowed: {{ when = ..., value = '...' }}", line)
            when = row["when"]
            if not isinstance(when, str):
                when = self.number(when, f"computed.{name}.when", line)
            elif not NAME.fullmatch(when.replace("-", "_")):
                raise self.fail(f"computed.{name}.when, allowed: a number or a word", line)
            found[name] = Computed(when, self.expression(row["value"], "computed", known))
        return found

    def read_check(self, text: str, remedy: Any) -> Check:
        node = self.expression(text, "check", self.constants)
        if not isinstance(remedy, str) or node.op not in ("<", "<=", ">", ">=", "==", "!="):
            raise self.fail(
                f"check {text[:40]!r}: allowed: a comparison = 'what to do'", self.line_of("check")
            )
        return Check(text, node, remedy)

    def read_dyr(self, model: str, row: Any) -> DyrModel:
        line = self.line_of(model, "dyr")
        if not isinstance(row, str) or not NAME.fullmatch(model) or model != model.upper():
            raise self.fail(f"dyr.{model[:40]}: allowed: MODEL = 'fields in order; NAME = value, ...'", line)
        head, _, tail = row.partition(";")
        fields = tuple(head.split())
        assigned: dict[str, Node] = {}
        known = self.constants | set(fields)
        for part in filter(None, (p.strip() for p in _split(tail))):
            name, sign, text = part.partition("=")
            if not sign or name.strip() not in self.parameters:
                raise self.fail(f"dyr.{model}: {part[:40]!r}, allowed: PARAMETER = value", line)
            assigned[name.strip()] = self.expression(text.strip(), "dyr", known)
        used = {n for node in assigned.values() for n in names_of(node)}
        for name in fields:
            if name not in ("-", "0") and name not in self.parameters and name not in used:
                raise self.fail(
                    f"dyr.{model}: {name[:40]} is no parameter, {nearest(name[:40], self.parameters)}", line
                )
        if len(set(fields) - {"-", "0"}) != len([f for f in fields if f not in ("-", "0")]):
            raise self.fail(f"dyr.{model}: a field is named twice", line)
        return DyrModel(model, fields, tuple(assigned.items()))

    def check_use(self, lines: tuple[Line, ...], others: list[Node]) -> None:
        used = {name for line in lines for name in names_of(line.node)} | {self.kind.output}
        for line in lines:
            if line.name not in used:
                raise self.fail(
                    f"the signal {line.name} leads nowhere; use it or take its line out", line.number
                )
        used |= {name for node in others for name in names_of(node)}
        for name in (*self.parameters, *self.references):
            if name not in used:
                where = self.line_of(name, "parameters")
                raise self.fail(f"{name} is used nowhere; use it or take it out", where)
        states = sum(bool(line.element) + (line.element == "filter2") for line in lines)
        if states > MOST_STATES:
            raise self.fail(f"{states} states, allowed: {MOST_STATES}")


def _size(node: Node, sizes: Mapping[str, int]) -> int:
    """Number of parts of an expression; `sizes`: of names that stand for more than one."""
    parts = (*node.args, *(part for _, part in node.options))
    return sizes.get(node.name, 1) if node.op == "name" else 1 + sum(_size(part, sizes) for part in parts)


def _split(text: str) -> list[str]:
    """Split at commas outside parentheses."""
    parts, depth = [""], 0
    for letter in text:
        depth += (letter == "(") - (letter == ")")
        if letter == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += letter
    return parts
