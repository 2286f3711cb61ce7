r"""Stability of a bank of controllers for every sequence of losses and returns.

With the supervisor of `models/c/controller/supervisor.c` the loop is at every instant a convex combination of
the loops :math:`A_v` in which one member is active and some set of signals arrives: weights and trust fade
with one time constant towards the same corners. One :math:`P > 0` with

.. math:: A_v^T P + P A_v \le -2 \alpha P \quad \text{for every } v

therefore proves the decay rate :math:`\alpha` for every sequence, as fast as it likes, and through every
fade. Between the loss of a signal and its detection the old member runs without it: these loops are among
the :math:`A_v`. Where no such P exists, a dwell time is proven from one Lyapunov function per set of
signals [Geromel2006]. Rounding is bounded, the solver is not believed: `proven_decay` recomputes the rate
from P.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import control
import numpy as np
from scipy.linalg import block_diag, expm, solve_continuous_lyapunov

from interarea.models.threads import one_blas_thread

from ..controllers.bank import ControllerBank
from ..errors import UncertifiedDesign
from ..linear.linearise import select
from ..lmi.expressions import Program
from ..lmi.problem import Matrix
from ..lmi.solve import solve
from ..reduction.balanced import balanced_truncation

#: time constants after which a fade is over: what is left, 1e-11, is below the margin of the certificate
FADE_OVER = 25.0


@dataclass(frozen=True)
class SwitchingCertificate:
    """What was proven for arbitrary sequences of losses and returns on the full linear plant.

    Attributes
    ----------
    kind : "common Lyapunov function" or "dwell time".
    decay_rate : proven for every sequence (common Lyapunov function); 0 for a dwell time. 1/s
    slowest : rightmost pole of the slowest loop: no proof can reach more. 1/s, positive
    dwell_s : least time between two changes for which stability is proven; 0 = none is needed.
    loops : the loops, "active member: signals that arrive".
    condition_number : of P in units in which its diagonal is 1.
    """

    kind: str
    decay_rate: float
    slowest: float
    dwell_s: float
    loops: tuple[str, ...]
    condition_number: float

    @classmethod
    def of_common(cls, loops: Mapping[str, Matrix], P: Matrix, rate: float) -> SwitchingCertificate:
        """Return the certificate of a common Lyapunov function with its proven decay rate."""
        slowest = -max(float(np.linalg.eigvals(A).real.max()) for A in loops.values())
        return cls("common Lyapunov function", rate, slowest, 0.0, tuple(loops), _condition(P))

    def as_dict(self) -> dict[str, Any]:
        """Return the record as JSON values."""
        return {
            "kind": self.kind,
            "decay_rate": self.decay_rate,
            "slowest": self.slowest,
            "dwell_s": self.dwell_s,
            "loops": list(self.loops),
            "condition_number": self.condition_number,
        }


class BankLoop:
    """Closed loop of a plant with a bank: `matrix(member, signals)`; states of the plant come first.

    plant : without reference angle, outputs as the signals of the bank (rad/s), inputs as its actuators (pu).
    """

    def __init__(self, plant: control.StateSpace, bank: ControllerBank) -> None:
        G = select(plant, list(bank.outputs), list(bank.inputs))
        if np.any(G.D):
            raise ValueError(
                f"bank {bank.name}: the plant has a direct feedthrough; a strictly proper one is needed"
            )
        self.bank, self.members = bank, bank.matrices()
        self.A, self.B, self.C = (np.asarray(M, dtype=float) for M in (G.A, G.B, G.C))
        for name, (A, *_) in self.members.items():
            if A.size and not np.linalg.eigvals(A).real.max() < 0.0:
                raise ValueError(
                    f"bank {bank.name}: {name} is not stable by itself; in standby its states would grow "
                    f"without bound"
                )

        self.parts = [_balancing(self.A, self.B, self.C)]
        self.parts += [_balancing(A, B, C) for A, B, C, _ in self.members.values()]
        self.order = sum(map(len, self.parts))  #: states of the plant and of all members

    def mixed(self, weights: Mapping[str, float], trust: Matrix) -> Matrix:
        """Return the loop for weights of the members and of the signals."""
        A_K = block_diag(*(K[0] for K in self.members.values()))
        B_K = np.vstack([K[1] for K in self.members.values()]) * trust
        C_K = np.hstack([weights.get(name, 0.0) * K[2] for name, K in self.members.items()])
        D_K = sum(weights.get(name, 0.0) * K[3] for name, K in self.members.items()) * trust
        return np.block([[self.A + self.B @ D_K @ self.C, self.B @ C_K], [B_K @ self.C, A_K]])

    def matrix(self, member: str, signals: tuple[str, ...]) -> Matrix:
        """Return the loop in which `member` is active and `signals` arrive."""
        return self.mixed({member: 1.0}, self.trust(signals))

    def trust(self, signals: tuple[str, ...]) -> Matrix:
        """Return 1 for each signal of the bank that is in `signals`, else 0."""
        return np.array([1.0 if s in signals else 0.0 for s in self.bank.inputs])

    def corners(self) -> dict[str, Matrix]:
        """Return "active member: signals" -> loop, losses that the supervisor does not know yet included."""
        result = {}
        for trusted in self.bank.signal_sets():
            member = self.bank.active(trusted)
            for arriving in self.bank.signal_sets():
                if set(arriving) <= set(trusted):
                    result[f"{member}: {' '.join(arriving) or 'none'}"] = self.matrix(member, arriving)
        return result


def proven_decay(loops: Mapping[str, Matrix], P: Matrix) -> float:
    """Return the decay rate (1/s) that `P` proves for every convex combination of loops.

    A bound of the rounding is taken off. Negative or NaN: P proves nothing.
    """
    if not np.all(np.isfinite(P)) or not np.all(np.diag(P) > 0.0):
        return float("nan")
    unit = np.sqrt(np.diag(P))  # states in units in which V is 1: condition numbers mean something
    try:
        L = np.linalg.cholesky(0.5 * (P + P.T) / np.outer(unit, unit))
    except np.linalg.LinAlgError:
        return float("nan")
    rates = []
    for physical in loops.values():
        A = physical * unit[:, None] / unit[None, :]
        # x' = A x in coordinates z = L^T x, in which V is |z|^2
        M = np.linalg.solve(L, (A.T @ L)).T
        size, eps = float(np.linalg.norm(A, 2)), float(np.finfo(float).eps)
        rounding = 4.0 * len(A) * eps * size * float(np.linalg.cond(L))
        rates.append(-float(np.linalg.eigvalsh(0.5 * (M + M.T)).max()) - rounding)
    return min(rates)


def common_lyapunov(
    loops: Mapping[str, Matrix], rate: float, parts: list[Matrix] | None = None
) -> Matrix | None:
    """Return P > 0 with A^T P + P A <= -2 rate P for all loops, of least condition; None if there is none.

    parts : for the numerics, coordinates of the plant and of each member (`BankLoop.parts`).
    """
    names, matrices = list(loops), list(loops.values())
    n = len(matrices[0])
    T = _coordinates(matrices, parts or [np.eye(n)])
    T_inverse = np.linalg.inv(T)
    program = Program()
    P, bound = program.symmetric("P", n), program.scalar("bound")
    program.require("P >= 1", P - np.eye(n))
    program.require("P <= bound", bound * np.eye(n) - P)
    for name, A in zip(names, matrices, strict=True):
        M = T @ A @ T_inverse
        product = P @ M
        program.require(name, -1.0 * (product + product.T + 2.0 * rate * P))
    program.minimise(bound)
    with one_blas_thread():
        result = solve(program.problem())
    if "P" not in result.values or not result.status.endswith("optimal"):
        return None
    return np.asarray(T.T @ result.values["P"] @ T)


def switching_certificate(
    plant: control.StateSpace, bank: ControllerBank, *, search_order: int = 14
) -> tuple[SwitchingCertificate, Matrix | None]:
    """Prove the bank on the full plant for every sequence of losses and returns; return the proof and P.

    The rate is sought on a balanced truncation of order `search_order`, then proven on the full plant.

    Raises
    ------
    UncertifiedDesign : a loop is unstable, so that nothing can be proven; the message names it.
    """
    loop = BankLoop(plant, bank)
    corners = loop.corners()
    abscissa = {name: float(np.linalg.eigvals(A).real.max()) for name, A in corners.items()}
    worst = max(abscissa, key=abscissa.__getitem__)
    if not abscissa[worst] < 0.0:
        raise UncertifiedDesign(
            f"bank {bank.name}: the loop {worst!r} (active member: signals that arrive) has the pole "
            f"{abscissa[worst]:.4g} 1/s; use members with less gain, or add a member for that set of signals"
        )
    slowest = -abscissa[worst]
    rate = _reachable_rate(plant, bank, slowest, search_order)
    shares = () if rate is None else (0.9 * rate, 0.5 * rate, 0.1 * rate)
    for sought in shares:
        P = common_lyapunov(corners, sought, loop.parts)
        proven = float("nan") if P is None else proven_decay(corners, P)
        if P is not None and proven > 0.0:
            return SwitchingCertificate.of_common(corners, P, proven), P
    return SwitchingCertificate(
        "dwell time", 0.0, slowest, dwell_time(loop), tuple(corners), float("nan")
    ), None


def dwell_time(loop: BankLoop, *, longest_s: float = 200.0) -> float:
    """Return a time (s): changes of the set of trusted signals at least that far apart are proven stable.

    Each set i of signals has V_i = x^T P_i x with A_i^T P_i + P_i A_i < 0; the fade into i lasts t_f and
    stretches V by at most g; after the dwell tau the next V_j must be below V_i: the answer is t_f + tau.

    Raises
    ------
    UncertifiedDesign : more than `longest_s` would be needed.
    """
    sets = loop.bank.signal_sets()
    A = {s: loop.matrix(loop.bank.active(s), s) for s in sets}
    T = _coordinates(list(A.values()), loop.parts)
    inverse = np.linalg.inv(T)
    moved = {s: T @ M @ inverse for s, M in A.items()}
    eye = np.eye(len(T))
    root = {s: np.linalg.cholesky(solve_continuous_lyapunov(M.T, -eye)).T for s, M in moved.items()}
    back = {s: np.linalg.inv(R) for s, R in root.items()}
    stretch: dict[tuple[str, ...], float] = dict.fromkeys(sets, 1.0)
    if loop.bank.fade_s > 0.0:
        for i in sets:
            stretch[i] = max(
                float(np.linalg.norm(root[i] @ T @ _fade(loop, k, i) @ inverse @ back[i], 2))
                for k in sets
                if k != i
            )

    def holds(tau: float) -> bool:
        for i in sets:
            flow = expm(moved[i] * tau) @ back[i]
            if any(not stretch[i] * np.linalg.norm(root[j] @ flow, 2) < 1.0 for j in sets if j != i):
                return False
        return True

    high = 0.125
    while not holds(high):
        high *= 2.0
        if high > longest_s:
            raise UncertifiedDesign(
                f"bank {loop.bank.name}: no dwell time up to {longest_s:g} s can be proven"
            )
    low = 0.5 * high
    for _ in range(6):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if holds(middle) else (middle, high)
    return high + (FADE_OVER * loop.bank.fade_s)


def _fade(loop: BankLoop, start: tuple[str, ...], end: tuple[str, ...], steps: int = 250) -> Matrix:
    """Transition matrix of the fade from one set of signals to another, by the exponential midpoint rule."""
    members = loop.bank.active(start), loop.bank.active(end)
    trust = loop.trust(start), loop.trust(end)
    h = FADE_OVER / steps
    total = np.eye(loop.order)
    for k in range(steps):
        old = float(np.exp(-(k + 0.5) * h))
        weights = dict.fromkeys(members, 0.0)
        weights[members[0]] += old
        weights[members[1]] += 1.0 - old
        mixed = loop.mixed(weights, old * trust[0] + (1.0 - old) * trust[1])
        total = expm(mixed * (h * loop.bank.fade_s)) @ total
    return total


def _reachable_rate(
    plant: control.StateSpace, bank: ControllerBank, slowest: float, order: int
) -> float | None:
    """Largest rate with a common P on the truncated plant, to 1/16 of the slowest pole; None if none is."""
    G = select(plant, list(bank.outputs), list(bank.inputs))
    small = balanced_truncation(G, order).system if order < G.nstates else G
    loop = BankLoop(small, bank)
    corners = loop.corners()

    def works(rate: float) -> bool:
        P = common_lyapunov(corners, rate, loop.parts)
        return P is not None and proven_decay(corners, P) > 0.0

    # at rate 0 the least-conditioned P touches the bound and proves nothing
    low, high = 0.01 * slowest, slowest
    if not works(low):
        return None
    for _ in range(4):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if works(middle) else (low, middle)
    return low


def _coordinates(loops: list[Matrix], parts: list[Matrix]) -> Matrix:
    """T of coordinates z = T x in which the loops have similar size: parts balanced, then one mean V."""
    T = block_diag(*parts)
    inverse = np.linalg.inv(T)
    eye = np.eye(len(T))
    P = np.sum([solve_continuous_lyapunov((T @ A @ inverse).T, -eye) for A in loops], axis=0)
    return np.asarray(np.linalg.cholesky(0.5 * (P + P.T)).T @ T)


def _balancing(A: Matrix, B: Matrix, C: Matrix) -> Matrix:
    """T of balanced coordinates z = T x; a floor under both Gramians keeps states that hardly count."""
    n = len(A)
    if n == 0:
        return np.zeros((0, 0))
    floor = 1e-5 * np.eye(n)
    W_c = solve_continuous_lyapunov(A, -(B @ B.T) - float(np.sum(B * B)) * floor)
    W_o = solve_continuous_lyapunov(A.T, -(C.T @ C) - float(np.sum(C * C)) * floor)
    L_c, L_o = np.linalg.cholesky(W_c), np.linalg.cholesky(W_o)
    U, s, _ = np.linalg.svd(L_o.T @ L_c)
    return np.asarray((U / np.sqrt(s)).T @ L_o.T)


def _condition(P: Matrix) -> float:
    """Condition number of P in units in which its diagonal is 1."""
    unit = np.sqrt(np.diag(P))
    return float(np.linalg.cond(P / np.outer(unit, unit)))
