r"""The closed loop in the unknowns of output-feedback synthesis, one form behind every specification.

    one plant         M = [[X A + B^ C, A^], [A, A Y + B C^]]
    several plants    M_i = [[X A + B^ C_i, A^ + B^ C_i Y], [A, A Y + B C^]]
    both              N = [[X, I], [I, Y]]
                      Bw = [X B1 + B^ D21; B1],  Cz = [C1, C1 Y + D12 C^],  D = D11        (D_K = 0)

[Scherer1997], [Chilali1996]; [Sundaria2016], eq. 4.17-4.28 with theta read as the half-angle.
For several plants one of B^, Y is a number in each half-step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from interarea.models.errors import UserError

from ..lmi import regions
from ..lmi.expressions import Affine, Program, affine, bmat
from ..lmi.problem import Matrix
from .generalized_plant import GeneralizedPlant


@dataclass(frozen=True)
class PoleRegion:
    """Where closed-loop poles must lie: all of the conditions given.

    Attributes
    ----------
    damping_ratio : least damping ratio of every pole (sector of half-angle arccos zeta).
    decay_rate : poles left of -decay_rate, 1/s; None: no such condition. Keep it slower than
        the weakly controllable modes.
    radius : poles inside this circle, rad/s; None: no such condition.
    """

    damping_ratio: float = 0.0
    decay_rate: float | None = None
    radius: float | None = 300.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.damping_ratio < 1.0:
            raise UserError(f"pole region: damping_ratio is {self.damping_ratio}, allowed: 0 <= zeta < 1")
        if self.decay_rate is not None and not (self.decay_rate >= 0.0 and np.isfinite(self.decay_rate)):
            raise UserError(f"pole region: decay_rate is {self.decay_rate}, allowed: >= 0 (1/s)")
        if self.radius is not None and not self.radius > 0.0:
            raise UserError(f"pole region: radius is {self.radius}, allowed: > 0 (rad/s)")
        if self.radius is not None and self.decay_rate is not None and not self.radius > self.decay_rate:
            raise UserError(
                f"pole region: poles left of -{self.decay_rate:g} and inside radius {self.radius:g} "
                "contradict each other; raise the radius or lower the decay rate"
            )

    def outside(self, poles: Matrix, tolerance: float = 1e-6) -> Matrix:
        """Return the poles that violate a condition."""
        size = np.maximum(np.abs(poles), 1e-12)
        bad = ~(-poles.real >= (self.damping_ratio - tolerance) * size)
        bad |= ~(poles.real < 0.0)
        if self.decay_rate is not None:
            bad |= ~(poles.real <= -self.decay_rate * (1.0 - tolerance))
        if self.radius is not None:
            bad |= ~(size <= self.radius * (1.0 + tolerance))
        return poles[bad]

    @property
    def trivial(self) -> bool:
        """Whether stability is all that is asked for."""
        return self.damping_ratio == 0.0 and not self.decay_rate and self.radius is None

    def describe(self) -> str:
        """Return the conditions in words."""
        words = [f"damping ratio >= {self.damping_ratio:.4g}"]
        if self.decay_rate is not None:
            words.append(f"Re s <= -{self.decay_rate:.4g} 1/s")
        if self.radius is not None:
            words.append(f"|s| <= {self.radius:.4g} rad/s")
        return ", ".join(words)


@dataclass(frozen=True)
class Unknowns:
    """X, Y (n, n), A^ (n, n), B^ (n, p), C^ (m, n): unknowns of a program or, in a half-step, a matrix."""

    X: Affine
    Y: Affine
    Ah: Affine
    Bh: Affine
    Ch: Affine

    @classmethod
    def of(
        cls, program: Program, P: GeneralizedPlant, *, Y: Matrix | None = None, Bh: Matrix | None = None
    ) -> Unknowns:
        """Add the unknowns of a full-order controller for `P`; those given are fixed."""
        n, p, m = P.order, P.C2.shape[0], P.B2.shape[1]
        return cls(
            X=program.symmetric("X", n),
            Y=program.symmetric("Y", n) if Y is None else affine(Y),
            Ah=program.matrix("A^", n, n),
            Bh=program.matrix("B^", n, p) if Bh is None else affine(Bh),
            Ch=program.matrix("C^", m, n),
        )


@dataclass(frozen=True)
class ClosedLoop:
    """M, N, Bw, Cz, D of the docstring above."""

    M: Affine
    N: Affine
    Bw: Affine
    Cz: Affine
    D: Matrix


def closed_loop(
    P: GeneralizedPlant, u: Unknowns, *, C2: Matrix | None = None, D21: Matrix | None = None
) -> ClosedLoop:
    """Return the closed loop of `P` in the unknowns.

    With `C2` (and `D21`) given it is one of several plants that differ in what
    is measured, and A^ does not absorb ``B^ C2 Y``.
    """
    identity = np.eye(P.order)
    upper_right = u.Ah if C2 is None else u.Ah + u.Bh @ C2 @ u.Y
    C = P.C2 if C2 is None else C2
    D = P.D21 if D21 is None else D21
    return ClosedLoop(
        M=bmat([[u.X @ P.A + u.Bh @ C, upper_right], [P.A, P.A @ u.Y + P.B2 @ u.Ch]]),
        N=bmat([[u.X, identity], [identity, u.Y]]),
        Bw=bmat([[u.X @ P.B1 + u.Bh @ D], [P.B1]]),
        Cz=bmat([[P.C1, P.C1 @ u.Y + P.D12 @ u.Ch]]),
        D=P.D11,
    )


def require_region(program: Program, loop: ClosedLoop, region: PoleRegion, label: str = "") -> None:
    """Add the inequalities of a pole region; a shift or any sector alone makes the closed loop stable."""
    if region.damping_ratio > 0.0:
        program.require(f"damping ratio{label}", regions.sector(loop.M, region.damping_ratio))
    if region.decay_rate is not None:
        program.require(f"decay rate{label}", regions.shift(loop.M, loop.N, region.decay_rate))
    elif region.damping_ratio == 0.0:
        program.require(f"stability{label}", regions.shift(loop.M, loop.N, 0.0))
    if region.radius is not None:
        program.require(f"radius{label}", regions.disk(loop.M, loop.N, region.radius))
