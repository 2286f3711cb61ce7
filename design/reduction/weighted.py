"""Reduction that keeps what matters in use: frequency weights (Enns) and the closed loop itself."""

from __future__ import annotations

import control
import numpy as np
from numpy.typing import NDArray

from ..linear.linearise import select
from ..linear.norms import gramian_factor, hinf_of
from .gramians import (
    Reduction,
    ReductionError,
    assemble,
    check_order,
    difference,
    matrices,
    mode_name,
    projections,
    separate,
    separate_slow,
)

Matrix = NDArray[np.float64]
Realisation = tuple[Matrix, Matrix, Matrix, Matrix]


def weighted_reduction(
    system: control.StateSpace,
    order: int,
    *,
    input_weight: control.StateSpace | None = None,
    output_weight: control.StateSpace | None = None,
) -> Reduction:
    r"""Reduce so that :math:`W_o (G - G_k) W_i` stays small (Enns).

    The controllability Gramian is the block of :math:`G W_i` that belongs to G, the observability Gramian
    that of :math:`W_o G`; both are balanced and the weak states cut. There is no simple a-priori bound; the
    weighted error is measured. With weights on both sides stability is not guaranteed and is checked.

    Parameters
    ----------
    system : stable part is reduced, other modes are kept.
    order : states of the result, kept modes included.
    input_weight : stable, as many outputs as `system` has inputs.
    output_weight : stable, as many inputs as `system` has outputs.

    Raises
    ------
    ReductionError : sizes that do not fit, unstable weight, or an unstable result.
    """
    A, B, C, D = matrices(system)
    split = separate(A, B, C, D)
    unstable = split.rest[0].shape[0]
    check_order(order, system.nstates, unstable, split.names)
    p, m = D.shape
    Wi = _weight(input_weight, m, "input", "outputs")
    Wo = _weight(output_weight, p, "output", "inputs")
    stable = split.stable
    n = stable[0].shape[0]
    before, after = _series(Wi, stable), _series(stable, Wo)
    # the states of the second system of a series come first
    Lc = gramian_factor(before[0], before[1])[:n]
    Lo = gramian_factor(after[0].T, after[2].T)[after[0].shape[0] - n :]
    W, T, values = projections(Lc, Lo)
    k = min(order - unstable, W.shape[1])
    W, T = W[:, :k], T[:, :k]
    small = (W.T @ stable[0] @ T, W.T @ stable[1], stable[2] @ T, stable[3])
    if k and not np.max(np.linalg.eigvals(small[0]).real) < 0.0:
        raise ReductionError(
            f"order {order} with these weights gives an unstable model; weight one side only or ask for "
            "another order"
        )
    return Reduction(
        system=assemble(system, small, split.rest),
        method="frequency-weighted balanced truncation (Enns)",
        hankel_values=values,
        bound=None,
        error=hinf_of(*_series(_series(Wi, difference(stable, small)), Wo)).value,
        error_of="W_o (G - G_k) W_i, H-infinity",
        kept=split.names,
    )


