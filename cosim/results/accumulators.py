"""What is gathered over all points of a run, however many parts they come in.

Those that look at neighbours (`Squares`, `Settling`, `Samples`) are given each part with the last point of
the one before at its head. In one part each has the bits of the whole at once; in several a sum may
differ in its last bit.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from math import acos, cos, degrees, radians

import numpy as np
import numpy.typing as npt

from interarea.models.case.case import Case
from interarea.models.case.hvdc_schema import Hvdc
from interarea.models.grid.dc_link import ends_of

from ..trajectory import TIME, Trajectory

Array = npt.NDArray[np.float64]
#: least extinction angle after which a valve blocks: thyristors take 400 us, 7.2 deg at 50 Hz, 8.6 at 60 Hz
CRITICAL_DEG = 8.0
_NONE = 1e-6  #: apparent power, pu of the link, below which it carries nothing
DRAWN = 32_768  #: points up to which `Curves` keeps every one


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
class Accumulators:
    """Ages by channel, and by column what is not finite: value, first time (s), number of points."""

    channels: tuple[str, ...]
    ages: dict[str, Ages] = field(default_factory=dict)
    not_finite: dict[str, tuple[float, float, int]] = field(default_factory=dict)
    points: int = 0

    def add(self, part: Trajectory) -> None:
        """Count the points of a part."""
        self.points += len(part.time_s)
        for name in (n for n in self.channels if f"{n}.age" in part):
            age, result = part[f"{name}.age"], self.ages.setdefault(name, Ages())
            result.last, result.total = float(age[-1]), result.total + float(np.sum(age))
            result.largest, result.points = max(result.largest, float(np.max(age))), result.points + len(age)
        for name in part.units:
            bad = np.flatnonzero(~np.isfinite(part[name]))
            if bad.size:
                first = (float(part[name][bad[0]]), float(part.time_s[bad[0]]), 0)
                value, time_s, count = self.not_finite.get(name, first)
                self.not_finite[name] = value, time_s, count + int(bad.size)

    @classmethod
    def of(cls, trajectory: Trajectory, channels: Iterable[str]) -> Accumulators:
        """Return what a whole trajectory gives."""
        accumulators = cls(tuple(channels))
        accumulators.add(trajectory)
        return accumulators

    @property
    def warnings(self) -> list[str]:
        """A line on each signal that is not finite somewhere: to go on, nothing may have been connected."""
        return [
            f"{name} is {value} at {count} of {self.points} points, first at t = {time_s:.9g} s; nothing is "
            "connected to it"
            for name, (value, time_s, count) in self.not_finite.items()
        ]


class Squares:
    """Integral of the square of a signal from `start_s` on (trapezoids)."""

    def __init__(self, start_s: float = 0.0) -> None:
        self.start_s, self.total = start_s, 0.0

    def add(self, time_s: Array, signal: Array) -> None:
        after = time_s >= self.start_s
        self.total += float(np.trapezoid(signal[after] ** 2, time_s[after]))


class Settling:
    """When |signal| was last above a share of its peak, which is known at the end only.

    Kept are the points after which it is never as large again: whatever the share, the last point above it
    is one of them.
    """

    def __init__(self, start_s: float, band: float) -> None:
        self.start_s, self.band = start_s, band
        self.peak = self._last = 0.0
        self._candidates = np.empty((4, 0))  # time and value of a point, and of the one after it

    def add(self, time_s: Array, signal: Array) -> None:
        size = np.abs(signal)
        self.peak = float(np.maximum(self.peak, np.max(size)))
        after = time_s >= self.start_s
        t, x = time_s[after], size[after]
        if not len(t):
            return
        later = np.maximum.accumulate(x[::-1])[::-1]  # the largest from here on
        new = np.flatnonzero((x[:-1] > later[1:]) & (x[:-1] > self.band * self.peak))
        retained = self._candidates[:, self._candidates[1] > max(later[0], self.band * self.peak)]
        self._candidates = np.hstack([retained, [t[new], x[new], t[new + 1], x[new + 1]]])
        self._last = float(x[-1])

    @property
    def time_s(self) -> float | None:
        """From `start_s` to the last crossing, on the straight line between points; None: still above."""
        limit = self.band * self.peak
        if self._last > limit:
            return None
        outside = self._candidates[:, self._candidates[1] > limit]
        if not outside.size:
            return 0.0
        t, x, t_next, x_next = outside[:, -1]
        return float(t + (t_next - t) * (x - limit) / (x - x_next) - self.start_s)


class Samples:
    """Signals on a uniform grid from `start_s` to `stop_s`, on straight lines between their points."""

    def __init__(self, signals: int, start_s: float, stop_s: float, step_s: float) -> None:
        n = max(0, int(np.floor((stop_s - start_s) / step_s + 1e-9)) + 1)
        self.time_s: Array = start_s + step_s * np.arange(n, dtype=np.float64)
        self.values = np.empty((n, signals))  #: (times, signals)
        self._done = 0

    def add(self, time_s: Array, signals: Sequence[Array]) -> None:
        there = slice(self._done, int(np.searchsorted(self.time_s, time_s[-1], side="right")))
        for k, signal in enumerate(signals):
            self.values[there, k] = np.interp(self.time_s[there], time_s, signal)
            self.values[there.stop :, k] = signal[-1]  # the grid's last point may lie past it by a rounding
        self._done = max(self._done, there.stop)


class Curves:
    """A trajectory to be drawn: every point of a short run, least and largest of each stretch of a long one.

    points : that are to come. The first and the last are exact.
    """

    def __init__(self, points: int) -> None:
        self._width = 1 if points <= DRAWN else -(-points // (DRAWN // 4))
        self._parts: list[Trajectory] = []
        self._last: list[Trajectory] = []

    def add(self, part: Trajectory, names: Iterable[str]) -> None:
        """Take a part, of which `names` are kept."""
        retained = part.thinned(list(dict.fromkeys([TIME, *names])), 0, 1)
        if self._width == 1:  # copies, without which all other columns would stay too
            columns = {name: retained[name].copy() for name in retained.units}
            self._parts.append(Trajectory(columns, retained.units, retained.descriptions, retained.engine))
            return
        begin = np.arange(0, len(part.time_s), self._width)
        drawn = {name: _envelope(retained[name], begin) for name in retained.units}
        first = [] if self._parts else [retained.thinned(list(retained.units), 0, len(part.time_s))]
        self._parts += [*first, Trajectory(drawn, retained.units, retained.descriptions, retained.engine)]
        self._last = [retained.thinned(list(retained.units), -1, 1)]

    @property
    def trajectory(self) -> Trajectory:
        """What was taken, in one."""
        parts = [*self._parts, *self._last]
        one = parts[-1]
        columns = {name: np.concatenate([p[name] for p in parts]) for name in one.units}
        return Trajectory(columns, one.units, one.descriptions, one.engine)


def _envelope(values: Array, begin: npt.NDArray[np.intp]) -> Array:
    """Return two values for each stretch: its least and largest, in the order that its ends have."""
    end = np.append(begin[1:], len(values)) - 1
    least, largest = np.minimum.reduceat(values, begin), np.maximum.reduceat(values, begin)
    rises = values[end] >= values[begin]
    return np.column_stack([np.where(rises, least, largest), np.where(rises, largest, least)]).ravel()


def _columns(row: Hvdc) -> tuple[str, str, str]:
    at = f"plant.{row.name}"
    return f"{at}.p_inverter", f"{at}.q_inverter", f"plant.bus{row.inverter_bus}.v"


@dataclass
class _Link:
    """One link: failures so far, and cos(beta) at the last point, NaN where it carried nothing."""

    row: Hvdc
    share: float  #: its base over that of the case
    before: float = np.nan
    failures: int = 0
    first: tuple[float, float] = (np.nan, np.nan)  #: time, s, and cosine of the extinction angle

    @property
    def least_deg(self) -> float:
        """The critical angle, or `gamma_min_deg` where its control allows less."""
        return min(CRITICAL_DEG, self.row.gamma_min_deg)

    def add(self, time_s: Array, p: Array, q: Array, u: Array) -> None:
        inverter = ends_of(self.row)[1]
        size = np.hypot(p, q) / self.share
        carries, u = size > _NONE, np.maximum(u, 1e-9)
        phi = np.where(carries, p / self.share / np.where(carries, size, 1.0), np.nan)
        rho = inverter.drop * size / (inverter.no_load * u) ** 2
        beta = phi - rho
        after = np.concatenate([[self.before], beta[:-1]]) + 2.0 * rho
        failed = np.flatnonzero(carries & (after > cos(radians(self.least_deg)) + 1e-9))
        if failed.size and not self.failures:
            self.first = float(time_s[failed[0]]), float(after[failed[0]])
        self.failures += int(failed.size)
        self.before = float(beta[-1])


class Commutations:
    """Commutation failures of line-commutated dc links, which the model itself does not have.

    The control of the model sets the firing of the inverter at once. A valve that has fired cannot fire
    again: where the voltage of its bus falls within one communication step, its extinction angle is that of
    the firing before with the voltage and the current after [Thio1996]. Per unit on the base of the link,
    with rho = r i/(c u) of plant/machine/dc_link.h, which phi of the ac side gives,

        cos(phi) = cos(gamma) - rho,   cos(beta) = cos(gamma) - 2 rho,
        cos(gamma after) = cos(beta before) + 2 rho after.

    A jump of the voltage's angle is left out.
    """

    def __init__(self, case: Case) -> None:
        self._links = [_Link(row, row.base_mva / case.base_mva) for row in case.hvdcs]

    def add(self, part: Trajectory) -> None:
        """Take the points of a part; a link whose columns are not there is left out."""
        for link in self._links:
            columns = _columns(link.row)
            if all(name in part for name in columns):
                link.add(part.time_s, *(part[name] for name in columns))

    @property
    def failed(self) -> tuple[str, ...]:
        """The links that fail to commutate."""
        return tuple(link.row.name for link in self._links if link.failures)

    @property
    def warnings(self) -> list[str]:
        """A line on each link that fails to commutate."""
        return [self._line(link) for link in self._links if link.failures]

    @staticmethod
    def _line(link: _Link) -> str:
        time_s, cosine = link.first
        angle = f"an extinction angle of {degrees(acos(cosine)):.3g} deg" if cosine < 1.0 else "no extinction"
        return (
            f"commutation failure of {link.row.name} at its inverter's bus {link.row.inverter_bus}, at "
            f"{link.failures} points, first at t = {time_s:.9g} s: {angle} with the firing of the point "
            f"before, critical: {link.least_deg:g} deg; the model continues without a failure, so the "
            "results from there on are optimistic; add an event hvdc_block over the failure"
        )
