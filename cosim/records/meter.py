"""Mode meter: oscillations of a record, their damping, whether they are forced, and the modes of a case."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from scipy.stats import norm

from ..results import matrix_pencil as pencil
from ..results import metrics as m
from .ambient import LEVEL, AmbientMode, Estimate, ambient_modes, squared_cosine
from .forced import FORCED, LEAST_DAMPING, MODAL, UNDECIDED, Line, forced_hz, lines_of, without
from .record import BAND_HZ, Array, Record, RecordError
from .signals import Swings, swings_of

if TYPE_CHECKING:
    from interarea.design.modes.modes import Mode

LEAST_AMBIENT_S = 120.0  #: from which ambient motion gives a damping ratio
RING_DOWN = "ring-down, matrix pencil"
_JOLT = 5.0  # of the largest motion over its median: a disturbance
_WINDOW_S = 2.0
_POOR_FIT = 0.1  # misfit of a ring-down over its largest value, above which it says nothing
_LEAST_STRENGTH = 0.05
NEAR_HZ = 0.12  # of a frequency: a mode of a case that it may be
_LIKE = 0.8  # square of the cosine of two shapes that are one
_LEAST_RING_S = 4.0
_ANY_RATIO = 1.0  # half an interval of a damping ratio: wider, it excludes hardly any


@dataclass(frozen=True)
class Swing:
    """An oscillation.

    kind : modal, forced or undecided. amplitude : rms of the largest signal, in `Meter.unit`. estimates :
    frequency and damping ratio by each method; none if forced or undecided. shape : terminal -> size
    and phase, largest 1. why : evidence for the kind. mode : of the case, "" for none; mode_damping : its
    ratio there.
    """

    frequency_hz: float
    kind: str
    amplitude: float
    estimates: tuple[Estimate, ...]
    shape: Mapping[str, complex]
    why: str
    mode: str = ""
    mode_damping: float | None = None


@dataclass(frozen=True)
class Meter:
    """What `meter` found: `swings`, the largest first; notes of the record and of the analysis."""

    source: str
    length_s: float
    quantity: str
    unit: str
    kind: str
    swings: tuple[Swing, ...]
    notes: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return plain types, for JSON."""
        rows = []
        for s in self.swings:
            row = {k: v for k, v in vars(s).items() if k not in ("estimates", "shape")}
            row["estimates"] = [plain_estimate(e) for e in s.estimates]
            row["shape"] = {t: [abs(z), float(np.degrees(np.angle(z)))] for t, z in s.shape.items()}
            rows.append(row)
        plain = {k: v for k, v in vars(self).items() if k not in ("swings", "notes")}
        return {**plain, "level": LEVEL, "swings": rows, "notes": list(self.notes)}


def plain_estimate(estimate: Estimate) -> dict[str, Any]:
    """Return plain types, for JSON."""
    return {k: list(v) if isinstance(v, tuple) else v for k, v in vars(estimate).items()}


def meter(
    record: Record,
    *,
    band_hz: tuple[float, float] = BAND_HZ,
    quantity: str | None = None,
    channels: Sequence[str] = (),
    modes: Sequence[Mode] = (),
) -> Meter:
    """Return the oscillations of a record.

    quantity, channels : to be analysed; default the best measured quantity. modes : of a case, as names.

    Raises
    ------
    RecordError : no oscillation, or a record too short for it.
    """
    swings = swings_of(record, band_hz, quantity, channels)
    start = _jolt(swings)
    if start is None and not swings.length_s >= LEAST_AMBIENT_S:
        swings_seen, kind = _of_short(swings, record.source, band_hz)
    else:
        swings_seen, error = [], 1.0
        if start is not None:
            swings_seen, error = _ring_down(swings, start, band_hz, since=start)
        kind = "ring-down" if error <= _POOR_FIT else "ambient"
        if kind == "ambient":
            swings_seen = _ambient(swings, band_hz)
    swings_seen = [_named(s, modes) for s in swings_seen]
    return Meter(
        record.source, record.length_s, swings.quantity, swings.unit, kind, tuple(swings_seen),
        (*record.notes, *swings.notes),
    )  # fmt: skip


