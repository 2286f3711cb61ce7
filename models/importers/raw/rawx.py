"""RAWX, the JSON form of RAW (version 35): its tables as the sections of a RAW file.

Each row becomes the lines that RAW 35 would have, so one reader makes the grid of both and says the same of
both; the places it names are the lines of the rows.
"""

from __future__ import annotations

import functools
import json
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from ...documents import DocumentError, unique_keys
from ...errors import CaseError
from .file import Group, RawFile
from .layouts import fields
from .text import read_lines

VERSION = 35
#: section -> table, and what the table calls the fields that it does not call as RAW does
_SECTIONS: dict[str, tuple[str, dict[str, str]]] = {
    "bus": ("bus", {}),
    "load": ("load", {"ID": "loadid", "STATUS": "stat"}),
    "fixed shunt": ("fixshunt", {"ID": "shntid", "STATUS": "stat"}),
    "generator": ("generator", {"ID": "machid"}),
    "branch": ("acline", {"R": "rpu", "X": "xpu", "B": "bpu", "ST": "stat"}),
    "switching device": ("sysswd", {"X": "xpu"}),
    "transformer": ("transformer", {"NMETR": "nmet"}),
    "two-terminal dc": ("twotermdc", {"METER": "met"}),
    "VSC dc": ("vscdc", {}),
    "FACTS": ("facts", {}),
    "switched shunt": ("swshunt", {"ID": "shntid", "SWREM": "swreg"}),
    "induction machine": ("indmach", {"ID": "imid", "SC": "scode", "DC": "dcode", "PC": "pcode"}),
}
_MOTOR = {"H": "hconst", "A": "aconst", "B": "bconst", "D": "dconst", "E": "econst"}
_SECTIONS["induction machine"][1].update(_MOTOR)
_ENDS = {"I": "ibus", "J": "jbus", "K": "kbus"}
#: tables that play no part in a power flow: buses are the joined nodes of substations already
_ASIDE = (
    *("area", "zone", "owner", "iatrans", "iatransfer", "msline", "rating"),
    *("sub", "subnode", "subswd", "subterm"),
)
_SETTINGS = ("caseid", "general", "gauss", "newton", "adjust", "tysl", "solver")
#: fields of RAWX in later releases than the layout here, which play no part in a power flow
_FURTHER = {"bp", "name", "mname", "droopname", "rsetnam", "fcreg", "nreg", "tcode", "bcode"}
_CORRECTIONS, _POINT = "impcor", ("itable", "tap", "refact", "imfact")
_READ = {table for table, _ in _SECTIONS.values()} | {_CORRECTIONS}
_LARGEST = sys.float_info.max
_Row = tuple[int, Mapping[str, Any]]  #: line, values by lower-case name


def read_rawx(path: Path) -> RawFile:
    """Return the RAWX file `path` (plain, gzip, xz or bzip2) as the RAW file of the same content.

    Raises
    ------
    CaseError : unreadable, no JSON of this form, a change case, or rows of a table that is not read; with
        file and line.
    """
    text = "\n".join(read_lines(path))
    tables = _tables(path, text)
    raw = _empty(path, tables)
    for table, rows in tables.items():
        if table in _ASIDE and rows:
            raw.aside[table] = (len(rows), rows[0][0])
        elif rows and table not in _READ and table not in _SETTINGS:
            where = f"{path}:{rows[0][0]}"
            raise CaseError(f"{where}: RAWX table {table!r} is not read, allowed: empty; write a .raw")
    for section, (table, _) in _SECTIONS.items():
        groups = [_group(section, row) for row in tables.get(table, [])]
        if groups:
            raw.groups[section] = groups
    if tables.get(_CORRECTIONS):
        raw.groups["impedance correction"] = _corrections(tables[_CORRECTIONS])
    for table in tables:
        if table in _READ and tables[table]:
            raw.notes += _left_aside(path, text, table, tables[table][0][1])
    return raw


