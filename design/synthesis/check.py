"""What a synthesis returns, and the checks before (can the modes move?) and after (does the loop hold?)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import control
import numpy as np

from ..errors import InfeasibleDesign, UncertifiedDesign
from ..linear.norms import hinf_of
from ..lmi.problem import Matrix
from .generalized_plant import GeneralizedPlant, scaled
from .lmi_form import PoleRegion

#: Share of the largest modal gain below which a mode is suspected where a design fails.
WEAK_MODE = 1e-2
#: Share of the size of the matrices below which a part counts as not reached: 1e5 times their rounding.
STAIRCASE = 1e-11


@dataclass(frozen=True)
class Synthesis:
    """A controller that passed the checks on its design plant.

    Attributes
    ----------
    controller : u = +K y, inputs and outputs named as in the plant; D = 0.
    gamma : level the LMIs guarantee (None: no norm was bounded).
    norm_of : loss pattern -> the norm measured on the closed loop.
    poles_of : loss pattern -> closed-loop poles on the design plant.
    region_of : loss pattern -> pole region asked for, and met.
    solves, seconds, engine : LMI problems solved, their time, by what.
    facts : further numbers, by name.
    """

    controller: control.StateSpace
    gamma: float | None
    norm_of: Mapping[str, float]
    poles_of: Mapping[str, Matrix]
    region_of: Mapping[str, PoleRegion]
    solves: int
    seconds: float
    engine: str
    facts: Mapping[str, Any] = field(default_factory=dict)

    @property
    def damping_ratio(self) -> dict[str, float]:
        """Least damping ratio per loss pattern on the design plant."""
        return {name: float(np.min(-p.real / np.abs(p))) for name, p in self.poles_of.items()}

    @property
    def slowest_pole(self) -> float:
        """Real part of the controller's rightmost pole, 1/s."""
        return float(np.linalg.eigvals(self.controller.A).real.max())

    @property
    def fastest_pole(self) -> float:
        """Largest modulus of the controller's poles, rad/s."""
        return float(np.abs(np.linalg.eigvals(self.controller.A)).max())


def modal_shares(A: Matrix, B: Matrix, C: Matrix) -> tuple[Matrix, Matrix]:
    r"""Return the eigenvalues and, for each, controllability times observability as a share of the largest.

    The measure is the modal gain :math:`|C v_k| |w_k^H B| / (|w_k^H v_k| |\mathrm{Re} \lambda_k|)`, which
    does not depend on coordinates; a decay below 1e-6 of the largest eigenvalue counts as that. It ranks
    modes and does not tell whether one is fixed: `out_of_reach` does.
    """
    values, V = np.linalg.eig(A)
    W = np.linalg.pinv(V)  # of a defective eigenvalue V is singular
    gain = np.linalg.norm(C @ V, axis=0) * np.linalg.norm(W @ B, axis=1)
    size = np.abs(values)
    decay = np.maximum(np.abs(values.real), 1e-3 * np.maximum(size, 1e-3 * max(float(size.max()), 1e-300)))
    gain = gain / decay
    return values, gain / max(float(gain.max()), 1e-300)


def modal_parts(A: Matrix, B: Matrix, C: Matrix, mode: complex) -> tuple[float, float]:
    r"""Return the controllability and observability of an eigenvalue of A: 0 if it is fixed.

    :math:`\sigma_{min}[A - \lambda I, B]` and :math:`\sigma_{min}[A - \lambda I; C]` as shares of the size
    of A, in balanced states, B and C brought to the size of A: the test of Popov, Belevitch and Hautus as a
    distance. It holds for repeated and defective eigenvalues and for integrators too. [Zhou1996], section 3.3
    """
    for _ in range(2):  # states to the size of inputs and outputs, these to the size of A
        size = max(float(np.linalg.norm(A, 2)), abs(mode), 1e-300)
        B, C = (M * (size / max(float(np.linalg.norm(M, 2)), 1e-300)) for M in (B, C))
        A, B, C = _balanced(A, B, C)
    size = max(float(np.linalg.norm(A, 2)), abs(mode), 1e-300)
    shifted = A / size - mode / size * np.eye(A.shape[0])

    def least(M: Matrix, parts: Callable[[list[Matrix]], Matrix]) -> float:
        largest = float(np.linalg.norm(M, 2))
        if not largest > 0.0:
            return float(np.linalg.svd(shifted, compute_uv=False)[-1])
        return float(np.linalg.svd(parts([shifted, M / largest]), compute_uv=False)[-1])

    return least(B, np.hstack), least(C, np.vstack)


