"""The optimum of H-infinity control by the equations of [Doyle1989], solved by scipy: nothing of the package.

For D11 = 0, D12' [C1 D12] = [0 I], [B1; D21] D21' = [0; I]: both solutions exist, are positive semidefinite,
and the spectral radius of their product lies below gamma squared.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg


def _solution(
    A: np.ndarray, B1: np.ndarray, B2: np.ndarray, C: np.ndarray, level: float
) -> np.ndarray | None:
    """X of A'X + XA + X(B1 B1'/level^2 - B2 B2')X + C'C = 0, stabilising; None if there is none."""
    B = np.hstack([B1, B2])
    R = scipy.linalg.block_diag(-(level**2) * np.eye(B1.shape[1]), np.eye(B2.shape[1]))
    try:
        X = scipy.linalg.solve_continuous_are(A, B, C.T @ C, R)
    except (np.linalg.LinAlgError, ValueError):
        return None
    closed = A - B @ np.linalg.solve(R, B.T @ X)
    if not np.linalg.eigvals(closed).real.max() < 0.0:
        return None
    if not np.linalg.eigvalsh((X + X.T) / 2).min() >= -1e-7 * max(1.0, np.abs(X).max()):
        return None
    return X


def optimum(
    A: np.ndarray, B1: np.ndarray, B2: np.ndarray, C1: np.ndarray, C2: np.ndarray, tolerance: float = 1e-8
) -> float:
    """Return the least norm that a stabilising controller reaches, by bisection."""

    def reached(level: float) -> bool:
        X = _solution(A, B1, B2, C1, level)
        Y = _solution(A.T, C1.T, C2.T, B1.T, level)
        if X is None or Y is None:
            return False
        return bool(np.abs(np.linalg.eigvals(X @ Y)).max() < level**2)

    low, high = 0.0, 1.0
    while not reached(high):
        low, high = high, 2.0 * high
        assert high < 1e9
    while high - low > tolerance * high:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if reached(middle) else (middle, high)
    return high
