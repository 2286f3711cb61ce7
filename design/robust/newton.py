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
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from .smoothed_objective import Array, Complex, Gains, Objective
from .spectra import eigensystems

#: eigenvalues nearer to one another than this (rad/s) count as so far apart: their derivative has no bound
APART = 1e-2
#: bounds of poles (natural logarithm) and effort (relative) that are so near count in the Hessian
NEAR_BOUND = 0.1
#: step of the differences that give the curvature of D, of each unknown's scale
DIFFERENCE = 1e-5
#: eigenvalues whose second derivatives are added at once: some ten MB
TOGETHER = 256


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
                radius = min(4.0 * radius, 2.0) if ratio > 0.7 else radius
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
    moves = _Moves(objective, K)
    sums, feed = _Sums(moves), np.zeros(K[3].shape)
    for group, size, loops, v in spectra:
        share = (np.exp(rho * (v - top)) / total).sum(axis=1)
        near = np.flatnonzero(share > 1e-6)
        for k, found in zip(map(int, near), eigensystems(loops[near]), strict=True):
            if found is None:  # a defective matrix: its neighbours carry the derivatives
                continue
            values, right, left = found
            excess, dv = objective.excess(values)
            # of a pair only one is looked at, with the weight of both
            weight = np.exp(rho * (excess - top)) / total * np.where(values.imag > 0.0, 2.0, 1.0)
            few = np.flatnonzero((weight > 1e-7) & (values.imag >= 0.0))
            gap = values[few, None] - values
            size_of_gap = np.maximum(np.abs(gap), 1e-300)
            inverse = np.conj(gap) / size_of_gap / np.maximum(size_of_gap, APART)
            inverse[np.arange(few.size), few] = 0.0
            bends = np.array([objective.bends(complex(value)) for value in values[few]]).reshape(-1, 3)
            reach = (left[:, :size] @ group[k].B).astype(complex)
            seen = group[k].C @ right[:size]
            outs, ins = moves.sides(reach, left[:, size:], seen, right[size:])
            # sum over j of r_j l_j / (lambda_i - lambda_j), as the controller sees it
            resolvents = (inverse[:, None, :] * ins.T) @ outs
            sums.add(weight[few], dv[few], bends, outs[few], ins[few], resolvents)
            feed += ((reach[few].T * (weight * dv)[few]) @ seen[:, few].T).real
    return *sums.derivatives(rho), feed


class _Sums:
    """Sums over eigenvalues: p g, p g g^T and p times the second derivatives of v.

    Some hundred eigenvalues are kept and added in one product: it costs a fraction of one for each.
    """

    def __init__(self, moves: _Moves) -> None:
        self._moves, self._count = moves, 0
        self._kept: list[tuple[npt.NDArray[Any], ...]] = []
        self._gradient = np.zeros(moves.size)
        self._squares, self._half = np.zeros((2, moves.size, moves.size))

    def add(self, *of_each: npt.NDArray[Any]) -> None:
        """Add k eigenvalues: weights (k,), dv (k,), bends (k, 3), outs, ins and resolvents of `_Moves`."""
        self._kept.append(of_each)
        self._count += len(of_each[0])
        if self._count >= TOGETHER:
            self._flush()

    def derivatives(self, rho: float) -> tuple[Array, Array]:
        """Return gradient (n,) and Hessian (n, n) of the smoothed worst."""
        self._flush()
        kinks = self._squares - np.outer(self._gradient, self._gradient)
        return self._gradient, self._half + self._half.T + rho * kinks

    def _flush(self) -> None:
        if not self._kept:
            return
        weight, dv, bends, outs, ins, resolvents = (
            np.concatenate(each) for each in zip(*self._kept, strict=True)
        )
        self._kept, self._count = [], 0
        first = self._moves.first(outs, ins)
        rows = (dv[:, None] * first).real
        self._gradient += weight @ rows
        self._squares += (rows.T * weight) @ rows
        da, db = first.real, first.imag
        aa, ab, bb = weight * bends.T
        self._half += self._moves.second(outs * (weight * dv)[:, None], ins, resolvents)
        self._half += (da.T * (0.5 * aa)) @ da + (da.T * ab) @ db + (db.T * (0.5 * bb)) @ db


class _Block(NamedTuple):
    """Unknowns of one matrix and one part of K: each an entry of a rectangle of rows and columns."""

    of: npt.NDArray[np.intp]  #: the unknowns
    rows: npt.NDArray[np.intp]  #: places in `outs`
    columns: npt.NDArray[np.intp]  #: places in `ins`
    place: npt.NDArray[np.intp]  #: of each unknown in the rectangle, row by row