def closed_loop_reduction(
    plant: control.StateSpace,
    controller: control.StateSpace,
    order: int,
    *,
    slowest_rad_s: float | None = 0.01,
) -> Reduction:
    r"""Reduce a controller by what its states do in the closed loop.

    With u = K y + w, y = G u and w white noise at the plant input, the closed loop
    :math:`\dot x = A_{cl} x + B_{cl} w,\ y = C_{cl} x` has Gramians P, Q. Their blocks of the controller's
    states are balanced and the weak states cut: a state of K counts as much as it is driven from
    w and seen in y *through the loop*. Poles of K slower than `slowest_rad_s` (near-integrators, which
    would spoil the Gramians) are taken out first, with their partial fraction.

    There is no a-priori bound: `error` is the measured H-infinity norm of the difference of
    both closed loops from w to y, and the reduced loop is checked to be stable.

    Parameters
    ----------
    plant : the design or full plant; its inputs and outputs include, by name, the controller's
        outputs and inputs.
    controller : K; u = + K y.
    order : states of the reduced controller.
    slowest_rad_s : None leaves slow poles where they are.

    Raises
    ------
    ReductionError : signals that do not match, an unstable closed loop before or after.
    """
    G = matrices(select(plant, list(controller.output_labels), list(controller.input_labels)))
    K = matrices(controller, "controller")
    check_order(order, controller.nstates, 0, ())
    removed: tuple[str, ...] = ()
    full = _closed_loop(G, K)
    if not np.max(np.linalg.eigvals(full[0]).real) < 0.0:
        worst = max(np.linalg.eigvals(full[0]), key=lambda v: v.real)
        raise ReductionError(
            f"the loop with the full controller is not stable ({mode_name(complex(worst))}): its Gramians "
            "do not exist; remove the reference angle from the plant, or correct the controller"
        )
    if slowest_rad_s is not None:
        slow = separate_slow(*K, slowest_rad_s)
        if slow.rest[0].shape[0]:
            K, removed = slow.stable, slow.names
    loop = _closed_loop(G, K)
    if not np.max(np.linalg.eigvals(loop[0]).real) < 0.0:
        raise ReductionError(
            f"without {', '.join(removed)} the closed loop is not stable; keep them with slowest_rad_s=None"
        )
    n = G[0].shape[0]
    W, T, values = projections(gramian_factor(loop[0], loop[1])[n:], gramian_factor(loop[0].T, loop[2].T)[n:])
    k = min(order, W.shape[1])
    W, T = W[:, :k], T[:, :k]
    small: Realisation = (W.T @ K[0] @ T, W.T @ K[1], K[2] @ T, K[3])
    reduced = _closed_loop(G, small)
    if not np.max(np.linalg.eigvals(reduced[0]).real) < 0.0:
        raise ReductionError(
            f"the closed loop with the controller of order {order} is not stable; use a higher order"
        )
    return Reduction(
        system=assemble(controller, small),
        method="closed-loop balanced truncation",
        hankel_values=values,
        bound=None,
        error=hinf_of(*difference(full, reduced)).value,
        error_of="closed loops from plant input noise to y, H-infinity of the difference",
        removed=removed,
    )


def _weight(weight: control.StateSpace | None, size: int, side: str, ports: str) -> Realisation:
    """Matrices of a weight, identity for none."""
    if weight is None:
        return np.zeros((0, 0)), np.zeros((0, size)), np.zeros((size, 0)), np.eye(size)
    W = matrices(weight, f"{side} weight")
    result = W[3].shape[0] if ports == "outputs" else W[3].shape[1]
    if result != size:
        raise ReductionError(f"the {side} weight has {result} {ports}; the system needs {size}")
    if W[0].shape[0] and not np.max(np.linalg.eigvals(W[0]).real) < 0.0:
        raise ReductionError(f"the {side} weight is not stable")
    return W


def _series(first: Realisation, second: Realisation) -> Realisation:
    """Second after first; states of the second come first."""
    A1, B1, C1, D1 = first
    A2, B2, C2, D2 = second
    A = np.block([[A2, B2 @ C1], [np.zeros((A1.shape[0], A2.shape[0])), A1]])
    return A, np.vstack([B2 @ D1, B1]), np.hstack([C2, D2 @ C1]), D2 @ D1


def _closed_loop(G: Realisation, K: Realisation) -> Realisation:
    """Loop of u = K y + w, from w to y, states (plant, controller)."""
    A, B, C, D = G
    Ak, Bk, Ck, Dk = K
    E = np.linalg.inv(np.eye(D.shape[0]) - D @ Dk)  # y = E (C x + D Ck xk + D w)
    F = np.eye(D.shape[1]) + Dk @ E @ D
    return (
        np.block([[A + B @ Dk @ E @ C, B @ F @ Ck], [Bk @ E @ C, Ak + Bk @ E @ D @ Ck]]),
        np.vstack([B @ F, Bk @ E @ D]),
        np.hstack([E @ C, E @ D @ Ck]),
        E @ D,
    )
