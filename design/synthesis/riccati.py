r"""H-infinity control by two Riccati equations: what is exact where no pole region is asked for.

`hinf_riccati` is the two-Riccati solution of the H-infinity problem with D11 of any value,
inside a bisection over gamma. [Doyle1989], [Zhou1996]
`without_region` is the design by it, checked as one by LMIs is.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from interarea.models.threads import one_blas_thread

from ..lmi.problem import Matrix
from .check import Synthesis, checked, first_certified, from_slack
from .generalized_plant import GeneralizedPlant
from .lmi_form import PoleRegion

#: Shares by which the level of the controller lies above the optimum, tried in turn.
_SLACKS = (5e-4, 1e-3, 1e-2, 0.05, 0.2)


@dataclass(frozen=True)
class HinfDesign:
    """Central controller u = +K y of the standard problem; `note` says what was regularised."""

    gamma: float  #: level at which the conditions hold; within the bisection's tolerance of the optimum
    trials: int  #: levels tried
    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    note: str


def hinf_riccati(P: GeneralizedPlant, *, tolerance: float = 1e-9, regularise: float = 1e-6) -> HinfDesign:
    r"""Solve ``min |T_zw|`` by bisection over the two-Riccati conditions. [Doyle1989], [Zhou1996]

    D11 need not vanish, D12 and D21 any: they are brought to the standard form
    by scaling u and y; where D12 has not full column rank or D21 not full row
    rank, `regularise` times the plant's size is appended as extra performance
    outputs ``eps u`` or disturbances ``eps w'`` and `note` says so. The controller is the central
    one and may have D_K not zero where D11 is not.

    Raises
    ------
    ValueError
        If no level up to 1e12 is feasible: (A, B2) not
        stabilizable or (C2, A) not detectable.
    """
    P, note = _full_rank(P, regularise)
    standard = _normalised(P)
    low = float(np.linalg.norm(_static_floor(P)))
    high = max(1.0, 2.0 * low)
    controller, trials = _central(standard, high), 1
    while controller is None:
        low, high = high, 4.0 * high
        if high > 1e12:
            raise ValueError(
                "H-infinity Riccati: no level is feasible; (A, B2) is not stabilizable, (C2, A) is not "
                "detectable, or zeros lie on the imaginary axis"
            )
        controller, trials = _central(standard, high), trials + 1
    while high - low > tolerance * high:
        middle = 0.5 * (low + high) if low > 0.5 * high else max(np.sqrt(max(low, 1e-12) * high), 0.25 * high)
        trial, trials = _central(standard, middle), trials + 1
        if trial is None:
            low = middle
        else:
            high, controller = middle, trial
    return HinfDesign(float(high), trials, *controller, note=note)


def without_region(
    P: GeneralizedPlant, region: PoleRegion, *, slack: float | None, what: str
) -> Synthesis | None:
    """Return the central controller a little above the optimum; None where these equations do not apply.

    They do not where D12 or D21 lack rank, zeros lie on the imaginary axis, or the controller has D_K not 0.

    slack : share by which its level lies above the optimum; None: 5e-4, more where the check fails there.

    Raises
    ------
    UncertifiedDesign : the closed loop contradicts every level.
    """
    started = time.perf_counter()
    try:
        with one_blas_thread():
            optimum = hinf_riccati(P)
    except ValueError:
        return None
    if optimum.note:
        return None
    standard = _normalised(P)

    def attempt(r: float) -> Synthesis | None:
        level = (1.0 + r) * optimum.gamma
        central = _central(standard, level)
        if central is None:
            return None
        *K, D_K = central
        if not _norm(D_K) <= 1e-12 * max(1.0, _norm(K[2]) * _norm(K[1])):
            return None
        pattern, regions = {"normal": (P.C2, P.D21)}, {"normal": region}
        poles_of, norm_of = checked(P, (K[0], K[1], K[2]), pattern, regions, level, what=what)
        return Synthesis(
            controller=P.controller(*K),
            gamma=level,
            norm_of=norm_of,
            poles_of=poles_of,
            region_of=regions,
            solves=0,
            seconds=time.perf_counter() - started,
            engine="Riccati equations",
            facts={
                "gamma_optimum": optimum.gamma,
                "gamma_slack": r,
                "gap": 1e-9,
                "iterations": optimum.trials,
                "status": "optimal",
            },
        )

    return first_certified(from_slack(slack, _SLACKS), attempt)


def _full_rank(P: GeneralizedPlant, regularise: float) -> tuple[GeneralizedPlant, str]:
    """Append small performance outputs or disturbances where D12 or D21 lack rank."""
    notes = []
    if np.linalg.matrix_rank(P.D12) < P.D12.shape[1]:
        m2 = P.D12.shape[1]
        eps = regularise * max(1.0, float(np.linalg.norm(P.C1, 2)))
        P = replace(
            P,
            C1=np.vstack([P.C1, np.zeros((m2, P.order))]),
            D11=np.vstack([P.D11, np.zeros((m2, P.D11.shape[1]))]),
            D12=np.vstack([P.D12, eps * np.eye(m2)]),
        )
        notes.append(f"D12 has not full column rank: {eps:.1e} u added to the performance outputs")
    if np.linalg.matrix_rank(P.D21) < P.D21.shape[0]:
        p2 = P.D21.shape[0]
        eps = regularise * max(1.0, float(np.linalg.norm(P.B1, 2)))
        P = replace(
            P,
            B1=np.hstack([P.B1, np.zeros((P.order, p2))]),
            D11=np.hstack([P.D11, np.zeros((P.D11.shape[0], p2))]),
            D21=np.hstack([P.D21, eps * np.eye(p2)]),
        )
        notes.append(f"D21 has not full row rank: {eps:.1e} w' added to the measurements")
    return P, "; ".join(notes)


def _static_floor(P: GeneralizedPlant) -> Matrix:
    """D11 seen through directions the controller cannot reach: its norm bounds gamma from below."""
    left = scipy.linalg.null_space(P.D12.T).T
    right = scipy.linalg.null_space(P.D21)
    sides = [left @ P.D11, P.D11 @ right]
    return max((s for s in sides if s.size), key=lambda s: np.linalg.norm(s, 2), default=np.zeros((1, 1)))


def _central(N: _Normalised, level: float) -> tuple[Matrix, Matrix, Matrix, Matrix] | None:
    """Return the central controller with norm below `level`, None if there is none. [Zhou1996], th. 17.1"""
    D11, p1, m1 = N.P.D11, *N.P.D11.shape
    m2, p2 = N.P.B2.shape[1], N.P.C2.shape[0]
    d1111, d1112 = D11[: p1 - m2, : m1 - p2], D11[: p1 - m2, m1 - p2 :]
    d1121, d1122 = D11[p1 - m2 :, : m1 - p2], D11[p1 - m2 :, m1 - p2 :]
    if not level > max(_norm(np.hstack([d1111, d1112])), _norm(np.vstack([d1111, d1121]))):
        return None
    A, B1, B2, C1, C2 = N.P.A, N.P.B1, N.P.B2, N.P.C1, N.P.C2
    B, C = np.hstack([B1, B2]), np.vstack([C1, C2])
    row, column = np.hstack([D11, N.P.D12]), np.vstack([D11, N.P.D21])
    R = row.T @ row - scipy.linalg.block_diag(level**2 * np.eye(m1), np.zeros((m2, m2)))
    Q = column @ column.T - scipy.linalg.block_diag(level**2 * np.eye(p1), np.zeros((p2, p2)))
    try:
        X = _stabilising(A, B, C1, row, R)
        Y = _stabilising(A.T, C.T, B1.T, column.T, Q)
    except np.linalg.LinAlgError:
        return None
    if X is None or Y is None:
        return None
    small = 1e-7
    for S in (X, Y):
        if not float(np.linalg.eigvalsh(S)[0]) >= -small * max(1.0, float(np.abs(S).max())):
            return None
    if not float(np.abs(np.linalg.eigvals(X @ Y)).max()) < level**2:
        return None
    F = -np.linalg.solve(R, row.T @ C1 + B.T @ X)
    L = -np.linalg.solve(Q.T, (B1 @ column.T + Y @ C.T).T).T
    F12, F2 = F[m1 - p2 : m1], F[m1:]
    L12, L2 = L[:, p1 - m2 : p1], L[:, p1:]
    inner = level**2 * np.eye(p1 - m2) - d1111 @ d1111.T
    other = level**2 * np.eye(m1 - p2) - d1111.T @ d1111
    D_K = -d1121 @ d1111.T @ np.linalg.solve(inner, d1112) - d1122
    square12 = np.eye(m2) - d1121 @ np.linalg.solve(other, d1121.T)
    square21 = np.eye(p2) - d1112.T @ np.linalg.solve(inner, d1112)
    try:
        D12 = np.linalg.cholesky(square12)
        D21 = np.linalg.cholesky(square21).T
        Z = np.linalg.inv(np.eye(A.shape[0]) - Y @ X / level**2)
    except np.linalg.LinAlgError:
        return None
    B2h = Z @ (B2 + L12) @ D12
    C2h = -D21 @ (C2 + F12)
    B1h = -Z @ L2 + B2h @ np.linalg.solve(D12, D_K)
    C1h = F2 + D_K @ np.linalg.solve(D21, C2h)
    A_K = A + B @ F + B1h @ np.linalg.solve(D21, C2h)
    return A_K, B1h @ N.y_scale, N.u_scale @ C1h, N.u_scale @ D_K @ N.y_scale


@dataclass(frozen=True)
class _Normalised:
    """Plant with D12 = [0; I], D21 = [0 I]; u = u_scale u~, y~ = y_scale y."""

    P: GeneralizedPlant
    u_scale: Matrix
    y_scale: Matrix


def _normalised(P: GeneralizedPlant) -> _Normalised:
    """Rotate z and w and scale u and y so that D12 = [0; I], D21 = [0 I]."""
    m2, p2 = P.D12.shape[1], P.D21.shape[0]
    U, s, Vt = np.linalg.svd(P.D12)
    Tz = np.hstack([U[:, m2:], U[:, :m2]]).T
    u_scale = Vt.T / s
    U, s, Vt = np.linalg.svd(P.D21)
    Tw = np.vstack([Vt[p2:], Vt[:p2]]).T
    y_scale = (U / s).T
    moved = replace(
        P,
        B1=P.B1 @ Tw,
        B2=P.B2 @ u_scale,
        C1=Tz @ P.C1,
        C2=y_scale @ P.C2,
        D11=Tz @ P.D11 @ Tw,
        D12=Tz @ P.D12 @ u_scale,
        D21=y_scale @ P.D21 @ Tw,
    )
    return _Normalised(moved, u_scale, y_scale)


def _stabilising(A: Matrix, B: Matrix, C: Matrix, D: Matrix, R: Matrix) -> Matrix | None:
    """Return the stabilising solution X of the Riccati equation with Hamiltonian of (A, B, C, D, R).

    None if an eigenvalue lies on the imaginary axis or the subspace is not a graph.
    """
    n = A.shape[0]
    upper = np.vstack([B, -C.T @ D])
    H = np.block([[A, np.zeros((n, n))], [-C.T @ C, -A.T]]) - upper @ np.linalg.solve(
        R, np.hstack([D.T @ C, B.T])
    )
    T, U, stable = scipy.linalg.schur(H, sort="lhp")
    if stable != n or not np.all(np.isfinite(T)):
        return None
    values = np.linalg.eigvals(H)
    if not float(np.abs(values.real).min()) > 1e-10 * max(1.0, float(np.abs(values).max())):
        return None
    if not np.linalg.cond(U[:n, :n]) < 1e13:
        return None
    X: Matrix = np.linalg.solve(U[:n, :n].T, U[n:, :n].T).T
    return (X + X.T) / 2


def _norm(a: Matrix) -> float:
    return float(np.linalg.norm(a, 2)) if a.size else 0.0
