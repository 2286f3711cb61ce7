"""A case as the tables of its file: read, a variant merged into its base, rows by their ids; unchecked.

What looks a name up in a bundled case needs no more: `outline`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Set
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_args

from ..bundled import bundled_elsewhere, meant
from ..documents import DocumentError, other_kind, parse_toml, read_document, require_regular
from ..errors import CaseError, nearest, reason
from ..files import read_text, toml_files

#: table in the file -> field that holds the row's key
ROW_TABLES = {"buses": "number"} | dict.fromkeys(
    ("branches", "shunts", "loads", "machines", "svcs", "tcscs", "converters", "hvdcs", "vscs"), "name"
)
LATER_TABLES = ("svcs", "tcscs", "converters", "hvdcs", "vscs")  #: of these, that earlier cases did not have
RESERVED = ("source", "defaults")  #: keys of a table of rows that are not ids
REMOVED = "none"  #: what stands in place of a row, a stabilizer, a tie that is taken out
BUNDLED = Path(__file__).resolve().parents[1] / "cases"  #: folder of the cases that come with the package


def case_names() -> list[str]:
    """Return the names of the bundled cases, sorted."""
    return list(toml_files(BUNDLED))


def outline(name: str | Path) -> Any:
    """Return the rows of a bundled case, attributes by key as in its file: a `Case` takes longer to build.

    >>> [m.name for m in outline("two-area-thesis").machines]
    ['G1', 'G2', 'G3', 'G4']

    Raises
    ------
    CaseError : unknown name, with the nearest ones.
    """
    raw = case_document(name)
    rows = {table: rows_of(raw.get(table, {}), table, key, str(name))[0] for table, key in ROW_TABLES.items()}
    tables = {table: [_attributes(row) for row in of] for table, of in rows.items()}
    return SimpleNamespace(**{**raw, **tables})


def _attributes(value: Any) -> Any:
    if not isinstance(value, dict):
        return value
    return SimpleNamespace(**{k: _attributes(v) for k, v in value.items()})


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
        keys = {*there.get("defaults", {}), *part.get("defaults", {})}
        new = {name: row for name, row in part.items() if name not in {*there, *RESERVED}}
        for name, row in new.items():
            nearby = f"{table}.{name}: there is no {name!r} to change; {nearest(name, known)}"
            if row == REMOVED or (table == "buses" and name not in _ends(change)):
                yield nearby
            elif isinstance(row, Mapping) and known and (missing := _needed_more(table, keys, row)):
                yield f"{nearby} (a new one needs {', '.join(missing)})"


def _needed_more(table: str, keys: Set[str], row: Mapping[str, Any]) -> list[str]:
    """Return the keys that a row lacks; none where it has most of them: a new one, checked as such."""
    needed, missing = _needed(table, keys), _needed(table, {*keys, *row})
    return missing if 2 * len(missing) >= len(needed) else []


def _needed(table: str, left_out: Set[str]) -> list[str]:
    """Keys that every row of a table has, but for its id and those that are `left_out`."""
    from .tables import CaseTables

    row = get_args(CaseTables.model_fields[table].annotation)[0]
    needed = [field.alias or name for name, field in row.model_fields.items() if field.is_required()]
    return [key for key in needed if key != ROW_TABLES[table] and key not in left_out]


def _ends(change: Mapping[str, Any]) -> set[str]:
    """Buses that the branches of a change lead to: a new bus is one of them."""
    branches = change.get("branches")
    rows = branches.values() if isinstance(branches, Mapping) else ()
    return {str(row.get(end)) for row in rows if isinstance(row, Mapping) for end in ("from", "to")}


def case_document(
    name_or_path: str | Path, seen: tuple[str, ...] = (), beside: Path | None = None
) -> dict[str, Any]:
    """Return the tables of a bundled case or a case file, the change of a variant merged into its base.

    Raises
    ------
    CaseError : unknown name, unreadable file, one of another kind, a change to what is not there.
    """
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
        from ..mistakes import suggestion
        from .tables import CaseTables

        inside = extra[0] in CaseTables.model_fields or extra[0] == "event"
        hint = "" if inside else f"; {suggestion(extra[0], keys)}"
        raise CaseError(
            f"{where}: {extra[0]} stands outside [change]; a variant holds {', '.join(keys)}{hint}"
        )
    base = case_document(raw["base"], (*seen, where), folder)
    change = with_device_texts(raw.get("change", {}), folder or BUNDLED, where)
    changed = apply_change(base, change, where=where)
    return changed | {k: raw[k] for k in ("name", "title", "source") if k in raw}


def _text(name_or_path: str | Path, beside: Path | None) -> tuple[str, str, Path | None]:
    name, path = str(name_or_path), case_file(name_or_path, beside)
    if not name.endswith(".toml"):
        return read_text(path), name, None
    try:
        return read_document(path, "a case file").decode("utf-8"), str(path), path.parent
    except DocumentError as error:
        raise CaseError(str(error)) from None
    except (OSError, UnicodeDecodeError) as error:
        raise CaseError(f"{path}: the case file cannot be read: {reason(error)}") from None


def case_file(name_or_path: str | Path, beside: Path | None = None) -> Path:
    """Return the file of a bundled case, or the one that a name ending in .toml means; nothing is read.

    beside : folder in which the name of a file is looked for.

    Raises
    ------
    CaseError : unknown name, with the nearest ones, or no regular file.
    """
    name = str(name_or_path)
    if name.endswith(".toml"):
        path = Path(name) if beside is None else beside / name
        require_regular(path, f"a case file{meant(name, 'case')}", CaseError)
        return path
    known = case_names()
    if name not in known:
        if (other := bundled_elsewhere(name, "case")) is not None:
            raise CaseError(f"{name} {other}")
        if Path(name).exists():
            raise CaseError(
                f"{name}: is no .toml file, so no case; "
                "`interarea import GRID.raw --dyr GRID.dyr --out GRID.toml` makes one of a grid"
            )
        hint = meant(name, "case") or f"; {nearest(name, known)} (or give the path of a .toml file)"
        raise CaseError(f"case {name!r} does not exist{hint}")
    return toml_files(BUNDLED)[name]


def with_device_texts(table: Mapping[str, Any], folder: Path, where: str) -> dict[str, Any]:
    """Return `table` with what the files of its list `devices` hold, by name, in place of that list.

    folder : in which relative names are looked for. where : names the table in errors.

    Raises
    ------
    CaseError : no list of names, or a file that cannot be read.
    """
    names = table.get("devices")
    if not isinstance(names, list | tuple):
        return dict(table)
    from ..devices.language.read import device_text
    from ..errors import DeviceError

    texts: dict[str, str] = {}
    for name in names:
        if not isinstance(name, str | Path) or not str(name).endswith(".toml"):
            raise CaseError(f"{where}: devices: {str(name)[:80]!r}, allowed: the name of a .toml file")
        try:
            texts[str(name)] = device_text(folder / name)
        except DeviceError as error:
            raise CaseError(f"{where}: devices: {error}") from None
    return {**table, "devices": texts}


def rows_of(table: Any, name: str, key: str, where: str) -> tuple[list[dict[str, Any]], str]:
    """Return the rows of the table `name` with their id under `key` and its defaults, and its source."""
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