def _empty(path: Path, tables: Mapping[str, list[_Row]]) -> RawFile:
    """A RAW file of these settings without any record."""
    head = _single(tables, "caseid")
    if _number(path, head, "ic", 0.0) != 0.0:
        raise CaseError(f"{path}: caseid: ic = {head['ic']!r}, allowed: 0 (a change case holds changes only)")
    base, frequency = _number(path, head, "sbase", 100.0), _number(path, head, "basfrq", 0.0)
    if not (base > 0.0 and frequency >= 0.0):
        raise CaseError(f"{path}: caseid: sbase = {base:g}, basfrq = {frequency:g}, allowed: above 0")
    if not tables.get("bus"):
        raise CaseError(f"{path}: no rows in the table bus, allowed: at least one")
    general = {name.upper(): value for name, value in _single(tables, "general").items()}
    system = {name: float(value) for name, value in general.items() if _is_number(value)}
    return RawFile(
        path, base, frequency or None, int(_number(path, head, "rev", VERSION)), VERSION, system, {}
    )


def is_rawx(path: Path) -> bool:
    """Return whether a name is that of a RAWX file, packed or not."""
    return ".rawx" in [suffix.lower() for suffix in path.suffixes[-2:]]


def _single(tables: Mapping[str, list[_Row]], table: str) -> Mapping[str, Any]:
    rows = tables.get(table, [])
    return rows[0][1] if rows else {}


def _number(path: Path, row: Mapping[str, Any], name: str, default: float) -> float:
    value = row.get(name)
    if value is None:
        return default
    if not _is_number(value):
        raise CaseError(f"{path}: caseid: {name} = {str(value)[:40]!r}, allowed: a number")
    return float(value)


def _is_number(value: Any) -> bool:
    """Whether a value of JSON is a number that a double can be."""
    return not isinstance(value, bool) and isinstance(value, int | float) and abs(value) <= _LARGEST


def _group(section: str, row: _Row) -> Group:
    """The lines of RAW 35 that a row is."""
    number, values = row
    parts = _parts(section)
    if section == "transformer" and not values.get("kbus"):
        parts = parts[:-1]  # no third winding
    return tuple((number, _line(names, values, other)) for names, other in parts)


@functools.cache
def _parts(section: str) -> tuple[tuple[Mapping[str, int], Mapping[str, str]], ...]:
    """For each line of a record of RAW 35 its fields, and what RAWX calls those that it names otherwise."""
    parts = [(fields(section, VERSION), _ENDS | _SECTIONS[section][1])]
    if section == "transformer":
        names = fields("transformer impedance", VERSION)
        parts.append((names, {name: name.lower().replace("-", "_") for name in names}))
        names = fields("transformer winding", VERSION)
        for k in "123":
            own = {name: f"wdg{k}{name.lower()}" for name in names if name.startswith("RATE")}
            parts.append((names, {name: f"{name.lower()}{k}" for name in names} | own | {"NOD": f"node{k}"}))
    elif section in ("two-terminal dc", "VSC dc"):
        part, ends = ("dc converter", "ri") if section == "two-terminal dc" else ("VSC converter", "12")
        names = fields(part, VERSION)
        for end in ends:
            own = {name: f"{name.lower()}{end}" for name in names}
            parts.append((names, own | ({"REMOT": f"vsreg{end}"} if section == "VSC dc" else {})))
    return tuple(parts)


def _corrections(rows: list[_Row]) -> list[Group]:
    """Tables of impedance correction, a row a point, each as the line of RAW 35."""
    points: dict[str, list[str]] = {}
    lines: dict[str, int] = {}
    for line, values in rows:
        number = _word(values.get("itable"))
        lines.setdefault(number, line)
        points.setdefault(number, []).extend(_word(values.get(name)) for name in _POINT[1:])
    return [((lines[number], ",".join([number, *words])),) for number, words in points.items()]


def _left_aside(path: Path, text: str, table: str, names: Iterable[str]) -> Iterator[str]:
    """Yield a note for each field of a table that no record of RAW 35 has."""
    section = next((section for section, (name, _) in _SECTIONS.items() if name == table), None)
    parts = _parts(section) if section else ()
    known = {other.get(name, name.lower()) for fields_, other in parts for name in fields_} or {*_POINT}
    for name in (name for name in names if name not in known | _FURTHER):
        begin = _begin(text, table)
        field = re.compile(f'"{re.escape(name)}"', re.IGNORECASE).search(text, begin)
        line = text.count("\n", 0, field.start() if field else begin) + 1
        near = get_close_matches(name, sorted(known - {*names}), 3, 0.5)
        hint = f"; did you mean {' or '.join(near)}?" if near else ""
        yield f"{path}:{line}: field {name!r} of {table}, which RAW {VERSION} does not have, ignored{hint}"


