r"""Passive fault-tolerant synthesis by the iteration as printed: least angle. [Sundaria2016], 4.3.1

Step (i) fixes B^ = 0, (ii) finds the smallest half-angle theta that all loss patterns allow, its Y is fixed
and (iv) finds the smallest again, now with B^ free; then B^ is fixed, and so on until a half-step lowers
theta by no more than 1e-3 rad (eq. 4.29). Nothing bounds effort or poles. `fault_tolerant` is the one to use:
it takes targets and spends what is left on low effort; this one is here so that both can be compared.

Only one thing is added to the print: X, Y <= `bound` I, without which the set of solutions is not bounded and
an interior-point method need not end.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass

import control
import numpy as np

from ..errors import InfeasibleDesign, UncertifiedDesign
from ..lmi import regions
from ..lmi.expressions import Program, linear
from ..lmi.problem import Matrix, Problem
from ..lmi.recover import recover
from ..lmi.solve import solve, usable
from .check import Synthesis, checked
from .fault_tolerant import loss_patterns
from .generalized_plant import GeneralizedPlant, balanced_states, effort_plant, scaled
from .lmi_form import PoleRegion, Unknowns, closed_loop

#: of the sector's inequality, so that the accepted point is strictly inside; the most asked of a trial
_MARGIN = 1e-3
#: part of the damping ratio that is asked of the recovered loop: near theta = 0 rounding alone costs more
_SLACK = 0.98


@dataclass(frozen=True)
class _Step:
    """A half-step: its half-angle (rad) and the unknowns there."""

    theta: float
    values: Mapping[str, Matrix]


def printed_iteration(
    G: control.StateSpace,
    loss_of: Mapping[str, tuple[str, ...]],
    *,
    tolerance: float = 1e-3,
    half_steps: int = 20,
    bound: float = 1e5,
    engine: str = "structured",
) -> Synthesis:
    """Find one controller whose sector is as narrow as the printed iteration makes it, for all loss patterns.

    Parameters
    ----------
    G : design plant, D = 0, outputs named; speeds in rad/s.
    loss_of : loss pattern -> names of the outputs lost, beside "normal".
    tolerance : eq. 4.29, rad. half_steps : most of them. bound : of X and Y.

    Returns
    -------
    Synthesis
        ``facts["theta_rad"]`` holds the half-angle of each half-step, ``facts["stopped"]`` why it ended.

    Raises
    ------
    InfeasibleDesign, UncertifiedDesign, ValueError
    """
    what = "printed iteration"
    started = time.perf_counter()
    P = scaled(balanced_states(effort_plant(G)))
    patterns = loss_patterns(P, dict.fromkeys(("normal", *loss_of), 0.0), loss_of)
    search = _Search(P, patterns, bound, tolerance, engine)
    values = np.linalg.eigvals(P.A)
    start = math.acos(float(np.clip(np.min(-values.real / np.abs(values)), -1.0, 1.0)))
    step = search.narrowest({"Bh": np.zeros((P.order, P.C2.shape[0]))}, start + 2.0 * tolerance)
    if step is None:
        raise InfeasibleDesign(
            f"{what}: step (i) finds no point at the open loop's half-angle {start:.4f} rad; the plant must "
            "be stable",
            constraint="stability",
        )
    thetas, stopped = [step.theta], f"{half_steps} half-steps"
    for k in range(1, half_steps):
        fixed = {"Y": step.values["Y"]} if k % 2 else {"Bh": step.values["B^"]}
        following = search.narrowest(fixed, step.theta)
        lowered = 0.0 if following is None else step.theta - following.theta
        step = step if following is None else following
        thetas.append(step.theta)
        if lowered <= tolerance:
            stopped = f"a half-step lowered the angle by no more than {tolerance:g} rad (eq. 4.29)"
            break
    v = step.values
    try:
        K = recover(P.A, P.B2, None, v["X"], v["Y"], v["A^"], v["B^"], v["C^"])
    except ValueError as error:
        raise UncertifiedDesign(f"{what}: {error}") from error
    region_of = dict.fromkeys(patterns, PoleRegion(_SLACK * math.cos(step.theta), None, None))
    poles_of, norm_of = checked(P, K, patterns, region_of, None, what=what)
    return Synthesis(
        controller=P.controller(*K),
        gamma=max(norm_of.values()),
        norm_of=norm_of,
        poles_of=poles_of,
        region_of=region_of,
        solves=search.solves,
        seconds=time.perf_counter() - started,
        engine=engine,
        facts={"theta_rad": tuple(thetas), "stopped": stopped},
    )


class _Search:
    """The search for the smallest half-angle with Y or B^ fixed; counts its LMIs."""

    def __init__(
        self,
        P: GeneralizedPlant,
        patterns: Mapping[str, tuple[Matrix, Matrix]],
        bound: float,
        tolerance: float,
        engine: str,
    ) -> None:
        self.P, self.patterns, self.engine = P, patterns, engine
        self.bound, self.tolerance = bound, tolerance
        self.solves = 0

    def narrowest(self, fixed: Mapping[str, Matrix], widest: float) -> _Step | None:
        """Return the smallest feasible half-angle up to `widest`, to the tolerance; None: not even that."""
        best = self._at(widest, fixed)
        if best is None:
            return None
        if widest <= self.tolerance:
            return best
        nearer = self._at(widest - self.tolerance, fixed)  # most half-steps end here
        if nearer is None:
            return best
        best, low = nearer, 0.0
        while best.theta - low > self.tolerance:
            middle = self._at(0.5 * (low + best.theta), fixed)
            if middle is None:
                low = 0.5 * (low + best.theta)
            else:
                best = middle
        return best

    def _at(self, theta: float, fixed: Mapping[str, Matrix]) -> _Step | None:
        """Return the point deepest inside at a half-angle, None where none is strictly inside."""
        self.solves += 1
        problem = self.problem(theta, fixed)
        solution = solve(problem, self.engine)
        if not usable(problem, solution) or not solution.scalars["margin"] > 0.0:
            return None
        provided = {"Y": fixed["Y"]} if "Y" in fixed else {"B^": fixed["Bh"]}
        return _Step(theta, {**solution.values, **provided})

    def problem(self, theta: float, fixed: Mapping[str, Matrix]) -> Problem:
        """Return eq. 4.25 and 4.26 for every pattern at one half-angle; the largest margin up to a cap."""
        P = self.P
        program = Program()
        u = Unknowns.of(program, P, Y=fixed.get("Y"), Bh=fixed.get("Bh"))
        margin = program.scalar("margin")
        program.require("margin <= cap", _MARGIN * np.eye(1) - margin * np.eye(1))
        program.require("X <= bound", self.bound * np.eye(P.order) - u.X)
        if "Y" not in fixed:
            program.require("Y <= bound", self.bound * np.eye(P.order) - u.Y)
        for k, (name, (C2, D21)) in enumerate(self.patterns.items()):
            loop = closed_loop(P, u, C2=C2, D21=D21)
            if k == 0:
                program.require("Lyapunov matrix", loop.N)
            sector = regions.sector(loop.M, math.cos(theta))
            program.require(f"damping ratio, {name}", sector - margin * np.eye(2 * P.order))
        program.minimise(linear(margin) * -1.0)
        return program.problem()
