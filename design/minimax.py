r"""The last stretch of a robust design: sequential linear programs on the worst damping itself.

Near the optimum many eigenvalues and effort constraints are active at once and descent on the smoothed
objective crawls. Here every eigenvalue close to the worst is linearised, and

.. math::
    \min_{d, t, s} \; t + \mu s \quad \text{s.t.} \quad v_i + \nabla v_i^T d \le t, \quad
    e_j + \nabla e_j^T d \le s, \quad s \ge 0, \quad |d_k| \le \Delta\, w_k

is solved, with *v* as in `smoothed.py` and *e* the relative excess over the effort cap at each frequency and
over the band of the controller's poles. The step is taken when it lowers :math:`\max v + \mu \max(0, e)`.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import linprog

from .smoothed import Array, Complex, Gains, Objective

#: price of an excess over a cap, in damping
PENALTY = 2.0


def minimax_polish(
    objective: Objective, start: Array, *, iterations: int = 200, radius: float = 0.02
) -> tuple[Array, float]:
    """Return the parameters after sequential linear programs from `start`, and the merit reached.

    radius : first trust region, relative to the size of each parameter.
    """
    theta = start
    merit = worst_merit(objective, theta)
    model = None
    for _ in range(iterations):
        if model is None:
            model = _linear_model(objective, theta, 0.3 * radius + 0.02)
        step, predicted = _linear_program(model, theta, radius)
        gained = merit - worst_merit(objective, theta + step)
        if gained > 0.0:
            theta, merit, model = theta + step, merit - gained, None
        if not predicted > 1e-7:
            break
        ratio = gained / predicted
        radius *= 2.0 if ratio > 0.7 else 1.0 if ratio > 0.2 else 0.4
        radius = min(radius, 0.2)
        if not radius > 1e-7:
            break
    return theta, merit


def worst_merit(objective: Objective, theta: Array) -> float:
    """Return max v plus the price of the largest excess over a cap; infinite for an unstable design model."""
    K = objective.unpack(theta)
    worst = max(float(objective.excess(np.linalg.eigvals(loops))[0].max()) for loops in objective.loops(K))
    return worst + PENALTY * max(0.0, *(float(e.max(initial=0.0)) for e, _ in _caps(objective, K)))


def _linear_model(objective: Objective, theta: Array, depth: float) -> tuple[Array, Array, Array, Array]:
    """Values and gradients of the eigenvalues within `depth` of the worst, and of caps nearly reached."""
    K = objective.unpack(theta)
    spectra = [np.linalg.eig(loops) for loops in objective.loops(K)]
    excesses = [objective.excess(values) for values, _ in spectra]
    top = max(float(v.max()) for v, _ in excesses)
    values: list[Array] = []
    gradients: list[Array] = []
    for (eigenvalues, right), (v, dv), (_, _, B, C) in zip(spectra, excesses, objective.groups, strict=True):
        near = (v > top - depth) & (eigenvalues.imag >= 0.0)
        for k in map(int, np.flatnonzero(near.any(axis=1))):
            try:
                left = np.linalg.inv(right[k])
            except np.linalg.LinAlgError:
                continue
            which = near[k]
            values.append(v[k][which])
            gradients.append(
                _eigenvalue_gradients(objective, K, left[which], right[k][:, which], dv[k][which], B[k], C[k])
            )
    caps = _caps(objective, K)
    e, de = np.concatenate([c[0] for c in caps]), np.vstack([c[1] for c in caps])
    return np.concatenate(values), np.vstack(gradients), e, de


def _eigenvalue_gradients(
    objective: Objective, K: Gains, left: Complex, right: Complex, dv: Complex, B: Array, C: Array
) -> Array:
    """Gradient rows of v for eigenvalues with rows `left` and columns `right`."""
    size = B.shape[0]
    lB, lK = (left[:, :size] @ B) * dv[:, None], left[:, size:] * dv[:, None]
    rC, rK = (C @ right[:size]).T, right[size:].T
    parts = [np.einsum("ki,kj->kij", x, y).real for x, y in ((lK, rK), (lK, rC), (lB, rK), (lB, rC))]
    return np.array([objective.pack_gradient(K, *rows) for rows in zip(*parts, strict=True)])


def _caps(objective: Objective, K: Gains) -> list[tuple[Array, Array]]:
    """Excess and its gradient rows where an effort or a pole is within 10 % of its cap or beyond."""
    A_K, B_K, C_K, D_K = K
    size = objective.pack(*K).size
    found = [(np.zeros(0), np.zeros((0, size)))]
    for omega, G, cap in objective.grids:
        P = np.linalg.inv(1j * omega[:, None, None] * np.eye(A_K.shape[0]) - A_K)
        PB, CP = P @ B_K, C_K @ P
        gain = C_K @ PB + D_K
        S = np.linalg.inv(np.eye(gain.shape[1]) - gain @ G)
        T = S @ gain
        h = np.sqrt((np.abs(T) ** 2).sum(axis=(2, 3)))
        rows = np.nonzero(h > 0.9 * cap)
        G, T, S, h, limit = G[rows], T[rows], S[rows], h[rows], cap[rows]
        if not h.size:
            continue
        X = (np.eye(G.shape[1]) + G @ T) @ np.conj(T.transpose(0, 2, 1)) @ S / (h * limit)[:, None, None]
        PB, CP = PB[rows[1]], CP[rows[1]]
        parts = [np.transpose(M, (0, 2, 1)).real for M in (PB @ X @ CP, X @ CP, PB @ X, X)]
        gradients = np.array([objective.pack_gradient(K, *g) for g in zip(*parts, strict=True)])
        found.append((h / limit - 1.0, gradients))
    found.append(_pole_caps(objective, K))
    return found


def _pole_caps(objective: Objective, K: Gains) -> tuple[Array, Array]:
    """ln(|p|/fastest) and ln(slowest/|p|), and Re p + slowest/4, as excesses."""
    poles, right = np.linalg.eig(K[0])
    left = np.linalg.inv(right)
    size = np.maximum(np.abs(poles), 1e-12)
    radial = np.conj(poles) / size**2
    values = [np.log(size / objective.fastest_pole), np.log(objective.slowest_pole / size), poles.real + 0.02]
    slopes = [radial, -radial, np.ones_like(poles)]
    rows = [
        [objective.pack_gradient(K, np.real(s * np.outer(left[i], right[:, i]))) for i, s in enumerate(slope)]
        for slope in slopes
    ]
    return np.concatenate(values), np.concatenate([np.array(r) for r in rows])


def _linear_program(
    model: tuple[Array, Array, Array, Array], theta: Array, radius: float
) -> tuple[Array, float]:
    """Return the step and the decrease of the merit that the linear model predicts."""
    v, dv, e, de = model
    scale = np.abs(theta) + 0.1 * float(np.sqrt(np.mean(theta**2)))
    top, over = float(v.max()), max(0.0, float(e.max(initial=0.0)))
    n = theta.size
    rows = np.vstack(
        [
            np.hstack([dv * scale, -np.ones((v.size, 1)), np.zeros((v.size, 1))]),
            np.hstack([de * scale, np.zeros((e.size, 1)), -np.ones((e.size, 1))]),
        ]
    )
    found = linprog(
        np.concatenate([np.zeros(n), [1.0, PENALTY]]),
        A_ub=rows,
        b_ub=np.concatenate([top - v, -e]),
        bounds=[(-radius, radius)] * n + [(None, None), (0.0, None)],
        method="highs",
    )
    if found.x is None:
        return np.zeros(n), 0.0
    return scale * found.x[:n], PENALTY * over - float(found.fun)
