"""The case: everything a study is told about a grid, checked once, frozen from then on.

A case file is TOML. Tables of rows are keyed by their id; `source` and `defaults` of a table
apply to all its rows:

    name = "my-grid"
    title = "..."
    frequency_hz = 60.0
    base_mva = 100.0
    solver_step_s = 0.002       # optional: longest Runge-Kutta step of the plant FMU
    swing = ["G2", "G4"]        # optional: machines whose speed difference a run is judged by
    devices = ["my_avr.toml"]   # optional: device files of one's own beside this one
    [branches]
    source = "Kundur1994, Ex. 12.6"
    "7-8 a" = { from = 7, to = 8, r = 0.011, x = 0.11, b = 0.1925 }
    [machines.defaults]
    base_mva = 900.0

A variant names its `base` and holds only `[change]` tables of the same form, merged row by row:
`defaults` there reach every row, a control whose `kind` changes is replaced as a whole, and the
word "none" in place of a row, a stabilizer or the tie takes it out.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence, Set
from functools import cached_property
from pathlib import Path
from typing import Any, Self, get_args

from pydantic import ValidationError, model_validator

from ..documents import DocumentError, parse_toml
from ..errors import CaseError, Collected, nearest, reason
from ..files import read_text, toml_files
from ..mistakes import meant, mistakes
from .checks import check_whole
from .cycles import in_seconds
from .device_files import devices_of, with_device_texts
from .event_targets import check_events
from .events import events_of
from .file_kind import other_kind
from .tables import CaseTables

__all__ = ["Case", "CaseError", "apply_change", "case_names", "case_of", "load_case", "merge", "nearest"]

#: table in the file -> field that holds the row's key
ROW_TABLES = {"buses": "number", "branches": "name", "shunts": "name", "loads": "name", "machines": "name"}


RESERVED = ("source", "defaults")  #: keys of a table of rows that are not ids

REMOVED = "none"  #: what stands in place of a row, a stabilizer, a tie that is taken out
BUNDLED = Path(__file__).resolve().parents[1] / "cases"  #: folder of the cases that come with the package


class Case(CaseTables):
    """A grid with its machines, controls and loads; rows keep the order of the file."""

    def __repr__(self) -> str:
        return f"Case({self.name!r}, {len(self.buses)} buses, {len(self.machines)} machines)"

    def __str__(self) -> str:
        return repr(self)

    @cached_property
    def hash(self) -> str:
        """Content hash (hex): changes with any name or number, not with titles and sources."""
        content = _without_words(self.model_dump(mode="json"))
        del content["swing"]  # how a run is judged, nothing that the grid does
        if self.solver_step_s is None:
            del content["solver_step_s"]
        if not self.devices:
            del content["devices"]
        text = json.dumps(content, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def document(self) -> dict[str, Any]:
        """Return the case in the form of its file: tables keyed by row id."""
        scalars = {"name", "title", "source", "frequency_hz", "base_mva", "solver_step_s", "tie", "event"}
        raw = {
            k: v
            for k, v in self.model_dump(by_alias=True, exclude_none=True).items()
            if k in scalars and v not in ("", ())
        }
        if self.devices:
            raw["devices"] = dict(self.devices)
        if self.swing is not None:
            raw["swing"] = list(self.swing)
        for table, key in ROW_TABLES.items():
            short = table != "machines"
            dumped = [
                row.model_dump(by_alias=True, exclude_none=True, exclude_defaults=short)
                for row in getattr(self, table)
            ]
            rows = {str(row.pop(key)): _without_empty(row) for row in dumped}
            raw[table] = ({"source": self.sources[table]} if table in self.sources else {}) | rows
        return raw

    def with_changes(self, change: Mapping[str, Any], *, name: str | None = None) -> Case:
        """Return this case with `change` merged in, tables as in the `[change]` of a variant file.

        >>> case = load_case("two-area-thesis")
        >>> case.with_changes({"branches": {"8-9 a": {"in_service": False}}}).branch("8-9 a").in_service
        False

        Raises
        ------
        CaseError : a key that does not exist, a value out of range, a network that falls apart.
        """
        where = f"{self.name} with changes"
        document = apply_change(self.document(), with_device_texts(change, Path(), where), where=where)
        document["name"] = name or self.name
        return case_of(document, where=where)

    @model_validator(mode="after")
    def _whole(self) -> Self:
        check_whole(self)
        check_events(self, self.events)
        return self


def case_names() -> list[str]:
    """Return the names of the bundled cases, sorted."""
    return list(toml_files(BUNDLED))


def load_case(name_or_path: str | Path) -> Case:
    """Load a bundled case by name, or a case file (a path that ends in .toml).

    >>> load_case("kundur-manual").frequency_hz
    60.0

    Raises
    ------
    CaseError : unknown name (with the nearest ones), unreadable file, or any rule of the case broken.
    """
    return case_of(_document(name_or_path, seen=()), where=str(name_or_path))


def case_of(document: Mapping[str, Any], *, where: str) -> Case:
    """Build a Case from a document in the form of a case file; `where` names it in errors.

    Files of devices are read from the current folder.
    """
    raw = {k: v for k, v in with_device_texts(document, Path(), where).items() if v != REMOVED}
    sources = dict(raw.get("sources", {}))
    for table, key in ROW_TABLES.items():
        rows, source = _rows(raw.get(table, {}), table, key, where)
        raw[table] = rows
        if source:
            sources[table] = source
    for row in raw["branches"]:
        _to_case_base(row, raw.get("base_mva"), where)
    raw["sources"] = sources
    hz, events = raw.get("frequency_hz"), raw.get("event", ())
    if isinstance(hz, int | float) and hz > 0.0:
        events = in_seconds({"event": events}, lambda: hz)["event"]
    own = devices_of(raw.get("devices", {}), where)
    raw["event"], found = (), Collected()
    with found:
        raw["event"] = events_of(events, where=where)
    with found:
        case = _checked(raw, own, where)
    found.end(CaseError)
    return case


def _checked(raw: dict[str, Any], own: Any, where: str) -> Case:
    try:
        return Case.model_validate(raw, context=own)
    except ValidationError as error:
        lines = mistakes(error, Case, path_of=lambda location: _path(location, raw))
        raise CaseError(*(f"{where}: {line}" for line in lines)) from None


def merge(base: Mapping[str, Any], change: Mapping[str, Any]) -> dict[str, Any]:
    """Return `base` with `change` merged in table by table.

    Values replace values; a table whose `kind` differs replaces the old one.
    """
    result = dict(base)
    for key, value in change.items():
        old = result.get(key)
        if isinstance(value, Mapping) and isinstance(old, Mapping):
            other_kind = "kind" in value and value["kind"] != old.get("kind", value["kind"])
            result[key] = dict(value) if other_kind else merge(old, value)
        else:
            result[key] = value
    return result


def apply_change(document: Mapping[str, Any], change: Mapping[str, Any], *, where: str) -> dict[str, Any]:
    """Return `document` with `change` merged in; the `defaults` of a changed table reach every row of it.

    Raises
    ------
    CaseError : a row that is not there, of which `change` does not give enough for a new one either.
    """
    wrong = [f"{where}: {line}" for line in _strangers(document, change)]
    if wrong:
        raise CaseError(*wrong)
    result = merge(document, change)
    for table in ROW_TABLES:
        part = change.get(table)
        if not isinstance(part, Mapping):
            continue
        every = part.get("defaults")
        if not isinstance(every, Mapping) or not isinstance(document.get(table), Mapping):
            continue
        for key, row in document[table].items():
            if key not in RESERVED and isinstance(row, Mapping):
                own = part.get(key, {})
                result[table][key] = merge(merge(row, every), own) if isinstance(own, Mapping) else own
    return result


def _strangers(document: Mapping[str, Any], change: Mapping[str, Any]) -> Iterator[str]:
    """Tell each row of `change` that `document` lacks and that is no whole row by itself: a name misspelt."""
    for table in ROW_TABLES:
        there, part = document.get(table, {}), change.get(table)
        if not isinstance(part, Mapping) or not isinstance(there, Mapping):
            continue
        known = [name for name in there if name not in RESERVED]
        given = {*there.get("defaults", {}), *part.get("defaults", {})}
        new = {name: row for name, row in part.items() if name not in {*there, *RESERVED}}
        for name, row in new.items():
            nearby = f"{table}.{name}: there is no {name!r} to change; {nearest(name, known)}"
            if row == REMOVED or (table == "buses" and name not in _ends(change)):
                yield nearby
            elif isinstance(row, Mapping) and (missing := _needed(table, {*given, *row})):
                yield f"{nearby} (a new one needs {', '.join(missing)})"


def _needed(table: str, given: Set[str]) -> list[str]:
    """Keys that every row of a table has, but for its id and those that are `given`."""
    row = get_args(Case.model_fields[table].annotation)[0]
    needed = [field.alias or name for name, field in row.model_fields.items() if field.is_required()]
    return [key for key in needed if key != ROW_TABLES[table] and key not in given]


def _ends(change: Mapping[str, Any]) -> set[str]:
    """Buses that the branches of a change lead to: a new bus is one of them."""
    branches = change.get("branches")
    rows = branches.values() if isinstance(branches, Mapping) else ()
    return {str(row.get(end)) for row in rows if isinstance(row, Mapping) for end in ("from", "to")}


def _document(name_or_path: str | Path, seen: tuple[str, ...], beside: Path | None = None) -> dict[str, Any]:
    text, where, folder = _text(name_or_path, beside)
    try:
        raw = parse_toml(text)
    except DocumentError as error:
        raise CaseError(f"{where}: {error}") from None
    raw = with_device_texts(raw, folder or BUNDLED, where)
    other = other_kind(raw, "case")
    if other is not None:
        raise CaseError(f"{where}: {other}")
    if "base" not in raw:
        return raw
    if where in seen:
        raise CaseError(f"{where}: base = {raw['base']!r} leads back to the case itself")
    keys = ("base", "change", "name", "title", "source")
    extra = sorted(set(raw) - set(keys))
    if extra:
        inside = extra[0] in Case.model_fields or extra[0] == "event"
        hint = "" if inside else f"; {meant(extra[0], keys)}"
        raise CaseError(
            f"{where}: {extra[0]} stands outside [change]; a variant holds {', '.join(keys)}{hint}"
        )
    base = _document(raw["base"], (*seen, where), folder)
    change = with_device_texts(raw.get("change", {}), folder or BUNDLED, where)
    changed = apply_change(base, change, where=where)
    return changed | {k: raw[k] for k in ("name", "title", "source") if k in raw}


def _text(name_or_path: str | Path, beside: Path | None) -> tuple[str, str, Path | None]:
    name = str(name_or_path)
    if name.endswith(".toml"):
        path = Path(name) if beside is None else beside / name
        try:
            return path.read_text(encoding="utf-8"), str(path), path.parent
        except (OSError, UnicodeDecodeError) as error:
            raise CaseError(f"{path}: the case file cannot be read: {reason(error)}") from None
    known = case_names()
    if name not in known:
        hint = "(or give the path of a .toml file)"
        there = Path(name).exists()
        what = f"{name}: is no .toml file, so no case" if there else f"case {name!r} does not exist"
        raise CaseError(f"{what}; {nearest(name, known)} {hint}")
    return read_text(toml_files(BUNDLED)[name]), name, None


def _rows(table: Any, name: str, key: str, where: str) -> tuple[list[dict[str, Any]], str]:
    if not isinstance(table, Mapping):
        raise CaseError(f"{where}: {name} must be a table keyed by {key}, got {type(table).__name__}")
    defaults = table.get("defaults", {})
    rows: list[dict[str, Any]] = []
    for identity, row in table.items():
        if identity in RESERVED or row == REMOVED:
            continue
        if not isinstance(row, Mapping):
            raise CaseError(f"{where}: {name}.{identity} = {row!r}, allowed: a table with the row's values")
        whole = {k: v for k, v in merge(defaults, row).items() if v != REMOVED}
        rows.append({key: _number(identity, f"{where}: {name}") if key == "number" else identity, **whole})
    source = table.get("source", "")
    if not isinstance(source, str):
        raise CaseError(f"{where}: {name}.source = {source!r}, allowed: a string such as 'KEY, Table n'")
    return rows, source


def _number(text: str, what: str) -> int:
    if not text.isdecimal():
        raise CaseError(f"{what}.{text}: a bus is named by its number, allowed: 1, 2, ...")
    return int(text)


def _to_case_base(row: dict[str, Any], case_base: Any, where: str) -> None:
    own = row.pop("base_mva", None)
    if own is None:
        return
    for value in (own, case_base):
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < math.inf:
            raise CaseError(f"{where}: branches.{row['name']}.base_mva = {own!r}, allowed: a number above 0")
    for key, factor in (("r", case_base / own), ("x", case_base / own), ("b", own / case_base)):
        if isinstance(row.get(key), int | float):
            row[key] = row[key] * factor


def _path(location: Sequence[int | str], raw: Mapping[str, Any]) -> list[str]:
    path: list[str] = []
    for part in location:
        if path and path[-1] in ROW_TABLES and isinstance(part, int):
            path.append(str(raw[path[-1]][part][ROW_TABLES[path[-1]]]))
        elif part not in _KINDS:
            path.append(str(part))
    return path


_KINDS = {"none", "float", "int", "str"}  # parts of a location that are no keys
_WORDS = {"source", "sources", "title"}


def _without_words(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _without_words(v) for k, v in value.items() if k not in _WORDS}
    return [_without_words(v) for v in value] if isinstance(value, list) else value


def _without_empty(row: dict[str, Any]) -> dict[str, Any]:
    kept = {k: v for k, v in row.items() if not (k in ("source", "name") and v == "")}
    return {k: _without_empty(v) if isinstance(v, dict) else v for k, v in kept.items()}
