"""Forced or modal: whether an oscillation is a line of constant amplitude or a mode excited by noise.

A sine is fitted to the signals, and slow motion is filtered out of the residual only: the filter would
distort the line at the ends of the record. The result is demodulated and decimated to a narrow band. Of all
combinations of the signals that pass the pattern of the line, the one with the least residual (Capon 1969)
has the complex envelope z. Two models of z are compared by their likelihoods:

    modal    z = mode + noise, the mode an Ornstein-Uhlenbeck process of decay sigma >= LEAST_DAMPING w
    forced   z = constant + mode + noise

The constant is integrated out, with a uniform density in the circle of its fitted size (restricted
likelihood, Patterson and Thompson 1971), because a short envelope fits its own mean too well. The envelope of
a forced line is constant; that of a mode varies with the time constant 1/sigma. Harmonics are searched too:
constant ones come from a limit or a deadband.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize, minimize_scalar

from .record import Array
from .signals import Swings, without_slow_motion

ComplexArray = npt.NDArray[np.complex128]
FORCED, MODAL, UNDECIDED = "forced", "modal", "undecided"
LEAST_DAMPING = 0.005  #: a mode with less cannot be told from a line in a record of usual length
#: share of a line in its narrow band -> twice the logarithm of the ratio of likelihoods from which it is
#: undecided, and forced. Of modes with `LEAST_DAMPING`, in 60 s, at .15 to 1.5 Hz, with white noise 5 to 40
#: dB below, half exceed the first, a tenth the second and .3 % the 12
#: (`benchmarks/records/forced_or_modal.py --least-damped 4000`), which are very strong evidence by Kass and
#: Raftery (1995). Of a wide spectrum the largest of many independent values stands out by chance: of 290
#: records of 10 minutes of modes with 3.2 and 8.1 % one reaches the 12, with 14.2
_LIMITS = ((0.85, 3.3, 12.0), (0.5, 6.3, 12.0), (0.0, 12.0, 18.0))
_STANDS_OUT = 6.0  # of a peak over the median of its surroundings, in amplitude
_AROUND_HZ = 0.3
_MOST_CANDIDATES, _MOST_HARMONIC = 4, 5
_MOST_POINTS = 40
#: of the search of a mode: decay over frequency, log of noise over mode; 36 starts find the same in 25 of 25
_STARTS = ((0.001, -8.0), (0.005, -4.0), (0.02, -2.0), (0.1, 0.0))
_SIDE = 0.3  # of the frequency: the band to each side, at least
_LEAST_WIDE = 9.0  # of 1 / length: that band, at least
_IMPURE = 0.3  # of a line in its narrow band: less is a mode without further looking
_COHERENT = 0.8  # share of a line in its narrow band, above which a harmonic counts


@dataclass(frozen=True)
class Line:
    """An oscillation. amplitude : of each combination, complex. likelihood : 2 log of the ratio.

    kind : forced, modal or undecided. width_hz : of its peak at half the power; of a line about 1 / length.
    harmonics : orders of the constant ones. purity : share of the line in its narrow band.
    """

    frequency_hz: float
    kind: str
    amplitude: ComplexArray
    likelihood: float
    width_hz: float
    purity: float
    harmonics: tuple[int, ...]


def lines_of(swings: Swings) -> list[Line]:
    """Return the clear peaks in the spectrum of the combined signals, the largest first."""
    lines: list[Line] = []
    rest = swings
    for frequency in _peaks(swings):
        if any(
            abs(frequency - k * line.frequency_hz) < 2.0 / swings.length_s
            for line in lines
            for k in range(1, 6)
        ):
            continue
        line = _judged(rest, frequency)
        lines.append(line)
        if line.kind == FORCED:
            rest = without(rest, [line])
    return lines


def forced_hz(lines: Sequence[Line]) -> list[float]:
    """Return the frequencies of the forced `lines` and of their harmonics, Hz."""
    return [x.frequency_hz * k for x in lines if x.kind == FORCED for k in (1, *x.harmonics)]


def without(swings: Swings, lines: Sequence[Line]) -> Swings:
    """Return signals minus the forced `lines` and their harmonics."""
    taken = forced_hz(lines)
    if not taken:
        return swings
    factors, _ = _fit(swings.values, swings, taken)
    return swings.of(swings.raw - sines(len(swings.raw), swings.step_s, taken) @ factors)


def _fit(values: Array, swings: Swings, frequencies_hz: list[float]) -> tuple[Array, Array]:
    """Return factors of cosines and sines in values without slow motion, and what they leave of these."""
    basis = sines(len(values), swings.step_s, frequencies_hz)
    moving = without_slow_motion(basis, swings.step_s, swings.band_hz)
    factors = np.linalg.lstsq(moving, values, rcond=None)[0]
    return np.asarray(factors), np.asarray(values - moving @ factors)


def sines(points: int, step_s: float, frequencies_hz: list[float]) -> Array:
    """Return cosines and then sines of these frequencies: (points, 2 frequencies)."""
    turns = 2.0 * np.pi * np.outer(np.arange(points) * step_s, frequencies_hz)
    return np.hstack([np.cos(turns), np.sin(turns)])


def _spectrum(values: Array, step_s: float) -> tuple[Array, Array]:
    """Return frequencies and the amplitude there of each signal, with a Hann window."""
    window = np.hanning(len(values))[:, None]
    many = 4 * len(values)
    size = 2.0 * np.abs(np.fft.rfft(values * window, many, axis=0)) / window.sum()
    f = np.asarray(np.fft.rfftfreq(many, step_s), dtype=np.float64)
    return f, np.asarray(size, dtype=np.float64)


def _peaks(swings: Swings) -> list[float]:
    """Return the frequencies of the clear peaks, the largest first: those of each combination, because a
    peak of another may hide one that is near."""
    f, sizes = _spectrum(swings.combined, swings.step_s)
    size = np.sqrt(np.sum(sizes**2, axis=1))
    inside = np.flatnonzero((f >= swings.band_hz[0]) & (f <= swings.band_hz[1]))
    top = {int(k) for one in (size, *sizes.T) for k in inside if one[k] == one[max(0, k - 8) : k + 9].max()}
    loud: list[float] = []
    for k in sorted(top, key=lambda k: -size[k]):
        around = size[(np.abs(f - f[k]) < _AROUND_HZ) & (np.abs(f - f[k]) > 3.0 / swings.length_s)]
        if size[k] > _STANDS_OUT * np.median(around) or not loud:
            loud.append(float(f[k]))
    return loud[:_MOST_CANDIDATES]


def _fitted(swings: Swings, frequency_hz: float) -> tuple[float, ComplexArray, Array]:
    """Return the frequency near that given whose sine leaves least of the combinations, its amplitudes in
    `patterns`, and what it leaves."""
    near = 0.5 / swings.length_s
    best = minimize_scalar(
        lambda f: float(np.sum(_fit(swings.combined, swings, [f])[1] ** 2)),
        bounds=(frequency_hz - near, frequency_hz + near), method="bounded", options={"xatol": 1e-3 * near},
    )  # fmt: skip
    factors, rest = _fit(swings.values @ swings.patterns.T, swings, [float(best.x)])
    return float(best.x), np.asarray(factors[0] - 1j * factors[1]), rest


def side_hz(frequency_hz: float, length_s: float) -> float:
    """Return the half width of the band of a line's envelope, Hz."""
    return min(max(_SIDE * frequency_hz, _LEAST_WIDE / length_s), 0.5 * _MOST_POINTS / length_s)


