"""Damping from ambient motion, by two methods of different kind, each with an interval.

Both take the covariances R(t) of the signals. Stochastic subspace identification (Van Overschee and De Moor
1996; driven by covariances, Peeters and De Roeck 1999) factors their Toeplitz matrix; the order is one at
which the poles are stationary. The modified Yule-Walker equations (Stoica and Moses 2005, 3.7; for grids
Wies, Pierre and Trudnowski 2003) fit an autoregression to lags beyond its order.

Intervals are by the jackknife over blocks of the record: the estimate is repeated without each block.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from scipy.stats import t as student

from .record import Array

ComplexArray = npt.NDArray[np.complex128]
_Entry = tuple[int, complex, ComplexArray, float]  #: order, pole, shape, share
LEVEL = 0.95
SUBSPACE, YULE_WALKER = "subspace identification", "modified Yule-Walker"
_LAG_S = 2.0  # of the Toeplitz matrix, a side
_ORDERS = range(4, 25, 2)
_STAYS_F, _STAYS_Z = (
    0.02,
    0.02,
)  # relative change of a frequency, change of a damping ratio from order to order
LIKE = 0.5  #: squared cosine of two shapes that are nearer to each other than to any at right angles
_LEAST_ORDERS = 4  # at which a pole is there
_MOST_DAMPED = 0.35
_LEAST_SHARE = 0.01  # of the motion: less is no mode
_SAME = 0.08  # of the distance of two poles over their size that are one mode by two methods
_SAME_OF_ONE = 0.25  # the same where a signal passes little but one mode
_FEW_ORDERS = [6, 8, 10, 12]  # of the model of such a signal
_AR_ORDER, _AR_EQUATIONS = 8, 20
_BLOCK_S, _MOST_BLOCKS, _LEAST_BLOCKS = 30.0, 20, 8


@dataclass(frozen=True)
class Estimate:
    """A mode by one method; intervals at `LEVEL`."""

    method: str
    frequency_hz: float
    frequency_interval_hz: tuple[float, float]
    damping_ratio: float
    damping_interval: tuple[float, float]


@dataclass(frozen=True)
class AmbientMode:
    """A mode in ambient motion. shape : (combinations,). share : of the motion. order : of the model."""

    pole: complex
    share: float
    shape: ComplexArray
    order: int
    estimates: tuple[Estimate, ...]


@dataclass(frozen=True)
class _Covariances:
    """Sums of products over blocks, (blocks, lags + 1, signals, signals), and samples in each block."""

    sums: Array
    counts: Array

    @classmethod
    def of(cls, values: Array, lags: int, blocks: int) -> _Covariances:
        ends = np.linspace(0, len(values) - lags, blocks + 1).astype(int)
        m = values.shape[1]
        sums = np.zeros((blocks, lags + 1, m, m))
        for b, (first, last) in enumerate(pairwise(ends)):
            for lag in range(lags + 1):
                sums[b, lag] = values[first + lag : last + lag].T @ values[first:last]
        return cls(sums, np.diff(ends).astype(float))

    def all(self) -> Array:
        return np.asarray(self.sums.sum(axis=0) / self.counts.sum())

    def without(self, block: int) -> Array:
        rest = self.sums.sum(axis=0) - self.sums[block]
        return np.asarray(rest / (self.counts.sum() - self.counts[block]))


def ambient_modes(values: Array, step_s: float, band_hz: tuple[float, float]) -> list[AmbientMode]:
    """Return the modes in ambient signals (points, signals), strongest first.

    A mode is one that both methods find, or the first alone: `estimates` has those that do.
    """
    rows = max(8, round(_LAG_S / step_s))
    length_s = len(values) * step_s
    blocks = int(np.clip(length_s / _BLOCK_S, _LEAST_BLOCKS, _MOST_BLOCKS))
    lags = max(2 * rows, 2 * _AR_ORDER + _AR_EQUATIONS)
    covariances = _Covariances.of(values, lags, blocks)
    R = covariances.all()
    modes = []
    for order, pole, shape, share in _stable(R, rows, step_s, band_hz):
        poles_of = partial(_poles_of_order, rows=rows, order=order, step_s=step_s)
        estimates = [_estimate(SUBSPACE, covariances, pole, shape, poles_of)]
        other = _nearest(*_yule_walker(R, step_s), pole, shape)
        if other is not None:
            again = partial(_yule_walker, step_s=step_s)
            estimates.append(_estimate(YULE_WALKER, covariances, other, shape, again))
        modes.append(AmbientMode(pole, share, shape, order, tuple(e for e in estimates if e is not None)))
    return sorted(modes, key=lambda mode: -mode.share)


def estimate_of_one(values: Array, step_s: float, band_hz: tuple[float, float]) -> Estimate | None:
    """Return frequency and damping ratio of the strongest component in a band of one signal (points, 1).

    For a signal that contains little but one mode, however well damped: the pole of the autoregression
    nearest to the pole with the largest share by subspaces. None if they differ.
    """
    rows = max(8, round(_LAG_S / step_s))
    blocks = int(np.clip(len(values) * step_s / _BLOCK_S, _LEAST_BLOCKS, _MOST_BLOCKS))
    covariances = _Covariances.of(values, max(2 * rows, 2 * _AR_ORDER + _AR_EQUATIONS), blocks)
    R = covariances.all()
    pole = _strongest(R, rows, step_s, band_hz)
    if pole is None:
        return None
    shape = np.ones(1, complex)
    own = _nearest(*_yule_walker(R, step_s), pole, shape, _SAME_OF_ONE)
    if own is None:
        return None
    return _estimate(YULE_WALKER, covariances, own, shape, partial(_yule_walker, step_s=step_s))


def _strongest(R: Array, rows: int, step_s: float, band_hz: tuple[float, float]) -> complex | None:
    """Return the pole with the largest share, the mean over a few orders; None if none is in the band."""
    best = []
    for poles, _, shares in _subspace(R, rows, _FEW_ORDERS, step_s):
        f = poles.imag / (2.0 * np.pi)
        share = np.where((f >= band_hz[0]) & (f <= band_hz[1]) & (poles.real < 0.0), shares, -np.inf)
        if share.size and np.isfinite(share.max()):
            best.append(poles[np.argmax(share)])
    return complex(np.mean(best)) if best else None


def _toeplitz(R: Array, rows: int) -> Array:
    return np.vstack([np.hstack([R[rows + r - c] for c in range(rows)]) for r in range(rows)])


def _subspace(
    R: Array, rows: int, orders: range | list[int], step_s: float
) -> list[tuple[ComplexArray, ComplexArray, Array]]:
    """Return for each order poles (rad/s, upper half), their shapes (m, poles) and shares of the motion."""
    m = R.shape[-1]
    left, sigma, right = np.linalg.svd(_toeplitz(R, rows), full_matrices=False)
    result = []
    for n in orders:
        n = min(n, len(sigma))
        observed = left[:, :n] * np.sqrt(sigma[:n])
        A = np.linalg.lstsq(observed[:-m], observed[m:], rcond=None)[0]
        G = (np.sqrt(sigma[:n])[:, None] * right[:n])[:, -m:]
        discrete, vectors = np.linalg.eig(A)
        shapes, entered = observed[:m] @ vectors, np.linalg.solve(vectors, G.astype(complex))
        upper = np.flatnonzero((discrete.imag > 0.0) & (np.abs(discrete) > 1e-6))
        # R(0) = sum of shape x entered / pole over all poles
        parts = np.array([2.0 * np.real(np.sum(shapes[:, k] * entered[k]) / discrete[k]) for k in upper])
        result.append(
            (np.log(discrete[upper].astype(complex)) / step_s, shapes[:, upper], parts / np.trace(R[0]))
        )
    return result


def _poles_of_order(R: Array, rows: int, order: int, step_s: float) -> tuple[ComplexArray, ComplexArray]:
    return _subspace(R, rows, [order], step_s)[0][:2]


def _stable(R: Array, rows: int, step_s: float, band_hz: tuple[float, float]) -> list[_Entry]:
    """Return order, pole, shape and share of each mode that stays from order to order."""
    tracks: list[list[_Entry]] = []
    for n, (poles, shapes, shares) in zip(_ORDERS, _subspace(R, rows, _ORDERS, step_s), strict=True):
        for k, pole in enumerate(poles):
            if not (
                band_hz[0] <= pole.imag / (2 * np.pi) <= band_hz[1] and 0.0 < _ratio(pole) < _MOST_DAMPED
            ):
                continue
            entry = (n, complex(pole), shapes[:, k], float(shares[k]))
            same = [t for t in tracks if n > t[-1][0] >= n - 4 and _stays(t[-1], entry)]
            if same:
                min(same, key=lambda t: abs(t[-1][1] - pole)).append(entry)
            else:
                tracks.append([entry])
    estimates = [
        t[3] for t in tracks if len(t) >= _LEAST_ORDERS and np.median([e[3] for e in t]) >= _LEAST_SHARE
    ]
    return _apart(estimates)


def _apart(estimates: list[_Entry]) -> list[_Entry]:
    """Leave out of two tracks of one pole and shape the weaker one."""
    left: list[_Entry] = []
    for entry in sorted(estimates, key=lambda e: -e[3]):
        if all(
            abs(entry[1] - e[1]) > 0.03 * abs(e[1]) or squared_cosine(entry[2], e[2]) < LIKE for e in left
        ):
            left.append(entry)
    return left


def squared_cosine(shapes: ComplexArray, other: ComplexArray) -> Array:
    """Return the squared cosine of each of `shapes` (m, poles) or (m,) and another (m,)."""
    size = np.sum(np.abs(shapes) ** 2, axis=0) * np.sum(np.abs(other) ** 2)
    return np.asarray(np.abs(other.conj() @ shapes) ** 2 / np.maximum(size, 1e-300))


def _ratio(pole: complex) -> float:
    return float(-pole.real / abs(pole))


def _stays(before: _Entry, now: _Entry) -> bool:
    change = abs(abs(now[1]) - abs(before[1])) / abs(before[1])
    close = change <= _STAYS_F and abs(_ratio(now[1]) - _ratio(before[1])) <= _STAYS_Z
    return bool(close and squared_cosine(now[2], before[2]) >= LIKE)


def _yule_walker(R: Array, step_s: float) -> tuple[ComplexArray, ComplexArray]:
    """Return poles (rad/s, upper half) and shapes (m, poles) of an autoregression by later lags."""
    p, m = _AR_ORDER, R.shape[-1]
    lags = range(p + 1, p + 1 + _AR_EQUATIONS)
    known = np.vstack([np.hstack([R[t - j].T for j in range(1, p + 1)]) for t in lags])
    coefficients = np.linalg.lstsq(known, np.vstack([R[t].T for t in lags]), rcond=None)[0]
    companion = np.eye(p * m, k=-m)
    companion[:m] = coefficients.T
    discrete, vectors = np.linalg.eig(companion)
    upper = (discrete.imag > 0.0) & (np.abs(discrete) > 1e-3)
    return np.log(discrete[upper].astype(complex)) / step_s, vectors[:m, upper].astype(complex)


def _nearest(
    poles: ComplexArray, shapes: ComplexArray, to: complex, shape: ComplexArray, within: float = _SAME
) -> complex | None:
    """Return the pole that is nearest to another, its distance divided by the likeness of their shapes."""
    if not poles.size:
        return None
    away = np.abs(poles - to) / np.maximum(squared_cosine(shapes, shape), 1e-6)
    best = complex(poles[np.argmin(away)])
    return best if abs(best - to) <= within * abs(to) else None


def _estimate(
    method: str,
    covariances: _Covariances,
    pole: complex,
    shape: ComplexArray,
    poles_of: Callable[[Array], tuple[ComplexArray, ComplexArray]],
) -> Estimate | None:
    """Return pole with its intervals by the jackknife; None where it is not there without some block."""
    blocks = len(covariances.counts)
    rest = []
    for b in range(blocks):
        same = _nearest(*poles_of(covariances.without(b)), pole, shape, np.inf)
        if same is None:
            return None
        rest.append(same)
    wide = float(student.ppf(0.5 + 0.5 * LEVEL, blocks - 1))
    hertz = np.array([abs(z) / (2.0 * np.pi) for z in rest])
    ratios = np.array([_ratio(z) for z in rest])

    def interval(value: float, others: Array) -> tuple[float, float]:
        half = wide * float(np.sqrt((blocks - 1) / blocks * np.sum((others - others.mean()) ** 2)))
        return value - half, value + half

    f, z = abs(pole) / (2.0 * np.pi), _ratio(pole)
    return Estimate(method, f, interval(f, hertz), z, interval(z, ratios))
