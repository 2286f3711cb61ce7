r"""Trust-region Newton descent of the smoothed worst damping, with the second derivatives of the eigenvalues.

The objective has a valley with a kink wherever two eigenvalues are equally bad, and a designed loop has
dozens of them: a quasi-Newton method needs thousands of evaluations along them. With
:math:`p_k \propto e^{\rho v_k}` the Hessian is

.. math:: H = \rho \sum_k p_k (g_k - g)(g_k - g)^T + \sum_k p_k \nabla^2 v_k,\qquad g = \sum_k p_k g_k,

whose first part is the kinks and whose second follows from

.. math:: d^2\lambda_k = l_k\, d^2\!A\, r_k
    + 2 \sum_{j \ne k} \frac{(l_k\, dA\, r_j)(l_j\, dA\, r_k)}{\lambda_k - \lambda_j} .

A step costs a few evaluations of the gradient; some tens of steps replace thousands, until two eigenvalues
meet, where they have no derivative: there `stages.py` goes on with L-BFGS for a while.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from .smoothed_objective import Array, Complex, Gains, Objective

#: eigenvalues nearer to one another than this (rad/s) count as so far apart: their derivative has no bound
APART = 1e-2
#: bounds of poles (natural logarithm) and effort (relative) that are so near count in the Hessian
NEAR_BOUND = 0.1
#: step of the differences that give the curvature of D, of each unknown's scale
DIFFERENCE = 1e-5


def newton_descent(
    objective: Objective,
    start: Array,
    steps: int,
    *,
    balanced: Callable[[Objective, Array], Array],
    radius: float = 0.1,
    least: float = 2e-5,
) -> tuple[Array, int]:
    """Return the parameters after at most `steps` steps from `start`, and evaluations.

    balanced : gives equivalent parameters in better coordinates; called every few steps.
    radius : of the first trust region, relative to the scale of the unknowns.
    least : ends where five steps gain less than this in all.
    """
    theta = balanced(objective, start)
    value, count = objective(theta)[0], 1
    gained: list[float] = []
    for step in range(steps):
        if step % 5 == 4:
            theta = balanced(objective, theta)
        scale = _scale(objective, theta)
        gradient, hessian = derivatives(objective, theta, scale)
        curvature, directions = np.linalg.eigh(hessian * np.outer(scale, scale))
        slope = directions.T @ (gradient * scale)
        before = value
        while radius > 1e-7:
            move, predicted = _trusted(slope, curvature, radius)
            tried = theta + scale * (directions @ move)
            reached, count = _value(objective, tried), count + 1
            ratio = (value - reached) / max(predicted, 1e-300)
            if ratio > 0.05:
                theta, value = tried, reached
                radius = min(2.0 * radius, 2.0) if ratio > 0.7 else radius
                break
            radius *= 0.35
        gained.append(before - value)
        if not sum(gained[-5:]) > least and (len(gained) >= 5 or not gained[-1] > 0.0):
            break
    return theta, count


def _value(objective: Objective, theta: Array) -> float:
    """Return f, or infinity where a controller has no finite loop."""
    try:
        value = objective.value(theta)
    except np.linalg.LinAlgError:
        return np.inf
    return value if np.isfinite(value) else np.inf


def _scale(objective: Objective, theta: Array) -> Array:
    """Return how large each unknown is in its place: poles in A, inputs in B, gains in C."""
    A, B, C, D = objective.unpack(theta)
    rate = np.sqrt(np.abs(np.diag(A)) + 0.3)
    rows = np.abs(B).max(axis=1, initial=1e-9, keepdims=True)
    columns = np.abs(C).max(axis=0, initial=1e-9, keepdims=True)
    return objective.pack(
        np.outer(rate, rate),
        np.maximum(np.broadcast_to(rows, B.shape), 1e-6),
        np.maximum(np.broadcast_to(columns, C.shape), 1e-6),
        np.full_like(D, max(float(np.abs(B).max(initial=0.0) * np.abs(C).max(initial=0.0)), 1e-6)),
    )


def _trusted(slope: Array, curvature: Array, radius: float) -> tuple[Array, float]:
    """Return the step of least model value within `radius`, in the Hessian's axes, and what it predicts."""
    # beyond its last digit, so that no curvature is left at zero
    low = max(0.0, -float(curvature.min()) * (1.0 + 1e-12)) + 1e-12
    shift = low
    if np.linalg.norm(slope / (curvature + low)) > radius:
        high = low + float(np.linalg.norm(slope)) / radius
        for _ in range(60):
            shift = 0.5 * (low + high)
            if np.linalg.norm(slope / (curvature + shift)) > radius:
                low = shift
            else:
                high = shift
        shift = high
    move = -slope / (curvature + shift)
    return move, float(-(slope @ move) - 0.5 * (curvature * move**2).sum())