class _Moves:
    """How every unknown moves a closed loop between a left and a right eigenvector: l dA r.

    With u = C x + D y, D = C A^-1 B where it is no unknown: an unknown's share is one entry of what the left
    vector has for it (`outs`) times one of what the right vector has (`ins`); of A the sum of two products.
    """

    def __init__(self, objective: Objective, K: Gains) -> None:
        A, B, C, _ = K
        n, p, m = A.shape[0], B.shape[1], C.shape[0]
        self._inner = np.linalg.solve(A, B) if objective.dc_block else np.zeros((n, p))
        self._outer = np.linalg.solve(A.T, C.T) if objective.dc_block else np.zeros((n, m))
        # places in outs: states' own, with D's share, actuators, D's share alone;
        # in ins: states' own, signals, with D's share, D's share alone
        own, seen, outputs = np.arange(n), n + np.arange(p), 2 * n + np.arange(m)
        row = own[:, None], n + own[:, None], outputs[:, None], outputs[:, None]
        column = own, seen, n + p + own, seen
        part, parts = np.zeros(n), len(objective.parts)
        for k, states in enumerate(objective.parts):
            part[states] = k
        matrix = part[:, None], parts + part[:, None], 2 * parts + part, np.array(3 * parts)
        shapes = (n, n), (n, p), (m, n), (m, p)
        rows, columns, kinds = (
            objective.pack(*(np.broadcast_to(M, shape) for M, shape in zip(of, shapes, strict=True))).astype(
                int
            )
            for of in (row, column, matrix)
        )
        self.size = kinds.size
        self._blocks: list[_Block] = []
        for kind in np.unique(kinds):
            of = np.flatnonzero(kinds == kind)
            self._add(of, rows[of], columns[of])
            if objective.dc_block and kind < parts:
                self._add(of, 2 * n + m + rows[of], 2 * n + p + columns[of])

    def _add(self, of: npt.NDArray[np.intp], row: npt.NDArray[np.intp], column: npt.NDArray[np.intp]) -> None:
        (rows, i), (columns, j) = (np.unique(each, return_inverse=True) for each in (row, column))
        self._blocks.append(_Block(of, rows, columns, i * len(columns) + j))

    def sides(
        self, reach: Complex, states: Complex, seen: Complex, right: Complex
    ) -> tuple[Complex, Complex]:
        """Return what each eigenvector has for the unknowns: left ones outs (j, .), right ones ins (j, .).

        reach (j, m), states (j, n): l B and l at the controller. seen (p, j), right (n, j): C r and r there.
        """
        handed, fed = reach @ self._outer.T, self._inner @ seen
        outs = np.concatenate([states, states + handed, reach, -handed], axis=1)
        ins = np.concatenate([right, seen, right + fed, fed])
        return outs, np.ascontiguousarray(ins.T)

    def first(self, outs: Complex, ins: Complex) -> Complex:
        """Return l dA r of k pairs of vectors for every unknown, (k, unknowns)."""
        found = np.zeros((len(outs), self.size), dtype=complex)
        for block in self._blocks:
            found[:, block.of] += _products(outs[:, block.rows], ins[:, block.columns])[:, block.place]
        return found

    def second(self, outs: Complex, ins: Complex, resolvents: Complex) -> Array:
        """Return the real part of the sum over k of (l dA S dA' r), (unknowns, unknowns): dA' in columns.

        outs (k, .), ins (k, .): of l and r. resolvents (k, ins, outs): S.
        """
        found = np.zeros((self.size, self.size))
        for a in self._blocks:
            left, onward = outs[:, a.rows], resolvents[:, a.columns]
            for b in self._blocks:
                ends = _products(left, ins[:, b.columns])
                between = onward[:, :, b.rows].reshape(len(outs), -1)
                shape = len(a.rows), len(b.columns), len(a.columns), len(b.rows)
                sums = (ends.T @ between).real.reshape(shape).transpose(0, 2, 3, 1)
                pairs = sums.reshape(len(a.rows) * len(a.columns), -1)
                found[np.ix_(a.of, b.of)] += pairs[np.ix_(a.place, b.place)]
        return found


def _products(a: Complex, b: Complex) -> Complex:
    """Return every product of an entry of a (k, i) and one of b (k, j): (k, i j).

    >>> _products(np.array([[1.0, 2.0]]), np.array([[3.0, 4.0]])).tolist()
    [[3.0, 4.0, 6.0, 8.0]]
    """
    return np.asarray((a[:, :, None] * b[:, None, :]).reshape(len(a), -1))
