"""Errors of the FMU builder and of opened FMUs."""

from __future__ import annotations

from interarea.models.errors import InterareaError, UserError


class FmuFileError(UserError):
    """A file that is no FMU, or none that can be used here: file, what is wrong, what is needed."""


class BuildError(InterareaError, RuntimeError):
    """An FMU could not be built: no compiler, a compiler error, or a block whose parts do not fit."""


class NoCompilerError(BuildError):
    """A binary that did not come with the package, and no compiler to make it."""


class FmuError(InterareaError, RuntimeError):
    """A call into an FMU failed.

    Attributes
    ----------
    instance : name of the FMU instance.
    call : FMI function that failed.
    time_s : simulation time of the call in seconds, or None before a run.
    log_line : last line that the FMU logged, or "".
    """

    def __init__(
        self, instance: str, call: str, reason: str, *, time_s: float | None = None, log_line: str = ""
    ) -> None:
        self.instance = instance
        self.call = call
        self.time_s = time_s
        self.log_line = log_line
        when = "" if time_s is None else f" at {time_s:.9g} s"
        log = f"; it said: {log_line}" if log_line else ""
        super().__init__(f"{instance}: {call}{when}: {reason}{log}")