def _judged(swings: Swings, frequency_hz: float) -> Line:
    f, amplitude, rest = _fitted(swings, frequency_hz)
    side = side_hz(f, swings.length_s)
    envelope, spacing = _envelope(amplitude, rest, swings.step_s, f, side)
    purity = float(np.abs(envelope.mean()) ** 2 / np.mean(np.abs(envelope) ** 2))
    ratio = _likelihood(envelope, spacing, 2.0 * np.pi * f) if purity >= _IMPURE else 0.0
    _, uncertain, certain = next((x for x in _LIMITS if purity >= x[0]), _LIMITS[-1])
    kind = FORCED if ratio >= certain else MODAL if ratio < uncertain else UNDECIDED
    harmonics = tuple(k for k in range(2, _MOST_HARMONIC + 1) if kind != MODAL and _stands(swings, k * f))
    return Line(f, kind, amplitude[: len(swings.weights)], ratio, _width(swings, f), purity, harmonics)


def _envelope(
    amplitude: ComplexArray, rest: Array, step_s: float, frequency_hz: float, side_hz: float
) -> tuple[ComplexArray, float]:
    """Return the envelope of a line of unit size and of what it leaves (points, combinations) in the band to
    each side, and its spacing in s: of the combination that has least of the latter."""
    length_s = len(rest) * step_s
    turns = np.exp(-2j * np.pi * frequency_hz * np.arange(len(rest)) * step_s)
    spectrum = 2.0 * np.fft.fft(rest * turns[:, None], axis=0)
    points = max(8, round(2.0 * side_hz * length_s))
    order = np.argsort(np.abs(np.fft.fftfreq(len(rest), step_s)), kind="stable")[:points]
    low = np.zeros((points, rest.shape[1]), complex)
    low[np.round(np.fft.fftfreq(len(rest), step_s)[order] * length_s).astype(int) % points] = spectrum[order]
    z = np.fft.ifft(low, axis=0) * points / len(rest)
    power = z.conj().T @ z / points
    power += 1e-9 * (np.trace(power).real + np.vdot(amplitude, amplitude).real) * np.eye(len(power))
    weights = np.linalg.solve(power.T, amplitude)
    return np.asarray(1.0 + z @ weights.conj() / np.vdot(weights, amplitude)), length_s / points


