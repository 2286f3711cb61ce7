"""One number of a case by its path, such as `machines.G1.exciter.KA` or `branches.8-9 a.x`."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel

from ..errors import nearest
from .case import Case, CaseError

_TABLES = ("buses", "branches", "shunts", "loads", "machines")


def parameter_value(case: Case, path: str) -> float:
    """Return the number at `path`: table, row, then field names, joined by dots.

    >>> from interarea.models.case.case import load_case
    >>> parameter_value(load_case("two-area-thesis"), "branches.8-9 a.x")
    0.11

    Raises
    ------
    CaseError : a table, row or field that does not exist (with the nearest names), or no number there.
    """
    table, name, fields = _split(case, path)
    value: Any = _rows(case, table)[name]
    for field in fields:
        known = (
            {*type(value).model_fields, *(value.model_extra or ())} if isinstance(value, BaseModel) else ()
        )
        if field not in known:
            raise CaseError(f"{case.name}: {path}: no field {field!r}; {nearest(field, known)}")
        value = getattr(value, field)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise CaseError(f"{case.name}: {path} is {value!r}, allowed: the path of a number that is given")
    return float(value)


def with_parameter(case: Case, path: str, value: float) -> Case:
    """Return `case` with the number at `path` replaced; the operating point follows when it is solved again.

    Raises
    ------
    CaseError : as `parameter_value`, or a value that the case refuses.
    """
    parameter_value(case, path)
    table, name, fields = _split(case, path)
    change: Any = value
    for field in reversed(fields):
        change = {field: change}
    return case.with_changes({table: {name: change}})


def _rows(case: Case, table: str) -> dict[str, BaseModel]:
    return {str(row.number if table == "buses" else row.name): row for row in getattr(case, table)}


def _split(case: Case, path: str) -> tuple[str, str, list[str]]:
    """Table, name of the row and field names of a path; names of rows may hold dots."""
    table, _, rest = path.partition(".")
    if table not in _TABLES:
        raise CaseError(f"{case.name}: {path}: no table {table!r}; {nearest(table, _TABLES)}")
    rows = _rows(case, table)
    found = [name for name in rows if rest.startswith(f"{name}.")]
    if not found:
        row = rest.partition(".")[0]
        raise CaseError(f"{case.name}: {path}: no row {row!r} in {table}; {nearest(row, rows)}")
    name = max(found, key=len)
    return table, name, rest[len(name) + 1 :].split(".")