def _of_short(swings: Swings, source: str, band_hz: tuple[float, float]) -> tuple[list[Swing], str]:
    """Return the oscillations and the kind of a record of about a minute without a clear disturbance."""
    start = int(np.argmax(np.abs(swings.combined).max(axis=1)))
    error = 1.0
    if start < 0.5 * len(swings.combined):  # near the end many poles fit the little that is left
        swings_seen, error = _ring_down(swings, start, band_hz, since=0)
        if error <= _POOR_FIT and any(s.kind == MODAL for s in swings_seen):
            return swings_seen, "ring-down"
    lines = [s for s in _ambient(swings, band_hz) if s.kind != MODAL]
    if not lines:
        raise RecordError(
            f"{source}: {swings.length_s:.4g} s without a ring-down after a disturbance (misfit "
            f"{error:.0%}) and without a forced line are too short for a damping ratio, wanted: "
            f"{LEAST_AMBIENT_S:g} s of ambient motion, or a ring-down"
        )
    return lines, "ambient"


def _jolt(swings: Swings) -> int | None:
    """Return where a disturbance has its largest motion; None where there is none."""
    size = np.sqrt(np.mean(swings.combined**2, axis=1))
    many = max(1, round(_WINDOW_S / swings.step_s))
    windows = np.sqrt(np.add.reduceat(size**2, np.arange(0, len(size), many)) / many)
    return int(np.argmax(size)) if windows.max() > _JOLT * np.median(windows) else None


def _ring_down(
    swings: Swings, start: int, band_hz: tuple[float, float], *, since: int
) -> tuple[list[Swing], float]:
    """Return the swings of the ring-down from a point on, as a run's is taken, and the misfit.

    One that neither decays nor grows is no ring-down: it is a forced line, which is taken out before what is
    left is looked at again, or undecided. So is one whose damping ratio could be any. since : the point from
    which a line may stand.
    """
    skip = start + round(0.25 / swings.step_s)
    if not (len(swings.raw) - skip) * swings.step_s >= _LEAST_RING_S:
        return [], 1.0
    values = swings.raw[skip:] - swings.raw[skip:].mean(axis=0)
    moving = values.std(axis=0) > 0.0
    time = swings.step_s * np.arange(len(values), dtype=np.float64)
    fit = m.ring_down(time, values[:, moving])
    if not fit.good:
        fit = m.robust_ring_down(time, values[:, moving], fit, [])
    poles = np.array([mode.pole for mode in fit.modes], dtype=complex)
    sizes = [float(np.max(np.abs(mode.amplitudes))) for mode in fit.modes]
    least = _LEAST_STRENGTH * max(sizes, default=0.0)
    seen = [
        (k, mode, size)
        for k, (mode, size) in enumerate(zip(fit.modes, sizes, strict=True))
        if band_hz[0] <= mode.frequency_hz <= band_hz[1] and size >= least
    ]
    stands = [mode.frequency_hz for _, mode, _ in seen if _stands(mode.pole)]
    if lines := _forced_at(swings, since, stands):
        rest, misfit = _ring_down(without(swings, lines), start, band_hz, since=since)
        forced = [_of_line(swings, line) for line in lines]
        return [*forced, *(rest if misfit <= _POOR_FIT else [])], fit.error
    spread = _spread(time, values[:, moving], poles)

    def swing(k: int, mode: m.RingDownMode, size: float) -> Swing:
        amplitudes = np.zeros(len(moving), complex)
        amplitudes[moving] = mode.amplitudes
        shape = _shape(swings, amplitudes)
        if _stands(mode.pole):
            why = f"damped by less than {LEAST_DAMPING:g}: a mode with almost no decay, or a forced line"
            return Swing(mode.frequency_hz, UNDECIDED, size, (), shape, why)
        why = f"rings down; misfit {fit.error:.1%} of the largest value"
        estimate = _with_spread(mode.pole, spread[k])
        if any_ratio := _any_ratio(estimate):
            why += any_ratio
            return Swing(mode.frequency_hz, UNDECIDED, size, (), shape, why)
        return Swing(mode.frequency_hz, MODAL, size, (estimate,), shape, why)

    return [swing(*each) for each in seen], fit.error