def _balanced(A: Matrix, B: Matrix, C: Matrix) -> tuple[Matrix, Matrix, Matrix]:
    """Return the matrices in the states of Osborne's method on [A B; C 0]."""
    (n, m), p = B.shape, C.shape[0]
    P = scaled(
        GeneralizedPlant(
            *(A, np.zeros((n, 0)), B, np.zeros((0, n)), C),
            *(np.zeros((0, 0)), np.zeros((0, m)), np.zeros((p, 0))),
        )
    )
    return P.A, P.B2, P.C2


def fixed_modes(A: Matrix, B: Matrix, C: Matrix) -> Matrix:
    """Return the eigenvalues of A that no feedback from the outputs to the inputs moves.

    Those of the parts that inputs do not reach and outputs do not show, split off by orthogonal staircases: a
    fixed eigenvalue that is repeated elsewhere in A is found as well. [Zhou1996], section 3.3
    """
    size = max(float(np.linalg.norm(A, 2)), 1e-300)
    B, C = (M * (size / max(float(np.linalg.norm(M, 2)), 1e-300)) for M in (B, C))
    A, B, C = _balanced(A, B, C)
    return np.concatenate([_not_reached(A, B), _not_reached(A.T, C.T)])


def _not_reached(A: Matrix, B: Matrix) -> Matrix:
    """Return the eigenvalues of the part of A that B does not reach."""
    limit = STAIRCASE * max(float(np.linalg.norm(A, 2)), float(np.linalg.norm(B, 2)))
    while A.size:
        U, s, _ = np.linalg.svd(B)
        rank = int(np.count_nonzero(s > limit))
        if rank == 0:
            return np.linalg.eigvals(A)
        A = U.T @ A @ U
        A, B = A[rank:, rank:], A[rank:, :rank]
    return np.zeros(0)


def out_of_reach(A: Matrix, B: Matrix, C: Matrix, mode: complex) -> bool:
    """Whether no feedback from the outputs to the inputs moves an eigenvalue of A."""
    near = 1e-6 * max(abs(mode), 1e-3 * float(np.linalg.norm(A, 2)))
    return bool(np.any(np.abs(fixed_modes(A, B, C) - mode) <= near))


def describe_reach(A: Matrix, B: Matrix, C: Matrix, mode: complex) -> str:
    """Return the controllability and observability of an eigenvalue of A in words."""
    reach, seen = modal_parts(A, B, C, mode)
    message = f"controllability {reach:.1e}, observability {seen:.1e} of the size of A"
    return message + ("; it is unstable and cannot be stabilised" if not mode.real < 0.0 else "")


def require_reachable(
    A: Matrix, B: Matrix, C: Matrix, region: PoleRegion, what: str
) -> list[tuple[complex, float]]:
    """Return the open-loop modes outside `region` that are weakly reached: (eigenvalue, share).

    Raises
    ------
    InfeasibleDesign
        If one cannot be moved at all.
    """
    values, shares = modal_shares(A, B, C)
    outside = set(region.outside(values).tolist())
    rows = [(v, s) for v, s in zip(values, shares, strict=True) if v in outside and v.imag >= 0.0]
    fixed = fixed_modes(A, B, C)
    zero = -1e-9 * float(np.abs(values).max(initial=0.0))  # an eigenvalue at 0, but for rounding
    staying = [v for v in fixed if v.imag >= 0.0 and (v.real > zero or region.outside(np.array([v])).size)]
    if staying:
        v = complex(max(staying, key=lambda v: v.real))
        zeta = -v.real / max(abs(v), 1e-300)
        raise InfeasibleDesign(
            f"{what}: mode {describe_mode(v)} lies outside the region ({region.describe()}) and cannot be "
            f"moved: {describe_reach(A, B, C, v)}; the region must contain it (damping ratio <= {zeta:.4f}, "
            f"decay rate <= {-v.real:.4g} 1/s, radius >= {abs(v):.4g} rad/s), or choose another actuator or "
            "signal",
            constraint="controllability",
            asked=region.damping_ratio,
            reachable=max(zeta, 0.0) if zeta < region.damping_ratio else region.damping_ratio,
        )
    return [(complex(v), float(s)) for v, s in rows if s < WEAK_MODE]


