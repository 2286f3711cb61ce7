"""Time as a whole number of ticks of 1 ns, and the communication points of a run.

A float sum of steps drifts and never lands on an event. Here t = t0 + k H in
whole ticks, steps are shortened to end at known instants (*event times*: events,
outages), and a time between two ticks is taken as the nearer one, at most
0.5 ns away (`on_tick`; results say so). The seconds handed to an FMU are the double nearest to
the decimal time, so 3 steps of 10 ms are 0.03 to the bit.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, overload

from pydantic import BaseModel

from .errors import ScenarioError

if TYPE_CHECKING:  # a scenario is checked without numpy: it takes as long as all else together
    import numpy as np
    import numpy.typing as npt


TICKS_PER_SECOND = 1_000_000_000
_MAX_SECONDS = 9.0e6  # 9e15 ticks: whole ticks are still exact as doubles


def seconds(ticks: int) -> float:
    """Return a tick count in seconds, rounded once to the nearest double.

    >>> seconds(30_000_000)
    0.03
    """
    return ticks / TICKS_PER_SECOND


def to_ticks(value_s: float, what: str) -> int:
    """Return the number of ticks nearest to `value_s` seconds.

    >>> to_ticks(1.0 + 8.0 / 60.0, "end_s")
    1133333333

    Raises
    ------
    ScenarioError : not finite, beyond 9e6 s, or so short that rounding would make it nothing.
    """
    value = float(value_s)
    if not abs(value) <= _MAX_SECONDS:
        raise ScenarioError(f"{what} = {value:g} s: a finite time of at most {_MAX_SECONDS:g} s is needed")
    ticks = round(value * TICKS_PER_SECOND)
    if value and not ticks:
        raise ScenarioError(f"{what} = {value:g} s is shorter than a tick, allowed: 0 or at least 1e-9")
    return ticks


def on_tick(value_s: float, what: str) -> float:
    """Return the instant of the clock nearest to `value_s`, s.

    >>> on_tick(1.0 + 8.0 / 60.0, "end_s")
    1.133333333

    Raises
    ------
    ScenarioError : see `to_ticks`.
    """
    return seconds(to_ticks(value_s, what))


def moved(requested_s: float, used_s: float) -> bool:
    """Whether a time and what it was taken as differ by more than the rounding of a sum of doubles."""
    return abs(requested_s - used_s) > 4.0 * math.ulp(used_s)


class Step(NamedTuple):
    """One communication step, in ticks.

    `edge`: a step of one tick before or after a mark, in which signals may
    jump; `recorded`: its end is a grid point, a mark or the end of the run.
    """

    start: int
    end: int
    edge: bool
    recorded: bool

    @property
    def start_s(self) -> float:
        return seconds(self.start)

    @property
    def length_s(self) -> float:
        return seconds(self.end - self.start)


@dataclass(frozen=True)
class Clock:
    """The communication points from `start` to `stop` in ticks: every `step`, every mark.

    With `edges` a mark is surrounded by points one tick before and after it:
    what a signal was just before a jump and what it is just after are then
    both known, whichever of the two an FMU reports at the instant itself.
    `points` are instants from which on a held signal has a new value (packets
    that arrive): communication points that are not recorded, with one more a
    tick later, where slopes of what depends on it are new. `slope_events` are instants
    at which slopes jump and nothing else: treated as event times, not recorded.
    """

    start: int
    stop: int
    step: int
    event_times: tuple[int, ...] = ()
    edges: bool = True
    points: tuple[int, ...] = ()
    slope_events: tuple[int, ...] = ()

    @classmethod
    def of_seconds(
        cls,
        stop_s: float,
        step_s: float,
        *,
        start_s: float = 0.0,
        event_times_s: Iterable[float] = (),
        edges: bool = True,
    ) -> Clock:
        """Return the clock of a run given in seconds.

        Raises
        ------
        ScenarioError : step not positive, stop not after start, a time between ticks.
        """
        start, stop, step = (
            to_ticks(start_s, "start_s"),
            to_ticks(stop_s, "stop_s"),
            to_ticks(step_s, "step_s"),
        )
        if not step > 2:
            raise ScenarioError(f"step_s = {step_s!r}: must be positive and longer than 2 ns")
        if not stop > start:
            raise ScenarioError(f"stop_s = {stop_s!r}: must lie after the start, {start_s!r} s")
        event_times = sorted({to_ticks(m, "event time") for m in event_times_s})
        return cls(start, stop, step, tuple(m for m in event_times if start < m < stop), edges)

    @cached_property
    def steps(self) -> Steps:
        """All steps of the run in order."""
        import numpy as np

        grid = np.arange(self.start + self.step, self.stop, self.step, dtype=np.int64)
        event_times = np.array(self.event_times, dtype=np.int64)
        points = np.array(self.points, dtype=np.int64)
        retained = np.append(grid, self.stop)  # of 1e7 steps each array counts: no more of them than needed
        del grid
        if event_times.size:
            retained = np.union1d(retained, event_times)
        around = [points]
        near = np.empty(0, dtype=np.int64)
        if self.edges:
            slope_events = np.append(event_times, np.array(self.slope_events, dtype=np.int64))
            around += [points + 1, slope_events - 1, slope_events, slope_events + 1]
            near = np.concatenate([slope_events, slope_events + 1, points + 1])
        extra = np.concatenate(around)
        extra = extra[(self.start < extra) & (extra < self.stop)]
        ends = np.union1d(retained, extra) if extra.size else retained
        short = np.append(ends[0] - self.start == 1, ends[1:] - ends[:-1] == 1)
        edge = np.zeros(len(ends), dtype=bool)
        edge[short] = np.isin(ends[short], near)
        recorded = np.ones(len(ends), dtype=bool)
        if ends is not retained:
            recorded[:] = False
            recorded[np.searchsorted(ends, retained)] = True
        ticks = array("q")
        ticks.frombytes(ends.data.cast("B"))
        return Steps(self.start, ticks, edge, recorded)


class Steps(Sequence[Step]):
    """Steps that follow one another: `start`, then where each ends, what each is; eight bytes an end."""

    def __init__(
        self, start: int, ends: array[int], edge: npt.NDArray[np.bool_], recorded: npt.NDArray[np.bool_]
    ) -> None:
        self.start, self.ends, self.edge, self.recorded = start, ends, edge, recorded

    def __len__(self) -> int:
        return len(self.ends)

    @overload
    def __getitem__(self, k: int) -> Step: ...

    @overload
    def __getitem__(self, k: slice) -> list[Step]: ...

    def __getitem__(self, k: int | slice) -> Step | list[Step]:
        """Return step number `k`, or those of a slice."""
        if isinstance(k, slice):
            return [self[i] for i in range(*k.indices(len(self)))]
        k = range(len(self))[k]
        start = self.ends[k - 1] if k else self.start
        return Step(start, self.ends[k], bool(self.edge[k]), bool(self.recorded[k]))


def event_on_ticks(event: Any, where: str) -> Any:
    """Return an event with its instants on ticks of the clock.

    Raises
    ------
    ScenarioError : it would begin and end at the same tick.
    """
    own = {key: getattr(event, key, None) for key in ("start_s", "end_s")}
    used = {key: on_tick(at, f"{where} ({event.kind}): {key}") for key, at in own.items() if at is not None}
    if "end_s" in used and not used["end_s"] > used["start_s"]:
        raise ScenarioError(
            f"{where} ({event.kind}): start_s = {own['start_s']!r} and end_s = {own['end_s']!r} fall "
            "on one tick of the clock (1 ns), allowed: at least 1e-9 apart"
        )
    same = all(used[key] == own[key] for key in used)
    return event if same else event.model_copy(update=used)


def roundings(provided: Any, used: Any, where: str = "") -> list[str]:
    """Return a line for each time of a table that is not taken as it was written."""
    if isinstance(provided, BaseModel):
        provided = dict(provided)
    if isinstance(provided, Mapping):
        fields = used if isinstance(used, Mapping) else dict(used) if isinstance(used, BaseModel) else {}
        pairs = [(f"{where}.{k}" if where else str(k), value, fields.get(k)) for k, value in provided.items()]
    elif isinstance(provided, list | tuple) and isinstance(used, list | tuple):
        pairs = [
            (f"{where} {k}", a, b) for k, (a, b) in enumerate(zip(provided, used, strict=False), start=1)
        ]
    elif isinstance(provided, float) and isinstance(used, float) and moved(provided, used):
        return [f"{where} = {provided!r} s is rounded to {used!r} s, a tick of the clock"]
    else:
        return []
    return [line for name, a, b in pairs for line in roundings(a, b, name)]
