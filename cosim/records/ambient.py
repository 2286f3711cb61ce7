"""Damping from ambient motion, by two methods of different kind, each with an interval.

Both take the covariances R(t) of the signals. Stochastic subspace identification (Van Overschee and De Moor
1996; driven by covariances, Peeters and De Roeck 1999) factors their Toeplitz matrix; a pole is the mean over
the first orders at which it is stationary. The modified Yule-Walker equations (Stoica and Moses 2005, 3.7;
for grids Wies, Pierre and Trudnowski 2003) fit an autoregression to lags beyond its order, by the largest
singular values of their matrix [Cadzow1982].

Intervals are by the infinitesimal jackknife over blocks of the record [Jaeckel1972], from the derivatives of
the poles by the weight of each block. Derivatives of poles by subspaces are those of covariances of exactly
the rank of the model, the asymptotic ones [ChiusoPicci2004]: those of the truncated decomposition itself
become infinite where the last singular value kept nears the first left out, far above the errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from scipy.stats import t as student

from .record import Array

ComplexArray = npt.NDArray[np.complex128]
LEVEL = 0.95
SUBSPACE, YULE_WALKER = "subspace identification", "modified Yule-Walker"
_LAG_S = 2.0  # of the Toeplitz matrix, a side
_ORDERS = range(4, 25, 2)
_STAYS_F, _STAYS_Z = (
    0.02,
    0.02,
)  # relative change of a frequency, change of a damping ratio from order to order
LIKE = 0.5  #: squared cosine of two shapes that are nearer to each other than to any at right angles
_LEAST_ORDERS = 4  # at which a pole is there, and of which it is the mean
_MOST_DAMPED = 0.35
_LEAST_SHARE = 0.01  # of the motion: less is no mode
_SAME = 0.08  # of the distance of two poles over their size that are one mode by two methods
_SAME_OF_ONE = 0.25  # the same where a signal passes little but one mode
_FEW_ORDERS = [6, 8, 10, 12]  # of the model of such a signal
_AR_ORDER, _AR_EQUATIONS = 8, 20
_AR_RANK = 10  # of the equations: with all 24 the errors of modes .03 Hz apart are 1.6 times as large
_LEAST_SINGULAR = 1e-12  # of the largest: less is rounding
_BLOCK_S, _MOST_BLOCKS, _LEAST_BLOCKS = 30.0, 20, 8
_LESS = 1e-3  # of the weight of a block, for derivatives by lags


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
class _Entry:
    """A pole (rad/s) at one order, or the mean of several, with the last order."""

    order: int
    pole: complex
    shape: ComplexArray
    share: float

    @classmethod
    def mean(cls, entries: Sequence[_Entry]) -> _Entry:
        last = entries[-1].shape
        turned = [e.shape * np.exp(-1j * np.angle(np.vdot(last, e.shape))) for e in entries]
        shape = np.mean([v / np.linalg.norm(v) for v in turned], axis=0)
        pole, share = np.mean([e.pole for e in entries]), np.mean([e.share for e in entries])
        return cls(entries[-1].order, complex(pole), shape, float(share))


@dataclass(frozen=True)
class _Covariances:
    """Sums of products over blocks, (blocks, lags + 1, signals, signals), and samples in each block."""

    sums: Array
    counts: Array

    @classmethod
    def of(cls, values: Array, step_s: float) -> _Covariances:
        blocks = int(np.clip(len(values) * step_s / _BLOCK_S, _LEAST_BLOCKS, _MOST_BLOCKS))
        lags = max(2 * _rows(step_s), 2 * _AR_ORDER + _AR_EQUATIONS)
        ends = np.linspace(0, len(values) - lags, blocks + 1).astype(int)
        m = values.shape[1]
        sums = np.zeros((blocks, lags + 1, m, m))
        for b, (first, last) in enumerate(pairwise(ends)):
            for lag in range(lags + 1):
                sums[b, lag] = values[first + lag : last + lag].T @ values[first:last]
        return cls(sums, np.diff(ends).astype(float))

    def all(self) -> Array:
        return np.asarray(self.sums.sum(axis=0) / self.counts.sum())

    def slopes(self) -> list[Array]:
        """Return the derivatives of the covariances by what is taken from the weight of each block."""
        R, count = self.all(), self.counts.sum()
        return [np.asarray((n * R - own) / count) for own, n in zip(self.sums, self.counts, strict=True)]


def _rows(step_s: float) -> int:
    return max(8, round(_LAG_S / step_s))


def ambient_modes(values: Array, step_s: float, band_hz: tuple[float, float]) -> list[AmbientMode]:
    """Return the modes in ambient signals (points, signals), strongest first.

    A mode is one that both methods find, or the first alone: `estimates` has those that do.
    """
    covariances, rows = _Covariances.of(values, step_s), _rows(step_s)
    R, slopes = covariances.all(), covariances.slopes()
    factors = _Factors.of(R, rows, step_s)
    tracks = _stable(factors, band_hz)
    orders = sorted({entry.order for track in tracks for entry in track})
    matrices = [_toeplitz(slope, rows) for slope in slopes]
    by_order = {n: factors.slopes(n, matrices) for n in orders}
    by_lags = _by_lags(R, slopes, step_s)
    modes = []
    for track in tracks:
        mode = _Entry.mean(track)
        own = np.mean([_of_pole(*by_order[e.order], e.pole) for e in track], axis=0)
        estimates = [_estimate(SUBSPACE, mode.pole, own)]
        other = _nearest(*_yule_walker(R, step_s), mode.pole, mode.shape)
        if other is not None:
            estimates.append(_estimate(YULE_WALKER, other, _slopes_by_lags(by_lags, other)))
        modes.append(AmbientMode(mode.pole, mode.share, mode.shape, mode.order, tuple(estimates)))
    return sorted(modes, key=lambda mode: -mode.share)


def estimate_of_one(values: Array, step_s: float, band_hz: tuple[float, float]) -> Estimate | None:
    """Return frequency and damping ratio of the strongest component in a band of one signal (points, 1).

    For a signal that contains little but one mode, however well damped: the pole of the autoregression
    nearest to the pole with the largest share by subspaces. None if they differ.
    """
    covariances = _Covariances.of(values, step_s)
    R = covariances.all()
    pole = _strongest(_Factors.of(R, _rows(step_s), step_s), band_hz)
    if pole is None:
        return None
    own = _nearest(*_yule_walker(R, step_s), pole, np.ones(1, complex), _SAME_OF_ONE)
    if own is None:
        return None
    return _estimate(YULE_WALKER, own, _slopes_by_lags(_by_lags(R, covariances.slopes(), step_s), own))


def _strongest(factors: _Factors, band_hz: tuple[float, float]) -> complex | None:
    """Return the pole with the largest share, the mean over a few orders; None if none is in the band."""
    best = []
    for poles, _, shares in map(factors.poles, _FEW_ORDERS):
        f = poles.imag / (2.0 * np.pi)
        share = np.where((f >= band_hz[0]) & (f <= band_hz[1]) & (poles.real < 0.0), shares, -np.inf)
        if share.size and np.isfinite(share.max()):
            best.append(poles[np.argmax(share)])
    return complex(np.mean(best)) if best else None


def _toeplitz(R: Array, rows: int) -> Array:
    return np.vstack([np.hstack([R[rows + r - c] for c in range(rows)]) for r in range(rows)])


@dataclass(frozen=True)
class _Factors:
    """The Toeplitz matrix of covariances as left x sigma x right. R0 : covariance of the signals (m, m)."""

    R0: Array
    left: Array
    sigma: Array
    right: Array
    step_s: float

    @classmethod
    def of(cls, R: Array, rows: int, step_s: float) -> _Factors:
        return cls(R[0], *np.linalg.svd(_toeplitz(R, rows), full_matrices=False), step_s)

    def poles(self, order: int) -> tuple[ComplexArray, ComplexArray, Array]:
        """Return poles (rad/s, upper half), their shapes (m, poles) and shares of the motion."""
        m, n = len(self.R0), self._rank(order)
        observed, _, discrete, vectors = self._states(n)
        G = (np.sqrt(self.sigma[:n])[:, None] * self.right[:n])[:, -m:]
        shapes, entered = observed[:m] @ vectors, np.linalg.solve(vectors, G.astype(complex))
        upper = _upper(discrete)
        # R(0) = sum of shape x entered / pole over all poles
        parts = np.array([2.0 * np.real(np.sum(shapes[:, k] * entered[k]) / discrete[k]) for k in upper])
        poles = np.asarray(np.log(discrete[upper]) / self.step_s, dtype=complex)
        return poles, shapes[:, upper], parts / np.trace(self.R0)

    def slopes(self, order: int, matrices: Sequence[Array]) -> tuple[ComplexArray, ComplexArray]:
        """Return the poles, and their derivatives (matrices, poles) by Toeplitz matrices added to one of rank
        `order`.

        The observability matrix O = left x sigma^0.5 changes by dO = dT x right / sigma^0.5, but for a change
        of coordinates; a pole z with vectors v, w of its shift matrix by w O+ (dO below - z dO above) v.
        """
        m, n = len(self.R0), self._rank(order)
        _, inverse, discrete, vectors = self._states(n)
        upper = _upper(discrete)
        z = discrete[upper]
        enters = (self.right[:n].T / np.sqrt(self.sigma[:n])) @ vectors[:, upper]
        leaves = np.linalg.inv(vectors)[upper] @ inverse
        rows = []
        for matrix in matrices:
            moved = matrix @ enters
            rows.append(np.sum(leaves.T * (moved[m:] - moved[:-m] * z), axis=0) / (z * self.step_s))
        return np.asarray(np.log(z) / self.step_s, dtype=complex), np.array(rows)

    def _rank(self, order: int) -> int:
        return min(order, int(np.sum(self.sigma > _LEAST_SINGULAR * self.sigma[0])))

    def _states(self, n: int) -> tuple[Array, Array, ComplexArray, ComplexArray]:
        """Return the observability matrix, the inverse of its upper part, discrete poles and vectors."""
        m, observed = len(self.R0), self.left[:, :n] * np.sqrt(self.sigma[:n])
        inverse = np.asarray(np.linalg.pinv(observed[:-m]), dtype=np.float64)
        discrete, vectors = np.linalg.eig(inverse @ observed[m:])
        return observed, inverse, discrete.astype(complex), vectors.astype(complex)


def _upper(discrete: ComplexArray) -> npt.NDArray[np.intp]:
    return np.flatnonzero((discrete.imag > 0.0) & (np.abs(discrete) > 1e-6))


def _stable(factors: _Factors, band_hz: tuple[float, float]) -> list[list[_Entry]]:
    """Return each mode that stays from order to order, at the first of them."""
    tracks: list[list[_Entry]] = []
    for n in _ORDERS:
        poles, shapes, shares = factors.poles(n)
        for k, pole in enumerate(poles):
            if not (
                band_hz[0] <= pole.imag / (2 * np.pi) <= band_hz[1] and 0.0 < _ratio(pole) < _MOST_DAMPED
            ):
                continue
            entry = _Entry(n, complex(pole), shapes[:, k], float(shares[k]))
            same = [t for t in tracks if n > t[-1].order >= n - 4 and _stays(t[-1], entry)]
            if same:
                min(same, key=lambda t: abs(t[-1].pole - pole)).append(entry)
            else:
                tracks.append([entry])
    modes = [t for t in tracks if len(t) >= _LEAST_ORDERS and np.median([e.share for e in t]) >= _LEAST_SHARE]
    return _apart([t[:_LEAST_ORDERS] for t in modes])


def _apart(tracks: list[list[_Entry]]) -> list[list[_Entry]]:
    """Leave out of two tracks of one pole and shape the weaker one."""
    left: list[tuple[_Entry, list[_Entry]]] = []
    for mode, track in sorted(((_Entry.mean(t), t) for t in tracks), key=lambda each: -each[0].share):
        if all(
            abs(mode.pole - e.pole) > 0.03 * abs(e.pole) or squared_cosine(mode.shape, e.shape) < LIKE
            for e, _ in left
        ):
            left.append((mode, track))
    return [track for _, track in left]


def squared_cosine(shapes: ComplexArray, other: ComplexArray) -> Array:
    """Return the squared cosine of each of `shapes` (m, poles) or (m,) and another (m,)."""
    size = np.sum(np.abs(shapes) ** 2, axis=0) * np.sum(np.abs(other) ** 2)
    return np.asarray(np.abs(other.conj() @ shapes) ** 2 / np.maximum(size, 1e-300))


def _ratio(pole: complex) -> float:
    return float(-pole.real / abs(pole))


def _stays(before: _Entry, now: _Entry) -> bool:
    change = abs(abs(now.pole) - abs(before.pole)) / abs(before.pole)
    close = change <= _STAYS_F and abs(_ratio(now.pole) - _ratio(before.pole)) <= _STAYS_Z
    return bool(close and squared_cosine(now.shape, before.shape) >= LIKE)


def _yule_walker(R: Array, step_s: float) -> tuple[ComplexArray, ComplexArray]:
    """Return poles (rad/s, upper half) and shapes (m, poles) of an autoregression by later lags."""
    p, m = _AR_ORDER, R.shape[-1]
    lags = range(p + 1, p + 1 + _AR_EQUATIONS)
    known = np.vstack([np.hstack([R[t - j].T for j in range(1, p + 1)]) for t in lags])
    left, sigma, right = np.linalg.svd(known, full_matrices=False)
    rank = min(_AR_RANK, int(np.sum(sigma > _LEAST_SINGULAR * sigma[0])))
    parts = (left.T @ np.vstack([R[t].T for t in lags]))[:rank] / sigma[:rank, None]
    coefficients = right[:rank].T @ parts
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


def _of_pole(poles: ComplexArray, slopes: ComplexArray, pole: complex) -> ComplexArray:
    return np.asarray(slopes[:, np.argmin(np.abs(poles - pole))])


def _by_lags(R: Array, slopes: Sequence[Array], step_s: float) -> list[ComplexArray]:
    """Return the poles of the autoregression with `_LESS` of the weight of each block in turn."""
    return [_yule_walker(R + _LESS * slope, step_s)[0] for slope in slopes]


def _slopes_by_lags(moved: Sequence[ComplexArray], pole: complex) -> ComplexArray:
    return np.array([(poles[np.argmin(np.abs(poles - pole))] - pole) / _LESS for poles in moved])


def _estimate(method: str, pole: complex, slopes: ComplexArray) -> Estimate:
    """Return a pole with its intervals, from its derivatives by the weight of each block."""
    blocks, size = len(slopes), abs(pole)
    wide = float(student.ppf(0.5 + 0.5 * LEVEL, blocks - 1))

    def interval(value: float, changes: Array) -> tuple[float, float]:
        around = changes - changes.mean()
        half = wide * float(np.sqrt(blocks / (blocks - 1) * np.sum(around**2)))
        return value - half, value + half

    f, z = size / (2.0 * np.pi), _ratio(pole)
    sizes = np.real(np.conj(pole) * slopes) / size
    ratios = -(slopes.real + z * sizes) / size
    return Estimate(method, f, interval(f, sizes / (2.0 * np.pi)), z, interval(z, ratios))
