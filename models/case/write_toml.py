"""Write a case as a TOML file that loads back to the same case."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..files import write_whole
from .case import Case
from .document import ROW_TABLES

_BARE = re.compile(r"[A-Za-z0-9_-]+")


def export_toml(case: Case, path: str | Path | None = None) -> str:
    """Return `case` in the form of a case file, and write it to `path` when one is given.

    Numbers keep every digit; r, x, b are on the base of the case. Loading the text gives the same hash.

    >>> from interarea.models.case.case import load_case
    >>> export_toml(load_case("kundur-manual")).splitlines()[0]
    'name = "kundur-manual"'

    Raises
    ------
    OSError : `path` cannot be written.
    """
    document = case.document()
    lines = [
        f"{key} = {_value(value)}"
        for key, value in document.items()
        if not isinstance(value, Mapping | tuple)
    ]
    lines += _devices(document.get("devices", {}))
    for table in ROW_TABLES:
        rows = dict(document.get(table, {}))
        if not rows:
            continue
        lines += ["", f"[{table}]"]
        if "source" in rows:
            lines.append(f"source = {_value(rows.pop('source'))}")
        if table == "machines":
            for name, row in rows.items():
                lines += _section(f"machines.{_key(name)}", row)
        else:
            lines += [f"{_key(name)} = {_value(row)}" for name, row in rows.items()]
    if "tie" in document:
        lines += _section("tie", {k: v for k, v in document["tie"].items() if v != ""})
    for event in document.get("event", ()):
        lines += ["", "[[event]]", *(f"{key} = {_value(value)}" for key, value in event.items())]
    text = "\n".join(lines) + "\n"
    if path is not None:
        write_whole(path, text)
    return text


def toml_text(table: Mapping[str, Any]) -> str:
    """Return a table as TOML: its values, its tables, then its arrays of tables.

    >>> toml_text({"stop_s": 2.0, "channels": {"remote": {"signal": "G2_dw"}}, "event": [{"kind": "a"}]})
    'stop_s = 2.0\\n\\n[channels.remote]\\nsignal = "G2_dw"\\n\\n[[event]]\\nkind = "a"\\n'
    """

    def listed(value: Any) -> bool:
        return isinstance(value, list | tuple) and bool(value) and isinstance(value[0], Mapping)

    plain = {k: v for k, v in table.items() if not isinstance(v, Mapping) and not listed(v)}
    lines = [f"{_key(k)} = {_value(v)}" for k, v in plain.items()]
    for key, value in table.items():
        if isinstance(value, Mapping):
            only_tables = all(isinstance(v, Mapping) for v in value.values())
            lines += _section(_key(key), value)[2 if only_tables else 0 :]  # whose header says nothing
    for key, rows in table.items():
        for row in rows if listed(rows) else ():
            lines += ["", f"[[{_key(key)}]]", *(f"{_key(k)} = {_value(v)}" for k, v in row.items())]
    return "\n".join(lines).lstrip("\n") + "\n"


def _section(name: str, row: Mapping[str, Any]) -> list[str]:
    lines = ["", f"[{name}]"]
    lines += [f"{_key(k)} = {_value(v)}" for k, v in row.items() if not isinstance(v, Mapping)]
    for key, value in row.items():
        if isinstance(value, Mapping):
            lines += _section(f"{name}.{_key(key)}", value)
    return lines


def _devices(texts: Mapping[str, str]) -> list[str]:
    rows = [f"{_key(name)} = {_lines(text)}" for name, text in texts.items()]
    return ["", "[devices]", *rows] if rows else []


def _lines(text: str) -> str:
    """Text of several lines as it stands."""
    inside = text.replace("\\", "\\\\").replace('"""', '""\\"').replace("\x7f", "\\u007f")
    return '"""\n' + inside + ('"""' if not inside.endswith('"') else '\\\n"""')


def _key(name: str) -> str:
    return name if _BARE.fullmatch(name) else _value(name)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(k)} = {_value(v)}" for k, v in value.items()) + " }"
    if isinstance(value, tuple | list):
        return "[" + ", ".join(_value(v) for v in value) + "]"
    # JSON's strings are TOML's, but for DEL, which TOML wants written as a number too
    return json.dumps(str(value), ensure_ascii=False).replace("\x7f", "\\u007f")
