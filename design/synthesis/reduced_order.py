"""A controller of lower order, and its price: what that costs in norm and effort on the full plant."""

from __future__ import annotations

import control
import numpy as np

from ..errors import UncertifiedDesign
from ..linear.linearise import select
from ..linear.norms import hinf_of
from ..lmi.problem import Matrix
from ..reduction.weighted import closed_loop_reduction
from .generalized_plant import GeneralizedPlant


def closed_loop_poles(plant: control.StateSpace, K: control.StateSpace, lost: tuple[str, ...] = ()) -> Matrix:
    """Return the poles of the full plant (speeds in rad/s) with u = +K y, some signals lost (zero)."""
    G = select(plant, list(K.output_labels), list(K.input_labels))
    keep = np.array([0.0 if s in lost else 1.0 for s in K.input_labels])
    values: Matrix = np.linalg.eigvals(_closed(G, K, keep))
    return values


def _closed(G: control.StateSpace, K: control.StateSpace, keep: Matrix) -> Matrix:
    """State matrix of the loop; D of the plant is zero."""
    B_K, D_K = K.B * keep, K.D * keep
    return np.block([[G.A + G.B @ D_K @ G.C, G.B @ K.C], [B_K @ G.C, K.A]])


def reduced_order(loop: control.StateSpace, K: control.StateSpace, order: int) -> control.StateSpace:
    """Reduce K by its closed-loop Gramians where it has more than `order` states."""
    if not order >= 1:
        raise ValueError(f"controller: order is {order}, wanted at least 1")
    if K.nstates <= order:
        return K
    named = control.ss(K.A, K.B, K.C, K.D, inputs=list(loop.output_labels), outputs=list(loop.input_labels))
    return closed_loop_reduction(loop, named, order).system


def reduction_price(
    name: str,
    plant: control.StateSpace,
    full: control.StateSpace,
    K: control.StateSpace,
    norms: tuple[float, float] | None,
    effort: float,
    cap: float,
) -> dict[str, list[float | None]]:
    """Return `effort` and `norm` on the full plant, each before and after the reduction of the order.

    Raises UncertifiedDesign where one has risen by more than `cap`. A controller that does not stabilize the
    full plant before it is reduced has no price: infinite before, so that nothing is refused.
    """
    if full.nstates == K.nstates:
        before = effort
    else:
        stable = np.max(closed_loop_poles(plant, full).real) < 0.0
        before = effort_of(plant, full, ()) if stable else float("inf")
    price = {"effort": [before, effort], "norm": [before, effort] if norms is None else list(norms)}
    for what, (first, last) in price.items():
        if not last <= cap * first:
            raise UncertifiedDesign(
                f"{name}: reducing the order from {full.nstates} to {K.nstates} raises the {what} on the "
                f"full plant from {first:.4g} to {last:.4g}, allowed is {cap:g} times as much; ask for a "
                "higher order or a higher price_cap"
            )
    return {what: [v if np.isfinite(v) else None for v in pair] for what, pair in price.items()}


def on_difference(k: control.StateSpace, remote: str, local: str, actuator: str) -> control.StateSpace:
    """Return k(s) [1, -1]: a controller of the difference as one of both signals."""
    both = np.array([[1.0, -1.0]])
    return control.ss(k.A, k.B @ both, k.C, k.D @ both, inputs=[remote, local], outputs=[actuator])


def closed_norm(P: GeneralizedPlant, k: control.StateSpace) -> float:
    """Return the H-infinity norm from w to z of a generalized plant closed by u = +k y; inf if not stable."""
    A = np.block([[P.A + P.B2 @ k.D @ P.C2, P.B2 @ k.C], [k.B @ P.C2, k.A]])
    if not np.max(np.linalg.eigvals(A).real) < 0.0:
        return float("inf")
    B = np.vstack([P.B1 + P.B2 @ k.D @ P.D21, k.B @ P.D21])
    C = np.hstack([P.C1 + P.D12 @ k.D @ P.C2, P.D12 @ k.C])
    return hinf_of(A, B, C, P.D11 + P.D12 @ k.D @ P.D21).value


def effort_of(plant: control.StateSpace, K: control.StateSpace, lost: tuple[str, ...]) -> float:
    """Norm of K (I - G K)^-1 on the full plant, pu per rad/s."""
    G = select(plant, list(K.output_labels), list(K.input_labels))
    keep = np.array([0.0 if s in lost else 1.0 for s in K.input_labels])
    A = _closed(G, K, keep)
    B = np.vstack([G.B @ (K.D * keep), K.B * keep])
    C = np.hstack([(K.D * keep) @ G.C, K.C])
    return hinf_of(A, B, C, K.D * keep).value
