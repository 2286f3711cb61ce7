"""Stable part apart from the rest, balanced coordinates, and the record every reduction returns."""

from __future__ import annotations

from dataclasses import dataclass

import control
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import matrix_balance, schur, solve_sylvester

from interarea.models.errors import UserError

from ..linear.matrices import ZERO_EIGENVALUE
from ..linear.norms import gramian_factor
from ..linear.systems import LinearSystemError, state_space

Matrix = NDArray[np.float64]
#: share of the largest Hankel singular value below which a state is rounding of the Gramians
NEGLIGIBLE = 1e-11


class ReductionError(UserError):
    """The reduction asked for does not exist or would not keep what it must."""


@dataclass(frozen=True, repr=False)
class Reduction:
    """A reduced model with what is known about it.

    Attributes
    ----------
    system : the reduced system, names of inputs and outputs kept.
    method : how it was made.
    hankel_values : Hankel singular values of the stable part (or the weighted ones), largest first.
    bound : a-priori bound on `error`; None where theory gives none.
    error : measured H-infinity norm of the difference (of the weighted or closed-loop difference
        for the weighted methods; `error_of` says of what).
    error_of : what `error` and `bound` measure.
    hankel_error : measured Hankel norm of the difference, None where it was not asked for.
    kept : unstable and zero modes taken over unchanged, by name.
    removed : modes removed before the reduction, by name.
    """

    system: control.StateSpace
    method: str
    hankel_values: Matrix
    bound: float | None
    error: float
    error_of: str
    hankel_error: float | None = None
    kept: tuple[str, ...] = ()
    removed: tuple[str, ...] = ()

    @property
    def order(self) -> int:
        """Number of states of the reduced system."""
        return int(self.system.nstates)

    def __repr__(self) -> str:
        """Return what was made and how far off it is, in a line."""
        bound = "" if self.bound is None else f", bound {self.bound:.3g}"
        apart = "".join(
            f"; {what} {', '.join(names)}"
            for what, names in (("kept", self.kept), ("removed", self.removed))
            if names
        )
        return (
            f"Reduction({self.order} states by {self.method}: {self.error_of} {self.error:.3g}{bound}{apart})"
        )


@dataclass(frozen=True)
class Split:
    """G = stable part (with D) + rest; the rest holds the eigenvalues on or right of the margin."""

    stable: tuple[Matrix, Matrix, Matrix, Matrix]
    rest: tuple[Matrix, Matrix, Matrix]
    names: tuple[str, ...]


def matrices(system: control.StateSpace, what: str = "system") -> tuple[Matrix, Matrix, Matrix, Matrix]:
    """A, B, C, D as float arrays. Raises ReductionError for what is no linear system in continuous time."""
    try:
        provided = state_space(system, what)
    except LinearSystemError as error:
        raise ReductionError(str(error)) from None
    A, B, C, D = (np.asarray(M, dtype=float) for M in (provided.A, provided.B, provided.C, provided.D))
    return A, B, C, D


def mode_name(value: complex, zero: float = ZERO_EIGENVALUE) -> str:
    """Name an eigenvalue that a reduction keeps or removes."""
    if abs(value) <= zero:
        return "zero mode"
    kind = "unstable" if value.real > 0.0 else "slow"
    text = f"{value.real:.4g}" + (f"+-j{abs(value.imag):.4g}" if value.imag else "")
    return f"{kind} mode {text}"


def separate(
    A: Matrix,
    B: Matrix,
    C: Matrix,
    D: Matrix,
    *,
    margin: float = ZERO_EIGENVALUE,
) -> Split:
    """Block-diagonalise: eigenvalues with Re < -margin on one side, all others on the other.

    The ordered real Schur form gives the invariant subspace, a Sylvester equation uncouples it:
    the transfer function is the sum of both parts exactly.
    """
    if A.shape[0] == 0:
        return Split((A, B, C, D), (A, B, C), ())
    A, B, C = scaled(A, B, C)
    if np.all(np.linalg.eigvals(A).real < -margin):
        return Split((A, B, C, D), (A[:0, :0], B[:0], C[:, :0]), ())
    T, Z, k = schur(A, output="real", sort=lambda re, im: re < -margin)
    return _uncouple(T, Z, int(k), B, C, D)


def separate_slow(A: Matrix, B: Matrix, C: Matrix, D: Matrix, slowest_rad_s: float) -> Split:
    r"""As `separate`, but the rest holds the eigenvalues with \|lambda\| < slowest_rad_s."""
    if A.shape[0] == 0:
        return Split((A, B, C, D), (A, B, C), ())
    A, B, C = scaled(A, B, C)
    T, Z, k = schur(A, output="real", sort=lambda re, im: np.hypot(re, im) >= slowest_rad_s)
    return _uncouple(T, Z, int(k), B, C, D)


