r"""From the unknowns of the LMIs back to a controller.

With ``U V' = I - X Y``, ``B^ = U B_K``, ``C^ = C_K V'`` (D_K = 0) and

    one plant        A^ = X A Y + X B C^ + B^ C Y + U A_K V'     [Scherer1997]; [Sundaria2016], eq. 4.17
    several plants   A^ = X A Y + X B C^ + U A_K V'              [Sundaria2016], eq. 4.24

the controller is recovered by two triangular-like solves with U and V.
"""

from __future__ import annotations

import numpy as np

from .problem import Matrix


def factors(X: Matrix, Y: Matrix) -> tuple[Matrix, Matrix]:
    """Return U, V (n, n) with ``U V' = I - X Y``, the singular values shared between them.

    Raises
    ------
    ValueError
        If I - X Y is singular to working precision: the LMIs sit on their boundary.
    """
    u, s, vt = np.linalg.svd(np.eye(X.shape[0]) - X @ Y)
    if not s[-1] > 1e-13 * s[0]:
        raise ValueError(
            f"recover: I - X Y is singular (condition {s[0] / max(s[-1], 1e-300):.1e}); "
            "stop the solver farther from the optimum or add eps tr(X + Y) to the objective"
        )
    return u * np.sqrt(s), vt.T * np.sqrt(s)


def recover(
    A: Matrix,
    B: Matrix,
    C: Matrix | None,
    X: Matrix,
    Y: Matrix,
    Ah: Matrix,
    Bh: Matrix,
    Ch: Matrix,
) -> tuple[Matrix, Matrix, Matrix]:
    """Return A_K (n, n), B_K (n, p), C_K (m, n).

    `C` is the measurement matrix (p, n) where A^ absorbed ``B^ C Y`` (one
    plant), None where it did not (several plants).
    """
    U, V = factors(X, Y)
    inner = Ah - X @ A @ Y - X @ B @ Ch
    if C is not None:
        inner = inner - Bh @ C @ Y
    A_K = np.linalg.solve(U, np.linalg.solve(V, inner.T).T)
    return A_K, np.linalg.solve(U, Bh), np.linalg.solve(V, Ch.T).T
