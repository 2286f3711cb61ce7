"""Records of PSS/E files: words of a line, sections of a RAW file of version 33, truncation found by line."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ..case.case import CaseError
from ..case.errors import reason

SECTIONS = (
    "bus",
    "load",
    "fixed shunt",
    "generator",
    "branch",
    "transformer",
    "area",
    "two-terminal dc",
    "vsc dc",
    "impedance correction",
    "multi-terminal dc",
    "multi-section line",
    "zone",
    "inter-area transfer",
    "owner",
    "FACTS",
    "switched shunt",
    "GNE",
    "induction machine",
)
_WORD = re.compile(r"'[^']*'|,|/|[^,/\s']+")


@dataclass(frozen=True)
class Record:
    """One record: its fields as words, and where it stands."""

    fields: tuple[str, ...]
    where: str  #: file:line

    def text(self, k: int, what: str) -> str:
        """Return field `k`; CaseError when the record is too short."""
        if k >= len(self.fields):
            raise CaseError(
                f"{self.where}: {what} (field {k + 1}) is missing, {len(self.fields)} are there (truncated?)"
            )
        return self.fields[k]

    def number(self, k: int, what: str, default: float | None = None) -> float:
        """Return field `k` as a number; an empty or absent field gives `default`."""
        if default is not None and (k >= len(self.fields) or self.fields[k] == ""):
            return default
        word = self.text(k, what)
        try:
            value = float(word)
        except ValueError:
            raise CaseError(f"{self.where}: {what} (field {k + 1}) = {word!r}, allowed: a number") from None
        if not math.isfinite(value):
            raise CaseError(f"{self.where}: {what} (field {k + 1}) = {word!r}, allowed: a finite number")
        return value

    def whole(self, k: int, what: str, default: int | None = None) -> int:
        """Return field `k` as an integer."""
        value = self.number(k, what, default)
        if value != int(value):
            raise CaseError(f"{self.where}: {what} (field {k + 1}) = {value:g}, allowed: an integer")
        return int(value)

    def bus(self, k: int, what: str, kinds: Mapping[int, int], *, active: bool = True) -> int:
        """Return field `k` as the number of a bus in `kinds` (bus -> IDE), not isolated if `active`."""
        number = abs(self.whole(k, what))
        if number not in kinds:
            raise CaseError(f"{self.where}: {what} = {number}, allowed: a bus of this file")
        if active and kinds[number] == 4:
            raise CaseError(f"{self.where}: in service at bus {number}, which is isolated (IDE = 4)")
        return number


def split_fields(text: str) -> tuple[str, ...]:
    """Return the words of a record line: commas or blanks part them, quotes bind them, `/` ends it."""
    fields: list[str] = []
    after_comma = True
    for word in _WORD.findall(text):
        if word == "/":
            break
        if word != ",":
            fields.append(word.strip("'").strip())
        elif after_comma:
            fields.append("")
        after_comma = word == ","
    return tuple(fields)


def read_raw(path: Path) -> tuple[Record, dict[str, list[Record]]]:
    """Return header and records of each section of a RAW file; CaseError for another version."""
    try:
        lines = path.read_text(encoding="latin-1").splitlines()
    except OSError as error:
        raise CaseError(f"{path}: cannot be read: {reason(error)}") from None
    if not lines:
        raise CaseError(f"{path}:1: the file is empty, allowed: a PSS/E RAW file of version 33")
    header = Record(split_fields(lines[0]), f"{path}:1")
    version = header.whole(2, "version")
    if version != 33:
        raise CaseError(f"{path}:1: RAW version {version}, allowed: 33 (save the case as version 33)")
    sections: dict[str, list[Record]] = {section: [] for section in SECTIONS}
    k, section = 3, 0
    while k < len(lines) and section < len(SECTIONS):
        fields = split_fields(lines[k])
        first = fields[0] if fields else ""
        if first == "Q":
            return header, sections
        if first == "0" and len(fields) <= 1:
            section += 1
        elif fields:
            sections[SECTIONS[section]].append(Record(fields, f"{path}:{k + 1}"))
        k += 1
    if section < SECTIONS.index("area"):
        raise CaseError(
            f"{path}:{len(lines)}: the file ends inside the {SECTIONS[section]} data (truncated?)"
        )
    return header, sections
