"""Times that were written between two ticks of the clock: what they are taken as, and a line that says so."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel

from ..clock import moved, on_tick
from ..errors import ScenarioError


def event_on_ticks(event: Any, where: str) -> Any:
    """Return an event with its instants on ticks of the clock.

    Raises
    ------
    ScenarioError : it would begin and end at the same tick.
    """
    given = {key: getattr(event, key, None) for key in ("start_s", "end_s")}
    used = {key: on_tick(at, f"{where} ({event.kind}): {key}") for key, at in given.items() if at is not None}
    if "end_s" in used and not used["end_s"] > used["start_s"]:
        raise ScenarioError(
            f"{where} ({event.kind}): start_s = {given['start_s']!r} and end_s = {given['end_s']!r} fall "
            "on one tick of the clock (1 ns), allowed: at least 1e-9 apart"
        )
    same = all(used[key] == given[key] for key in used)
    return event if same else event.model_copy(update=used)


def roundings(given: Any, used: Any, where: str = "") -> list[str]:
    """Return a line for each time of a table that is not taken as it was written."""
    if isinstance(given, BaseModel):
        given = dict(given)
    if isinstance(given, Mapping):
        fields = used if isinstance(used, Mapping) else dict(used) if isinstance(used, BaseModel) else {}
        pairs = [(f"{where}.{k}" if where else str(k), value, fields.get(k)) for k, value in given.items()]
    elif isinstance(given, list | tuple) and isinstance(used, list | tuple):
        pairs = [(f"{where} {k}", a, b) for k, (a, b) in enumerate(zip(given, used, strict=False), start=1)]
    elif isinstance(given, float) and isinstance(used, float) and moved(given, used):
        return [f"{where} = {given!r} s is taken as {used!r} s, a tick of the clock"]
    else:
        return []
    return [line for name, a, b in pairs for line in roundings(a, b, name)]
