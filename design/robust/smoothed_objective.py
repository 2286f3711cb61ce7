r"""Smoothed worst damping of many closed loops, with analytic gradient.

One controller :math:`K = (A_K, B_K, C_K, D_K)` is judged on a family of design models
(operating point x loss pattern x latency). With the eigenvalues
:math:`\lambda = a + jb` of every closed loop

.. math::
    f(K) = \frac1\rho \log \sum \left(e^{\rho v} + e^{\rho w}\right), \qquad
    v = t(|b|) - z + \max(a, 0)^2, \qquad w = -s z + \max(a, 0)^2, \qquad
    z = \frac{-a}{\max(|\lambda|, 0.2)} ,

so that minimising *f* raises the least damping ratio *z* over all models. The band offsets *t* require more
of the inter-area band than of the rest. With *w* every band requires stability, however little *t* asks of
it: *s* is 1 for growing eigenvalues and `STEEP` for others, so that *f* rises before an eigenvalue reaches
the imaginary axis, not in a jump where it crosses, which no step foresees. The square is for growing real
roots, whose damping ratio is -1 for any speed. All eigenvalues count: there is no sorting and no mode
tracking. Penalties keep the control effort below a cap over frequency and the controller's poles in a band.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from ..linear.matrices import ZERO_EIGENVALUE, decays
from .spectra import eigensystems, eigenvalues
from .swing_penalty import SwingPenalty

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]
Gains = tuple[Array, Array, Array, Array]

EFFORT_WEIGHT = 20.0**0.5  #: of the excess over the cap of the effort, before it is squared
#: slope of w over the damping ratio: a pair with .005, as weak as local modes are without control, holds the
#: worst no higher than -.2; designs of the bundled grids reach less with a signal lost (`worked_studies.md`)
STEEP = 40.0
#: modes slower than this are the common speed of all machines, rad/s: no target of a damping controller
COMMON_SPEED = 0.02
SLOW_RADIUS = 0.2  #: below this modulus damping is measured against the radius, not the modulus (rad/s)


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
class DesignModel:
    """One plant with its losses and latencies: x' = A x + B u, y = C x (rad/s in y, pu in u)."""

    name: str
    A: Array
    B: Array
    C: Array
    more: tuple[BandOffsets, ...] = ()  #: damping wanted on top of the objective's offsets


@dataclass(frozen=True)
class EffortGrid:
    """Plant response on a frequency grid, and the cap on |(I - K G)^-1 K| there."""

    name: str
    omega: Array  #: (f,) rad/s
    response: Complex  #: (f, p, m) G(j omega), filters in series with K and latencies included
    cap: Array  #: (f,)