def _any_ratio(estimate: Estimate) -> str:
    """Return what is said of an interval that excludes hardly any damping ratio; "" of another."""
    low, high = estimate.damping_interval
    if 0.5 * (high - low) <= _ANY_RATIO:
        return ""
    return f"; damping ratio not determined: {low:.3g} to {high:.3g}"


def _stands(pole: complex) -> bool:
    return abs(pole.real) < LEAST_DAMPING * abs(pole)


def _forced_at(swings: Swings, since: int, frequencies_hz: Sequence[float]) -> list[Line]:
    """Return the forced lines at given frequencies from a point on."""
    lines = lines_of(swings.of(swings.raw[since:])) if frequencies_hz else []
    return [
        line
        for line in lines
        if line.kind == FORCED and any(abs(line.frequency_hz - f) < line.width_hz for f in frequencies_hz)
    ]


def _spread(time: Array, values: Array, poles: npt.NDArray[np.complex128]) -> Array:
    """Return the covariance (poles, 2, 2) of real and imaginary part of fitted poles, of coloured misfit."""
    if not poles.size:
        return np.zeros((0, 2, 2))

    def misfit(z: npt.NDArray[np.complex128]) -> Array:
        return np.asarray(pencil.amplitudes_of(time, values, z)[1])

    rest = misfit(poles)
    columns = []
    for k, pole in enumerate(poles):
        for step in (1e-5 * abs(pole), 1e-5j * abs(pole)):
            moved = poles.copy()
            moved[k] += step
            columns.append((misfit(moved) - rest).ravel() / abs(step))
    J = np.array(columns).T
    freedom = max(1, rest.size - J.shape[1] - 2 * len(poles) * rest.shape[1])
    noise = rest - rest.mean(axis=0)
    power = float(np.sum(noise**2))
    together = 1.0
    for lag in range(1, len(noise) // 4):
        correlation = float(np.sum(noise[lag:] * noise[:-lag])) / power if power > 0.0 else 0.0
        if correlation <= 0.0:
            break
        together += 2.0 * correlation
    covariance = np.linalg.pinv(J.T @ J) * power / freedom * together
    return np.array([covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] for k in range(len(poles))])


def _with_spread(pole: complex, covariance: Array) -> Estimate:
    wide = float(norm.ppf(0.5 + 0.5 * LEVEL))
    size = abs(pole)
    ratio, f = -pole.real / size, abs(pole.imag) / (2.0 * np.pi)
    slope = np.array([-(pole.imag**2), pole.real * pole.imag]) / size**3
    half = wide * max(float(slope @ covariance @ slope), 0.0) ** 0.5
    half_f = wide * max(float(covariance[1, 1]), 0.0) ** 0.5 / (2.0 * np.pi)
    return Estimate(RING_DOWN, f, (f - half_f, f + half_f), ratio, (ratio - half, ratio + half))


def _ambient(swings: Swings, band_hz: tuple[float, float]) -> list[Swing]:
    lines = lines_of(swings)
    stand = [line for line in lines if line.kind != MODAL]
    swings_seen = [_of_line(swings, line) for line in stand]
    if swings.length_s >= LEAST_AMBIENT_S:
        rest = without(swings, stand)
        for mode in ambient_modes(rest.combined, swings.step_s, band_hz):
            f = mode.pole.imag / (2.0 * np.pi)
            if all(abs(f - line.frequency_hz) > line.width_hz for line in stand if line.kind == UNDECIDED):
                swings_seen.append(_of_mode(swings, mode, forced_hz(stand)))
    return sorted(swings_seen, key=lambda s: -s.amplitude)


