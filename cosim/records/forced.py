"""Forced or modal: whether a swing of one frequency is a line of constant size, or a mode that noise excites.

The signals are turned back by the frequency and thinned to a narrow band around it; what is left is the
complex envelope z. Two models of z are compared by their likelihoods:

    modal    z = mode + noise, the mode an Ornstein-Uhlenbeck process of decay sigma >= LEAST_DAMPING w
    forced   z = constant + mode + noise

A forced line is as narrow as the record is long, its envelope stands; that of a mode wanders with 1/sigma.
Lines of a period are looked for too: harmonics that stand are what a limit or a dead band makes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from .record import Array

ComplexArray = npt.NDArray[np.complex128]
FORCED, MODAL, UNDECIDED = "forced", "modal", "undecided"
LEAST_DAMPING = 0.005  #: a mode with less cannot be told from a line in a record of usual length
_CERTAIN, _UNCERTAIN = 17.0, 14.0  # twice the logarithm of the ratio of likelihoods
_STANDS_OUT = 6.0  # of a peak over the median of its surroundings, in amplitude
_AROUND_HZ = 0.3
_MOST_CANDIDATES, _MOST_HARMONIC = 4, 5
_MOST_POINTS = 40
_SIDE = 0.3  # of the frequency: the band to each side, at least
_LEAST_WIDE = 9.0  # of 1 / length: that band, at least
_PURE, _UNCERTAIN_PURE = (
    0.85,
    8.0,
)  # share of a line in its narrow band: of such, less likelihood is undecided
_IMPURE = 0.3  # of a line in its narrow band: less is a mode without further looking
_COHERENT = 0.8  # share of a line in its narrow band, above which a harmonic counts


@dataclass(frozen=True)
class Line:
    """A swing of one frequency. amplitude : of each combination, complex. likelihood : 2 log of the ratio.

    kind : forced, modal or undecided. width_hz : of its peak at half the power; of a line about 1 / length.
    harmonics : their orders, where they stand too. purity : share of the line in its narrow band.
    """

    frequency_hz: float
    kind: str
    amplitude: ComplexArray
    likelihood: float
    width_hz: float
    purity: float
    harmonics: tuple[int, ...]


def lines_of(values: Array, step_s: float, band_hz: tuple[float, float]) -> list[Line]:
    """Return the swings that stand out of the spectrum of signals (points, signals), the largest first."""
    lines: list[Line] = []
    rest = values
    for frequency in _peaks(values, step_s, band_hz):
        if any(
            abs(frequency - k * line.frequency_hz) < 2.0 / (len(values) * step_s)
            for line in lines
            for k in range(1, 6)
        ):
            continue
        line = _judged(rest, step_s, frequency)
        lines.append(line)
        if line.kind == FORCED:
            rest = without(rest, step_s, [line.frequency_hz * k for k in (1, *line.harmonics)])
    return lines


def without(values: Array, step_s: float, frequencies_hz: list[float]) -> Array:
    """Return signals (points, signals) less sines of these frequencies, by least squares."""
    if not frequencies_hz:
        return values
    basis = sines(len(values), step_s, frequencies_hz)
    return np.asarray(values - basis @ np.linalg.lstsq(basis, values, rcond=None)[0])


def sines(points: int, step_s: float, frequencies_hz: list[float]) -> Array:
    """Return cosines and then sines of these frequencies: (points, 2 frequencies)."""
    turns = 2.0 * np.pi * np.outer(np.arange(points) * step_s, frequencies_hz)
    return np.hstack([np.cos(turns), np.sin(turns)])


def _spectrum(values: Array, step_s: float) -> tuple[Array, Array]:
    """Return frequencies and the amplitude there of all signals together, with a Hann window."""
    window = np.hanning(len(values))[:, None]
    many = 4 * len(values)
    size = 2.0 * np.abs(np.fft.rfft(values * window, many, axis=0)) / window.sum()
    f = np.asarray(np.fft.rfftfreq(many, step_s), dtype=np.float64)
    return f, np.asarray(np.sqrt(np.sum(size**2, axis=1)), dtype=np.float64)


def _peaks(values: Array, step_s: float, band_hz: tuple[float, float]) -> list[float]:
    f, size = _spectrum(values, step_s)
    inside = np.flatnonzero((f >= band_hz[0]) & (f <= band_hz[1]))
    top = [k for k in inside if size[k] == size[max(0, k - 8) : k + 9].max()]
    loud: list[float] = []
    for k in sorted(top, key=lambda k: -size[k]):
        around = size[(np.abs(f - f[k]) < _AROUND_HZ) & (np.abs(f - f[k]) > 3.0 / (len(values) * step_s))]
        if size[k] > _STANDS_OUT * np.median(around) or not loud:
            loud.append(float(f[k]))
    return loud[:_MOST_CANDIDATES]


def _fitted(values: Array, step_s: float, frequency_hz: float) -> tuple[float, ComplexArray]:
    """Return the frequency near that given whose sine takes most power out, and its amplitudes (signals,)."""
    from scipy.optimize import minimize_scalar

    time = np.arange(len(values)) * step_s
    near = 0.5 / (len(values) * step_s)

    def amplitudes(f: float) -> ComplexArray:
        return np.asarray(2.0 * np.exp(-2j * np.pi * f * time) @ values / len(values))

    best = minimize_scalar(
        lambda f: -float(np.sum(np.abs(amplitudes(f)) ** 2)),
        bounds=(frequency_hz - near, frequency_hz + near), method="bounded", options={"xatol": 1e-3 * near},
    )  # fmt: skip
    return float(best.x), amplitudes(float(best.x))


def _judged(values: Array, step_s: float, frequency_hz: float) -> Line:
    f, amplitude = _fitted(values, step_s, frequency_hz)
    size = float(np.linalg.norm(amplitude))
    signal = values @ (amplitude.conj() / size)  # complex: the signals in the pattern of the line
    length_s = len(values) * step_s
    side = max(_SIDE * f, _LEAST_WIDE / length_s)
    envelope, spacing = _envelope(signal, step_s, f, min(side, 0.5 * _MOST_POINTS / length_s))
    purity = float(np.abs(envelope.mean()) ** 2 / np.mean(np.abs(envelope) ** 2))
    ratio = 0.0 if purity < _IMPURE else _likelihood(envelope, spacing, 2.0 * np.pi * f)
    uncertain = _UNCERTAIN if purity < _PURE else _UNCERTAIN_PURE
    kind = FORCED if ratio >= _CERTAIN else MODAL if ratio < uncertain else UNDECIDED
    harmonics = tuple(
        k for k in range(2, _MOST_HARMONIC + 1) if kind != MODAL and _stands(values, step_s, k * f)
    )
    return Line(f, kind, amplitude, ratio, _width(values, step_s, f), purity, harmonics)


def _envelope(
    signal: npt.NDArray[Any], step_s: float, frequency_hz: float, side_hz: float
) -> tuple[ComplexArray, float]:
    """Return the envelope around a frequency, of the band to each side, and its spacing in s."""
    time = np.arange(len(signal)) * step_s
    length_s = len(signal) * step_s
    spectrum = np.fft.fft(signal * np.exp(-2j * np.pi * frequency_hz * time))
    f = np.fft.fftfreq(len(signal), step_s)
    points = max(8, round(2.0 * side_hz * length_s))
    order = np.argsort(np.abs(f), kind="stable")[:points]
    low = np.zeros(points, complex)
    low[np.round(f[order] * length_s).astype(int) % points] = spectrum[order]
    return np.asarray(np.fft.ifft(low) * points / len(signal)), length_s / points


def _likelihood(z: ComplexArray, spacing_s: float, w: float) -> float:
    """Return 2 log of the likelihood of a forced line over that of a mode, each at its best."""
    lag = spacing_s * np.abs(np.subtract.outer(np.arange(len(z)), np.arange(len(z))))
    signed = spacing_s * np.subtract.outer(np.arange(len(z)), np.arange(len(z)))
    power, ends = float(np.mean(np.abs(z) ** 2)), spacing_s * len(z)
    one = np.ones(len(z), complex)

    def misfit(x: Array, line: bool) -> float:
        decay = LEAST_DAMPING * w + np.exp(x[0])
        K = power * np.exp(x[1]) * np.exp(-decay * lag + 1j * x[3] / ends * signed)
        K[np.diag_indices(len(z))] += power * (np.exp(x[2]) + 1e-9)
        try:
            factor = cho_factor(K, lower=True, check_finite=False)
        except np.linalg.LinAlgError:
            return 1e30
        if line:
            solved = cho_solve(factor, one, check_finite=False)
            rest = z - one * (solved.conj() @ z) / np.real(solved.conj() @ one)
        else:
            rest = z
        fit = float(np.real(rest.conj() @ cho_solve(factor, rest, check_finite=False)))
        return 2.0 * float(np.sum(np.log(np.abs(np.diag(factor[0]))))) + fit + 1e-3 * float(x @ x)

    def best(line: bool) -> float:
        starts = [(0.02 * w, 0.0, -3.0), (0.1 * w, -1.5, -1.5)]
        fits = [
            minimize(
                misfit, [np.log(s), a, b, 0.0], args=(line,), method="Nelder-Mead", options={"maxfev": 200}
            )
            for s, a, b in starts
        ]
        return float(min(fit.fun for fit in fits))

    return 2.0 * (best(False) - best(True))


def _stands(values: Array, step_s: float, frequency_hz: float) -> bool:
    """Whether a sine of constant size is most of what swings closely around a frequency."""
    length_s = len(values) * step_s
    if not frequency_hz < 0.45 / step_s:
        return False
    _, amplitude = _fitted(values, step_s, frequency_hz)
    signal = values @ (amplitude.conj() / np.linalg.norm(amplitude))
    z, _ = _envelope(signal, step_s, frequency_hz, 6.0 / length_s)
    return bool(np.abs(z.mean()) ** 2 > _COHERENT * np.mean(np.abs(z) ** 2))


def _width(values: Array, step_s: float, frequency_hz: float) -> float:
    """Return between where the peak of the spectrum at a frequency falls to half of its power, Hz."""
    f, size = _spectrum(values, step_s)
    k = int(np.argmin(np.abs(f - frequency_hz)))
    low = high = k
    while low > 0 and size[low] ** 2 > 0.5 * size[k] ** 2:
        low -= 1
    while high < len(f) - 1 and size[high] ** 2 > 0.5 * size[k] ** 2:
        high += 1
    return float(f[high] - f[low])
