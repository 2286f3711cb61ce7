"""One number of a case by its path, such as `machines.G1.exciter.KA` or `branches.8-9 a.x`.

`redispatch.G1:G2` is one too, 0 in every case: megawatts that G2 delivers in place of G1.
"""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel

from ..errors import nearest
from .case import Case, CaseError
from .document import ROW_TABLES

_REDISPATCH = "redispatch"
_REDISPATCH_STEP_MW = 1.0


def parameter_value(case: Case, path: str) -> float:
    """Return the number at `path`: table, row, then field names, joined by dots.

    >>> from interarea.models.case.case import load_case
    >>> parameter_value(load_case("two-area-thesis"), "branches.8-9 a.x")
    0.11

    Raises
    ------
    CaseError : a table, row or field that does not exist (with the nearest names), or no number there.
    """
    if _is_redispatch(path):
        _machines_of(case, path)
        return 0.0
    table, name, fields = _split(case, path)
    value: Any = _rows(case, table)[name]
    for field in fields:
        known = (
            {*type(value).model_fields, *(value.model_extra or ())} if isinstance(value, BaseModel) else ()
        )
        if field not in known:
            raise CaseError(f"{case.name}: {path}: no field {field!r}; {nearest(field, sorted(known))}")
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
    if _is_redispatch(path):
        return _redispatched(case, path, value)
    table, name, fields = _split(case, path)
    change: Any = value
    for field in reversed(fields):
        change = {field: change}
    return case.with_changes({table: {name: change}})


def parameter_step(path: str) -> float | None:
    """Return the step of a difference to both sides, where the value itself says none."""
    return _REDISPATCH_STEP_MW if _is_redispatch(path) else None


def _is_redispatch(path: str) -> bool:
    return path.partition(".")[0] == _REDISPATCH


def _machines_of(case: Case, path: str) -> tuple[str, str]:
    """The machines that deliver less and more."""
    less, colon, more = path.partition(".")[2].partition(":")
    if not colon or less == more:
        raise CaseError(f"{case.name}: {path}: wanted {_REDISPATCH}.FROM:TO, two machines of the case")
    names = [machine.name for machine in case.machines]
    for name in (less, more):
        if name not in names:
            raise CaseError(f"{case.name}: {path}: no machine {name!r}; {nearest(name, names)}")
    return less, more


def _redispatched(case: Case, path: str, moved_mw: float) -> Case:
    """The slack's power is what the power flow needs, so its own change follows."""
    less, more = _machines_of(case, path)
    change = {less: -moved_mw, more: moved_mw}
    rows = {
        m.name: {"P_mw": m.P_mw + change[m.name]} for m in case.machines if m.name in change and not m.slack
    }
    return case.with_changes({"machines": rows})


def _rows(case: Case, table: str) -> dict[str, BaseModel]:
    return {str(row.number if table == "buses" else row.name): row for row in getattr(case, table)}


def _split(case: Case, path: str) -> tuple[str, str, list[str]]:
    """Table, name of the row and field names of a path; names of rows may hold dots."""
    table, _, rest = path.partition(".")
    if table not in ROW_TABLES:
        raise CaseError(
            f"{case.name}: {path}: no table {table!r}; {nearest(table, (*ROW_TABLES, _REDISPATCH))}"
        )
    rows = _rows(case, table)
    matches = [name for name in rows if rest.startswith(f"{name}.")]
    if not matches:
        row = rest.partition(".")[0]
        raise CaseError(f"{case.name}: {path}: no row {row!r} in {table}; {nearest(row, rows)}")
    name = max(matches, key=len)
    return table, name, rest[len(name) + 1 :].split(".")
