"""Verdict of a run: one rule for single runs, sweeps, screenings, acceptance, studies and the explorer.

Synchronism is judged by the angles of all machines, and of all converters that are voltage sources, of each
island over the whole run. Decay is judged by spans (largest minus least value in a window) of each machine's
speed relative to the mean of its island, of that mean without its linear trend, and of each control signal.
Three windows are compared: all from the last event on, the last `LAST_S` (a quarter of the judged time if
that is longer), and the window of the same length before it. No window contains an instant at which an event
or an outage begins or ends.

``explorer/web/judge.js`` is the same rule in JavaScript; a test runs both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from .accumulators import Samples
from .largest_deviation import OUT_OF_STEP_DEG

Array = npt.NDArray[np.float64]
SETTLED, SLOW, STANDING, GROWING, LOST = VERDICTS = (
    "settled",
    "settling slowly",
    "standing swing",
    "growing",
    "synchronism lost",
)
STABLE = (SETTLED, SLOW)  #: the machines stay together, and what is left of a disturbance falls
NOT_JUDGED = "not judged"  #: the run ends too soon after its last event; no success
LAST_S = 5.0  #: at least half a period of the slowest swing that counts (0.1 Hz)
SETTLED_SHARE = 0.2  #: of the largest swing: below it and falling a swing has settled
RESIDUE = 0.02  #: of the largest swing, the band of the settling time: what lies within is no swing any more
SUSTAINED = 0.005  #: share by which a swing must shrink from one window to the next to be falling
GROWTH = 0.02  #: share by which it must rise to be growing
AT_LIMIT = 1e-3  #: how near to its limit a control counts as at it
NOTHING = 1e-9  #: pu: rounding of a grid at rest
SHOWS = 2.0  #: a run that lasts so many time constants of a growing root shows it
LEAST_S = 2.0  #: shorter than this nothing is judged after an event: four periods of the fastest swing, 2 Hz
#: the rule in words, for what is written beside a verdict
RULE = (
    "synchronism lost: two machines (or converters that are voltage sources) of an island half a turn apart; "
    "else by the spans of the machines' speeds against their island's mean and of the controls in the last "
    f"{LAST_S:g} s (a quarter of the time judged where that is longer), which holds no event and no end of "
    "an outage: settled, below a fifth of the largest and falling (or within 2 % of it); settling slowly, "
    "falling; growing; else standing swing, as a control at its limit is; growing too where the linear loop "
    "has a growing root that the run is too short to show"
)
_MOST_SAMPLES = 512  #: of an island's mean speed in a window


@dataclass(frozen=True)
class Verdict:
    """The verdict of a run with its evidence.

    name : one of `VERDICTS`, or `NOT_JUDGED`. why : in words with the numbers. window_s : judged for decay.
    largest, before, last : spans of what decided, pu: from the last event on, in the window before the last,
    in the last. angle_deg : largest between two machines or sources of one island, of the whole run, `pair`;
    lost_s : when it first reached half a turn, None: never.
    """

    name: str
    why: str
    window_s: tuple[float, float]
    largest: float
    before: float
    last: float
    angle_deg: float
    lost_s: float | None
    pair: tuple[str, str] | None

    @property
    def stable(self) -> bool:
        """Whether the machines kept synchronism and the remaining swing decays."""
        return self.name in STABLE

    @property
    def synchronous(self) -> bool:
        """Whether no angle between two machines or sources of an island reached half a turn."""
        return self.lost_s is None

    @property
    def slips(self) -> int:
        """Number of whole turns between two of them."""
        return int(self.angle_deg // 360.0)

    def __str__(self) -> str:
        return f"{self.name}: {self.why}"


@dataclass
class Motion:
    """Receives the points of a run in parts, in the order of time, and returns its `Verdict`.

    machines : names, in the order of the rows of speeds. sources : names of the converters that are voltage
    sources, whose angles come after those of the machines. islands : rows of the angles of each. events_s :
    instants of events; event_times_s : of outages too. stop_s : last point. omega_b : rad/s, by which
    speeds are integrated where the plant shows no angles; the sources are not judged then.
    """

    machines: Sequence[str]
    islands: Sequence[Sequence[int]]
    events_s: Sequence[float]
    event_times_s: Sequence[float]
    stop_s: float
    omega_b: float
    sources: Sequence[str] = ()
    window_s: tuple[float, float] = field(init=False)
    _controls: tuple[str, ...] = ()
    _angle: Array | None = None
    angle_deg: float = 0.0
    lost_s: float | None = None
    pair: tuple[str, str] | None = None
    unseen: tuple[str, ...] = ()  #: sources whose angles the plant does not show

    def __post_init__(self) -> None:
        self.window_s = begin, end = window_of(self.events_s, self.event_times_s, self.stop_s)
        self.width_s = width = min(max(LAST_S, 0.25 * (end - begin)), 0.5 * (end - begin))
        since = max((t for t in self.events_s if t < end), default=0.0)
        self._ends_with_mark = end < self.stop_s or any(t >= end for t in self.event_times_s)
        self._windows = ((since, end), (end - 2.0 * width, end - width), (end - width, end))
        self._spans: dict[str, Spans] = {k: Spans(self._windows) for k in ("speeds", "means", "controls")}
        spacing = max(0.05, width / _MOST_SAMPLES)
        of_machines = ([k for k in rows if k < len(self.machines)] for rows in self.islands)
        self._machines = [rows for rows in of_machines if rows]
        self._means = [Samples(len(self._machines), a, b, spacing) for a, b in self._windows[1:]]

    def add(self, time_s: Array, speeds: Array, angles: Array | None, controls: Mapping[str, Array]) -> None:
        """Take points; speeds (machines, points), pu; angles (machines, then sources), rad; controls, pu.

        Each part begins with the last point of the part before it.
        """
        self._synchronism(time_s, speeds, angles)
        begin, end = self._windows[0]
        # an event's instant is recorded twice, before and after
        inside = ((time_s > begin) | (begin == 0.0)) & (
            (time_s < end) if self._ends_with_mark else (time_s <= end)
        )
        means = np.array([speeds[rows].mean(axis=0) for rows in self._machines])
        for window in self._means:
            if time_s[-1] >= window.time_s[0] and len(window.time_s):
                window.add(time_s, list(means))
        self._controls = tuple(controls)
        if not np.any(inside):
            return
        relative = speeds.copy()
        for rows, mean in zip(self._machines, means, strict=True):
            if len(rows) > 1:  # of a machine alone its own speed
                relative[rows] -= mean
        time, selected = time_s[inside], {"speeds": relative, "means": means}
        if controls:
            selected["controls"] = np.array(list(controls.values()))
        for name, values in selected.items():
            self._spans[name].add(time, values[:, inside])

    def verdict(self, limit_pu: float | None, root: complex | None = None) -> Verdict:
        """Return the verdict of the run.

        limit_pu : of the magnitude of every control signal, None where they have none. root : the least
        damped of the linear loop in the window that is judged, 1/s; None where it is not known. A run in
        which nothing moves, or that is shorter than such a root takes to show, cannot contradict it.
        """
        if self.lost_s is not None:
            slips = int(self.angle_deg // 360.0)
            why = f"{' and '.join(self.pair or ())} half a turn apart at {self.lost_s:.2f} s, at most "
            why += f"{self.angle_deg:.0f} degrees" + (f", {slips} slip{'s' * (slips > 1)}" if slips else "")
            return self._verdict(LOST, why)
        begin, end = self.window_s
        if not end - begin >= min(LEAST_S, self.stop_s):
            return self._verdict(NOT_JUDGED, f"the run ends {end - begin:.2g} s after the last event")
        used = self._spans["controls"].size[2]
        decays = self._decays()
        if limit_pu is not None and used is not None:
            at = np.flatnonzero(used >= (1.0 - AT_LIMIT) * limit_pu)
            if at.size:
                name = self._controls[int(at[0])]
                what = f"{name} is at its limit of {limit_pu:g} pu in the last {self.width_s:.3g} s"
                return self._verdict(STANDING, what, *decays[2])
        name, why, spans = decays
        rate = 0.0 if root is None else root.real
        seen = spans[0] >= NOTHING and rate * (end - begin) >= SHOWS
        if root is not None and rate > 0.0 and name in STABLE and not seen:
            pair = f"{rate:+.3g} +- {abs(root.imag):.3g}j"
            return self._verdict(
                GROWING, f"the linear loop has the root {pair} 1/s; in this run {why}", *spans
            )
        return self._verdict(name, why, *spans)

    @property
    def names(self) -> tuple[str, ...]:
        """Machines, then sources: the rows of angles."""
        return (*self.machines, *self.sources)

    @property
    def rule(self) -> str:
        """The rule in words, with the parts that could not be applied."""
        if not self.unseen:
            return RULE
        number, first = len(self.unseen), self.unseen[0]
        names = first if number == 1 else f"{first} and {number - 1} more converters"
        return f"{RULE}; not judged: the angle of {names}, which is not an output of the plant"

    @property
    def at_rest(self) -> bool:
        """Whether nothing moved, so that only the linear loop can tell."""
        spans = self._spans["speeds"].of(0)
        return spans is None or not float(np.max(spans)) >= NOTHING

    def _verdict(
        self, name: str, why: str, largest: float = 0.0, before: float = 0.0, last: float = 0.0
    ) -> Verdict:
        return Verdict(
            name, why, self.window_s, largest, before, last, self.angle_deg, self.lost_s, self.pair
        )

    def _decays(self) -> tuple[str, str, tuple[float, float, float]]:
        """Return verdict, reason and spans of the least decaying of speeds, common speed and controls."""
        speeds = self._family("speeds")
        candidates = [(*_judged(*speeds[:3]), speeds)]
        means = [_detrended(w) for w in self._means]
        together = [k for k, rows in enumerate(self._machines) if len(rows) > 1]
        raw = self._spans["means"].of(0)
        if together and raw is not None and all(len(x) for x in means):
            # a slow, well damped common swing is shorter than its period in a window: it counts while large
            k = max(together, key=lambda k: float(means[1][k]))
            largest = max(speeds[0], float(raw[k]))
            common = (largest, float(means[0][k]), float(means[1][k]), "the common speed")
            if common[2] > SETTLED_SHARE * largest:
                candidates.append((*_judged(*common[:3]), common))
        if self._controls:
            controls = self._family("controls")
            candidates.append((*_judged(*controls[:3]), controls))
        place, _, (largest, before, last, what) = max(candidates, key=lambda c: (c[0], c[1]))
        name = VERDICTS[place]
        if largest < NOTHING:
            return name, "nothing moves", (largest, before, last)
        why = (
            f"{what} spans {_share(last, largest)} of the largest swing in the last {self.width_s:.3g} s, "
            f"{_share(before, largest)} in the {self.width_s:.3g} s before"
        )
        if self.window_s[1] < self.stop_s:
            why += f"; judged up to {self.window_s[1]:g} s: less than {LAST_S:g} s follow the change there"
        return name, why, (largest, before, last)

    def _family(self, name: str) -> tuple[float, float, float, str]:
        """Return the spans of the signal of a family that decays worst, and its name."""
        largest, before, last = (self._spans[name].of(k) for k in range(3))
        if largest is None or before is None or last is None:
            return 0.0, 0.0, 0.0, name
        scale = float(np.max(largest))  # a signal that hardly moves is compared with those that do
        worst = max(
            range(len(last)),
            key=lambda k: (*_judged(scale, float(before[k]), float(last[k])), float(last[k])),
        )
        signal = f"the speed of {self.machines[worst]}" if name == "speeds" else self._controls[worst]
        return scale, float(before[worst]), float(last[worst]), signal

    def _synchronism(self, time_s: Array, speeds: Array, angles: Array | None) -> None:
        if angles is None:  # moved against one another since the start, by their speeds
            if self._angle is None:
                self._angle = np.zeros(len(speeds))
            steps = 0.5 * self.omega_b * np.diff(time_s) * (speeds[:, 1:] + speeds[:, :-1])
            angles = self._angle[:, None] + np.hstack([np.zeros((len(speeds), 1)), np.cumsum(steps, axis=1)])
            self._angle = angles[:, -1].copy()
            self.unseen = tuple(self.sources)
        names = self.names
        for rows in self._machines if len(angles) < len(names) else self.islands:
            part = angles[rows]
            apart = np.degrees(np.ptp(part, axis=0))
            k = int(np.argmax(apart))
            if apart[k] > self.angle_deg:
                self.angle_deg = float(apart[k])
                ends = rows[int(np.argmax(part[:, k]))], rows[int(np.argmin(part[:, k]))]
                self.pair = names[ends[0]], names[ends[1]]
            lost = np.flatnonzero(apart >= OUT_OF_STEP_DEG)
            if lost.size and (self.lost_s is None or time_s[lost[0]] < self.lost_s):
                self.lost_s = float(time_s[lost[0]])


class Spans:
    """Largest minus least value of each signal in each window, and the largest magnitude there."""

    def __init__(self, windows: Sequence[tuple[float, float]]) -> None:
        self.windows = windows
        self._low: list[Array | None] = [None] * len(windows)
        self._high: list[Array | None] = [None] * len(windows)

    def add(self, time_s: Array, values: Array) -> None:
        """Take values (signals, points)."""
        for k, (begin, end) in enumerate(self.windows):
            inside = (time_s >= begin) & (time_s <= end)
            if not np.any(inside):
                continue
            selected = values[:, inside]
            low, high = selected.min(axis=1), selected.max(axis=1)
            old_low, old_high = self._low[k], self._high[k]
            self._low[k] = low if old_low is None else np.minimum(old_low, low)
            self._high[k] = high if old_high is None else np.maximum(old_high, high)

    def of(self, window: int) -> Array | None:
        """Return the spans in a window; None where no point was in it."""
        low, high = self._low[window], self._high[window]
        return None if low is None or high is None else high - low

    @property
    def size(self) -> list[Array | None]:
        """The largest magnitude of each signal in each window."""
        both = zip(self._low, self._high, strict=True)
        return [None if a is None or b is None else np.maximum(np.abs(a), np.abs(b)) for a, b in both]


def window_of(
    events_s: Sequence[float], event_times_s: Sequence[float], stop_s: float
) -> tuple[float, float]:
    """Return the window for the decay: from one event time to the next, or to the end of the run.

    It begins at the last event time; if less than `LAST_S` remains, at an earlier one that leaves as much,
    but never before the last event.
    """
    last_event = max((t for t in events_s if t < stop_s), default=0.0)
    edges = sorted({last_event, stop_s, *(t for t in event_times_s if last_event < t < stop_s)})
    pairs = list(pairwise(edges))
    long = [pair for pair in pairs if pair[1] - pair[0] >= LAST_S]
    return (long or [max(pairs, key=lambda pair: pair[1] - pair[0])])[-1]


def _judged(largest: float, before: float, last: float) -> tuple[int, float]:
    """Return the position in `VERDICTS` of a signal with these spans, and the ratio of the last two spans."""
    ratio = last / before if before > 0.0 else float(last > 0.0) * 2.0
    if largest < NOTHING or last < NOTHING:
        return 0, 0.0
    if last <= RESIDUE * largest:
        return 0, 0.0
    if ratio <= 1.0 - SUSTAINED:
        return (0 if last <= SETTLED_SHARE * largest else 1), ratio
    return (3 if ratio >= 1.0 + GROWTH else 2), ratio


def _detrended(samples: Samples) -> Array:
    """Return the span of each signal less its straight line; empty where there are few samples."""
    time, values = samples.time_s, samples.values
    if len(time) < 3:
        return np.empty(0)
    basis = np.column_stack([np.ones_like(time), time - time.mean()])
    rest = values - basis @ np.linalg.lstsq(basis, values, rcond=None)[0]
    return np.asarray(np.ptp(rest, axis=0))


def _share(part: float, whole: float) -> str:
    share = part / whole if whole > 0.0 else 0.0
    return f"{100.0 * share:.0f} %" if share >= 0.095 else f"{100.0 * share:.2g} %"