def _likelihood(z: ComplexArray, spacing_s: float, w: float) -> float:
    """Return 2 log of the likelihood of a forced line of unit size over that of a mode, each at its best."""
    n = len(z)
    lag, one = spacing_s * np.abs(np.subtract.outer(np.arange(n), np.arange(n))), np.ones(n)

    def misfit(x: Array, line: bool) -> float:
        """x : log of the decay beyond the least, log of noise over mode; the size of both is that which fits
        best."""
        K = np.exp(-(LEAST_DAMPING * w + np.exp(x[0])) * lag)
        K[np.diag_indices(n)] += np.exp(x[1]) + 1e-9
        factor = cho_factor(K, lower=True, check_finite=False)
        freedom, left = n, float(np.real(z.conj() @ cho_solve(factor, z, check_finite=False)))
        volume = 2.0 * float(np.sum(np.log(np.diag(factor[0]))))
        if line:
            solved = cho_solve(factor, one, check_finite=False)
            weight = float(solved @ one)
            freedom, left = n - 1, left - float(np.abs(solved @ z)) ** 2 / weight
            volume += float(np.log(weight))
        return volume + freedom * (1.0 + float(np.log(max(left, 1e-300) / freedom)))

    def best(line: bool) -> float:
        fits = [
            minimize(misfit, [np.log(share * w), noise], args=(line,), method="L-BFGS-B",
                     bounds=[(np.log(1e-4 * w), np.log(3.0 * w)), (-16.0, 4.0)])
            for share, noise in _STARTS
        ]  # fmt: skip
        return float(min(fit.fun for fit in fits))

    return 2.0 * (best(False) - best(True))


def _stands(swings: Swings, frequency_hz: float) -> bool:
    """Whether a sine of constant size is most of what swings closely around a frequency."""
    if not frequency_hz < 0.45 / swings.step_s:
        return False
    f, amplitude, rest = _fitted(swings, frequency_hz)
    z, _ = _envelope(amplitude, rest, swings.step_s, f, 6.0 / swings.length_s)
    return bool(np.abs(z.mean()) ** 2 > _COHERENT * np.mean(np.abs(z) ** 2))


def _width(swings: Swings, frequency_hz: float) -> float:
    """Return between where the peak of the spectrum at a frequency falls to half of its power, Hz."""
    f, sizes = _spectrum(swings.combined, swings.step_s)
    size = np.sqrt(np.sum(sizes**2, axis=1))
    k = int(np.argmin(np.abs(f - frequency_hz)))
    low = high = k
    while low > 0 and size[low] ** 2 > 0.5 * size[k] ** 2:
        low -= 1
    while high < len(f) - 1 and size[high] ** 2 > 0.5 * size[k] ** 2:
        high += 1
    return float(f[high] - f[low])
