r"""Smoothed worst damping of many closed loops, with analytic gradient.

One controller :math:`K = (A_K, B_K, C_K)` is judged on a family of design models
(operating point x loss pattern x latency). With the eigenvalues
:math:`\lambda = a + jb` of every closed loop

.. math::
    f(K) = \frac1\rho \log \sum e^{\rho v}, \qquad
    v = t(|b|) - z, \qquad z = \frac{-a}{\max(|\lambda|, 0.2)} ,

so that minimising *f* raises the least damping ratio *z* over all models; the
band offsets *t* ask more of the inter-area band than of the rest. All
eigenvalues count: there is no sorting and no mode tracking. Penalties keep the
control effort below a cap over frequency and the controller's poles in a band.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

SLOW_RADIUS = 0.2  #: below this modulus damping is measured against the radius, not the modulus (rad/s)


@dataclass(frozen=True)
class DesignModel:
    """One plant with its losses and latencies: x' = A x + B u, y = C x (rad/s in y, pu in u)."""

    name: str
    A: Array
    B: Array
    C: Array


@dataclass(frozen=True)
class EffortGrid:
    """Plant response on a frequency grid, and the cap on |(I - K G)^-1 K| there."""

    name: str
    omega: Array  #: (f,) rad/s
    response: Complex  #: (f, p, m) G(j omega), filters in series with K and latencies included
    cap: Array  #: (f,)


@dataclass(frozen=True)
class BandOffsets:
    """Piecewise-linear t(|Im lambda|): how much more (or less) damping a band must have."""

    omega: tuple[float, ...] = (0.0, 1.0, 2.4, 5.0, 5.8, 15.0, 18.0)
    offset: tuple[float, ...] = (-0.05, -0.05, 0.06, 0.06, 0.0, 0.0, -0.10)

    def __call__(self, omega: Array) -> tuple[Array, Array]:
        """Return the offset and its slope at `omega` >= 0, arrays of equal shape."""
        nodes, values = np.array(self.omega), np.array(self.offset)
        slopes = np.append(np.diff(values) / np.diff(nodes), 0.0)
        k = np.clip(np.searchsorted(nodes, omega, side="right") - 1, 0, len(nodes) - 1)
        return np.interp(omega, nodes, values), slopes[k]


