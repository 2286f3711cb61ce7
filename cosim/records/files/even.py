"""Samples on an even time axis: gaps filled or cut, angles unwrapped, and all of it said."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from ..record import ANGLES, Array, RecordError
from .names import Raw

_ROUNDED = 0.25  # of a step: a stamp that lies this near to its place is a rounded one
_MOST_LOST = 0.2  # of a channel's samples
_LEAST_POINTS = 8
_NAMED = 3  # channels with missing samples that are named

Places = npt.NDArray[np.intp]


def even_times(source: str, stamps: Array) -> tuple[Places, Places, float, list[str]]:
    """Return which samples are used, their places on an even axis, its spacing in s, and notes.

    stamps : (points,), s. Stamps are rounded in files: the spacing is that of the line through them.

    Raises
    ------
    RecordError : too few samples, stamps that go back or jump, or that lie at no even spacing.
    """
    if len(stamps) < _LEAST_POINTS:
        raise RecordError(f"{source}: {len(stamps)} samples, wanted: at least {_LEAST_POINTS}")
    if not np.isfinite(stamps).all():
        row = int(np.flatnonzero(~np.isfinite(stamps))[0]) + 1
        raise RecordError(f"{source}: sample {row} has no time, wanted: a number of seconds or a date")
    steps = np.diff(stamps)
    back = np.flatnonzero(steps < 0.0)
    if back.size:
        k = int(back[0])
        raise RecordError(
            f"{source}: the time decreases from {stamps[k]:.6g} to {stamps[k + 1]:.6g} s at sample {k + 2}, "
            "allowed: increasing times; split the file there and read each part"
        )
    step = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 0.0
    if not step > 0.0:
        raise RecordError(f"{source}: all samples have the same time, wanted: increasing times")
    step = float(steps[(steps > 0.5 * step) & (steps < 1.5 * step)].mean())  # stamps are rounded
    counted = np.concatenate([[0.0], np.cumsum(np.round(steps / step))])
    if counted[-1] > 0.0:
        near = np.abs(steps / step - np.round(steps / step)) < _ROUNDED
        if near.mean() < 0.9:
            raise RecordError(
                f"{source}: {np.mean(~near):.0%} of the samples do not fit an even spacing of {step:.4g} s, "
                "allowed: samples at one rate; resample the signals at their source"
            )
        step = float(np.polyfit(counted, stamps, 1)[0])
    place = np.round((stamps - stamps[0]) / step).astype(np.intp)
    away = np.abs((stamps - stamps[0]) / step - place)
    used = _nearest(place, away)
    notes = []
    off = int(np.sum(away[used] > _ROUNDED))
    if off:
        notes.append(f"{off} time stamps deviate from the even spacing of {step:.6g} s: moved to the nearest")
    twice = int(np.sum(steps == 0.0))
    if twice:
        notes.append(f"{twice} samples occur twice: the last of each is used")
    between = len(stamps) - len(used) - twice
    if between > 0:
        notes.append(f"{between} samples lie between those of the even spacing: left out")
    return used, place[used], step, notes


def _nearest(place: Places, away: Array) -> Places:
    """Return of the samples at each place the nearest to it, the last of several, as at an event of a run."""
    order = np.lexsort((-np.arange(len(place)), away, place))
    _, first = np.unique(place[order], return_index=True)
    return np.asarray(order[first], dtype=np.intp)


def longest_piece(source: str, place: Places, step_s: float, fill_s: float) -> tuple[slice, list[str]]:
    """Return the samples of the longest piece without a gap of more than `fill_s`, and notes."""
    gaps = np.flatnonzero(np.diff(place) * step_s > max(fill_s, 1.5 * step_s))
    lost = int(np.sum(np.maximum(np.diff(place) - 1, 0)))
    if not gaps.size:
        return slice(0, len(place)), [f"{lost} frames are missing: interpolated"] if lost else []
    ends = [0, *(int(k) + 1 for k in gaps), len(place)]
    pieces = [slice(a, b) for a, b in pairwise(ends)]
    best = max(pieces, key=lambda s: int(place[s.stop - 1] - place[s.start]))
    from_s, to_s = (float((place[k] - place[0]) * step_s) for k in (best.start, best.stop - 1))
    k = int(gaps[np.argmax(np.diff(place)[gaps])])
    hole = (
        f"{float((place[k + 1] - place[k]) * step_s):.3g} s at {float((place[k] - place[0]) * step_s):.6g} s"
    )
    if not to_s - from_s >= 0.5 * float(place[-1] - place[0]) * step_s:
        raise RecordError(
            f"{source}: the time stamps jump, by {hole} at most, and no part without a jump of more than "
            f"{fill_s:g} s is half of the record; allowed: one such part; split the file, or raise fill_s"
        )
    return best, [
        f"gaps of more than {fill_s:g} s, the longest {hole}: only {from_s:g} to {to_s:g} s is used"
    ]


def on_axis(
    source: str,
    place: Places,
    values: Array,
    raws: Sequence[Raw],
    step_s: float,
    fill_s: float,
) -> tuple[Array, list[Raw], list[str]]:
    """Return values (points, channels) on the even axis, the channels that are left, and notes.

    values : (samples, channels) in the units of a record; NaN where a sample is missing. Angles are
    unwrapped before anything is interpolated.
    """
    place = place - place[0]
    points = int(place[-1]) + 1
    everywhere = np.arange(points)
    left: list[Raw] = []
    result, notes = np.empty((points, len(raws))), []
    filled: dict[str, int] = {}
    for raw, column in zip(raws, values.T, strict=True):
        full = np.full(points, np.nan)
        full[place] = column
        there = np.flatnonzero(np.isfinite(full))
        channel = raw.channel
        if there.size < 2 or not there.size >= (1.0 - _MOST_LOST) * points:
            notes.append(
                f"{channel.name}: {1.0 - there.size / points:.0%} of its samples are missing: left out"
            )
            continue
        hole = int(max(np.diff(there).max(), there[0] + 1, points - there[-1]))
        if hole > 1 and not hole * step_s <= max(fill_s, 2.5 * step_s):
            notes.append(f"{channel.name}: a gap of {hole * step_s:.3g} s: left out (fill_s = {fill_s:g} s)")
            continue
        known = np.unwrap(full[there]) if channel.quantity in ANGLES else full[there]
        if there.size < points and there.size < len(np.unique(place)):
            filled[channel.name] = len(np.unique(place)) - there.size
        result[:, len(left)] = np.interp(everywhere, there, known)
        left.append(raw)
    if not left:
        raise RecordError(
            f"{source}: no channel is left, {'; '.join(notes[:3])}; wanted: channels without long gaps"
        )
    if filled:
        most = sorted(filled, key=lambda name: -filled[name])[:_NAMED]
        more = f", and {len(filled) - _NAMED} channels more" if len(filled) > _NAMED else ""
        named = ", ".join(f"{name} ({filled[name]})" for name in most)
        notes.append(f"samples are missing and interpolated: {named}{more}")
    return result[:, : len(left)], left, notes


def resampled(values: Array, step_s: float, rate_hz: float, source: str) -> tuple[Array, float, str]:
    """Return values at a lower rate, without what would alias, their spacing in s, and a note."""
    from fractions import Fraction

    from scipy.signal import resample_poly

    most = 1.0 + 1e-3  # of the rate of a record whose stamps are rounded
    target = rate_hz * step_s
    share = Fraction(target).limit_denominator(1000) if 0.0 < target < most else Fraction(0)
    if not 0 < share <= 1:
        raise RecordError(
            f"{source}: rate_hz = {rate_hz:g}, allowed: above 0 up to the record's own {1.0 / step_s:g}"
        )
    up, down = share.numerator, share.denominator
    if up == down:
        return values, step_s, ""
    trend = np.linspace(0.0, 1.0, len(values))[:, None] * (values[-1] - values[0]) + values[0]
    lower = resample_poly(values - trend, up, down, axis=0, padtype="line")
    new_step = step_s * down / up
    line = (
        np.arange(len(lower))[:, None] * new_step / ((len(values) - 1) * step_s) * (values[-1] - values[0])
        + values[0]
    )
    note = f"resampled from {1.0 / step_s:g} to {1.0 / new_step:g} a second, with a filter of zero phase"
    return lower + line, new_step, note
