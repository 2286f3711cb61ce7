"""What is counted over all points of a run, however many parts they come in."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from ..trajectory import Trajectory


@dataclass
class Ages:
    """Of the age of what a channel passes on, s: at the last point, summed over the points, the largest."""

    last: float = 0.0
    total: float = 0.0
    largest: float = -np.inf
    points: int = 0

    @property
    def mean(self) -> float:
        return self.total / self.points


@dataclass
class Tally:
    """Ages by channel, and by column what is not finite: value, first time (s), number of points."""

    channels: tuple[str, ...]
    ages: dict[str, Ages] = field(default_factory=dict)
    not_finite: dict[str, tuple[float, float, int]] = field(default_factory=dict)
    points: int = 0

    def add(self, part: Trajectory) -> None:
        """Count the points of a part."""
        self.points += len(part.time_s)
        for name in (n for n in self.channels if f"{n}.age" in part):
            age, found = part[f"{name}.age"], self.ages.setdefault(name, Ages())
            found.last, found.total = float(age[-1]), found.total + float(np.sum(age))
            found.largest, found.points = max(found.largest, float(np.max(age))), found.points + len(age)
        for name in part.units:
            bad = np.flatnonzero(~np.isfinite(part[name]))
            if bad.size:
                first = (float(part[name][bad[0]]), float(part.time_s[bad[0]]), 0)
                value, time_s, count = self.not_finite.get(name, first)
                self.not_finite[name] = value, time_s, count + int(bad.size)

    @classmethod
    def of(cls, trajectory: Trajectory, channels: Iterable[str]) -> Tally:
        """Return what a whole trajectory gives."""
        tally = cls(tuple(channels))
        tally.add(trajectory)
        return tally

    @property
    def warnings(self) -> list[str]:
        """A line on each signal that is not finite somewhere: to go on, nothing may have been connected."""
        return [
            f"{name} is {value} at {count} of {self.points} points, first at t = {time_s:.9g} s; nothing is "
            "connected to it"
            for name, (value, time_s, count) in self.not_finite.items()
        ]
