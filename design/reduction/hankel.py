"""Optimal Hankel-norm approximation: Glover's all-pass construction in balanced coordinates."""

from __future__ import annotations

from typing import Literal

import control
import numpy as np
from numpy.typing import NDArray

from ..linear.norms import gramian_factor, hinf_of
from .gramians import (
    Reduction,
    ReductionError,
    assemble,
    balance,
    check_order,
    difference,
    matrices,
    separate,
)

Matrix = NDArray[np.float64]
Realisation = tuple[Matrix, Matrix, Matrix, Matrix]


def hankel_reduction(
    system: control.StateSpace, order: int, *, feedthrough: Literal["keep", "optimal"] = "keep"
) -> Reduction:
    r"""Reduce so that the Hankel norm of the error is the smallest possible, :math:`\sigma_{k+1}`.

    Balanced realisation ordered as :math:`\Sigma = \mathrm{diag}(\Sigma_1, \sigma I_r)` with
    :math:`\sigma = \sigma_{k+1}` last, :math:`\Gamma = \Sigma_1^2 - \sigma^2 I`, U orthogonal with
    :math:`B_2 = -C_2^T U`:

    .. math::
        \hat A = \Gamma^{-1} (\sigma^2 A_{11}^T + \Sigma_1 A_{11} \Sigma_1 - \sigma C_1^T U B_1^T), \quad
        \hat B = \Gamma^{-1} (\Sigma_1 B_1 + \sigma C_1^T U), \quad
        \hat C = C_1 \Sigma_1 + \sigma U B_1^T, \quad \hat D = D - \sigma U .

    :math:`G - \hat G` is all-pass of height sigma; the stable part of :math:`\hat G` (k states) is the answer
    [Glover1984, section 6]. The Hankel norm does not see D, so D is a free choice:

    * ``keep``: the plant's D (a strictly proper plant stays so); H-infinity error at most
      :math:`2 \sum_{i>k} \sigma_i`.
    * ``optimal``: Glover's D, found by reducing the unstable part of :math:`\hat G` to a constant;
      H-infinity error at most :math:`\sum_{i>k} \sigma_i`, at the price of D != 0.

    Parameters
    ----------
    system : n states; modes with Re >= -1e-6 are kept as they are.
    order : states of the result, those modes included.

    Raises
    ------
    ReductionError : order out of range, or it would split a multiple Hankel singular value.
    """
    if feedthrough not in ("keep", "optimal"):
        raise ReductionError(f"feedthrough = {feedthrough!r}: must be 'keep' or 'optimal'")
    split = separate(*matrices(system))
    unstable = split.rest[0].shape[0]
    check_order(order, system.nstates, unstable, split.names)
    b = balance(*split.stable)
    k = min(order - unstable, b.rank)
    if k == b.rank:
        small: Realisation = (b.A, b.B, b.C, b.D)
        constant = b.D
    else:
        small, constant = _optimal(b.A, b.B, b.C, b.D, b.values[: b.rank], k)
    small = (*small[:3], constant if feedthrough == "optimal" else b.D)
    error = difference(split.stable, small)
    tail = float(np.sum(b.values[k:]))
    return Reduction(
        system=assemble(system, small, split.rest),
        method=f"optimal Hankel norm, D {feedthrough}",
        hankel_values=b.values,
        bound=tail if feedthrough == "optimal" else 2.0 * tail,
        error=hinf_of(*error).value,
        error_of="G - G_k, H-infinity",
        hankel_error=_hankel_norm(*error[:3]),
        kept=split.names,
    )


def _hankel_norm(A: Matrix, B: Matrix, C: Matrix) -> float:
    """Largest Hankel singular value of (A, B, C), stable."""
    values = np.linalg.svd(gramian_factor(A.T, C.T).T @ gramian_factor(A, B), compute_uv=False)
    return float(values[0]) if values.size else 0.0


def _optimal(
    A: Matrix, B: Matrix, C: Matrix, D: Matrix, values: Matrix, k: int
) -> tuple[Realisation, Matrix]:
    """Stable part with k states of the all-pass extension of a balanced system, and Glover's D."""
    big, _ = _all_pass(A, B, C, D, values, k)
    # the rest of `big` grows: its mirror image is a stable system with the tail's singular values
    split = separate(*big, margin=0.0)
    if split.stable[0].shape[0] != k:
        raise ReductionError(
            f"order {k} of the stable part cannot be separated: Hankel singular values {values[k - 1]:.6g} "
            f"and {values[k]:.6g} are too close; ask for another order"
        )
    F, G, H = split.rest
    constant = split.stable[3]
    if F.shape[0]:
        constant = constant + _constant_for(-F, -G, H, np.zeros_like(D))
    return split.stable, constant


def _all_pass(A: Matrix, B: Matrix, C: Matrix, D: Matrix, values: Matrix, k: int) -> tuple[Realisation, int]:
    """Glover's extension at sigma = values[k]: order n - r, with r the multiplicity of sigma."""
    sigma = values[k]
    same = np.abs(values - sigma) <= 1e-10 * sigma
    if np.any(same[:k]):
        first = int(np.flatnonzero(same)[0])
        raise ReductionError(
            f"order {k} splits the Hankel singular value {sigma:.6g}, which is {int(same.sum())}-fold; "
            f"ask for {first} or {first + int(same.sum())}"
        )
    p, m = D.shape
    size = max(p, m)
    B = np.hstack([B, np.zeros((B.shape[0], size - m))])
    C = np.vstack([C, np.zeros((size - p, C.shape[1]))])
    one, two = np.flatnonzero(~same), np.flatnonzero(same)
    A11, B1, C1, S = A[np.ix_(one, one)], B[one], C[:, one], values[one]
    U = _orthogonal(B[two], C[:, two])
    gamma = (S**2 - sigma**2)[:, None]
    Ah = (sigma**2 * A11.T + S[:, None] * A11 * S - sigma * C1.T @ U @ B1.T) / gamma
    Bh = (S[:, None] * B1 + sigma * C1.T @ U) / gamma
    Ch = C1 * S + sigma * U @ B1.T
    return (Ah, Bh[:, :m], Ch[:p], D - sigma * U[:p, :m]), int(two.size)


def _orthogonal(B2: Matrix, C2: Matrix) -> Matrix:
    """Square orthogonal U with B2 = -C2.T @ U, which exists because B2 B2^T = C2^T C2."""
    Wc, s, Vh = np.linalg.svd(C2, full_matrices=True)
    # right factors of B2^T in the same basis V: B2^T V / s
    r = int(np.sum(s > 1e-14 * max(s[0], 1e-300)))
    Wb = B2.T @ Vh[:r].T / s[:r]
    Wb, triangle = np.linalg.qr(np.hstack([Wb, np.eye(Wb.shape[0])]))
    Wb[:, :r] *= np.sign(np.diag(triangle)[:r])
    return np.asarray(-(Wc[:, :r] @ Wb[:, :r].T + Wc[:, r:] @ Wb[:, r:].T))


def _constant_for(A: Matrix, B: Matrix, C: Matrix, D: Matrix) -> Matrix:
    """Constant within the sum of the Hankel singular values of a stable system."""
    while A.shape[0]:
        b = balance(A, B, C, D)
        if b.rank == 0:
            break
        values = b.values[: b.rank]
        last = int(np.flatnonzero(np.abs(values - values[-1]) <= 1e-10 * values[-1])[0])
        (A, B, C, D), _ = _all_pass(b.A, b.B, b.C, b.D, values, last)
    return D