def derivatives(objective: Objective, theta: Array, scale: Array) -> tuple[Array, Array]:
    """Return gradient (n,) and Hessian (n, n) of the objective, a penalty on the first swing left out of it.

    scale : (n,) of the unknowns, for the differences that give the curvature of D where it follows from the
        others.
    """
    K = objective.unpack(theta)
    gradient, hessian, feed = _damping(objective, K)
    if objective.dc_block:
        A, B, C, _ = (np.zeros_like(M) for M in K)
        here, bent = objective.pack_gradient(K, A, B, C, feed), np.empty_like(hessian)
        for k, h in enumerate(DIFFERENCE * scale):
            moved = theta.copy()
            moved[k] += h
            bent[k] = (objective.pack_gradient(objective.unpack(moved), A, B, C, feed) - here) / h
        hessian += 0.5 * (bent + bent.T)
    # of the squares of hinges the first part, which is never negative: where poles meet the second has no
    # bound. Of bounds that are near too, else every other step runs into one
    rows = objective.hinges(K, NEAR_BOUND)[1]
    return gradient + objective.penalties(K)[1], hessian + 2.0 * rows.T @ rows


def _damping(objective: Objective, K: Gains) -> tuple[Array, Array, Array]:
    """Return gradient and Hessian of the smoothed worst, D taken as linear, and its gradient over D."""
    spectra = objective.spectra(K)
    top = max(float(v.max()) for *_, v in spectra)
    rho = objective.rho
    total = sum(float(np.exp(rho * (v - top)).sum()) for *_, v in spectra)
    rows: list[Array] = []
    weights: list[float] = []
    moves = _Moves(objective, K)
    bent, feed = np.zeros((moves.size, moves.size)), np.zeros(K[3].shape)
    for group, size, loops, v in spectra:
        share = (np.exp(rho * (v - top)) / total).sum(axis=1)
        for k in map(int, np.flatnonzero(share > 1e-6)):
            values, right = (each.astype(complex) for each in np.linalg.eig(loops[k]))
            try:
                left = np.linalg.inv(right)
            except np.linalg.LinAlgError:  # a defective matrix: its neighbours carry the derivatives
                continue
            excess, dv = objective.excess(values)
            # of a pair only one is looked at, with the weight of both
            weight = np.exp(rho * (excess - top)) / total * np.where(values.imag > 0.0, 2.0, 1.0)
            reach = (left[:, :size] @ group[k].B).astype(complex)
            seen = group[k].C @ right[:size]
            outs, ins = moves.sides(reach, left[:, size:], seen, right[size:])
            for i in map(int, np.flatnonzero((weight > 1e-7) & (values.imag >= 0.0))):
                gap = values[i] - values
                size_of_gap = np.maximum(np.abs(gap), 1e-300)
                inverse = np.conj(gap) / size_of_gap / np.maximum(size_of_gap, APART)
                inverse[i] = 0.0
                # l_i dA r_j and l_j dA r_i for every j, (j, unknowns)
                onward, back = (
                    moves.between(outs[:, i : i + 1], ins),
                    moves.between(outs, ins[:, :, i : i + 1]),
                )
                first = onward[i]
                second = ((onward * (dv[i] * inverse)[:, None]).T @ back).real
                bent += weight[i] * (second + second.T)
                aa, ab, bb = objective.bends(complex(values[i]))
                da, db = first.real, first.imag
                cross = np.outer(da, db)
                bent += weight[i] * (aa * np.outer(da, da) + ab * (cross + cross.T) + bb * np.outer(db, db))
                rows.append((dv[i] * first).real)
                weights.append(float(weight[i]))
                feed += weight[i] * (dv[i] * np.outer(reach[i], seen[:, i])).real
    G, p = np.array(rows), np.array(weights)
    gradient = p @ G
    return gradient, bent + rho * ((G.T * p) @ G - np.outer(gradient, gradient)), feed


