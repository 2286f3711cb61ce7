"""The case: everything a study knows about a grid, checked once, frozen from then on.

A case file is TOML. Tables of rows are keyed by their id; `source` and `defaults` of a table
apply to all its rows:

    name = "my-grid"
    title = "..."
    frequency_hz = 60.0
    base_mva = 100.0
    solver_step_s = 0.002       # optional: longest Runge-Kutta step of the plant FMU
    swing = ["G2", "G4"]        # optional: machines whose speed difference a run is judged by
    devices = ["my_avr.toml"]   # optional: user-defined device files beside this one
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
from collections.abc import Mapping, Sequence
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, Self

from pydantic import ValidationError, model_validator

from ..devices.language.structure import Model
from ..devices.library import own_models
from ..documents import in_seconds
from ..errors import CaseError, Collected, DeviceError, nearest
from ..mistakes import mistakes
from .checks import check_events, check_whole
from .document import (
    LATER_TABLES,
    REMOVED,
    ROW_TABLES,
    apply_change,
    case_document,
    case_names,
    rows_of,
    with_device_texts,
)
from .events import events_of
from .tables import CaseTables

__all__ = ["Case", "CaseError", "case_names", "case_of", "devices_of", "load_case", "nearest"]

_DEVICES = 'allowed: a list of device files such as ["my_avr.toml"], or a table of what they hold by name'


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
        for late in ("devices", *LATER_TABLES):
            if not content[late]:
                del content[late]
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
            if table in LATER_TABLES and not getattr(self, table):
                continue
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


def load_case(name_or_path: str | Path) -> Case:
    """Load a bundled case by name, or a case file (a path that ends in .toml).

    >>> load_case("kundur-manual").frequency_hz
    60.0

    Raises
    ------
    CaseError : unknown name (with the nearest ones), unreadable file, or any rule of the case broken.
    """
    name = str(name_or_path)
    return case_of(case_document(name), where=name) if name.endswith(".toml") else _bundled_case(name)


@lru_cache(maxsize=16)
def _bundled_case(name: str) -> Case:
    """Return a bundled case, read once in a process: nobody changes its file, and a case is frozen."""
    return case_of(case_document(name), where=name)


def case_of(document: Mapping[str, Any], *, where: str) -> Case:
    """Build a Case from a document in the form of a case file; `where` names it in errors.

    Files of devices are read from the current folder.
    """
    raw = {k: v for k, v in with_device_texts(document, Path(), where).items() if v != REMOVED}
    sources = dict(raw.get("sources", {}))
    for table, key in ROW_TABLES.items():
        rows, source = rows_of(raw.get(table, {}), table, key, where)
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
    raw["event"], collected = (), Collected()
    with collected:
        raw["event"] = events_of(events, where=where)
    with collected:
        case = _checked(raw, own, where)
    collected.end(CaseError)
    return case


def devices_of(texts: Any, where: str) -> Mapping[str, Model]:
    """Return the devices of a case by key; `texts`: its entry `devices`, `where` names the case in errors.

    Raises
    ------
    CaseError : not such an entry, or a device file that is wrong.
    """
    held = isinstance(texts, Mapping) and all(isinstance(v, str) for kv in texts.items() for v in kv)
    if not held or any(text.endswith(".toml") for text in texts.values()):
        raise CaseError(f"{where}: devices = {str(texts)[:60]!r}, {_DEVICES}")
    try:
        return own_models(texts)
    except DeviceError as error:
        raise CaseError(f"{where}: devices: {error}") from None


def _checked(raw: dict[str, Any], own: Any, where: str) -> Case:
    try:
        return Case.model_validate(raw, context=own)
    except ValidationError as error:
        lines = mistakes(error, Case, path_of=lambda location: _path(location, raw))
        raise CaseError(*(f"{where}: {line}" for line in lines)) from None


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
        elif len(path) == 2 and part == ROW_TABLES.get(path[0]):
            continue  # a row's id is the key of its table
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
    retained = {k: v for k, v in row.items() if not (k in ("source", "name") and v == "")}
    return {k: _without_empty(v) if isinstance(v, dict) else v for k, v in retained.items()}
