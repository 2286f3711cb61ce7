"""What kind of file a TOML table is, for the message to somebody who gave another kind."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

#: kind -> (keys of which one is in every file of it and in no other kind, the command that takes it)
KINDS: Mapping[str, tuple[frozenset[str], str]] = {
    "study": (frozenset({"published", "disturbance"}), "interarea study"),
    "claims": (frozenset({"statement", "correction"}), "interarea study, as `claims` in its file"),
    "sweep": (frozenset({"parameters"}), "interarea sweep"),
    "design": (frozenset({"conditions", "ask"}), "interarea design"),
    "case": (frozenset({"machines", "buses", "branches", "base", "change"}), "interarea modes"),
    "device": (frozenset({"diagram"}), "interarea device"),
    "scenario": (frozenset({"stop_s", "event", "channels", "connections"}), "interarea run"),
}


def other_kind(table: Mapping[str, Any], wanted: str) -> str | None:
    """Return what `table` is, as the end of a sentence about its file, where it plainly is not a `wanted`.

    >>> other_kind({"case": "two-area-thesis", "stop_s": 20.0}, "sweep")
    'is a scenario (`interarea run`), wanted: a sweep'
    >>> other_kind({}, "sweep")
    'is empty, wanted: a sweep'
    >>> other_kind({"parameters": {}, "stop_s": 1.0}, "sweep") is None
    True
    """
    if not table:
        return f"is empty, wanted: a {wanted}"
    keys = set(table)
    if keys & KINDS[wanted][0]:
        return None
    for kind, (signs, command) in KINDS.items():
        if kind != wanted and keys & signs:
            return f"is a {kind} (`{command}`), wanted: a {wanted}"
    return None
