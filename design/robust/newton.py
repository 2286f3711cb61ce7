r"""Newton steps on the smoothed worst damping that follow every nearly worst eigenvalue separately.

A designed loop has dozens of equally bad eigenvalues. The objective has a slope discontinuity wherever two of
them meet, so a quadratic model of it, or the memory of a quasi-Newton method, is valid for only a fraction of
the distance to the next. Each eigenvalue alone is nearly linear. With :math:`v_k` its shortfall of damping,
:math:`g_k` its gradient and :math:`p_k \propto e^{\rho v_k}`, a step is the least value over :math:`x` of

.. math:: \frac1\rho \log \sum_k e^{\rho (v_k + g_k^T x)} + \tfrac12 x^T |H| x
    + \sum_j \max(0, h_j + r_j^T x)^2 + \tfrac\sigma2 |x|^2 ,\qquad H = \sum_k p_k \nabla^2 v_k ,

the second derivatives from

.. math:: d^2\lambda_k = l_k\, d^2\!A\, r_k
    + 2 \sum_{j \ne k} \frac{(l_k\, dA\, r_j)(l_j\, dA\, r_k)}{\lambda_k - \lambda_j} .

The sum is convex, because |H| has the magnitudes of the eigenvalues of H: negative curvature limits a step as
much as positive curvature, since the linear model is valid no further in either case. :math:`h_j` are the
bounds of effort and poles; :math:`\sigma` grows if a step gains less than predicted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_factor, cho_solve

from .smoothed_objective import Array, Complex, Gains, Objective
from .spectra import eigensystems

#: eigenvalues nearer to one another than this (rad/s) count as so far apart: their derivative has no bound
APART = 1e-2
#: eigenvalues within this of the worst (damping), or so many times 1 / rho, are followed by themselves
NEAR_WORST, SHARE = 0.05, 8.0
#: bounds of poles (natural logarithm) and effort (relative) that are so near are followed too
NEAR_BOUND = 0.5
#: step of the differences that give the curvature of D, of each unknown's scale
DIFFERENCE = 1e-5
#: eigenvalues whose second derivatives are added at once: some ten MB
TOGETHER = 256
#: a step counts that gains this share of what was foreseen; the next one is held back less, more
ACCEPTED, RELAXED, HELD = 0.05, 0.8, 0.2


def newton_descent(
    objective: Objective,
    start: Array,
    steps: int,
    *,
    balanced: Callable[[Objective, Array], Array],
    held: float = 1e-2,
    least: float = 2e-5,
    progress: Callable[[float, float], object] | None = None,
    over: Callable[[], bool] = lambda: False,
) -> tuple[Array, int]:
    """Return the parameters after at most `steps` steps from `start`, and evaluations.

    balanced : gives equivalent parameters in better coordinates; called every few steps.
    held : sigma of the first step, in units of the unknowns' scale.
    least : ends where five steps gain less than this in all.
    progress : called before each step with the share of the steps that is done and the objective.
    over : whether to begin no further step.
    """
    theta = balanced(objective, start)
    value, count = objective.value(theta), 1
    gained: list[float] = []
    for step in range(steps):
        if over():
            break
        if progress is not None:
            progress(step / steps, value)
        if step % 5 == 4:
            theta = balanced(objective, theta)
        scale = _scale(objective, theta)
        near = expansion(objective, theta, scale).convex()
        before, tries, ratio = value, 0, 0.0
        while held < 1e9:
            move, predicted = near.least(held)
            moved = theta + scale * move
            reached, count, tries = _value(objective, moved), count + 1, tries + 1
            ratio = (value - reached) / max(predicted, 1e-300)
            if ratio > ACCEPTED:
                theta, value = moved, reached
                break
            held *= 4.0
        if tries == 1 and ratio > RELAXED:
            held = max(0.2 * held, 1e-9)
        elif not ratio > HELD:
            held *= 2.0
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


@dataclass(frozen=True)
class Expansion:
    """Local model of the objective near one controller, in units of the unknowns' scale.

    It does not include the penalty on the first swing.
    """

    rho: float
    values: Array  #: (k,) v of the eigenvalues that are followed
    rows: Array  #: (k, n) their gradients
    counts: Array  #: (k,) 2 for a pair, of which one is there
    curvature: Array  #: (n, n) mean of their second derivatives
    hinges: Array  #: (h,) by how much bounds are exceeded, below 0 where they are near
    bounds: Array  #: (h, n) their gradients

    def convex(self) -> Expansion:
        """Return the expansion with the magnitudes of the curvature's eigenvalues."""
        values, directions = np.linalg.eigh(self.curvature)
        return replace(self, curvature=(directions * np.abs(values)) @ directions.T)

    def value(self, move: Array) -> float:
        """Return the predicted objective."""
        worst, _ = self._weighed(move)
        over = np.maximum(self.hinges + self.bounds @ move, 0.0)
        return worst + 0.5 * float(move @ self.curvature @ move) + float(over @ over)

    def derivatives(self, move: Array) -> tuple[Array, Array]:
        """Return gradient (n,) and Hessian (n, n) of `value`."""
        _, share = self._weighed(move)
        selected = share > 1e-12
        rows, share = self.rows[selected], share[selected]
        mean = share @ rows
        over = self.hinges + self.bounds @ move
        active, curved = self.bounds[over > 0.0], self.curvature @ move
        gradient = mean + curved + 2.0 * over[over > 0.0] @ active
        # rounding must not leave a product of the rows with itself unsymmetrical
        differences = (rows - mean) * np.sqrt(share)[:, None]
        return gradient, self.curvature + self.rho * differences.T @ differences + 2.0 * active.T @ active

    def least(self, held: float) -> tuple[Array, float]:
        """Return the step of least value plus `held` / 2 times its square, and the decrease of `value`.

        The curvature has no negative eigenvalue (`convex`).
        """
        n = self.curvature.shape[0]
        move = np.zeros(n)
        for rho in (0.125 * self.rho, 0.35 * self.rho, self.rho):
            smooth = replace(self, rho=rho)
            current = smooth.value(move) + 0.5 * held * float(move @ move)
            for _ in range(30):
                slope, hessian = smooth.derivatives(move)
                slope = slope + held * move
                step = -_solved(hessian + held * np.eye(n), slope)
                fall = -float(slope @ step)
                if not fall > 1e-9:
                    break
                length = 1.0
                while length > 1e-6:
                    moved = move + length * step
                    there = smooth.value(moved) + 0.5 * held * float(moved @ moved)
                    if there <= current - 0.1 * length * fall:
                        break
                    length *= 0.5
                else:
                    break
                move, current = moved, there
        return move, self.value(np.zeros(n)) - self.value(move)

    def _weighed(self, move: Array) -> tuple[float, Array]:
        """Return the smoothed worst and each eigenvalue's share of it (k,)."""
        v = self.values + self.rows @ move
        top = float(v.max())
        weight = self.counts * np.exp(self.rho * (v - top))
        total = float(weight.sum())
        return top + float(np.log(total)) / self.rho, weight / total