def _line(names: Mapping[str, int], values: Mapping[str, Any], other: Mapping[str, str]) -> str:
    return ",".join(_word(values.get(other.get(name, name.lower()))) for name in names)


def _word(value: Any) -> str:
    if value is None:
        return ""
    return "'" + value.replace("'", " ") + "'" if isinstance(value, str) else repr(value)


def _tables(path: Path, text: str) -> dict[str, list[_Row]]:
    """The rows of every table, each with its line."""
    try:
        network = json.loads(text, object_pairs_hook=unique_keys)["network"]
        named = {table: _names(path, table, content["fields"]) for table, content in network.items()}
        missing = next((table for table in named if not isinstance(network[table].get("data"), list)), None)
    except json.JSONDecodeError as error:
        raise CaseError(f"{path}:{error.lineno}: no JSON: {error.msg}; allowed: a RAWX file") from None
    except DocumentError as error:
        raise CaseError(f"{path}: {error}, allowed: once") from None
    except (TypeError, KeyError, AttributeError, RecursionError):
        allowed = '{"network": {TABLE: {"fields": [..], "data": [..]}}}'
        raise CaseError(f"{path}: no tables of a grid; allowed: {allowed}") from None
    except ValueError as error:  # an integer of thousands of digits
        raise CaseError(f"{path}: no number: {str(error).partition(';')[0]}") from None
    if missing is not None:
        raise CaseError(f"{path}: RAWX table {missing!r} has no data, allowed: a list")
    return {table.lower(): list(_rows(path, text, table, names)) for table, names in named.items()}


def _names(path: Path, table: str, names: list[Any]) -> list[str]:
    """The fields of a table in lower case, each a text and once."""
    lower = [name.lower() if isinstance(name, str) else name for name in names]
    if wrong := [n for k, n in enumerate(lower) if not isinstance(n, str) or n in lower[:k]]:
        raise CaseError(f"{path}: fields of {table}: {wrong[0]!r}, allowed: texts, each once")
    return lower


def _begin(text: str, table: str) -> int:
    """Where the table begins in the text."""
    match = re.search(rf'"{re.escape(table)}"\s*:\s*{{', text, re.IGNORECASE)
    return match.end() if match else 0


def _rows(path: Path, text: str, table: str, names: list[str]) -> Iterator[_Row]:
    """Yield the rows of a table: lists in a list, or one list of values."""
    data = re.compile(r'"data"\s*:\s*\[').search(text, _begin(text, table))
    if data is None:  # written with escapes
        raise CaseError(f"{path}: RAWX table {table!r} has no data, allowed: a list")
    decoder, blank, at = json.JSONDecoder(), re.compile(r"[\s,]*"), data.end()
    flat: list[Any] = []
    first = text.count("\n", 0, data.end()) + 1
    while True:
        at = blank.match(text, at).end()  # type: ignore[union-attr]
        if text[at] == "]":
            break
        line = text.count("\n", 0, at) + 1
        row, at = decoder.raw_decode(text, at)
        if isinstance(row, list):
            yield line, _values(f"{path}:{line}", table, names, row)
        else:
            flat.append(row)
    if flat:
        yield first, _values(f"{path}:{first}", table, names, flat)


def _values(where: str, table: str, names: list[str], row: list[Any]) -> Mapping[str, Any]:
    if table.lower() not in _READ:
        return dict(zip(names, row, strict=False))
    if len(row) != len(names):
        raise CaseError(
            f"{where}: {table} row of {len(row)} values, allowed: {len(names)}, {' '.join(names)}"
        )
    if any(isinstance(value, list | dict) for value in row):
        raise CaseError(f"{where}: {table} row holds a list, allowed: numbers and texts")
    return dict(zip(names, row, strict=True))
