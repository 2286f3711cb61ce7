"""Oscillating signals of a record: one quantity at a uniform rate, and their strongest combinations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import butter, sosfiltfilt

from ..errors import nearest
from .files.even import resampled
from .record import BAND_HZ, Array, Record, RecordError

#: what is looked at where it was measured, the best first
_QUANTITIES = ("speed", "frequency", "active power", "rotor angle", "voltage angle", "voltage")
_ANGLES = ("rotor angle", "voltage angle")
_RATE = 4.0  # samples a period of the upper end of the band
_MOST_COMBINED = 3
_COARSE = 0.3  # of what swings in the band: steps of the numbers above which a quantity is taken last
_LEAST_SHARE = 0.02  # of the motion in the band: a combination with less is noise
_LEAST_SINGULAR = 1e-5  # of the largest: less is rounding
_LEAST_PERIODS = 2.0  # of the lower end of the band


@dataclass(frozen=True, eq=False)
class Swings:
    """The oscillating signals of a record.

    names, terminals : of the signals. unit : theirs. raw : (points, signals). values : without slow motion.
    combined : (points, combinations), of unit size in the band. weights : (combinations, signals), combined =
    values weights^T. patterns : weights, also of combinations that are hardly more than noise. band_hz :
    analysed.
    """

    names: tuple[str, ...]
    terminals: tuple[str, ...]
    quantity: str
    unit: str
    raw: Array
    values: Array
    combined: Array
    weights: Array
    patterns: Array
    step_s: float
    band_hz: tuple[float, float]
    notes: tuple[str, ...]

    @property
    def length_s(self) -> float:
        """Length of the record, s."""
        return len(self.values) * self.step_s

    def of(self, raw: Array) -> Swings:
        """Return the same combinations of other values (points, signals)."""
        values = without_slow_motion(raw, self.step_s, self.band_hz)
        return replace(self, raw=raw, values=values, combined=values @ self.weights.T)


def swings_of(
    record: Record,
    band_hz: tuple[float, float] = BAND_HZ,
    quantity: str | None = None,
    of: Sequence[str] = (),
) -> Swings:
    """Return the signals of the best measured quantity, or of `quantity`, or the channels `of`.

    From speeds, frequencies and angles at three places or more their mean is subtracted. Angles are converted
    to frequencies by their slope.

    Raises
    ------
    RecordError : no such channel, only constant ones, a rate or length insufficient for the band.
    """
    low, high = band_hz
    _require_shown(record, low, high)
    chosen, what, notes = _chosen(record, band_hz, quantity, of)
    values = np.column_stack([record[c] for c in chosen])
    unit = next(c.unit for c in record.channels if c.name == chosen[0])
    if what in _ANGLES:
        values, unit = np.gradient(values, record.step_s, axis=0) / (2.0 * np.pi), "Hz"
    if values.shape[1] >= 3 and what in ("speed", "frequency", *_ANGLES):
        values = values - values.mean(axis=1, keepdims=True)
        notes.append("the mean of all places is removed")
    step_s = record.step_s
    if step_s * _RATE * high < 0.75:
        values, step_s, _ = resampled(values, step_s, _RATE * high, record.source)
    raw, values = values, without_slow_motion(values, step_s, band_hz)
    inside = _passed(values, step_s, band_hz)
    size = inside.std(axis=0)
    if not size.max() > 0.0:
        raise RecordError(f"{record.source}: no {what} varies from {low:g} to {high:g} Hz")
    scale = 1.0 / np.maximum(size, 1e-6 * size.max())
    _, sigma, right = np.linalg.svd(inside * scale, full_matrices=False)
    share = sigma**2 / np.sum(sigma**2)
    count = int(min(_MOST_COMBINED, max(1, np.sum(share > _LEAST_SHARE))))
    most = int(min(_MOST_COMBINED, np.sum(sigma > _LEAST_SINGULAR * sigma[0])))
    patterns = right[:most] * scale / (sigma[:most, None] / np.sqrt(len(values)))
    weights = patterns[:count]
    terminal = {c.name: c.terminal for c in record.channels}
    return Swings(
        tuple(chosen), tuple(terminal[n] for n in chosen), what, unit, raw, values, values @ weights.T,
        weights, patterns, step_s, band_hz, tuple(notes),
    )  # fmt: skip


def _require_shown(record: Record, low: float, high: float) -> None:
    """Raise unless the record is quick and long enough for a band."""
    if not 0.0 < low < high:
        raise RecordError(f"band {low:g}:{high:g} Hz, allowed: 0 < low < high")
    if not 1.0 / record.step_s >= 2.0 * high:
        least = 0.5 / record.step_s
        remedy = (
            f"a band that ends below {least:.4g} Hz" if low < least else "the unit of its times, as Time [ms]"
        )
        raise RecordError(
            f"{record.source}: {1.0 / record.step_s:.4g} samples a second are too few for {high:g} Hz, "
            f"wanted: {2.0 * high:g} at least, or {remedy}"
        )
    if not record.length_s >= 0.99 * _LEAST_PERIODS / low:
        least = _LEAST_PERIODS / record.length_s
        remedy = f"or a band from {least:.2g} Hz" if least < high else "or another unit of its times"
        raise RecordError(
            f"{record.source}: {record.length_s:.4g} s are too short for {low:g} Hz, wanted: "
            f"{_LEAST_PERIODS / low:g} s at least, {remedy}"
        )


def _chosen(
    record: Record, band_hz: tuple[float, float], quantity: str | None, of: Sequence[str]
) -> tuple[list[str], str, list[str]]:
    """Return the channels to look at, their quantity, and notes."""
    still = set(record.still())
    what, names, notes = _requested(record, of, quantity) if of else _best(record, band_hz, quantity, still)
    moving = [n for n in names if n not in still]
    if not moving:
        if not names:
            there = nearest(what, (c.quantity for c in record.channels))
            raise RecordError(f"{record.source}: no channel of {what} is there; {there}")
        raise RecordError(
            f"{record.source}: none of {', '.join(names[:4])} varies, wanted: a measured "
            f"{' or '.join(_QUANTITIES[:3])} that varies"
        )
    left = [n for n in names if n in still]
    return moving, what, [*notes, *([f"{', '.join(left[:6])}: constant, left out"] if left else [])]


def _requested(record: Record, of: Sequence[str], quantity: str | None) -> tuple[str, list[str], list[str]]:
    for name in of:
        record[name]  # raises for one that is not there
    kinds = {c.quantity for c in record.channels if c.name in of}
    if len(kinds) > 1 or (quantity is not None and kinds != {quantity}):
        single = quantity or "one quantity"
        raise RecordError(f"{record.source}: channels of {' and '.join(sorted(kinds))}, wanted: of {single}")
    return kinds.pop(), list(of), []


def _best(
    record: Record, band_hz: tuple[float, float], quantity: str | None, still: set[str]
) -> tuple[str, list[str], list[str]]:
    """Return the first quantity that moves and whose numbers are fine enough, its channels, and notes."""
    quantities = _QUANTITIES if quantity is None else (quantity,)
    there = {q: [c.name for c in record.channels if c.quantity == q] for q in quantities}
    live = [q for q in quantities if not still.issuperset(there[q])]
    fine = [q for q in live if q in _ANGLES or not _coarse(record, set(there[q]) - still, band_hz)]
    what = (fine or live or list(quantities))[0]
    coarse = quantity is None and bool(live) and what != live[0]
    return what, there[what], [f"{live[0]}: its resolution is too coarse"] if coarse else []


def _coarse(record: Record, names: set[str], band_hz: tuple[float, float]) -> bool:
    """Whether the numbers of most channels step by much of what swings in a band."""
    coarse = 0
    for name in names:
        values = np.sort(record[name])
        steps = np.diff(values)
        step = float(np.median(steps[steps > 1e-9 * np.ptp(values)]))
        coarse += step > _COARSE * float(_passed(record[name][:, None], record.step_s, band_hz).std())
    return coarse > len(names) / 2


def without_slow_motion(values: Array, step_s: float, band_hz: tuple[float, float]) -> Array:
    """Return values (points, signals) without motion slower than a band, by a zero-phase filter.

    The filter distorts steady oscillations near the ends: remove lines first (`forced.without`).
    """
    return _passed(values, step_s, (0.8 * band_hz[0], None))


def _passed(values: Array, step_s: float, band_hz: tuple[float, float | None]) -> Array:
    """Return what lies in a band, by a filter of zero phase."""
    low, high = band_hz
    nyquist = 0.5 / step_s
    if high is None or high >= 0.98 * nyquist:
        sos = butter(2, low / nyquist, "high", output="sos")
    else:
        sos = butter(2, [low / nyquist, high / nyquist], "band", output="sos")
    return np.asarray(sosfiltfilt(sos, values - values.mean(axis=0), axis=0))
