"""H2 (LQG) control of a generalized plant by two Riccati equations. [Zhou1996], section 14.5"""

from __future__ import annotations

import time

import numpy as np
import scipy.linalg

from ..errors import InfeasibleDesign, UncertifiedDesign
from ..lmi.problem import Matrix
from .check import Synthesis, closed_loop_matrices, require_reachable
from .generalized_plant import GeneralizedPlant, balanced_states, scaled
from .lmi_form import PoleRegion

_STABLE = PoleRegion(0.0, None, None)


def h2_optimal(P: GeneralizedPlant, *, what: str = "H2 design") -> Synthesis:
    """Return the controller u = +K y of the least H2 norm from w to z; it is unique and of the order of `P`.

    `gamma` is the optimum by the two equations, `norm_of` the norm of the closed loop by its Gramian.

    Raises
    ------
    InfeasibleDesign : an unstable mode that is fixed; D11, D12 or D21 for which no optimum exists.
    UncertifiedDesign : the closed loop is not stable or does not have that norm.
    """
    started = time.perf_counter()
    if P.D11.any():
        raise InfeasibleDesign(
            f"{what}: D11 is not zero (largest {np.abs(P.D11).max():.3g}), so that the H2 norm has no bound; "
            "low-pass the disturbance or the performance output",
            constraint="feedthrough",
        )
    for name, D, size in (("D12", P.D12, P.D12.shape[1]), ("D21", P.D21, P.D21.shape[0])):
        if np.linalg.matrix_rank(D) < size:
            raise InfeasibleDesign(
                f"{what}: {name} has rank {np.linalg.matrix_rank(D)}, wanted {size}: a control without "
                "cost or a measurement without noise has no optimum; add a small weight",
                constraint=name,
            )
    P = scaled(balanced_states(P))
    require_reachable(P.A, P.B2, P.C2, _STABLE, what)
    try:
        X, F = _regulator(P.A, P.B2, P.C1, P.D12)
        Y, L = _regulator(P.A.T, P.C2.T, P.B1.T, P.D21.T)
    except np.linalg.LinAlgError as error:
        raise InfeasibleDesign(
            f"{what}: a Riccati equation has no stabilising solution ({error}): the path from u to z or from "
            "w to y has a zero on the imaginary axis; move it off with a weight",
            constraint="zeros",
        ) from None
    K = (P.A + P.B2 @ F + L.T @ P.C2, -L.T, F)
    weighed = P.D12 @ F
    optimum = float(np.sqrt(np.trace(P.B1.T @ X @ P.B1) + np.trace(weighed @ Y @ weighed.T)))
    A, B, C, _ = closed_loop_matrices(P, K, P.C2, P.D21)
    poles = np.linalg.eigvals(A)
    norm = float("inf")
    if poles.real.max() < 0.0:
        norm = float(np.sqrt(np.trace(C @ scipy.linalg.solve_continuous_lyapunov(A, -B @ B.T) @ C.T)))
    if not abs(norm - optimum) <= 1e-5 * optimum:
        raise UncertifiedDesign(f"{what}: the closed loop has norm {norm:.6g}, the equations {optimum:.6g}")
    return Synthesis(
        controller=P.controller(*K),
        gamma=optimum,
        norm_of={"normal": norm},
        poles_of={"normal": poles},
        region_of={"normal": _STABLE},
        solves=0,
        seconds=time.perf_counter() - started,
        engine="Riccati equations",
    )


def _regulator(A: Matrix, B: Matrix, C: Matrix, D: Matrix) -> tuple[Matrix, Matrix]:
    """Return the stabilising X and the gain F of the cost |C x + D u|."""
    R, S = D.T @ D, C.T @ D
    X = scipy.linalg.solve_continuous_are(A, B, C.T @ C, R, s=S)
    return X, -np.linalg.solve(R, B.T @ X + S.T)
