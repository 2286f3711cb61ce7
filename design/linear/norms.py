"""Gramians, H2 and H-infinity norms of stable linear systems, by our own numpy and scipy only.

Certificates rest on these numbers, so no optimisation solver is involved: Gramian factors come
from Hammarling's recursion on the Schur form, the H-infinity norm from imaginary eigenvalues of
the Hamiltonian matrix.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import control
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import matrix_balance, qr, schur, solve_triangular
from scipy.optimize import minimize_scalar

from interarea.models.errors import InterareaError

from .systems import state_space

Matrix = NDArray[np.float64]
ComplexMatrix = NDArray[np.complex128]


class UnstableSystem(InterareaError, ValueError):
    """A norm or Gramian that exists only for a stable system was asked for."""


@dataclass(frozen=True)
class PeakGain:
    """Largest gain over frequency, `value`, at `frequency_rad` (rad/s), to `tolerance` relative."""

    value: float
    frequency_rad: float
    tolerance: float


def require_stable(A: Matrix, what: str) -> None:
    """Raise UnstableSystem, naming the rightmost eigenvalue, unless all of A decays."""
    if A.shape[0] == 0:
        return
    if not np.all(np.isfinite(A)):
        raise UnstableSystem(f"{what}: the state matrix has entries that are not finite")
    values = np.linalg.eigvals(A)
    worst = values[np.argmax(values.real)]
    if not worst.real < 0.0:
        raise UnstableSystem(
            f"{what} exists for stable systems only; eigenvalue {worst.real:.4g}{worst.imag:+.4g}j does not "
            "decay: separate it first"
        )


def gramian_factor(A: Matrix, B: Matrix) -> Matrix:
    r"""Factor L of the controllability Gramian, without ever forming the Gramian.

    :math:`A P + P A^T + B B^T = 0,\ P = L L^T`. On the Schur form :math:`A = U T U^H` the upper
    triangular factor is found column by column from the last, with
    :math:`r = |b| / \sqrt{-2 \mathrm{Re} \lambda}` and
    :math:`(T_1 + \bar\lambda I) y = -(B_1 b^H / r + t r)`, then :math:`B_1 \leftarrow B_1 - y b / r`
    (Hammarling). Small Hankel singular values keep their relative accuracy this way.

    Parameters
    ----------
    A : (n, n) stable.   B : (n, m).

    Returns
    -------
    L : (n, n) lower triangular. For the observability Gramian pass A.T, C.T.
    """
    n = A.shape[0]
    require_stable(A, "the Gramian")
    if n == 0:
        return np.zeros((0, 0))
    # states of like size first: rounding in the Schur form is relative to the largest entry
    balanced, scaling = matrix_balance(A, permute=False, separate=True)
    A = np.asarray(balanced, dtype=float)
    scale = scaling[0]
    T, U = schur(A, output="complex")
    R = np.zeros((n, n), dtype=complex)
    F = U.conj().T @ (B / scale[:, None]).astype(complex)
    for k in range(n - 1, -1, -1):
        b = F[k]
        size = np.linalg.norm(b)
        if size == 0.0:
            continue
        root = np.sqrt(-2.0 * T[k, k].real)
        r = size / root
        R[k, k] = r
        if k == 0:
            continue
        direction = b * (root / size)  # b / r
        M = T[:k, :k] + np.conj(T[k, k]) * np.eye(k)
        y = solve_triangular(M, -(F[:k] @ direction.conj() + T[:k, k] * r))
        R[:k, k] = y
        F[:k] -= np.outer(y, direction)
    L = scale[:, None] * (U @ R)
    # P is real: P = Re(L) Re(L)^T + Im(L) Im(L)^T
    triangle = qr(np.hstack([L.real, L.imag]).T, mode="r")[0]
    return np.asarray(triangle[:n].T)


def hankel_singular_values(system: control.StateSpace) -> Matrix:
    """Hankel singular values (n,) of a stable system, largest first."""
    system = state_space(system)
    A, B, C = (np.asarray(M, dtype=float) for M in (system.A, system.B, system.C))
    if A.shape[0] == 0:
        return np.zeros(0)
    return np.asarray(np.linalg.svd(gramian_factor(A.T, C.T).T @ gramian_factor(A, B), compute_uv=False))


def frequency_response(
    A: Matrix, B: Matrix, C: Matrix, D: Matrix, omega_rad: Matrix | list[float]
) -> ComplexMatrix:
    r"""Values :math:`C (j\omega I - A)^{-1} B + D`, shape (len(omega), p, m)."""
    return transfer_of(A, B, C, D)(omega_rad)


def transfer_of(
    A: Matrix, B: Matrix, C: Matrix, D: Matrix
) -> Callable[[Matrix | list[float]], ComplexMatrix]:
    """Return what gives `frequency_response` at one set of frequencies after another, from one Schur form."""
    n = A.shape[0]
    if n > 0:
        balanced, (scale, _) = matrix_balance(A, permute=False, separate=True)
        T, U = schur(np.asarray(balanced, dtype=float), output="complex")
        left, right = (C * scale) @ U, U.conj().T @ (B / scale[:, None])
        eye = np.eye(n)

    def values(omega_rad: Matrix | list[float]) -> ComplexMatrix:
        omega = np.atleast_1d(np.asarray(omega_rad, dtype=float))
        out = np.empty((omega.size, C.shape[0], B.shape[1]), dtype=complex)
        out[:] = D
        for k, w in enumerate(omega if n > 0 else ()):
            out[k] += left @ solve_triangular(1j * w * eye - T, right)
        return out

    return values


def response(system: control.StateSpace, omega_rad: Matrix) -> ComplexMatrix:
    """Return C (jw I - A)^-1 B + D, shape (len(omega_rad), outputs, inputs), all frequencies in one solve."""
    system = state_space(system)
    A, B, C, D = (np.asarray(m, dtype=float) for m in (system.A, system.B, system.C, system.D))
    if A.shape[0] == 0:
        return np.broadcast_to(D.astype(complex), (omega_rad.size, *D.shape)).copy()
    resolvent = 1j * omega_rad[:, None, None] * np.eye(A.shape[0]) - A
    return np.asarray(C @ np.linalg.solve(resolvent, np.broadcast_to(B, (omega_rad.size, *B.shape))) + D)


def hinf_norm(system: control.StateSpace, *, tolerance: float = 1e-8) -> PeakGain:
    r"""H-infinity norm by bisection on the Hamiltonian matrix, two-step variant.

    :math:`\gamma` is a singular value of :math:`G(j\omega)` exactly where :math:`j\omega` is an eigenvalue of

    .. math:: H(\gamma) = \begin{bmatrix} A + B R^{-1} D^T C & B R^{-1} B^T \\
              -C^T (I + D R^{-1} D^T) C & -(A + B R^{-1} D^T C)^T \end{bmatrix},
              \qquad R = \gamma^2 I - D^T D .

    Starting from the largest gain at the resonances, gamma is raised to the largest gain at and
    between neighbouring crossings until none is left; the answer is (1 + 2 tolerance) times a gain
    that is reached (Boyd, Balakrishnan; Bruinsma, Steinbuch).

    Raises
    ------
    UnstableSystem : the norm would be infinite. LinearSystemError : no system in continuous time.
    """
    system = state_space(system)
    A, B, C, D = (np.asarray(M, dtype=float) for M in (system.A, system.B, system.C, system.D))
    return hinf_of(A, B, C, D, tolerance=tolerance)


def hinf_of(A: Matrix, B: Matrix, C: Matrix, D: Matrix, *, tolerance: float = 1e-8) -> PeakGain:
    """`hinf_norm` on bare matrices: A (n, n), B (n, m), C (p, n), D (p, m)."""
    at_infinity = float(np.linalg.norm(D, 2)) if D.size else 0.0
    if A.shape[0] == 0 or B.size == 0 or C.size == 0:
        return PeakGain(at_infinity, float("inf"), tolerance)
    require_stable(A, "the H-infinity norm")
    poles = np.linalg.eigvals(A)
    balanced, (scale, _) = matrix_balance(A, permute=False, separate=True)
    A = np.asarray(balanced, dtype=float)
    B, C = B / scale[:, None], C * scale

    transfer = transfer_of(A, B, C, D)

    def gain(omega: Matrix) -> Matrix:
        return np.asarray(np.linalg.svd(transfer(omega), compute_uv=False)[:, 0])

    trial = np.unique(np.concatenate([[0.0], np.abs(poles.imag), np.abs(poles)]))
    gains = gain(trial)
    best, where = float(np.max(gains)), float(trial[np.argmax(gains)])
    if at_infinity > best:
        best, where = at_infinity, float("inf")
    if best == 0.0:
        return PeakGain(0.0, 0.0, tolerance)
    for _ in range(60):
        gamma = (1.0 + 2.0 * tolerance) * best
        crossings = _near_crossings(A, B, C, D, gamma)
        if crossings.size == 0:
            break
        edges = np.unique(np.concatenate([[0.0], crossings, [2.0 * crossings[-1]]]))
        middle = np.unique(np.concatenate([0.5 * (edges[1:] + edges[:-1]), crossings]))
        gains = gain(middle)
        top = int(np.argmax(gains))
        if not float(gains[top]) > best:
            break
        best, where = float(gains[top]), float(middle[top])
        low = float(middle[top - 1]) if top > 0 else 0.0
        high = float(middle[top + 1]) if top + 1 < middle.size else 2.0 * where
        peak = minimize_scalar(
            lambda w: -float(gain(np.array([w]))[0]),
            bounds=(low, high),
            method="bounded",
            options={"xatol": 1e-9 * high},
        )
        if -peak.fun > best:
            best, where = float(-peak.fun), float(peak.x)
    else:
        raise ArithmeticError(
            "the H-infinity iteration did not converge in 60 steps; the state matrix is ill-scaled"
        )
    return PeakGain((1.0 + 2.0 * tolerance) * best, where, 2.0 * tolerance)


def _near_crossings(A: Matrix, B: Matrix, C: Matrix, D: Matrix, gamma: float) -> Matrix:
    """Frequencies >= 0 (rad/s, sorted) where gamma may be a singular value.

    Rounding moves a crossing off the axis, two that are about to meet by the root of it. So every
    eigenvalue near the axis counts: a false one costs an evaluation, a missed one the norm.
    """
    # scale so that gamma is 1: B and C shrink by the same factor
    B, C, D = B / np.sqrt(gamma), C / np.sqrt(gamma), D / gamma
    R = np.eye(D.shape[1]) - D.T @ D
    RD = np.linalg.solve(R, D.T)
    F = A + B @ RD @ C
    H = np.block([[F, B @ np.linalg.solve(R, B.T)], [-C.T @ (C + D @ RD @ C), -F.T]])
    values = np.linalg.eigvals(matrix_balance(H, permute=False)[0])
    near = np.abs(values.real) <= 1e-2 * np.abs(values)
    return np.unique(np.abs(values.imag[near]))