def _of_line(swings: Swings, line: Line) -> Swing:
    amplitudes = _in_signals(swings, line.amplitude)
    size = float(np.max(np.abs(amplitudes))) / np.sqrt(2.0)
    harmonics = f", harmonics {', '.join(map(str, line.harmonics))} stand too" if line.harmonics else ""
    why = (
        f"{line.width_hz:.3g} Hz wide at half power, resolution {1.0 / swings.length_s:.2g} Hz; "
        f"{line.purity:.0%} of its band is one sine; 2 log(L forced / L modal) = {line.likelihood:.3g}"
        f"{harmonics}"
    )
    return Swing(line.frequency_hz, line.kind, size, (), _shape(swings, amplitudes), why)


def _of_mode(swings: Swings, mode: AmbientMode, forced_hz: list[float]) -> Swing:
    amplitudes = _in_signals(swings, mode.shape)
    f = mode.pole.imag / (2.0 * np.pi)
    rms = np.sqrt(max(mode.share, 0.0) * swings.combined.shape[1])
    size = float(rms * np.max(np.abs(amplitudes)) / np.linalg.norm(mode.shape))
    why = f"{mode.share:.0%} of the motion, order {mode.order}"
    if not mode.estimates[0].damping_ratio >= LEAST_DAMPING:
        why += f"; damped by less than {LEAST_DAMPING:g}: it may be a forced line of varying amplitude"
        return Swing(f, UNDECIDED, size, (), _shape(swings, amplitudes), why)
    if any_ratio := _any_ratio(mode.estimates[0]):
        return Swing(f, UNDECIDED, size, (), _shape(swings, amplitudes), why + any_ratio)
    if any(abs(f - forced) < 0.1 * f for forced in forced_hz):
        why += "; near a forced line, which was removed first: its interval may be too narrow"
    return Swing(f, MODAL, size, mode.estimates, _shape(swings, amplitudes), why)


def _in_signals(swings: Swings, combined: npt.NDArray[np.complex128]) -> npt.NDArray[np.complex128]:
    """Return amplitudes of the signals of amplitudes of the combinations."""
    return np.asarray(np.linalg.pinv(swings.weights) @ combined)


def _shape(swings: Swings, amplitudes: npt.NDArray[np.complex128]) -> dict[str, complex]:
    largest = amplitudes[int(np.argmax(np.abs(amplitudes)))]
    names = [t or n for t, n in zip(swings.terminals, swings.names, strict=True)]
    return {n: complex(a / largest) for n, a in zip(names, amplitudes, strict=True)}


def likeness(one: Mapping[str, complex], other: Mapping[str, complex]) -> float:
    """Return the squared cosine of two shapes at their common terminals; 0 if these are fewer than two."""
    both = [t for t in one if t in other]
    if len(both) < 2:
        return 0.0
    a, b = (np.array([complex(shape[t]) for t in both]) for shape in (one, other))
    a, b = (a - a.mean(), b - b.mean()) if len(both) >= 3 else (a, b)
    return float(squared_cosine(a, b))


def _named(swing: Swing, modes: Sequence[Mode]) -> Swing:
    """Return a swing with the name of the mode of a case that has its frequency and shape."""
    best, fits = None, _LIKE
    for mode in modes:
        if not abs(mode.frequency_hz - swing.frequency_hz) <= NEAR_HZ * swing.frequency_hz:
            continue
        like = likeness(swing.shape, mode.shape)
        if like >= fits:
            best, fits = mode, like
    if best is None:
        return swing
    return replace(swing, mode=best.name, mode_damping=best.damping_ratio)
