"""What this room raises."""

from __future__ import annotations

import difflib
import errno
import os
from collections.abc import Iterable
from typing import TYPE_CHECKING

from interarea.models.errors import InterareaError, UserError

if TYPE_CHECKING:
    from .trajectory import Trajectory


class ScenarioError(UserError):
    """A scenario that cannot be run as written: file, key, value, what is allowed."""


class ScenarioWarning(UserWarning):
    """Something in a scenario that can be run as written but is probably unintended: one line."""


class GraphError(UserError):
    """Connections that do not fit the participants they name."""


class DestinationError(UserError):
    """A place where results cannot be written."""


class SweepError(UserError):
    """A sweep that cannot run as written, or results that do not belong to it."""


class StepError(InterareaError, RuntimeError):
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

    def __reduce__(self) -> tuple[object, ...]:
        """Travel between processes as message and fields."""
        return _restored, (type(self), self.args, self.__dict__)


class NoSolutionError(StepError):
    """An FMU discards a step and neither does nor continues it in parts: it has no solution there."""


def _restored(kind: type[StepError], arguments: tuple[object, ...], fields: dict[str, object]) -> StepError:
    error = kind.__new__(kind, *arguments)
    error.__dict__.update(fields)
    return error


#: errors of the machine, not of what it computes: no space, quota, file size, open files, I/O, memory
MACHINE = frozenset(
    getattr(errno, name)
    for name in ("ENOSPC", "EDQUOT", "EFBIG", "EMFILE", "ENFILE", "EIO", "ENOMEM", "EROFS")
    if hasattr(errno, name)
)


def machine_error(error: BaseException) -> OSError | None:
    """Return the error of the machine among an error and its causes: with it, nothing is known of the run."""
    seen: set[int] = set()
    todo: list[BaseException | None] = [error]
    while todo:
        own_error = todo.pop()
        if own_error is None or id(own_error) in seen:
            continue
        seen.add(id(own_error))
        if isinstance(own_error, OSError) and own_error.errno in MACHINE:
            return own_error
        if isinstance(own_error, MemoryError):
            return OSError(errno.ENOMEM, os.strerror(errno.ENOMEM))
        todo += [own_error.__cause__, own_error.__context__]
    return None


def nearest(name: str, known: Iterable[str]) -> str:
    """Return a clause naming the known names closest to `name`, or all of them when there are few."""
    names = sorted(set(known))
    close = difflib.get_close_matches(name, names, n=3, cutoff=0.5) or [
        known for known in names if known.casefold() == name.casefold()
    ]
    if close:
        return "did you mean " + " or ".join(repr(c) for c in close) + "?"
    if not names:
        return "there are none"
    shown = ", ".join(names[:12]) + (", ..." if len(names) > 12 else "")
    return f"there are: {shown}"
