"""JSON as a person reads it: one row of a matrix, one list of numbers, one short table a line."""

from __future__ import annotations

import json
from typing import Any

_WIDTH = 200  #: characters up to which a table of plain values stays on its line


def json_text(value: Any) -> str:
    """Return `value` as JSON text with a line end; every number keeps all its digits."""
    return _text(value, "") + "\n"


def _text(value: Any, indent: str) -> str:
    line = json.dumps(value)
    items = list(value.values()) if isinstance(value, dict) else value
    plain = not isinstance(items, (list, tuple)) or not any(isinstance(x, (list, tuple, dict)) for x in items)
    if plain and (not isinstance(value, dict) or len(indent) + len(line) <= _WIDTH):
        return line
    inner = indent + " "
    if isinstance(value, dict):
        rows = [f"{inner}{json.dumps(str(key))}: {_text(item, inner)}" for key, item in value.items()]
    else:
        rows = [inner + _text(item, inner) for item in value]
    start, end = "{}" if isinstance(value, dict) else "[]"
    return start + "\n" + ",\n".join(rows) + f"\n{indent}{end}"