@dataclass(frozen=True)
class Objective:
    """f(K) and its gradient; `order`, `n_y`, `n_u` fix the shapes, `mask` the structure.

    The parameter vector has A_K, B_K, C_K, D_K row by row without masked entries, and without D_K if there is
    no mask and no `feedthrough`. With `dc_block` D_K is not a parameter but C_K A_K^-1 B_K, so that K(0) = 0:
    a washout without a state, whose corner is the slowest pole of K. `swing` adds its penalty.
    """

    models: Sequence[DesignModel]
    order: int
    efforts: Sequence[EffortGrid] = ()
    offsets: BandOffsets = field(default_factory=BandOffsets)
    rho: float = 600.0
    fastest_pole: float = 280.0  #: rad/s, on the controller's own poles
    slowest_pole: float = 0.06  #: rad/s
    mask: npt.NDArray[np.bool_] | None = None
    feedthrough: bool = False
    dc_block: bool = False
    swing: SwingPenalty | None = None  #: on what K adds to the first swing after a fault

    @property
    def n_y(self) -> int:
        """Number of signals."""
        return int(self.models[0].C.shape[0])

    @property
    def n_u(self) -> int:
        """Number of actuators."""
        return int(self.models[0].B.shape[1])

    @cached_property
    def parts(self) -> list[list[int]]:
        """States of each part of K that no entry of A_K couples to the others."""
        n = self.order
        joined = self._free[: n * n].reshape(n, n)
        parts: list[list[int]] = []
        for k in range(n):
            linked = [part for part in parts if joined[k, part].any() or joined[part, k].any()]
            parts = [part for part in parts if part not in linked]
            parts.append(sorted([k, *(i for part in linked for i in part)]))
        return parts

    @cached_property
    def _free(self) -> npt.NDArray[np.bool_]:
        n, p, m = self.order, self.n_y, self.n_u
        free = np.ones(n * n + n * p + m * n + m * p, dtype=bool)
        free[n * n + n * p + m * n :] = self.feedthrough and not self.dc_block
        if self.mask is not None:
            free[: self.mask.size] &= self.mask
        return free

    @cached_property
    def groups(self) -> list[tuple[list[DesignModel], Array, Array, Array]]:
        """Models of equal size with A, B, C stacked."""
        sizes: dict[int, list[DesignModel]] = {}
        for model in self.models:
            sizes.setdefault(model.A.shape[0], []).append(model)
        return [
            (
                group,
                np.array([g.A for g in group]),
                np.array([g.B for g in group]),
                np.array([g.C for g in group]),
            )
            for _, group in sorted(sizes.items())
        ]

    @cached_property
    def grids(self) -> list[tuple[Array, Complex, Array]]:
        """Effort grids of equal frequencies stacked: omega (f,), responses (e, f, p, m), caps (e, f)."""
        stacks: list[tuple[Array, list[Complex], list[Array]]] = []
        for effort in self.efforts:
            for omega, responses, caps in stacks:
                if np.array_equal(omega, effort.omega):
                    responses.append(effort.response)
                    caps.append(effort.cap)
                    break
            else:
                stacks.append((effort.omega, [effort.response], [effort.cap]))
        return [(omega, np.array(responses), np.array(caps)) for omega, responses, caps in stacks]

    def unpack(self, theta: Array) -> tuple[Array, Array, Array, Array]:
        """Return (A_K, B_K, C_K, D_K) of the parameter vector."""
        n, p, m = self.order, self.n_y, self.n_u
        full = np.zeros(self._free.size)
        full[self._free] = theta
        a, b, c = n * n, n * n + n * p, n * n + n * p + m * n
        A, B, C = full[:a].reshape(n, n), full[a:b].reshape(n, p), full[b:c].reshape(m, n)
        return A, B, C, C @ np.linalg.solve(A, B) if self.dc_block else full[c:].reshape(m, p)

    def pack(self, A: Array, B: Array, C: Array, D: Array | None = None) -> Array:
        """Return the parameter vector of (A_K, B_K, C_K, D_K) or of gradients of that shape."""
        D = np.zeros((self.n_u, self.n_y)) if D is None else D
        return np.asarray(np.concatenate([A.ravel(), B.ravel(), C.ravel(), D.ravel()])[self._free])

    def narrowed(self, theta: Array, within: float) -> Objective:
        """Return the objective over the models that are within `within` (damping) of the worst at `theta`."""
        spectra = self.spectra(self.unpack(theta))
        tops = [float(top) for *_, v in spectra for top in v.max(axis=1)]
        names = [model.name for group in self.groups for model in group[0]]
        worst = max(tops)
        near = {name for name, top in zip(names, tops, strict=True) if top >= worst - within}
        return replace(self, models=[model for model in self.models if model.name in near])

    def closed_loops(self, theta: Array) -> list[Array]:
        """Return the closed-loop matrix of every design model."""
        return [loop for loops in self.loops(self.unpack(theta)) for loop in loops]

    def worst(self, theta: Array) -> tuple[float, float]:
        """Return (largest real part, least damping ratio among modes above 0.2 rad/s) over all models."""
        values = self._roots(theta)
        oscillating = values[np.abs(values.imag) > SLOW_RADIUS]
        damping = -oscillating.real / np.abs(oscillating)
        return float(values.real.max()), float(damping.min(initial=1.0))

    def stable(self, theta: Array) -> bool:
        """Return whether the loop of every model is stable (`decays`)."""
        return decays(self._roots(theta))

    def _roots(self, theta: Array) -> Complex:
        return np.concatenate([eigenvalues(loops).ravel() for loops in self.loops(self.unpack(theta))])

    def __call__(self, theta: Array) -> tuple[float, Array]:
        """Return f and its gradient."""
        K = self.unpack(theta)
        f, *gradient = self._damping(K)
        penalty, slope = self.penalties(K)
        return f + penalty, self.pack_gradient(K, *gradient) + slope

    def value(self, theta: Array) -> float:
        """Return f alone."""
        K = self.unpack(theta)
        v = np.concatenate([v.ravel() for *_, v in self.spectra(K)])
        top = float(v.max())
        return top + float(np.log(np.exp(self.rho * (v - top)).sum())) / self.rho + self.penalties(K)[0]

    def penalties(self, K: Gains) -> tuple[float, Array]:
        """Return the penalties on effort, first swing and poles, and their gradient over the parameters."""
        hinges, rows = self.hinges(K)
        value, gradient = float((hinges**2).sum()), 2.0 * hinges @ rows
        if self.swing is None:
            return value, gradient
        more, *slopes = self.swing(K)
        return value + more, gradient + self.pack_gradient(K, *slopes)

    def hinges(self, K: Gains, margin: float = 0.0) -> tuple[Array, Array]:
        """Return the excess of effort and poles over their bounds (h,), and its gradients (h, parameters).

        The penalty is the sum of the squares. margin : also return values within a bound by at most this,
        below 0.
        """
        result = [self.pole_hinges(K, margin)]
        result += [self._effort_hinges(K, *grid, margin) for grid in self.grids]
        values, rows = zip(*result, strict=True)
        return np.concatenate(values), np.concatenate(rows)

    def pack_gradient(
        self, K: Gains, dA: Array, dB: Array | None = None, dC: Array | None = None, dD: Array | None = None
    ) -> Array:
        """Return the gradient over the parameters at K of gradients over A_K, B_K, C_K and D_K (None: 0)."""
        A, B, C, _ = K
        dB = np.zeros_like(B) if dB is None else dB
        dC = np.zeros_like(C) if dC is None else dC
        if self.dc_block and dD is not None:
            # D = C A^-1 B: its part is handed on to A, B and C
            AB, CA = np.linalg.solve(A, B), np.linalg.solve(A.T, C.T)
            dA, dB, dC = dA - CA @ dD @ AB.T, dB + CA @ dD, dC + dD @ AB.T
        return self.pack(dA, dB, dC, dD)

    def loops(self, K: Gains) -> list[Array]:
        """Return the closed-loop matrices (k, n, n) of each group of equal size."""
        return [_loops(A, B, C, K) for _, A, B, C in self.groups]

    def spectra(self, K: Gains) -> list[tuple[list[DesignModel], int, Array, Array]]:
        """Return for each group its models, their states, closed loops (k, n, n), v and w (k, 2 n)."""
        spectra = []
        for group, A, B, C in self.groups:
            loops = _loops(A, B, C, K)
            excess = self.excess(eigenvalues(loops), group)[0]
            spectra.append((group, A.shape[1], loops, excess))
        return spectra

    def _damping(self, K: Gains) -> tuple[float, Array, Array, Array, Array]:
        # eigenvalues alone cost a third of those with vectors, and few models carry the gradient
        spectra = self.spectra(K)
        top = max(float(v.max()) for *_, v in spectra)
        total = sum(float(np.exp(self.rho * (v - top)).sum()) for *_, v in spectra)
        f = top + np.log(total) / self.rho
        dA, dB, dC, dD = (np.zeros_like(M) for M in K)
        for group, size, loops, v in spectra:
            # a model whose weight is below rounding adds nothing to the gradient
            share = (np.exp(self.rho * (v - top)) / total).sum(axis=1)
            few = np.flatnonzero(share > 1e-8)
            for k, damping in zip(map(int, few), eigensystems(loops[few]), strict=True):
                if damping is None:  # a defective matrix: its neighbours carry the gradient
                    continue
                values, right, left = damping
                (excess,), (dv,) = self.excess(values[None], [group[k]])
                weighted = (np.exp(self.rho * (excess - top)) / total * dv).reshape(2, -1).sum(axis=0)
                M = ((right * weighted) @ left).T.real
                g = group[k]
                dD += g.B.T @ M[:size, :size] @ g.C.T
                dC += g.B.T @ M[:size, size:]
                dB += M[size:, :size] @ g.C.T
                dA += M[size:, size:]
        return float(f), dA, dB, dC, dD

    def excess(
        self, values: npt.NDArray[np.inexact[Any]], models: Sequence[DesignModel] = ()
    ) -> tuple[Array, Complex]:
        """Return v, then w, of the n eigenvalues of each loop (..., 2 n), and their d/da - j d/db.

        The last axis of `values` has the eigenvalues of one loop. -1 for the common speed, which no
        controller moves: only the eigenvalue nearest to 0 may be that. models : (k,) of the loops, `values`
        then (k, n); none: all models have equal requirements.
        """
        a, b = values.real, values.imag
        modulus = np.abs(values)
        fast = modulus >= SLOW_RADIUS
        m = np.where(fast, modulus, SLOW_RADIUS)
        offset, slope = self.offsets(np.abs(b))
        for k, model in enumerate(models):
            for more in model.more:
                extra, bend = more(np.abs(b[k]))
                offset[k] += extra
                slope[k] += bend
        away, steep = np.maximum(a, 0.0), np.where(a > 0.0, 1.0, STEEP)
        da = np.where(fast, b**2 / m**3, 1.0 / SLOW_RADIUS)
        db = np.where(fast, -a * b / m**3, 0.0)
        is_common = (
            (modulus < COMMON_SPEED)
            & (a < ZERO_EIGENVALUE)
            & (modulus <= modulus.min(axis=-1, keepdims=True))
        )
        demand = offset + a / m + away**2, da + 2.0 * away - 1j * (db + slope * np.sign(b))
        stable = steep * a / m + away**2, steep * da + 2.0 * away - 1j * steep * db
        values_of, slopes_of = (
            np.concatenate([np.where(is_common, common, each) for each in both], axis=-1)
            for common, both in zip((-1.0, 0.0), zip(demand, stable, strict=True), strict=True)
        )
        return values_of, slopes_of

    def bends(self, eigenvalue: complex, of_w: bool) -> tuple[float, float, float]:
        """Second derivatives of v, or of w: over a twice, over a and b, over b twice."""
        a, b, m = eigenvalue.real, eigenvalue.imag, abs(eigenvalue)
        away, steep = (2.0, 1.0) if a > 0.0 else (0.0, STEEP if of_w else 1.0)
        if m < SLOW_RADIUS:
            return away, 0.0, 0.0
        scale = steep / m**5
        return (
            away - 3.0 * a * b**2 * scale,
            b * (2.0 * a**2 - b**2) * scale,
            a * (2.0 * b**2 - a**2) * scale,
        )

    def pole_hinges(self, K: Gains, margin: float = 0.0) -> tuple[Array, Array]:
        """Return the excess of poles of K over their bounds (h,), and its gradients (h, parameters)."""
        poles, right = np.linalg.eig(K[0])
        left = np.linalg.inv(right)
        size = np.maximum(np.abs(poles), 1e-9)
        hinges = [
            (np.log(size / self.fastest_pole), np.conj(poles) / size**2),
            (np.log(self.slowest_pole / size), -np.conj(poles) / size**2),
            (np.sqrt(10.0) * (poles.real + self.slowest_pole), np.full(poles.shape, np.sqrt(10.0) + 0j)),
        ]
        values, rows = [], [np.zeros((0, self._free.sum()))]
        for value, slope in hinges:
            for k in np.flatnonzero(value > -margin):
                values.append(float(value[k]))
                dA = (slope[k] * np.outer(right[:, k], left[k])).T.real
                rows.append(self.pack_gradient(K, dA)[None])
        return np.array(values), np.concatenate(rows)

    def _effort_hinges(
        self, K: Gains, omega: Array, G: Complex, cap: Array, margin: float
    ) -> tuple[Array, Array]:
        """Return where |T|/cap - 1 > -margin, T = (I - K G)^-1 K, Frobenius norm, (h,), and its gradients.

        omega (f,), G (e, f, p, m), cap (e, f): e plants on one frequency grid.
        """
        A_K, B_K, C_K, D_K = K
        P = np.linalg.inv(1j * omega[:, None, None] * np.eye(A_K.shape[0]) - A_K)
        PB, CP = P @ B_K, C_K @ P
        gain = C_K @ PB + D_K
        loop = np.eye(gain.shape[1]) - gain @ G
        S = 1.0 / loop if loop.shape[-1] == 1 else np.linalg.inv(loop)
        T = S @ gain
        size = np.sqrt((T.real**2 + T.imag**2).sum(axis=(2, 3)))
        excess = size / cap - 1.0
        plants, frequencies = np.nonzero(excess > -margin)
        G, T, S = G[plants, frequencies], T[plants, frequencies], S[plants, frequencies]
        PB, CP = PB[frequencies], CP[frequencies]
        # d(|T|/cap) = d(|T|^2) / (2 |T| cap)
        scale = EFFORT_WEIGHT / (cap * np.maximum(size, 1e-300))[plants, frequencies]
        X = (np.eye(G.shape[1]) + G @ T) @ np.conj(T.transpose(0, 2, 1)) @ S * scale[:, None, None]
        dD, dC, dB, dA = (M.real.transpose(0, 2, 1) for M in (X, PB @ X, X @ CP, PB @ X @ CP))
        rows = [self.pack_gradient(K, *each)[None] for each in zip(dA, dB, dC, dD, strict=True)]
        empty = np.zeros((0, self._free.sum()))
        return EFFORT_WEIGHT * excess[plants, frequencies], np.concatenate([empty, *rows])


def _loops(A: Array, B: Array, C: Array, K: Gains) -> Array:
    """Closed-loop matrices of stacked models (k, n, n), (k, n, m), (k, p, n) with one controller."""
    A_K, B_K, C_K, D_K = K
    size = A.shape[1]
    loops = np.empty((A.shape[0], size + A_K.shape[0], size + A_K.shape[0]))
    loops[:, :size, :size] = A + B @ D_K @ C
    loops[:, :size, size:] = B @ C_K
    loops[:, size:, :size] = B_K @ C
    loops[:, size:, size:] = A_K
    return loops