def _solved(hessian: Array, slope: Array) -> Array:
    """Return hessian^-1 slope; eigenvalues that rounding made negative count as no less than rounding."""
    try:
        return np.asarray(cho_solve(cho_factor(hessian), slope))
    except np.linalg.LinAlgError:
        values, directions = np.linalg.eigh(hessian)
        least = len(values) * np.finfo(float).eps * values[-1]
        return np.asarray(directions @ (directions.T @ slope / np.maximum(values, least)))


def expansion(objective: Objective, theta: Array, scale: Array) -> Expansion:
    """Return the expansion of the objective at `theta`, its unknowns in units of `scale` (n,)."""
    K = objective.unpack(theta)
    spectra = objective.spectra(K)
    top, rho = max(float(v.max()) for *_, v in spectra), objective.rho
    total = sum(float(np.exp(rho * (v - top)).sum()) for *_, v in spectra)
    within = top - max(NEAR_WORST, SHARE / rho)
    moves = _Moves(objective, K)
    curved, feed = _Curvature(moves), np.zeros(K[3].shape)
    result: list[tuple[Array, Array, Array]] = []
    for group, size, loops, v in spectra:
        near = np.flatnonzero(v.max(axis=1) > within)
        for k, system in zip(map(int, near), eigensystems(loops[near]), strict=True):
            if system is None:  # a defective matrix: its neighbours carry the derivatives
                continue
            values, right, left = system
            (excess,), (dv,) = objective.excess(values[None], [group[k]])
            # v, then w, of every eigenvalue; of a pair only one is looked at, with the weight of both
            n, both = values.size, np.tile(values, 2)
            counts = np.where(both.imag > 0.0, 2.0, 1.0)
            weight = counts * np.exp(rho * (excess - top)) / total
            selected = np.flatnonzero((excess > within) & (both.imag >= 0.0))
            if not selected.size:
                continue
            reach = (left[:, :size] @ group[k].B).astype(complex)
            seen = group[k].C @ right[:size]
            at = selected % n
            outs, ins = moves.sides(reach[at], left[at, size:], seen[:, at], right[size:, at])
            first = moves.first(outs, ins)
            result.append((excess[selected], (dv[selected, None] * first).real * scale, counts[selected]))
            feed += ((reach[at].T * (weight * dv)[selected]) @ seen[:, at].T).real
            heavy = np.flatnonzero(weight[selected] > 1e-7)
            if not heavy.size:
                continue
            few = selected[heavy]
            gap = both[few, None] - values
            size_of_gap = np.maximum(np.abs(gap), 1e-300)
            inverse = np.conj(gap) / size_of_gap / np.maximum(size_of_gap, APART)
            inverse[np.arange(few.size), few % n] = 0.0
            bends = np.array([objective.bends(complex(both[k]), k >= n) for k in few])
            # sum over j of r_j l_j / (lambda_i - lambda_j), as the controller sees it
            all_outs, all_ins = moves.sides(reach, left[:, size:], seen, right[size:])
            resolvents = (inverse[:, None, :] * all_ins.T) @ all_outs
            curved.add(weight[few], dv[few], bends, first[heavy], outs[heavy], ins[heavy], resolvents)
    curvature = curved.total()
    if objective.dc_block:
        curvature += _curvature_of_feedthrough(objective, theta, scale, feed)
    excesses, rows, counted = (np.concatenate(each) for each in zip(*result, strict=True))
    hinges, bounds = objective.hinges(K, NEAR_BOUND)
    return Expansion(rho, excesses, rows, counted, curvature * np.outer(scale, scale), hinges, bounds * scale)


