"""Model reduction; unstable and zero modes are kept and named, every result carries its error.

Here: balanced truncation and singular perturbation. Optimal Hankel-norm approximation and the
weighted methods have files of their own and are offered from here as well.
"""

from __future__ import annotations

import control
import numpy as np
from numpy.typing import NDArray

from ..linear.norms import hinf_of
from .gramians import (
    NEGLIGIBLE,
    Balanced,
    Reduction,
    ReductionError,
    assemble,
    balance,
    check_order,
    difference,
    matrices,
    separate,
)
from .hankel import hankel_reduction
from .weighted import closed_loop_reduction, weighted_reduction

__all__ = [
    "Reduction",
    "ReductionError",
    "balanced_truncation",
    "closed_loop_reduction",
    "hankel_reduction",
    "singular_perturbation",
    "weighted_reduction",
]

Matrix = NDArray[np.float64]


def balanced_truncation(
    system: control.StateSpace, order: int, *, negligible: float = NEGLIGIBLE
) -> Reduction:
    r"""Reduce by balanced truncation (square-root method).

    In balanced coordinates both Gramians are :math:`\mathrm{diag}(\sigma_1 \ge \sigma_2 \ge \dots)`;
    the states of the smallest :math:`\sigma_i` are cut. The bound

    .. math:: \|G - G_k\|_\infty \le 2 \sum_{i > k} \sigma_i

    counts equal values once. D is unchanged, so the models agree at infinite frequency.

    Parameters
    ----------
    system : n states; modes with Re >= -1e-6 are kept as they are.
    order : states of the result, those modes included.
    negligible : Hankel singular values below this share of the largest are cut, whatever the order.

    Raises
    ------
    ReductionError : order out of range, matrices not finite.

    Examples
    --------
    >>> import control
    >>> G = control.ss([[-1.0, 0.0], [0.0, -100.0]], [[1.0], [1.0]], [[1.0, 1.0]], [[0.0]])
    >>> r = balanced_truncation(G, 1)
    >>> r.error <= r.bound * (1 + 1e-6)
    True
    """
    return _balanced(system, order, residualise=False, negligible=negligible)


def singular_perturbation(system: control.StateSpace, order: int) -> Reduction:
    r"""Reduce by letting the weak balanced states settle at once.

    :math:`A_k = A_{11} - A_{12} A_{22}^{-1} A_{21}` and so on: the models agree at frequency zero, D changes.
    Same bound as `balanced_truncation`, same arguments and errors.
    """
    return _balanced(system, order, residualise=True)


def _balanced(
    system: control.StateSpace, order: int, *, residualise: bool, negligible: float = NEGLIGIBLE
) -> Reduction:
    """Balanced truncation or residualisation of the stable part."""
    split = separate(*matrices(system))
    unstable = split.rest[0].shape[0]
    check_order(order, system.nstates, unstable, split.names)
    b = balance(*split.stable, negligible=negligible)
    k = min(order - unstable, b.rank)
    small = _residualised(b, k) if residualise else (b.A[:k, :k], b.B[:k], b.C[:, :k], b.D)
    return Reduction(
        system=assemble(system, small, split.rest),
        method="singular perturbation" if residualise else "balanced truncation",
        hankel_values=b.values,
        bound=truncation_bound(b.values, k),
        error=hinf_of(*difference(split.stable, small)).value,
        error_of="G - G_k, H-infinity",
        kept=split.names,
    )


def _residualised(b: Balanced, k: int) -> tuple[Matrix, Matrix, Matrix, Matrix]:
    """Solve the states after k for their steady state."""
    X = np.linalg.solve(b.A[k:, k:], np.hstack([b.A[k:, :k], b.B[k:]]))
    A21, B2 = X[:, :k], X[:, k:]
    return (
        b.A[:k, :k] - b.A[:k, k:] @ A21,
        b.B[:k] - b.A[:k, k:] @ B2,
        b.C[:, :k] - b.C[:, k:] @ A21,
        b.D - b.C[:, k:] @ B2,
    )


def truncation_bound(values: Matrix, k: int) -> float:
    """Twice the sum of the distinct Hankel singular values after the k-th."""
    total, last = 0.0, float("inf")
    for value in values[k:]:
        if not value > last * (1.0 - 1e-9):
            total += float(value)
            last = float(value)
    return 2.0 * total