@dataclass(frozen=True)
class Objective:
    """f(K) and its gradient; `order`, `n_y`, `n_u` fix the shapes, `mask` the structure.

    The parameter vector holds A_K, B_K, C_K row by row, masked entries left out.
    """

    models: Sequence[DesignModel]
    order: int
    efforts: Sequence[EffortGrid] = ()
    offsets: BandOffsets = field(default_factory=BandOffsets)
    rho: float = 600.0
    fastest_pole: float = 280.0  #: rad/s, on the controller's own poles
    slowest_pole: float = 0.06  #: rad/s
    mask: npt.NDArray[np.bool_] | None = None

    @property
    def n_y(self) -> int:
        return int(self.models[0].C.shape[0])

    @property
    def n_u(self) -> int:
        return int(self.models[0].B.shape[1])

    def unpack(self, theta: Array) -> tuple[Array, Array, Array]:
        """Return (A_K, B_K, C_K) of the parameter vector."""
        n, p, m = self.order, self.n_y, self.n_u
        full = theta
        if self.mask is not None:
            full = np.zeros(self.mask.size)
            full[self.mask] = theta
        return (
            full[: n * n].reshape(n, n),
            full[n * n : n * n + n * p].reshape(n, p),
            full[n * n + n * p :].reshape(m, n),
        )

    def pack(self, A: Array, B: Array, C: Array) -> Array:
        """Return the parameter vector of (A_K, B_K, C_K) or of gradients of that shape."""
        full = np.concatenate([A.ravel(), B.ravel(), C.ravel()])
        return full if self.mask is None else full[self.mask]

    def closed_loops(self, theta: Array) -> list[Array]:
        """Return the closed-loop matrix of every design model."""
        A_K, B_K, C_K = self.unpack(theta)
        return [np.block([[g.A, g.B @ C_K], [B_K @ g.C, A_K]]) for g in self.models]

    def worst(self, theta: Array) -> tuple[float, float]:
        """Return (largest real part, least damping ratio among modes above 0.2 rad/s) over all models."""
        eigenvalues = np.concatenate([np.linalg.eigvals(A) for A in self.closed_loops(theta)])
        oscillating = eigenvalues[np.abs(eigenvalues.imag) > SLOW_RADIUS]
        damping = -oscillating.real / np.abs(oscillating)
        return float(eigenvalues.real.max()), float(damping.min())

    def __call__(self, theta: Array) -> tuple[float, Array]:
        """Return f and its gradient."""
        A_K, B_K, C_K = self.unpack(theta)
        f, dA, dB, dC = self._damping(A_K, B_K, C_K)
        for effort in self.efforts:
            g, eA, eB, eC = _effort_penalty(effort, A_K, B_K, C_K)
            f, dA, dB, dC = f + g, dA + eA, dB + eB, dC + eC
        g, pA = self._pole_penalty(A_K)
        return f + g, self.pack(dA + pA, dB, dC)

    def _damping(self, A_K: Array, B_K: Array, C_K: Array) -> tuple[float, Array, Array, Array]:
        spectra = []
        v_all, dv_all = [], []
        for size, group in _by_size(self.models):
            loops = np.zeros((len(group), size + self.order, size + self.order))
            for k, g in enumerate(group):
                loops[k, :size, :size] = g.A
                loops[k, :size, size:] = g.B @ C_K
                loops[k, size:, :size] = B_K @ g.C
                loops[k, size:, size:] = A_K
            eigenvalues, right = np.linalg.eig(loops)
            v, dv = self._excess(eigenvalues)
            spectra.append((group, size, right))
            v_all.append(v)
            dv_all.append(dv)
        top = max(float(v.max()) for v in v_all)
        total = sum(float(np.exp(self.rho * (v - top)).sum()) for v in v_all)
        f = top + np.log(total) / self.rho
        dA, dB, dC = np.zeros_like(A_K), np.zeros_like(B_K), np.zeros_like(C_K)
        for (group, size, right), v, dv in zip(spectra, v_all, dv_all, strict=True):
            weight = np.exp(self.rho * (v - top)) / total
            # a model whose weight is below rounding adds nothing to the gradient
            for k in map(int, np.flatnonzero(weight.sum(axis=1) > 1e-14)):
                try:
                    left = np.linalg.inv(right[k])
                except np.linalg.LinAlgError:  # a defective matrix: its neighbours carry the gradient
                    continue
                M = ((right[k] * (weight[k] * dv[k])) @ left).T.real
                g = group[k]
                dC += g.B.T @ M[:size, size:]
                dB += M[size:, :size] @ g.C.T
                dA += M[size:, size:]
        return float(f), dA, dB, dC

    def _excess(self, eigenvalues: Complex) -> tuple[Array, Complex]:
        """v of every eigenvalue and dv/da - j dv/db."""
        a, b = eigenvalues.real, eigenvalues.imag
        modulus = np.abs(eigenvalues)
        fast = modulus >= SLOW_RADIUS
        m = np.where(fast, modulus, SLOW_RADIUS)
        offset, slope = self.offsets(np.abs(b))
        da = np.where(fast, b**2 / m**3, 1.0 / SLOW_RADIUS)
        db = np.where(fast, -a * b / m**3, 0.0) + slope * np.sign(b)
        return offset + a / m, da - 1j * db

    def _pole_penalty(self, A_K: Array) -> tuple[float, Array]:
        poles, right = np.linalg.eig(A_K)
        left = np.linalg.inv(right)
        size = np.maximum(np.abs(poles), 1e-9)
        fast = np.maximum(0.0, np.log(size / self.fastest_pole))
        slow = np.maximum(0.0, np.log(self.slowest_pole / size))
        late = np.maximum(0.0, poles.real + self.slowest_pole)
        radial = 2.0 * (fast - slow) / size  # d/d|p|
        derivative = radial * np.conj(poles) / size + 20.0 * late
        value = float((fast**2 + slow**2 + 10.0 * late**2).sum())
        return value, ((right * derivative) @ left).T.real


def _by_size(models: Sequence[DesignModel]) -> list[tuple[int, list[DesignModel]]]:
    sizes: dict[int, list[DesignModel]] = {}
    for model in models:
        sizes.setdefault(model.A.shape[0], []).append(model)
    return sorted(sizes.items(), key=lambda item: item[0])


def _effort_penalty(
    effort: EffortGrid, A_K: Array, B_K: Array, C_K: Array, weight: float = 20.0
) -> tuple[float, Array, Array, Array]:
    """weight * sum max(0, |T|/cap - 1)^2 with T = (I - K G)^-1 K, Frobenius norm, and its gradient."""
    n = A_K.shape[0]
    P = np.linalg.inv(1j * effort.omega[:, None, None] * np.eye(n) - A_K)
    PB = P @ B_K
    K = C_K @ PB
    G = effort.response
    S = np.linalg.inv(np.eye(K.shape[1]) - K @ G)
    T = S @ K
    size = np.sqrt((np.abs(T) ** 2).sum(axis=(1, 2)))
    excess = np.maximum(0.0, size / effort.cap - 1.0)
    value = weight * float((excess**2).sum())
    if value == 0.0:
        return 0.0, np.zeros_like(A_K), np.zeros_like(B_K), np.zeros_like(C_K)
    # d(value) = weight * 2 excess / cap * d|T|,  d|T| = d(|T|^2) / (2 |T|)
    scale = weight * excess / (effort.cap * np.maximum(size, 1e-300))
    X = (np.eye(G.shape[1]) + G @ T) @ np.conj(T.transpose(0, 2, 1)) @ S * scale[:, None, None]
    CP = C_K @ P
    dC = 2.0 * (PB @ X).sum(axis=0).real.T
    dB = 2.0 * (X @ CP).sum(axis=0).real.T
    dA = 2.0 * (PB @ X @ CP).sum(axis=0).real.T
    return value, dA, dB, dC
