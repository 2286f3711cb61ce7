"""What an FMU logs in a run, with times, and its calls that returned fmi2Warning."""

from __future__ import annotations

import logging
import sys
from collections import Counter
from collections.abc import Callable

from interarea.fmu_build.open.fmi2 import STATUS, WARNING, Log

MOST_LINES = 100_000  #: of one instance in one run; further ones are counted
_log = logging.getLogger("interarea")
_STEP = "fmi2DoStep"
Line = tuple[float | None, int, str]
#: new lines, number of lines that were not kept, calls with a warning, time of the first of these
News = tuple[list[Line], int, dict[str, int], float | None]


class FmuLog(Log):
    """The lines and warnings of one instance since its last `begin`; as a list the last messages.

    name : of the instance. now_s : returns the time to which the instance has come, s; None before the start.
    """

    def __init__(self, name: str, now_s: Callable[[], float | None]) -> None:
        super().__init__()
        self.name, self._now_s = name, now_s
        self.clear()

    def clear(self) -> None:
        """Begin a new run."""
        self.lines: list[Line] = []
        self.beyond = 0  #: lines that were not kept
        self.warnings: Counter[str] = Counter()  #: calls that returned fmi2Warning, by name
        self.first_s: float | None = None  #: time of the first of them

    def add(self, status: int, message: str) -> None:
        """Take one message of the FMU."""
        super().add(status, message)
        self._keep((self._now_s(), status, message))

    def warned(self, call: str, time_s: float | None, times: int = 1) -> None:
        """Count calls that returned fmi2Warning, the first of them at `time_s`."""
        if not self.warnings:
            self.first_s = time_s
        self.warnings[call] += times

    def news(self) -> News:
        """Return what came since the last call of this method, and clear it."""
        news = (self.lines, self.beyond, dict(self.warnings), self.first_s)
        self.clear()
        return news

    def merge(self, news: News) -> None:
        """Take the `news` of the same instance in another process."""
        lines, beyond, warnings, first_s = news
        for line in lines:
            self._keep(line)
        self.beyond += beyond
        for call, times in warnings.items():
            self.warned(call, first_s, times)

    def warning(self) -> str:
        """Return one line on calls with a warning and messages of a warning or worse; "" where none came."""
        warnings = [line for line in self.lines if line[1] >= WARNING and line[2]]
        quoted = f": {warnings[0][2][:300]!r}" if warnings else ", without a message"
        if self.warnings:
            steps = self.warnings[_STEP]
            calls = [f"{steps} step{'s' * (steps != 1)}"] if steps else []
            calls += [f"{n} call{'s' * (n != 1)} of {c}" for c, n in self.warnings.items() if c != _STEP]
            return (
                f"{self.name}: {' and '.join(calls)} with a warning{_when(', first', self.first_s)}{quoted}"
            )
        if warnings:
            number = f"{len(warnings)} message{'s' * (len(warnings) != 1)}"
            return f"{self.name}: logged {number} of a warning{_when(', first', warnings[0][0])}{quoted}"
        return ""

    def as_text(self) -> list[str]:
        """Return a text line for each message: instance, time, status, message."""
        text = [f"{self.name}{_when('', t)}: {_status(s)}: {message}" for t, s, message in self.lines]
        if self.beyond:
            text.append(f"{self.name}: {self.beyond} further messages were discarded, allowed: {MOST_LINES}")
        return text

    def _keep(self, line: Line) -> None:
        _log.info("%s%s: %s: %s", self.name, _when("", line[0]), _status(line[1]), line[2])
        if len(self.lines) < MOST_LINES:
            self.lines.append((line[0], line[1], " ".join(line[2].split())))
        else:
            self.beyond += 1


class SpokenLog(FmuLog):
    """Log lines that a worker process writes down at once: after a crash nobody could ask for them."""

    def add(self, status: int, message: str) -> None:
        """Take one message of the FMU."""
        print(message, file=sys.stderr, flush=True)
        super().add(status, message)


def _when(before: str, time_s: float | None) -> str:
    return before if time_s is None else f"{before} at {time_s:.9g} s"


def _status(status: int) -> str:
    return STATUS[status] if 0 <= status < len(STATUS) else f"status {status}"
