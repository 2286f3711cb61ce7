"""What this room raises."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .trajectory import Trajectory


class ScenarioError(ValueError):
    """A scenario that cannot be run as written: file, key, value, what is allowed."""


class GraphError(ValueError):
    """Connections that do not fit the participants they name."""


class SweepError(ValueError):
    """A sweep that cannot run as written, or results that do not belong to it."""


class StepError(RuntimeError):
    """A run that stopped: which instance, in which call, at what time, and its last log line.

    `trajectory` holds the results up to the last finished step (None when there are none yet).
    """

    def __init__(
        self,
        what: str,
        *,
        instance: str,
        call: str,
        time_s: float | None,
        last_log: str = "",
        advice: str = "",
    ) -> None:
        when = "" if time_s is None else f" at t = {time_s:.9g} s"
        log = f'; its last log line: "{last_log}"' if last_log else ""
        hint = f"; {advice}" if advice else ""
        super().__init__(f"{instance}: {call}{when}: {what}{log}{hint}")
        self.instance = instance
        self.call = call
        self.time_s = time_s
        self.last_log = last_log
        self.trajectory: Trajectory | None = None


def nearest(name: str, known: Iterable[str]) -> str:
    """Return a clause naming the known names closest to `name`, or all of them when there are few."""
    names = sorted(set(known))
    close = difflib.get_close_matches(name, names, n=3, cutoff=0.5)
    if close:
        return "did you mean " + " or ".join(repr(c) for c in close) + "?"
    if not names:
        return "there are none"
    shown = ", ".join(names[:12]) + (", ..." if len(names) > 12 else "")
    return f"there are: {shown}"