def _curvature_of_feedthrough(objective: Objective, theta: Array, scale: Array, feed: Array) -> Array:
    """Return the part of the curvature that is D's own, which follows from the others: D = C A^-1 B.

    feed : gradient over D.
    """
    K = objective.unpack(theta)
    A, B, C, _ = (np.zeros_like(M) for M in K)
    gradient = objective.pack_gradient(K, A, B, C, feed)
    curvature = np.empty((theta.size, theta.size))
    for k, h in enumerate(DIFFERENCE * scale):
        moved = theta.copy()
        moved[k] += h
        curvature[k] = (objective.pack_gradient(objective.unpack(moved), A, B, C, feed) - gradient) / h
    return 0.5 * (curvature + curvature.T)


class _Curvature:
    """Sum over eigenvalues of p times the second derivatives of v.

    Some hundred eigenvalues are kept and added in one product: it costs a fraction of one for each.
    """

    def __init__(self, moves: _Moves) -> None:
        self._moves, self._count = moves, 0
        self._rows: list[tuple[npt.NDArray[Any], ...]] = []
        self._half = np.zeros((moves.size, moves.size))

    def add(self, *of_each: npt.NDArray[Any]) -> None:
        """Add k eigenvalues: weights, dv (k,), bends (k, 3), first, outs, ins, resolvents of `_Moves`."""
        self._rows.append(of_each)
        self._count += len(of_each[0])
        if self._count >= TOGETHER:
            self._flush()

    def total(self) -> Array:
        """Return the sum, (n, n)."""
        self._flush()
        return self._half + self._half.T

    def _flush(self) -> None:
        if not self._rows:
            return
        weight, dv, bends, first, outs, ins, resolvents = (
            np.concatenate(each) for each in zip(*self._rows, strict=True)
        )
        self._rows, self._count = [], 0
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
        zeros = np.zeros((len(outs), self.size), dtype=complex)
        for block in self._blocks:
            zeros[:, block.of] += _products(outs[:, block.rows], ins[:, block.columns])[:, block.place]
        return zeros

    def second(self, outs: Complex, ins: Complex, resolvents: Complex) -> Array:
        """Return the real part of the sum over k of (l dA S dA' r), (unknowns, unknowns): dA' in columns.

        outs (k, .), ins (k, .): of l and r. resolvents (k, ins, outs): S.
        """
        zeros = np.zeros((self.size, self.size))
        for a in self._blocks:
            left, onward = outs[:, a.rows], resolvents[:, a.columns]
            for b in self._blocks:
                ends = _products(left, ins[:, b.columns])
                between = onward[:, :, b.rows].reshape(len(outs), -1)
                shape = len(a.rows), len(b.columns), len(a.columns), len(b.rows)
                sums = (ends.T @ between).real.reshape(shape).transpose(0, 2, 3, 1)
                pairs = sums.reshape(len(a.rows) * len(a.columns), -1)
                zeros[np.ix_(a.of, b.of)] += pairs[np.ix_(a.place, b.place)]
        return zeros


def _products(a: Complex, b: Complex) -> Complex:
    """Return every product of an entry of a (k, i) and one of b (k, j): (k, i j).

    >>> _products(np.array([[1.0, 2.0]]), np.array([[3.0, 4.0]])).tolist()
    [[3.0, 4.0, 6.0, 8.0]]
    """
    return np.asarray((a[:, :, None] * b[:, None, :]).reshape(len(a), -1))
