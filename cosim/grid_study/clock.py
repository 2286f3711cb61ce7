"""Processor time of a study, its shares for the stages, and the parts omitted for lack of time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from interarea.models.processes import processor_s

from .choices import MINUTES

#: stage -> share of the whole time by when it begins nothing more; what it does not need is left to the next
ENDS = {
    "loops": 0.12,
    "operating points": 0.2,
    "local stabilizers": 0.35,
    "search": 0.68,
    "faults": 0.86,
    "own-signal rival": 0.93,
    "latency": 1.0,
    "links": 1.0,
}
#: where the grid with its local stabilizers is looked at once more
ENDS_AGAIN = {"loops": 0.42, "operating points": 0.48}
#: shares of the whole time for the search of one set of loops: each first guess, and the stage that follows
GUESS, SEARCH = 0.025, 0.1


@dataclass
class Clock:
    """Counts processor time from its creation, so results do not depend on the load of the machine.

    left_out : omitted parts, in words. ends : of its stages.
    """

    minutes: float = MINUTES
    left_out: list[str] = field(default_factory=list)
    now: Callable[[], float] = processor_s
    ends: dict[str, float] = field(default_factory=lambda: dict(ENDS))

    def __post_init__(self) -> None:
        self._begin = self.now()

    def over(self, stage: str) -> bool:
        """Whether the time of a stage of `ENDS` is over.

        >>> seconds = iter([0.0, 100.0, 200.0])
        >>> clock = Clock(10.0, now=lambda: next(seconds))
        >>> clock.over("operating points"), clock.over("operating points")
        (False, True)
        """
        return self.now() - self._begin > self.ends[stage] * 60.0 * self.minutes

    def seconds(self, share: float) -> float:
        """Return a share of the whole time, s.

        >>> Clock(10.0).seconds(0.1)
        60.0
        """
        return share * 60.0 * self.minutes

    def again(self) -> None:
        """Allow the first stages to run again, until the ends of `ENDS_AGAIN`."""
        self.ends |= ENDS_AGAIN

    def leave(self, text: str) -> None:
        """Record an omitted part once."""
        if text not in self.left_out:
            self.left_out.append(text)
