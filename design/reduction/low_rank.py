r"""Reduction of a grid of any size to design order, from low-rank Gramians on the sparse blocks.

The Gramians P = Z Z', Q = Y Y' of what is left without the zero modes come from the alternating-direction
iteration with residual factors [Benner2013]: with a shift of real part below 0 and its conjugate

.. math:: V = (A + \alpha)^{-1} W, \quad \gamma = 2\sqrt{-\mathrm{Re}\,\alpha}, \quad
          \delta = \mathrm{Re}\,\alpha/\mathrm{Im}\,\alpha, \quad
          W \leftarrow W + \gamma^2 (\mathrm{Re} V + \delta\,\mathrm{Im} V),

which starts at W = B and ends when W is small: A P + P A' + B B' = W W'. A few dozen factored resolvents
serve both Gramians. The error is measured against the exact response.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import control
import numpy as np
import numpy.typing as npt

from ..linear.resolvent import Shifted
from ..linear.sparse_plant import SparsePlant
from .gramians import Reduction, ReductionError, projections

Matrix = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]

_RAY_HZ, _ON_RAY, _DAMPING = (0.08, 2.5), 22, 0.12
_REAL_RAD_S, _ON_AXIS = (0.08, 95.0), 10
_ROUNDS = 6  # of all shifts, at most
_RESIDUAL = 1e-7  # of W W' over B B' where the iteration ends
_POOR = 1e-2  # where it did not work at all
_ZERO = 1e-4  # 1/s: modes nearer to 0 are the rotation of all rotors, and with constant torque their speed
_KEPT = 1e-9  # of the largest: a zero mode with less than that of input and output is none of the response
_CHECK_HZ, _CHECKED, _RINGING = (0.1, 2.5), 40, 0.2


def low_rank_reduction(
    plant: SparsePlant,
    order: int,
    *,
    inputs: Sequence[str],
    outputs: Mapping[str, Mapping[str, float]],
    modes: Sequence[complex] = (),
) -> Reduction:
    """Reduce a sparse plant of any size to `order` states.

    Zero modes (the rotation of all rotors, with constant torque also their common speed) are taken out
    first; if an input drives and an output sees them they are states of the result. Hankel values are
    estimates. The error is the largest difference to the exact response over its peak, largest singular
    values, at forty frequencies from 0.1 to 2.5 Hz, and at and beside each mode of the result and of `modes`.

    Parameters
    ----------
    inputs : names, such as ``G1_vs``. outputs : name -> {``G1_dw``: weight}, speeds in pu.
    modes : eigenvalues, 1/s, at and beside whose frequencies the error is measured too.

    Raises
    ------
    ReductionError : unknown signals, an order out of range, an unstable plant.
    """
    B, C = input_columns(plant, inputs), output_rows(plant, outputs)
    if not 0 < order <= plant.nstates:
        raise ReductionError(f"order = {order}: must be a whole number from 1 to {plant.nstates}")
    zero = _zero_modes(plant)
    A0, B0, C0 = zero.left.T @ plant.times(zero.right), zero.left.T @ B, C @ zero.right
    seen = bool(np.max(np.abs(C0) @ np.abs(B0), initial=0.0) > _KEPT * np.linalg.norm(B) * np.linalg.norm(C))
    rest = order - (len(A0) if seen else 0)
    if rest < 1:
        raise ReductionError(
            f"order = {order}: {len(A0)} states are zero modes; ask for at least {len(A0) + 1}"
        )
    shifts = _Shifts(plant)
    Z, missing_c = _gramian_factor(shifts, zero.without(B), zero, transposed=False)
    Y, missing_o = _gramian_factor(shifts, zero.without_left(C.T), zero, transposed=True)
    residual = max(missing_c, missing_o)
    if not residual <= _POOR:
        raise ReductionError(
            f"no Gramians: the iteration ends at a residual of {residual:.2g}; is the plant unstable? "
            "`interarea modes` names what grows"
        )
    W, T, values = projections(Z, Y, 1e-13)
    k = min(rest, W.shape[1])
    W, T = W[:, :k], T[:, :k]
    parts = W.T @ plant.times(T), W.T @ B, C @ T
    if seen:
        n = len(A0)
        block = np.block([[A0, np.zeros((n, k))], [np.zeros((k, n)), parts[0]]])
        parts = block, np.vstack([B0, parts[1]]), np.hstack([C0, parts[2]])
    D = np.zeros((len(outputs), len(inputs)))
    system = control.ss(*parts, D, inputs=list(inputs), outputs=list(outputs))
    poles = np.linalg.eigvals(parts[0])
    ringing = poles[(poles.imag > 0.0) & (-poles.real < _RINGING * np.abs(poles))]
    hz = checked_frequencies([*modes, *ringing])
    names = ("zero mode",) * len(A0)
    return Reduction(
        system=system,
        method="low-rank balanced truncation",
        hankel_values=values,
        bound=None,
        error=_measured(plant, B, C, parts, hz),
        error_of=f"|G - G_k| over the peak of |G|, at {len(hz)} frequencies, {hz[0]:.2g} to {hz[-1]:.2g} Hz",
        kept=names if seen else (),
        removed=() if seen else names,
    )


def input_columns(plant: SparsePlant, inputs: Sequence[str]) -> Matrix:
    """Return the columns (n, inputs) of named inputs."""
    unknown = [name for name in inputs if name not in plant.inputs]
    if unknown or not inputs:
        raise ReductionError(
            f"input {unknown[0] if unknown else '(none)'}: the plant has {', '.join(plant.inputs[:8])}.."
        )
    return np.asarray(plant.Bu[:, [plant.inputs.index(name) for name in inputs]].toarray())


def output_rows(plant: SparsePlant, outputs: Mapping[str, Mapping[str, float]]) -> Matrix:
    """Return the rows (outputs, n) of weighted sums of speeds, pu."""
    speed = {f"{m}_dw": int(k) for m, k in zip(plant.machines, plant.speed, strict=True)}
    if not outputs:
        raise ReductionError(
            "no outputs, wanted: a name and the speeds it weighs, such as {'dw12': {'G1_dw': 1}}"
        )
    C = np.zeros((len(outputs), plant.nstates))
    for i, (name, weights) in enumerate(outputs.items()):
        for signal, weight in weights.items():
            if signal not in speed:
                raise ReductionError(
                    f"output {name}: {signal!r} is no speed of a machine, such as {next(iter(speed))}"
                )
            C[i, speed[signal]] += weight
    return C


def checked_frequencies(modes: Sequence[complex]) -> Matrix:
    """Return where the error is measured, Hz: a grid, each mode, and half its decay to both sides."""
    z = np.array([s for s in modes if s.imag > 0.0], dtype=complex)
    beside = np.concatenate([z.imag, z.imag + 0.5 * z.real, z.imag - 0.5 * z.real]) / (2.0 * np.pi)
    inside = beside[(beside > 0.5 * _CHECK_HZ[0]) & (beside < 2.0 * _CHECK_HZ[1])]
    return np.unique(np.concatenate([np.geomspace(*_CHECK_HZ, _CHECKED), inside]))


@dataclass(frozen=True)
class _ZeroModes:
    """Invariant subspace at 0: right and left bases (n, k) with left' right = 1."""

    right: Matrix
    left: Matrix

    def without(self, X: Matrix) -> Matrix:
        return X - self.right @ (self.left.T @ X)

    def without_left(self, X: Matrix) -> Matrix:
        return X - self.left @ (self.right.T @ X)