class _Moves:
    """How every unknown moves a closed loop between a left and a right eigenvector: l dA r.

    With u = C x + D y, D = C A^-1 B where it is no unknown: an unknown's share is one entry of what the left
    vector has for it times one of what the right vector has; of A two such products.
    """

    def __init__(self, objective: Objective, K: Gains) -> None:
        A, B, C, _ = K
        n, p, m = A.shape[0], B.shape[1], C.shape[0]
        self._inner = np.linalg.solve(A, B) if objective.dc_block else np.zeros((n, p))
        self._outer = np.linalg.solve(A.T, C.T) if objective.dc_block else np.zeros((n, m))
        # places in (states' own, states with D's share, actuators) and (states' own, signals, with D's share)
        own, shared, last = np.arange(0.0, n), np.arange(n, 2.0 * n), np.arange(2.0 * n, 2 * n + m)
        seen = np.arange(n, n + float(p))
        late = np.arange(n + p, 2.0 * n + p)
        self._from = self._places(objective, own, shared, last, last, (n, p, m), rows=True)
        self._to = self._places(objective, own, seen, late, seen, (n, p, m), rows=False)
        self.size = self._from.size
        of_A = objective.pack(np.ones((n, n)), np.zeros((n, p)), np.zeros((m, n)), np.zeros((m, p)))
        self._of_A = np.flatnonzero(of_A) if objective.dc_block else np.zeros(0, dtype=int)

    @staticmethod
    def _places(
        objective: Objective,
        a: Array,
        b: Array,
        c: Array,
        d: Array,
        sizes: tuple[int, int, int],
        *,
        rows: bool,
    ) -> npt.NDArray[np.intp]:
        """Return of every unknown where its row, or its column, stands among what a vector has for it."""
        n, p, m = sizes
        shapes = ((n, n), (n, p), (m, n), (m, p))
        spread = [
            np.broadcast_to(places[:, None] if rows else places[None, :], shape)
            for places, shape in zip((a, b, c, d), shapes, strict=True)
        ]
        return objective.pack(*spread).astype(np.intp)

    def sides(
        self, reach: Complex, states: Complex, seen: Complex, right: Complex
    ) -> tuple[Complex, Complex]:
        """Return what every eigenvector has for each unknown: left (2, j, unknowns), right (2, unknowns, j).

        reach (j, m), states (j, n): l B and l at the controller. seen (p, j), right (n, j): C r and r there.
        """
        handed, fed = reach @ self._outer.T, self._inner @ seen
        outs = np.concatenate([states, states + handed, reach], axis=1)[:, self._from]
        ins = np.concatenate([right, seen, right + fed], axis=0)[self._to]
        outs2, ins2 = np.zeros_like(outs), np.zeros_like(ins)
        k = self._of_A
        outs2[:, k], ins2[k] = -handed[:, self._from[k]], fed[self._to[k]]
        return np.stack([outs, outs2]), np.stack([ins, ins2])

    def between(self, outs: Complex, ins: Complex) -> Complex:
        """Return l dA r of every unknown, (j, unknowns): one left and many right vectors, or the reverse."""
        turned = ins.transpose(0, 2, 1)
        return np.asarray(outs[0] * turned[0] + outs[1] * turned[1])
