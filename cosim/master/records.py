"""What a master records: every output at every recorded point, kept to the end or handed on in parts.

And a run between two steps: what is needed to go back to there, or to go on from there in another run.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..clock import seconds
from ..participant import Participant
from ..trajectory import Trajectory

PART = 16_384  #: points that are handed on together, fewer where there are many outputs
_VALUES = 1 << 22  # of a part, 32 MB
Sink = Callable[[Trajectory], object]


class Records:
    """Times and outputs, a row for each recorded point; with a `sink` no more than `PART` at a time.

    sink : takes each part, a trajectory of its own; None: everything is kept.
    """

    def __init__(self, participants: Collection[Participant], points: int, sink: Sink | None) -> None:
        outputs = [(p.name, port) for p in participants for port in p.description.outputs]
        self.columns = [f"{name}.{port.name}" for name, port in outputs]
        self.ports = [port for _, port in outputs]
        self._sources = [(p, len(p.description.outputs)) for p in participants]
        self.sink = sink
        rows = points if sink is None else min(points, PART, max(1, _VALUES // max(1, len(outputs))))
        self.times = np.full(rows, np.nan)
        self.values = np.full((rows, len(outputs)), np.nan)
        self.count = 0

    def add(self, tick: int) -> None:
        """Take the present outputs."""
        row: list[float] = []
        for p, n in self._sources:
            row.extend(p.y[:n])  # not +=: buffers may be arrays, which would add
        self.values[self.count] = row
        self.times[self.count] = seconds(tick)
        self.count += 1

    def trajectory(self, engine: str) -> Trajectory:
        """Return what is here: with a sink, what it has not been given."""
        n = self.count
        return Trajectory.of_records(self.times[:n], self.values[:n], self.columns, self.ports, engine=engine)

    def free(self, engine: str) -> int:
        """Return for how many points there is room; where there was none, the sink takes all."""
        if self.count == len(self.times):
            self.hand_on(engine)
        return len(self.times) - self.count

    def hand_on(self, engine: str) -> None:
        """Give the sink, if there is one, what it has not been given."""
        if self.sink is not None and self.count:
            self.sink(self.trajectory(engine))
            self.count = 0


@dataclass(frozen=True)
class Snapshot:
    """A master between two steps: states of all participants and what the master itself remembers."""

    index: int
    states: Mapping[str, object]
    signals: tuple[tuple[object, ...], ...]
    rows: int


@dataclass(frozen=True)
class Fork:
    """A beginning that several masters can share: the state after it, what was recorded and counted."""

    snapshot: Snapshot
    ends: array[int]
    times: npt.NDArray[np.float64]
    records: npt.NDArray[np.float64]
    counts: tuple[float, int, int, str]
