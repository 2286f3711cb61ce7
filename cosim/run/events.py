"""An event given in Python, as the system takes it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from interarea.models.case.events import event_of
from interarea.models.errors import CaseError

from ..clock import event_on_ticks, roundings
from ..errors import ScenarioError


def timed_event(kind: Any, fields: Mapping[str, Any], where: str) -> tuple[Any, list[str]]:
    """Return an event (its kind and fields, or an event object) on ticks, and what was rounded for that.

    Raises
    ------
    ScenarioError : an unknown kind or field.
    """
    try:
        event = event_of({"kind": kind, **fields}, where="event") if isinstance(kind, str) else kind
    except CaseError as error:
        raise ScenarioError(str(error)) from None
    timed = event_on_ticks(event, where)
    return timed, roundings(event, timed, where)
