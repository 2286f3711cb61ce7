"""A RAW file cut into its sections; records are made of the lines when they are asked for."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from enum import Enum, auto
from pathlib import Path
from typing import NamedTuple

from ...errors import CaseError
from .layouts import fields, layout_of, sections
from .record import Record
from .text import read_lines, split_words

Line = tuple[int, str]  #: number in the file, text
Group = tuple[Line, ...]  #: the lines of one record

#: sections without which a file is cut off rather than short
_NEEDED = ("bus", "load", "fixed shunt", "generator", "branch", "switching device", "transformer")
_IGNORED = frozenset(
    [
        *(
            "area",
            "multi-section line",
            "zone",
            "inter-area transfer",
            "owner",
            "voltage droop",
            "rating set",
        ),
        *("load type", "interface", "interface element"),
    ]
)
#: fields of the longest record of any version, owners included; two on one line have more
_MOST = {"bus": 15, "load": 20, "fixed shunt": 6, "generator": 32, "branch": 24, "long branch": 36}
_LINES = {"two-terminal dc": 3, "VSC dc": 3}
_SECOND_QUOTED = re.compile(r"\s*[^,\s'\"]+\s*[,\s]\s*['\"]")
_ZERO = re.compile(r"\s*(?:0|'0\s*'|\"0\s*\")\s*(?:$|[,/\s])")


@dataclass
class RawFile:
    """A RAW file: what its first line says, and the lines of each section.

    version : layout by which it is read. revision : what the header says, None when it says nothing.
    notes : what was assumed about the file as a whole.
    """

    path: Path
    base_mva: float
    frequency_hz: float | None
    revision: int | None
    version: int
    system: dict[str, float]  #: system-wide values, upper case
    groups: dict[str, list[Group]] = field(repr=False)
    notes: list[str] = field(default_factory=list)
    #: section that plays no part -> number of its records, line of the first
    aside: dict[str, tuple[int, int]] = field(default_factory=dict)

    def records(self, section: str) -> Iterator[Record]:
        """Yield the records of `section`; further lines of a record are its parts, without names."""
        groups = self.groups.get(section, [])
        if not groups:
            return
        position = fields(section, self.version)
        most = _MOST.get("long branch" if section == "branch" and self.version >= 34 else section)
        for (number, text), *rest in groups:
            where = f"{self.path}:{number}"
            parts = tuple(self.record(section, line, {}) for line in rest)
            record = Record(section, split_words(text, where), where, position, parts)
            if most is not None and len(record.words) > most:
                raise record.refused(f"{len(record.words)} fields, allowed: {most} (are two on one line?)")
            yield record

    def record(self, kind: str, line: Line, position: dict[str, int] | None = None) -> Record:
        """Return `line` as a record of `kind`."""
        where = f"{self.path}:{line[0]}"
        names = fields(kind, self.version) if position is None else position
        return Record(kind, split_words(line[1], where), where, names)

    def part(self, record: Record, k: int, kind: str) -> Record:
        """Return part `k` of `record` under the names of `kind`."""
        plain = record.parts[k]
        return Record(kind, plain.words, plain.where, fields(kind, self.version))


def read_raw(path: Path) -> RawFile:
    """Cut the RAW file `path` (plain, gzip or xz) into sections.

    Raises
    ------
    CaseError : unreadable, no RAW file, change cases (IC = 1), cut off inside the network data, extended
        bus names.
    """
    numbered = list(enumerate(read_lines(path), 1))
    lines = [line for line in numbered if line[1].lstrip()[:2] not in ("@!", "//")]
    if not any(text.strip() for _, text in lines):
        raise CaseError(f"{path}:1: the file is empty, allowed: a PSS/E RAW file")
    first, text = lines[0]
    head = _Head.read(split_words(text, f"{path}:{first}"), f"{path}:{first}")
    body = lines[3:]
    named = "\n".join(text.upper() for _, text in body if text.lstrip()[:1] in "0'\"" and _ZERO.match(text))
    number, text = _first_bus(path, body)
    quoted = _SECOND_QUOTED.match(text) is not None
    version, note = layout_of(head.revision, split_words(text, f"{path}:{number}"), quoted, named)
    raw = RawFile(path, head.base_mva, head.frequency_hz, head.revision, version, {}, {})
    raw.notes += [f"{path}:{first}: {note}"] if note else []
    remark = next((number for number, text in numbered if text.lstrip()[:2] == "//"), None)
    raw.notes += [f"{path}:{remark}: a line that begins with // treated as comment"] if remark else []
    _cut(raw, body)
    raw.system = _system_wide(raw)
    return raw


class _Head(NamedTuple):
    """What the first line of a file says."""

    base_mva: float
    revision: int | None
    frequency_hz: float | None

    @classmethod
    def read(cls, words: tuple[str, ...], where: str) -> _Head:
        fields = {"IC": 0, "SBASE": 1, "REV": 2, "XFRRAT": 3, "NXFRAT": 4, "BASFRQ": 5}
        head = Record("header", words, where, fields)
        if head.whole("IC", 0) != 0:
            raise head.wrong("IC", head.text("IC"), "0 (a change case holds changes only)")
        base = head.number("SBASE", 100.0)
        if not base > 0.0:
            raise head.wrong("SBASE", f"{base:g}", "above 0 MVA")
        revision = head.whole("REV") if head.has("REV") else None
        frequency = head.number("BASFRQ", 0.0)
        if not frequency >= 0.0:
            raise head.wrong("BASFRQ", f"{frequency:g}", "above 0 Hz")
        return cls(base, revision, frequency or None)


def _system_wide(raw: RawFile) -> dict[str, float]:
    """The numbers of the system-wide section, by upper-case name."""
    system_wide: dict[str, float] = {}
    for _, text in (line for group in raw.groups.get("system-wide", []) for line in group):
        for name, value in re.findall(r"(\w+)\s*=\s*([-+.\deEdD]+)", text):
            with suppress(ValueError):
                system_wide[name.upper()] = float(value)
    return system_wide


def _first_bus(path: Path, body: list[Line]) -> Line:
    for line in body:
        word = line[1].lstrip()[:1]
        if not word or word.isalpha():  # empty, or a keyword of the system-wide data
            continue
        if _ZERO.match(line[1]):
            if "SYSTEM" in line[1].upper():
                continue
            break
        return line
    number = body[0][0] if body else 1
    raise CaseError(
        f"{path}:{number}: no bus record after the three lines of the header, allowed: a RAW file"
    )


def _cut(raw: RawFile, body: list[Line]) -> None:
    order = list(sections(raw.version))
    if order[0] == "system-wide" and not _has_system(body):
        order.pop(0)
    k = 0
    for section in order:
        start, groups = k, []
        k, end = _next_text(body, k)
        while end is _End.NONE:
            count = _span(raw, section, body, k)
            if section in _IGNORED:
                first = raw.aside.get(section, (0, body[k][0]))
                raw.aside[section] = (first[0] + 1, first[1])
            else:
                groups.append(_take(raw, section, body, k, count))
            k, end = _next_text(body, k + count)
        if groups:
            raw.groups[section] = raw.groups.get(section, []) + groups
        if end is _End.SECTION:
            split_words(body[k][1], f"{raw.path}:{body[k][0]}")  # refuses a record in its comment
        if end is _End.FILE and k > start and section in _NEEDED:
            raise CaseError(
                f"{raw.path}:{body[-1][0]}: the file ends inside the {section} data, allowed: a line with 0 "
                "after its last record (cut off?)"
            )
        if end is _End.QUIT:
            _left_behind(raw, body[k + 1 :], "the Q that ends the data")
            return
        k += end is _End.SECTION
    _left_behind(raw, body[k:], f"the last section of version {raw.version}")


def _left_behind(raw: RawFile, lines: list[Line], after: str) -> None:
    """Note what stands where no section is, but for blank lines and a Q."""
    rest = [line for line in lines if line[1].strip() and line[1].strip()[:1] not in "Qq"]
    if rest:
        raw.notes.append(f"{raw.path}:{rest[0][0]}: {len(rest)} lines after {after} ignored")


class _End(Enum):
    """What a line closes: nothing (it is a record), a section (0), all data (Q); or the file ends."""

    NONE = auto()
    SECTION = auto()
    QUIT = auto()
    FILE = auto()


def _next_text(body: list[Line], k: int) -> tuple[int, _End]:
    """The next line from `k` on that is not empty, and what it closes."""
    while k < len(body):
        text = body[k][1]
        stripped = text.strip()
        if _ZERO.match(text):
            return k, _End.SECTION
        if stripped[:1] in ("Q", "q") and stripped[1:2] in ("", " ", ",", "/"):
            return k, _End.QUIT
        if stripped:
            return k, _End.NONE
        k += 1
    return k, _End.FILE


def _has_system(body: list[Line]) -> bool:
    for _, text in body:
        if text.strip():
            return text.lstrip()[:1].isalpha() or (
                _ZERO.match(text) is not None and "BUS" in text.upper().partition("BEGIN")[2]
            )
    return False


def _take(raw: RawFile, section: str, body: list[Line], k: int, count: int) -> Group:
    """The lines of one record, empty ones between them left out."""
    group = [line for line in body[k : k + count] if line[1].strip()]
    if len(body) < k + count:
        raise CaseError(
            f"{raw.path}:{body[-1][0]}: the file ends inside the {section} record of line {body[k][0]} "
            "(cut off?)"
        )
    return tuple(group)


def _span(raw: RawFile, section: str, body: list[Line], k: int) -> int:
    """The number of lines, from `k`, of the record that begins there."""
    count = _LINES.get(section, 1)
    if section == "transformer":
        head = raw.record("transformer", body[k])
        count = 4 if head.bus("K", 0) == 0 else 5
    elif section == "multi-terminal dc":
        head = raw.record("multi-terminal dc", body[k])
        count = 1 + sum(max(head.whole(name, 0), 0) for name in ("NCONV", "NDCBS", "NDCLN"))
    elif section == "impedance correction" and raw.version >= 34:
        count = _table_lines(raw, body, k)
    elif section == "GNE":
        count = _gne_lines(raw, body, k)
    elif section == "substation":
        return _substation_lines(raw, body, k)
    if count == 1:
        return 1
    at = k
    while count > 0 and at < len(body):
        count -= bool(body[at][1].strip())
        at += 1
    return at - k + count


def _table_lines(raw: RawFile, body: list[Line], k: int) -> int:
    """A correction table of version 34 on: six triples a line until a triple of zeros or a short line."""
    count = 0
    for at in range(k, len(body)):
        words = split_words(body[at][1], f"{raw.path}:{body[at][0]}")
        values = words[1:] if count == 0 else words
        count += 1
        if len(values) < 18 or all(_zero(word) for word in values[-3:]):
            break
        if at + 1 < len(body) and _ZERO.match(body[at + 1][1]) and "END" in body[at + 1][1].upper():
            break
    return count


def _zero(word: str) -> bool:
    return word.strip("+-0.eEdD") == ""


def _gne_lines(raw: RawFile, body: list[Line], k: int) -> int:
    head = raw.record("GNE", body[k], {})
    names = {"NTERM": 2}
    ends = Record("GNE", head.words, head.where, names).whole("NTERM", 1)
    first = 3 + ends if raw.version >= 34 else len(head.words) - 6
    names = {"NREAL": first, "NINTG": first + 1, "NCHAR": first + 2}
    counted = Record("GNE", head.words, head.where, names)
    numbers = [max(counted.whole(name, 0), 0) for name in names]
    return (2 if raw.version >= 34 else 1) + sum(-(-n // 10) for n in numbers)


def _substation_lines(raw: RawFile, body: list[Line], k: int) -> int:
    """A station with its nodes, switches and terminals, each list closed by a zero of its own."""
    zeros = 0
    for at in range(k + 1, len(body)):
        zeros += _ZERO.match(body[at][1]) is not None
        if zeros == 3:
            return at + 1 - k
    return len(body) - k