def first_certified(
    slacks: Iterable[float], attempt: Callable[[float], Synthesis | None]
) -> Synthesis | None:
    """Return what `attempt` gives at the first slack of gamma where there is something and it passes.

    None where there is nothing at any slack.

    Raises
    ------
    UncertifiedDesign : of the first slack whose closed loop contradicts its level, if no later one passes.
    """
    refusal: UncertifiedDesign | None = None
    for slack in slacks:
        try:
            result = attempt(slack)
        except UncertifiedDesign as error:
            refusal = refusal or error
            continue
        if result is not None:
            return result
    if refusal is not None:
        raise refusal
    return None


def from_slack(first: float | None, ladder: Sequence[float]) -> Sequence[float]:
    """Return the slacks to try: those of `ladder`, or the given one and the larger ones.

    >>> from_slack(None, (1e-3, 1e-2)), from_slack(5e-3, (1e-3, 1e-2))
    ((0.001, 0.01), (0.005, 0.01))
    """
    return ladder if first is None else (first, *(x for x in ladder if x > first))


def describe_mode(value: complex) -> str:
    """Return an eigenvalue as frequency and damping ratio."""
    if value.imag == 0.0:
        return f"at {value.real:.4g} 1/s (real)"
    zeta = -value.real / abs(value)
    return f"at {abs(value.imag) / (2.0 * np.pi):.4f} Hz (damping ratio {zeta:.4f})"


def weak_words(weak: list[tuple[complex, float]]) -> str:
    """Return the weakly reached modes as the tail of a message."""
    if not weak:
        return ""
    modes = "; ".join(f"{describe_mode(v)}, reached {s:.1e} of the strongest" for v, s in weak[:3])
    return f"; suspect: mode {modes}"


def largest_feasible(
    feasible: Callable[[float], bool], low: float, high: float, steps: int = 10
) -> float | None:
    """Return the largest value in [low, high) found feasible by bisection, None if `low` is not."""
    if not feasible(low):
        return None
    for _ in range(steps):
        middle = 0.5 * (low + high)
        if feasible(middle):
            low = middle
        else:
            high = middle
    return low


def closed_loop_matrices(
    P: GeneralizedPlant, K: tuple[Matrix, Matrix, Matrix], C2: Matrix, D21: Matrix
) -> tuple[Matrix, Matrix, Matrix, Matrix]:
    """Return A, B, C, D from w to z of `P` measured through C2, D21 and closed by u = +K y (D_K = 0)."""
    A_K, B_K, C_K = K
    A = np.block([[P.A, P.B2 @ C_K], [B_K @ C2, A_K]])
    B = np.vstack([P.B1, B_K @ D21])
    C = np.hstack([P.C1, P.D12 @ C_K])
    return A, B, C, P.D11


def checked(
    P: GeneralizedPlant,
    K: tuple[Matrix, Matrix, Matrix],
    pattern_of: Mapping[str, tuple[Matrix, Matrix]],
    region_of: Mapping[str, PoleRegion],
    gamma: float | None,
    *,
    tolerance: float = 1e-3,
    what: str,
) -> tuple[dict[str, Matrix], dict[str, float]]:
    """Close the loop for every loss pattern and return its poles and norms.

    Raises
    ------
    UncertifiedDesign
        If a pole lies outside its region or a norm above gamma, beyond `tolerance` (relative).
    """
    poles_of: dict[str, Matrix] = {}
    norm_of: dict[str, float] = {}
    for name, (C2, D21) in pattern_of.items():
        A, B, C, D = closed_loop_matrices(P, K, C2, D21)
        if not np.all(np.isfinite(A)):
            raise UncertifiedDesign(f"{what}: the recovered controller has numbers that are not finite")
        poles = np.linalg.eigvals(A)
        bad = region_of[name].outside(poles, tolerance)
        if bad.size:
            worst = bad[np.argmax(bad.real)]
            raise UncertifiedDesign(
                f"{what}, {name}: closed-loop pole {describe_mode(complex(worst))} lies outside the region "
                f"the solver claims ({region_of[name].describe()}); loosen the region or the conditioning"
            )
        poles_of[name] = poles
        norm_of[name] = hinf_of(A, B, C, D, tolerance=1e-7).value
        if gamma is not None and not norm_of[name] <= gamma * (1.0 + tolerance):
            raise UncertifiedDesign(
                f"{what}, {name}: the closed loop has norm {norm_of[name]:.6g}, the solver claims {gamma:.6g}"
            )
    return poles_of, norm_of
