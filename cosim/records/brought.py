"""Effect of a controller: difference in damping between two records, with its interval.

A mode that a controller damps well no longer stands out among the others. Both records are therefore
projected on one combination of their signals, which passes the mode shape without the controller and
suppresses the other shapes as far as possible. The strongest component there is compared by the modified
Yule-Walker equations; forced lines are removed first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import norm

from .ambient import LEVEL, Estimate, estimate_of_one
from .forced import MODAL, lines_of, without
from .meter import Meter, Swing, meter, plain_estimate
from .record import BAND_HZ, Array, Record, RecordError
from .signals import Swings, swings_of

if TYPE_CHECKING:
    from interarea.design.modes.modes import Mode

POWER = 0.8  #: chance with which records of `wanted_s` show a difference
_NEAR = 0.25  # of a frequency: two ring-downs may be of one mode
_LEAST_PART = 0.2  # of the largest singular value of the shapes: less is no difference
_NEW = 0.15  # of a frequency: a swing with the controller that none without it corresponds to
_LOW, _HIGH = 0.65, 1.5  # of a frequency: where a controller may move it
_DAY_S = 86400.0


@dataclass(frozen=True)
class Difference:
    """The damping of one mode with and without a controller.

    before, after : by one method, without and with it. difference : of the damping ratios. interval : at
    `LEVEL`. shown : whether 0 is outside. wanted_s : length of both records that shows a difference of that
    size with probability `POWER`; None if it is shown.
    """

    frequency_hz: float
    mode: str
    before: Estimate
    after: Estimate
    difference: float
    interval: tuple[float, float]
    shown: bool
    wanted_s: float | None
    sentence: str

    def as_dict(self) -> dict[str, Any]:
        """Return plain types, for JSON."""
        plain = {k: list(v) if isinstance(v, tuple) else v for k, v in vars(self).items()}
        return plain | {k: plain_estimate(getattr(self, k)) for k in ("before", "after")}


@dataclass(frozen=True)
class Brought(Meter):
    """Result of `meter` for the record with the controller, and the effect of the controller.

    beside : result for the record without it. differences : mode by mode, the strongest first. new : a
    sentence on each swing that is clear only with the controller.
    """

    beside: Meter
    differences: tuple[Difference, ...]
    new: tuple[str, ...]

    @property
    def sentence(self) -> str:
        """The verdict on the strongest mode."""
        return self.differences[0].sentence

    def as_dict(self) -> dict[str, Any]:
        """Return plain types, for JSON."""
        own = {
            k: getattr(self, k) for k in ("source", "length_s", "quantity", "unit", "kind", "swings", "notes")
        }
        plain = {"differences": [d.as_dict() for d in self.differences], "new": list(self.new)}
        return {**Meter(**own).as_dict(), "beside": self.beside.as_dict(), **plain, "sentence": self.sentence}


def brought(
    record: Record,
    other: Record,
    *,
    band_hz: tuple[float, float] = BAND_HZ,
    quantity: str | None = None,
    channels: Sequence[str] = (),
    modes: Sequence[Mode] = (),
) -> Brought:
    """Compare a record with a controller with one without it; other arguments as in `meter`.

    Raises
    ------
    RecordError : the same record twice, no common signal, no mode in the record without the controller, or an
    error of `meter`.
    """
    if record.values.shape == other.values.shape and np.array_equal(record.values, other.values):
        raise RecordError(
            f"{record.source} and {other.source} contain the same data, wanted: one record with the "
            "controller and one without it"
        )
    beside = meter(other, band_hz=band_hz, quantity=quantity, channels=channels, modes=modes)
    metered = meter(record, band_hz=band_hz, quantity=beside.quantity, channels=channels, modes=modes)
    modal = [s for s in beside.swings if s.kind == MODAL and s.estimates]
    if not modal:
        raise RecordError(
            f"{other.source}: no mode identified in the record without the controller; "
            "use a longer record, or another --band"
        )
    if metered.kind == beside.kind == "ambient":
        rows = _ambient(record, other, beside, modal, band_hz, channels)
    else:
        rows = _matched(metered, modal)
    if not rows:
        seen = ", ".join(f"{s.frequency_hz:.3g} Hz" for s in metered.swings if s.estimates) or "none"
        raise RecordError(
            f"{record.source}: no mode near {modal[0].frequency_hz:.3g} Hz (modes: {seen}), wanted: that of "
            f"{other.source}; ambient records of both show one that is well damped"
        )
    lengths = (metered.length_s, beside.length_s)
    differences = tuple(_difference(s, b, a, lengths) for s, b, a in rows)
    return Brought(**vars(metered), beside=beside, differences=differences, new=_new(metered, rows))


def _new(metered: Meter, rows: Sequence[tuple[Swing, Estimate, Estimate]]) -> tuple[str, ...]:
    """Return a sentence on each mode of a record that is none of the compared ones."""
    known = [f for s, _, after in rows for f in (s.frequency_hz, after.frequency_hz)]
    return tuple(
        f"{s.frequency_hz:.3g} Hz, damping ratio {s.estimates[0].damping_ratio:.3f}: "
        "identified only with the controller"
        for s in metered.swings
        if s.estimates and all(abs(s.frequency_hz - f) > _NEW * f for f in known)
    )


def _matched(metered: Meter, modal: Sequence[Swing]) -> list[tuple[Swing, Estimate, Estimate]]:
    """Return the modes of both, by their frequencies, with the estimates of the first method of each."""
    rows = []
    for swing in modal:
        near = [
            s
            for s in metered.swings
            if s.estimates and abs(s.frequency_hz - swing.frequency_hz) <= _NEAR * swing.frequency_hz
        ]
        if near:
            best = min(near, key=lambda s: abs(s.frequency_hz - swing.frequency_hz))
            rows.append((swing, swing.estimates[0], best.estimates[0]))
    return rows


def _ambient(
    record: Record, other: Record, beside: Meter, modal: Sequence[Swing], band_hz: tuple[float, float],
    channels: Sequence[str],
) -> list[tuple[Swing, Estimate, Estimate]]:  # fmt: skip
    """Return the modes of the record without the controller, each with estimates in both records."""
    both = _common(record, other, beside.quantity, band_hz, channels)
    after, before = (swings_of(r, band_hz, None, both) for r in (record, other))
    names = [t or n for t, n in zip(before.terminals, before.names, strict=True)]
    shapes = [np.array([s.shape.get(n, 0.0) for n in names], complex) for s in modal]
    rows = []
    for k, swing in enumerate(modal):
        weights = _filter(shapes, k)
        near = (max(band_hz[0], _LOW * swing.frequency_hz), min(band_hz[1], _HIGH * swing.frequency_hz))
        one, other_one = (_estimate(s, weights, near) for s in (before, after))
        if one is not None and other_one is not None:
            rows.append((swing, one, other_one))
    return rows


def _common(
    record: Record, other: Record, quantity: str, band_hz: tuple[float, float], channels: Sequence[str]
) -> list[str]:
    """Return the names of the signals of a quantity that swing in both records."""
    names = set(swings_of(record, band_hz, quantity, channels).names)
    both = [n for n in swings_of(other, band_hz, quantity, channels).names if n in names]
    if not both:
        raise RecordError(
            f"{record.source}, {other.source}: no channel of {quantity} has the same name in both, wanted: "
            "records of the same places"
        )
    return both


def _filter(shapes: Sequence[Array], k: int) -> Array:
    """Return weights of the signals that pass shape k and not the others, as far as these differ.

    A real combination sees a shape at the turn at which it is most real.
    """
    real = []
    for shape in shapes:
        turn = np.exp(-0.5j * np.angle(np.sum(shape**2)))
        real.append(np.real(shape * turn) / np.linalg.norm(shape))
    return np.asarray(np.linalg.pinv(np.column_stack(real), rcond=_LEAST_PART)[k])


def _estimate(swings: Swings, weights: Array, near_hz: tuple[float, float]) -> Estimate | None:
    y = without(swings, lines_of(swings)).values @ weights
    return estimate_of_one((y / y.std())[:, None], swings.step_s, near_hz)


def _difference(
    swing: Swing, before: Estimate, after: Estimate, lengths_s: tuple[float, float]
) -> Difference:
    gained = after.damping_ratio - before.damping_ratio
    halves = [0.5 * (e.damping_interval[1] - e.damping_interval[0]) for e in (before, after)]
    half = float(np.hypot(halves[0], halves[1]))
    shown = abs(gained) > half
    z = float(norm.ppf(0.5 + 0.5 * LEVEL))
    size = half / z * (z + float(norm.ppf(POWER)))  # what records of this length show
    length_s = min(lengths_s)
    wanted_s = None if shown else length_s * (size / max(abs(gained), 1e-9)) ** 2
    name = swing.mode or f"the swing at {swing.frequency_hz:.3g} Hz"
    spread = f"{LEVEL:.0%} interval {100 * (gained - half):.1f} to {100 * (gained + half):.1f}"
    if shown:
        word = "rose" if gained > 0.0 else "fell"
        text = (
            f"the damping of {name} {word} by {100 * abs(gained):.1f} points, from "
            f"{before.damping_ratio:.3f} to {after.damping_ratio:.3f}; {spread}"
        )
    else:
        assert wanted_s is not None
        more = (
            f"a difference of that size needs {_words(wanted_s - length_s)} more"
            if wanted_s < _DAY_S
            else "a difference of that size needs records of more than a day"
        )
        text = (
            f"no significant difference in the damping of {name}: {100 * gained:+.1f} points, {spread}; "
            f"records of {_words(length_s)} resolve {100 * size:.1f} points and more; {more}"
        )
    return Difference(
        swing.frequency_hz, swing.mode, before, after, gained, (gained - half, gained + half), shown,
        wanted_s, text,
    )  # fmt: skip


def _words(seconds: float) -> str:
    if seconds >= 7200.0:
        return f"{seconds / 3600.0:.3g} h"
    return f"{seconds / 60.0:.3g} min" if seconds >= 60.0 else f"{seconds:.3g} s"
