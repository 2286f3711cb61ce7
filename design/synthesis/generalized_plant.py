r"""The plant as synthesis sees it: disturbance w and control u in, performance z and measurement y out.

.. math::
    \dot x = A x + B_1 w + B_2 u, \quad z = C_1 x + D_{11} w + D_{12} u, \quad y = C_2 x + D_{21} w

There is no direct path from u to y: the change of variables needs D22 = 0
(`loop_shift` undoes one that was taken out before).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import control
import numpy as np
import scipy.linalg

from ..linear.systems import state_space
from ..lmi.problem import Matrix


@dataclass(frozen=True)
class GeneralizedPlant:
    """Matrices of the generalized plant; checked when made. Sizes: n states, m1 w, m2 u, p1 z, p2 y."""

    A: Matrix
    B1: Matrix
    B2: Matrix
    C1: Matrix
    C2: Matrix
    D11: Matrix
    D12: Matrix
    D21: Matrix
    inputs: tuple[str, ...] = ()  #: names of u
    outputs: tuple[str, ...] = ()  #: names of y
    state_scale: Matrix | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        n, (p2, m2) = self.A.shape[0], (self.C2.shape[0], self.B2.shape[1])
        p1, m1 = self.D11.shape
        requested = {"A": (n, n), "B1": (n, m1), "B2": (n, m2), "C1": (p1, n), "C2": (p2, n)}
        requested |= {"D12": (p1, m2), "D21": (p2, m1)}
        for name, shape in requested.items():
            a = getattr(self, name)
            if a.shape != shape:
                raise ValueError(
                    f"generalized plant: {name} is {a.shape}, the other matrices require {shape}"
                )
        for name in (*requested, "D11"):
            if not np.all(np.isfinite(getattr(self, name))):
                raise ValueError(f"generalized plant: {name} has numbers that are not finite")

    @property
    def order(self) -> int:
        """Number of states."""
        return int(self.A.shape[0])

    def controller(self, A: Matrix, B: Matrix, C: Matrix) -> control.StateSpace:
        """Return the strictly proper controller of these matrices, y in and u out by their names."""
        D = np.zeros((self.B2.shape[1], self.C2.shape[0]))
        return control.ss(A, B, C, D, inputs=list(self.outputs) or None, outputs=list(self.inputs) or None)


def check_design_plant(G: control.StateSpace) -> None:
    """Refuse a plant the formulas do not hold for.

    Raises
    ------
    ValueError
        If it is no `StateSpace` in continuous time, a matrix is not finite, or D is not zero.
    """
    state_space(G, "design plant")
    if G.nstates < 1:
        raise ValueError("design plant: it has no states, no damping is possible")
    if np.any(G.D != 0.0):
        raise ValueError(
            f"design plant: D is not zero (largest {np.abs(G.D).max():.3g}), the change of variables forbids "
            "it; reduce by balanced truncation, or design on D = 0 and give K to loop_shift(K, D)"
        )


def loop_shift(K: control.StateSpace, D22: Matrix) -> control.StateSpace:
    """Return the controller for G + D22 from one designed for G: ``K (I + D22 K)^-1`` (u = +K y)."""
    E = np.linalg.inv(np.eye(K.noutputs) + K.D @ D22)  # u = C x + D (y - D22 u)
    C, D = E @ K.C, E @ K.D
    A, B = K.A - K.B @ D22 @ C, K.B - K.B @ D22 @ D
    return control.ss(A, B, C, D, inputs=K.input_labels, outputs=K.output_labels, name=K.name)


def mixed_sensitivity(
    G: control.StateSpace, W1: control.StateSpace, W2: control.StateSpace
) -> GeneralizedPlant:
    """Return the plant of ``|[W1 S; W2 K S]|`` with y = G u + w, S = (I - G K)^-1. [Sundaria2016], Fig. 3.5

    W1 acts on every measurement, W2 on every actuator (single-input
    single-output weights, repeated). States: G, W1 per output, W2 per input.
    """
    check_design_plant(G)
    n, p, m = G.nstates, G.noutputs, G.ninputs
    A1, B1, C1, D1 = _repeat(W1, p)
    A2, B2, C2, D2 = _repeat(W2, m)
    n1, n2 = A1.shape[0], A2.shape[0]
    A = scipy.linalg.block_diag(G.A, A1, A2)
    A[n : n + n1, :n] = B1 @ G.C
    return GeneralizedPlant(
        A=A,
        B1=np.vstack([np.zeros((n, p)), B1, np.zeros((n2, p))]),
        B2=np.vstack([G.B, np.zeros((n1, m)), B2]),
        C1=np.block([[D1 @ G.C, C1, np.zeros((p, n2))], [np.zeros((m, n + n1)), C2]]),
        C2=np.hstack([G.C, np.zeros((p, n1 + n2))]),
        D11=np.vstack([D1, np.zeros((m, p))]),
        D12=np.vstack([np.zeros((p, m)), D2]),
        D21=np.eye(p),
        inputs=tuple(G.input_labels),
        outputs=tuple(G.output_labels),
    )


def effort_plant(G: control.StateSpace) -> GeneralizedPlant:
    """Return the plant of the effort ``|K (I - G K)^-1|``: w added to y, z = u. [Sundaria2016], eq. 4.8"""
    check_design_plant(G)
    n, p, m = G.nstates, G.noutputs, G.ninputs
    return GeneralizedPlant(
        A=G.A,
        B1=np.zeros((n, p)),
        B2=G.B,
        C1=np.zeros((m, n)),
        C2=G.C,
        D11=np.zeros((m, p)),
        D12=np.eye(m),
        D21=np.eye(p),
        inputs=tuple(G.input_labels),
        outputs=tuple(G.output_labels),
    )


def _repeat(W: control.StateSpace, times: int) -> tuple[Matrix, Matrix, Matrix, Matrix]:
    """Block-diagonal repetition of a single-input single-output weight."""
    W = state_space(control.ss(W), "weight")
    if W.ninputs != 1 or W.noutputs != 1:
        raise ValueError(f"weight: {W.noutputs} x {W.ninputs}, wanted one input and one output")
    one = np.eye(times)
    return np.kron(one, W.A), np.kron(one, W.B), np.kron(one, W.C), np.kron(one, W.D)


def scaled(P: GeneralizedPlant, sweeps: int = 20) -> GeneralizedPlant:
    """Return the plant in well-scaled states: Osborne's method on [A B; C 0] by powers of two.

    Only the states change, so that any controller of the result is one of `P`
    and every gain stays what it was; `state_scale` holds the diagonal s of
    ``x = s * x_scaled``.
    """
    B, C = np.hstack([P.B1, P.B2]), np.vstack([P.C1, P.C2])
    s = np.ones(P.order)
    for _ in range(sweeps):
        moved = False
        for i in range(P.order):
            A = P.A * s[None, :] / s[:, None]
            row = np.sqrt(np.sum(np.delete(A[i], i) ** 2) + np.sum((B[i] / s[i]) ** 2))
            column = np.sqrt(np.sum(np.delete(A[:, i], i) ** 2) + np.sum((C[:, i] * s[i]) ** 2))
            if row > 0.0 and column > 0.0:
                factor = 2.0 ** np.round(0.5 * np.log2(row / column))
                if factor != 1.0:
                    s[i] *= factor
                    moved = True
        if not moved:
            break
    return replace(
        P,
        A=P.A * s[None, :] / s[:, None],
        B1=P.B1 / s[:, None],
        B2=P.B2 / s[:, None],
        C1=P.C1 * s[None, :],
        C2=P.C2 * s[None, :],
        state_scale=s if P.state_scale is None else P.state_scale * s,
    )


def balanced_states(P: GeneralizedPlant) -> GeneralizedPlant:
    """Return the plant in balanced coordinates of (A, [B1 B2], [C1; C2]) where A is stable, else as it is.

    Nearly uncontrollable or unobservable states would make the transformation
    singular; then the states are left and Osborne's scaling alone must do.
    """
    if not float(np.linalg.eigvals(P.A).real.max()) < 0.0:
        return P
    B, C = np.hstack([P.B1, P.B2]), np.vstack([P.C1, P.C2])
    Lc = _factor(scipy.linalg.solve_continuous_lyapunov(P.A, -B @ B.T))
    Lo = _factor(scipy.linalg.solve_continuous_lyapunov(P.A.T, -C.T @ C))
    U, hankel, Vt = np.linalg.svd(Lo.T @ Lc)
    if not hankel[-1] > 1e-8 * hankel[0]:
        return P
    T = Lc @ Vt.T / np.sqrt(hankel)  # x = T x_balanced
    Ti = (U / np.sqrt(hankel)).T @ Lo.T
    return replace(P, A=Ti @ P.A @ T, B1=Ti @ P.B1, B2=Ti @ P.B2, C1=P.C1 @ T, C2=P.C2 @ T)


def _factor(gramian: Matrix) -> Matrix:
    """Square root factor of a positive semidefinite matrix."""
    values, vectors = np.linalg.eigh((gramian + gramian.T) / 2)
    root: Matrix = vectors * np.sqrt(np.maximum(values, 0.0))
    return root
