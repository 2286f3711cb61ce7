"""Read a device file: limits first, then TOML, then every line checked against the others."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ...documents import DocumentError, parse_toml, require_regular
from ...errors import DeviceError, nearest, reason
from .device import BASES, KINDS, Check, Computed, Device, DyrModel, Line
from .diagram import Diagram
from .expression import COMPARISONS, NAME, Node, parse
from .parameters import read_parameters
from .source import Source

LARGEST_FILE, MOST_STATES = 65536, 40
_KEYS = {
    "name", "kind", "title", "sources", "oracle", "notes", "references", "diagram", "dyr", "computed",
    "parameters", "check",
}  # fmt: skip


def read_device(path: str | Path) -> Device:
    """Return the device of a file.

    Raises
    ------
    DeviceError : the file cannot be read, or is wrong anywhere.
    """
    return device_of(device_text(path), str(path))


def device_text(path: str | Path) -> str:
    """Return what a device file holds; DeviceError : it cannot be read, or is too long."""
    require_regular(Path(path), "the TOML file of a device", DeviceError)
    try:
        with Path(path).open("rb") as file:
            raw = file.read(LARGEST_FILE + 1)
    except OSError as error:
        raise DeviceError(f"{path}: the device file cannot be read: {reason(error)}") from None
    if len(raw) > LARGEST_FILE:
        raise DeviceError(f"{path}: longer than {LARGEST_FILE} bytes, allowed: at most that")
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
        raise DeviceError(f"{file}: longer than {LARGEST_FILE} bytes, allowed: at most that")
    try:
        raw = parse_toml(text)
    except DocumentError as error:
        raise DeviceError(f"{file}: {error}") from None
    return _Reader(raw, text, file).device()


class _Reader(Source):
    """One file while it is read."""

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
        self.parameters = read_parameters(self, kind, self.references)
        self.constants = frozenset(self.parameters) | {*BASES}
        lines = Diagram(self, kind, self.constants, self.references).lines()
        at_rest = self.constants | {*self.kind.inputs, self.kind.output, *self.kind.also}
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

    def expression(self, text: Any, section: str, known: frozenset[str] | set[str]) -> Node:
        where = f"{self.file}:{self.line_of(str(text), section) or self.line_of(section)}"
        if isinstance(text, bool) or not isinstance(text, str | int | float):
            raise DeviceError(f"{where}: [{section}] {str(text)[:40]!r}, allowed: an expression as a text")
        node = parse(str(text), where)
        for name in node.names:
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

    def read_computed(self, known: frozenset[str] | set[str]) -> dict[str, Computed]:
        sections = {}
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
            sections[name] = Computed(when, self.expression(row["value"], "computed", known))
        return sections

    def read_check(self, text: str, remedy: Any) -> Check:
        node = self.expression(text, "check", self.constants)
        if not isinstance(remedy, str) or node.op not in COMPARISONS:
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
        assigned = self.read_assigned(model, tail, self.constants | set(fields), line)
        named = [name for name in fields if name != "0" and not name.startswith(("-", "0:"))]
        known = {*self.parameters, *(n for node in assigned.values() for n in node.names)}
        for name in named:
            if name not in known:
                raise self.fail(
                    f"dyr.{model}: {name[:40]} is no parameter, {nearest(name[:40], self.parameters)}", line
                )
        if len(set(named)) != len(named):
            raise self.fail(f"dyr.{model}: a field is named twice", line)
        return DyrModel(model, fields, tuple(assigned.items()))

    def read_assigned(self, model: str, text: str, known: frozenset[str], line: int) -> dict[str, Node]:
        """What stands behind the fields of a record: parameters that follow from them."""
        assigned: dict[str, Node] = {}
        for part in filter(None, (p.strip() for p in _split(text))):
            name, sign, value = part.partition("=")
            if not sign or name.strip() not in self.parameters:
                raise self.fail(f"dyr.{model}: {part[:40]!r}, allowed: PARAMETER = value", line)
            assigned[name.strip()] = self.expression(value.strip(), "dyr", known)
        return assigned

    def check_use(self, lines: tuple[Line, ...], others: list[Node]) -> None:
        used = {name for line in lines for name in line.node.names} | {self.kind.output, *self.kind.also}
        for line in lines:
            if line.name not in used:
                raise self.fail(f"the signal {line.name} is not used; use it or remove its line", line.number)
        used |= {name for node in others for name in node.names} | {*self.kind.of_port}
        for name in (*self.parameters, *self.references):
            if name not in used:
                where = self.line_of(name, "parameters")
                raise self.fail(f"{name} is not used; use it or remove it", where)
        states = sum(bool(line.element) + (line.element == "filter2") for line in lines)
        if states > MOST_STATES:
            raise self.fail(f"{states} states, allowed: {MOST_STATES}")


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