def _zero_modes(plant: SparsePlant) -> _ZeroModes:
    """Of at most two: turning all rotors, and without governors and damping speeding all up."""
    shifted = Shifted(plant, 1e-3)
    R, L = np.zeros((plant.nstates, 2)), np.random.default_rng(3).standard_normal((plant.nstates, 2))
    R[plant.angle, 0] = R[plant.speed, 1] = 1.0
    for _ in range(40):
        R, _ = np.linalg.qr(shifted.solve(R).real)
        L, _ = np.linalg.qr(shifted.solve_left(L).real)
    L = L @ np.linalg.inv(L.T @ R).T
    values, X = np.linalg.eig(L.T @ plant.times(R))
    zero = np.flatnonzero(np.abs(values) < _ZERO)
    if len(zero) == 1:
        return _ZeroModes(R @ X[:, zero].real, L @ np.linalg.inv(X)[zero].T.real)
    return _ZeroModes(R[:, : len(zero)], L[:, : len(zero)])


class _Shifts:
    """Factored resolvents, kept: each shift is used in every round and for both Gramians."""

    def __init__(self, plant: SparsePlant) -> None:
        omega = 2.0 * np.pi * np.geomspace(*_RAY_HZ, _ON_RAY)
        ray = omega * (-_DAMPING + 1j * np.sqrt(1.0 - _DAMPING**2))
        shifts = np.concatenate([ray, -np.geomspace(*_REAL_RAD_S, _ON_AXIS) + 0j])
        self.order = [complex(z) for z in np.random.default_rng(5).permutation(shifts)]
        self._plant = plant
        self._kept: dict[complex, Shifted] = {}

    def solve(self, shift: complex, W: Matrix, transposed: bool) -> ComplexArray:
        """Return (A + shift)^-1 W, or of A'."""
        if shift not in self._kept:
            self._kept[shift] = Shifted(self._plant, -shift)
        shifted = self._kept[shift]
        return -(shifted.solve_left(W) if transposed else shifted.solve(W))


def _gramian_factor(
    shifts: _Shifts, W: Matrix, zero: _ZeroModes, *, transposed: bool
) -> tuple[Matrix, float]:
    """Z with Z Z' about the Gramian of (A, W), or of (A', W); and the residual."""
    whole = np.linalg.norm(W.T @ W)
    without = zero.without_left if transposed else zero.without
    parts: list[Matrix] = []
    residual = 1.0
    for _ in range(_ROUNDS):
        for alpha in shifts.order:
            V = shifts.solve(alpha, W, transposed)
            if alpha.imag == 0.0:
                real = without(V.real)
                parts.append(np.sqrt(-2.0 * alpha.real) * real)
                W = W - 2.0 * alpha.real * real
            else:
                gamma, delta = 2.0 * np.sqrt(-alpha.real), alpha.real / alpha.imag
                mixed, imag = without(V.real + delta * V.imag), without(V.imag)
                parts += [gamma * mixed, gamma * np.sqrt(delta**2 + 1.0) * imag]
                W = W + gamma**2 * mixed
        before, residual = residual, float(np.linalg.norm(W.T @ W) / whole)
        if residual <= _RESIDUAL or not residual < 0.9 * before:
            break
    return np.hstack(parts), residual


def _measured(
    plant: SparsePlant, B: Matrix, C: Matrix, parts: tuple[Matrix, Matrix, Matrix], hz: Matrix
) -> float:
    """Largest error over the peak."""
    A, b, c = parts
    sizes, errors = [], []
    for f in hz:
        s = 2j * np.pi * f
        exact = C @ Shifted(plant, s).solve(B)
        sizes.append(np.linalg.norm(exact, 2))
        errors.append(np.linalg.norm(exact - c @ np.linalg.solve(s * np.eye(len(A)) - A, b), 2))
    return float(np.max(errors) / np.max(sizes))