def scaled(A: Matrix, B: Matrix, C: Matrix) -> tuple[Matrix, Matrix, Matrix]:
    """Scale the states by powers of two so that A has rows and columns of like size."""
    balanced, (scale, _) = matrix_balance(A, permute=False, separate=True)
    A = np.asarray(balanced, dtype=float)
    return A, B / scale[:, None], C * scale


def _uncouple(T: Matrix, Z: Matrix, k: int, B: Matrix, C: Matrix, D: Matrix) -> Split:
    """Turn an ordered Schur form into two uncoupled systems."""
    B, C = Z.T @ B, C @ Z
    X = (
        solve_sylvester(T[:k, :k], -T[k:, k:], -T[:k, k:])
        if 0 < k < T.shape[0]
        else np.zeros(T[:k, k:].shape)
    )
    values = np.linalg.eigvals(T[k:, k:])
    names = tuple(mode_name(complex(v)) for v in values if v.imag >= 0.0)
    return Split(
        stable=(T[:k, :k], B[:k] - X @ B[k:], C[:, :k], D),
        rest=(T[k:, k:], B[k:], C[:, :k] @ X + C[:, k:]),
        names=names,
    )


@dataclass(frozen=True)
class Balanced:
    """Minimal part of a stable system in coordinates where both Gramians are diag(values)."""

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    values: Matrix  # all of them, also those below the rank kept here

    @property
    def rank(self) -> int:
        """Number of states kept as numerically minimal."""
        return int(self.A.shape[0])


def balance(A: Matrix, B: Matrix, C: Matrix, D: Matrix, *, negligible: float = NEGLIGIBLE) -> Balanced:
    r"""Balance a stable system by the square-root method, dropping values below negligible * largest.

    With :math:`P = L_c L_c^T, Q = L_o L_o^T` and :math:`L_o^T L_c = U \Sigma V^T` the projections are
    :math:`W = L_o U \Sigma^{-1/2}, T = L_c V \Sigma^{-1/2}`.
    """
    Lc, Lo = gramian_factor(A, B), gramian_factor(A.T, C.T)
    W, T, values = projections(Lc, Lo, negligible)
    return Balanced(W.T @ A @ T, W.T @ B, C @ T, D, values)


def projections(
    Lc: Matrix, Lo: Matrix, negligible: float = NEGLIGIBLE, *, most: int | None = None
) -> tuple[Matrix, Matrix, Matrix]:
    """W, T with W.T @ T = I that balance Lc Lc^T and Lo Lo^T, `most` columns, and all singular values."""
    U, values, Vh = np.linalg.svd(Lo.T @ Lc, full_matrices=False)
    rank = int(np.sum(values > negligible * values[0])) if values.size and values[0] > 0.0 else 0
    rank = rank if most is None else min(rank, most)
    root = np.sqrt(values[:rank])
    return Lo @ U[:, :rank] / root, Lc @ Vh[:rank].T / root, values


def assemble(
    like: control.StateSpace,
    stable: tuple[Matrix, Matrix, Matrix, Matrix],
    rest: tuple[Matrix, Matrix, Matrix] | None = None,
) -> control.StateSpace:
    """Stack the rest (states r1..) above the stable part (states z1..), with the signal names of `like`."""
    A, B, C, D = stable
    labels = [f"z{i + 1}" for i in range(A.shape[0])]
    if rest is not None and rest[0].shape[0]:
        R, S, T = rest
        n, m = R.shape[0], A.shape[0]
        A = np.block([[R, np.zeros((n, m))], [np.zeros((m, n)), A]])
        B, C = np.vstack([S, B]), np.hstack([T, C])
        labels = [f"r{i + 1}" for i in range(n)] + labels
    return control.ss(
        A, B, C, D, states=labels, inputs=list(like.input_labels), outputs=list(like.output_labels)
    )


def difference(
    one: tuple[Matrix, Matrix, Matrix, Matrix], two: tuple[Matrix, Matrix, Matrix, Matrix]
) -> tuple[Matrix, Matrix, Matrix, Matrix]:
    """The system one - two."""
    (A, B, C, D), (E, F, G, H) = one, two
    n, m = A.shape[0], E.shape[0]
    return (
        np.block([[A, np.zeros((n, m))], [np.zeros((m, n)), E]]),
        np.vstack([B, F]),
        np.hstack([C, -G]),
        D - H,
    )


def check_order(order: int, n: int, unstable: int, names: tuple[str, ...]) -> None:
    """Raise ReductionError unless unstable <= order <= n."""
    if isinstance(order, bool) or not isinstance(order, (int, np.integer)) or not 0 <= order <= n:
        raise ReductionError(
            f"order = {order!r}: must be a whole number from {unstable} to {n}, the plant's order"
        )
    if order < unstable:
        raise ReductionError(
            f"order = {order}: {unstable} states are in modes that are never reduced ({', '.join(names)}); "
            f"ask for at least {unstable}"
        )
