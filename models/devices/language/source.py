"""The text of a device file with the lines that errors point to."""

from __future__ import annotations

import keyword
import math
from typing import Any

from ...errors import DeviceError
from .device import BASES, NO_LIMIT
from .expression import NAME

MOST_ENTRIES = 200  #: of a table
_RESERVED = frozenset({*BASES, "none"})


class Source:
    """A file as TOML and as lines; its values by key, checked for their type."""

    def __init__(self, raw: dict[str, Any], text: str, file: str) -> None:
        self.raw, self.text, self.file = raw, text, file
        self.rows = text.splitlines()

    def fail(self, what: str, line: int = 0) -> DeviceError:
        return DeviceError(f"{self.file}{f':{line}' if line else ''}: {what}")

    def line_of(self, key: str, section: str = "") -> int:
        """Number of the line that defines `key`, 0 when it cannot be told."""
        in_section = not section
        for k, row in enumerate(self.rows, start=1):
            if row.startswith("["):
                in_section = row.strip() == f"[{section}]"
            if (in_section and _key_of(row.strip()) == key) or row.strip() == f"[{key}]":
                return k
        return 0

    def word(self, key: str, default: str | None = None) -> str:
        value = self.raw.get(key, default)
        if not isinstance(value, str) or len(value) > 20000:
            raise self.fail(f"{key} = {str(value)[:40]!r}, allowed: a text", self.line_of(key))
        return value

    def table(self, key: str) -> dict[str, Any]:
        value = self.raw.get(key, {})
        if not isinstance(value, dict) or len(value) > MOST_ENTRIES:
            raise self.fail(f"{key} must be a table of at most {MOST_ENTRIES} entries", self.line_of(key))
        return value

    def texts(self, key: str) -> tuple[str, ...]:
        value = self.raw.get(key, [])
        if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
            raise self.fail(f"{key}: allowed: a list of texts", self.line_of(key))
        return tuple(value)

    def name_of(self, name: str, line: int) -> str:
        if not NAME.fullmatch(name):
            raise self.fail(
                f"{name[:40]!r} is no name, allowed: a letter, then letters, digits, _ (24)", line
            )
        if keyword.iskeyword(name) or name in _RESERVED:
            raise self.fail(f"{name} is a reserved word; use another name, such as {name[:22]}_", line)
        return name

    def number(self, value: Any, what: str, line: int) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or value != value:
            raise self.fail(f"{what} = {str(value)[:40]!r}, allowed: a number", line)
        if math.isinf(value):
            return math.copysign(NO_LIMIT, value)
        if not abs(value) <= NO_LIMIT:
            raise self.fail(f"{what} = {str(value)[:40]}, allowed: at most 1e30 or inf", line)
        return float(value)


def _key_of(row: str) -> str:
    """The key of a line of TOML; one in quotes may hold an =."""
    return row[1:].partition(row[0])[0] if row[:1] in ("'", '"') else row.partition("=")[0].strip()
