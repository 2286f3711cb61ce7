"""Times in periods of the grid's frequency: "8 cycles" wherever a scenario or a case asks for seconds.

Terms joined by +: `1.5 s`, `8 cycles`, and `start`, the `start_s` of the same table.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

_TERM = re.compile(r"(?P<number>\d+(?:\.\d*)?(?:[eE][-+]?\d+)?)\s*(?P<unit>s|cycles?)")


def in_seconds(table: Mapping[str, Any], frequency_hz: Callable[[], float]) -> dict[str, Any]:
    """Return a table with every time in seconds; words that are no time stay, to be refused.

    frequency_hz : asked only where cycles are named, Hz.

    >>> in_seconds({"event": [{"start_s": 1.0, "end_s": "start + 6 cycles"}]}, lambda: 60.0)
    {'event': [{'start_s': 1.0, 'end_s': 1.1}]}
    """
    return {key: _moved(key, value, table, frequency_hz) for key, value in table.items()}


def _moved(key: str, value: Any, table: Mapping[str, Any], frequency_hz: Callable[[], float]) -> Any:
    if isinstance(value, Mapping):
        return in_seconds(value, frequency_hz)
    if isinstance(value, list | tuple):
        return type(value)(_moved(key, part, table, frequency_hz) for part in value)
    if isinstance(value, str) and key.endswith("_s"):
        return _seconds(value, table, frequency_hz)
    return value


def _seconds(text: str, table: Mapping[str, Any], frequency_hz: Callable[[], float]) -> str | float:
    total = 0.0
    for part in text.split("+"):
        word = part.strip()
        if word == "start" and table.get("start_s") != text:
            start = table.get("start_s")
            start = _seconds(start, table, frequency_hz) if isinstance(start, str) else start
            if not isinstance(start, int | float) or isinstance(start, bool):
                return text
            total += start
        elif found := _TERM.fullmatch(word):
            number = float(found["number"])
            total += number if found["unit"] == "s" else number / frequency_hz()
        else:
            return text
    return total
