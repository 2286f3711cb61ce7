r"""Output-feedback synthesis by LMIs: `wide_area_damping`, `conventional`, `fault_tolerant`.

All return controllers u = +K y of the order of their design plant with D_K = 0,
recovered, closed and checked (`Synthesis`); none trusts the solver's status.

Conditioning. The bare minimum of gamma has controllers with poles of 1e4 rad/s.
Every problem therefore minimises ``gamma + eps trace(X + Y) / n``, keeps the
poles inside a disk, and, where asked or needed, solves a second time at a slightly
larger gamma for well-conditioned X, Y. Where no pole region is asked for, the two
Riccati equations give the optimum without a solver (`riccati.without_region`).
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import control
import numpy as np

from ..errors import InfeasibleDesign, SolverError, UncertifiedDesign
from ..lmi import regions
from ..lmi.expressions import Program, bmat, linear, trace
from ..lmi.problem import Matrix, Problem, Solution
from ..lmi.recover import recover
from ..lmi.solve import infeasibility, solve, usable
from .check import (
    Synthesis,
    checked,
    first_certified,
    from_slack,
    largest_feasible,
    require_reachable,
    weak_words,
)
from .fault_tolerant import fault_tolerant
from .generalized_plant import GeneralizedPlant, balanced_states, effort_plant, mixed_sensitivity, scaled
from .lmi_form import PoleRegion, Unknowns, closed_loop, require_region
from .riccati import without_region

__all__ = [
    "Conditioning",
    "PoleRegion",
    "Synthesis",
    "conventional",
    "fault_tolerant",
    "hinf_region",
    "wide_area_damping",
]


#: Slacks of gamma tried in turn where the controller at a smaller one cannot be recovered and certified.
_SLACKS = (1e-3, 1e-2, 0.05, 0.2)
_FIRST_WEIGHT, _MOST_WEIGHTS, _SHARE = 1e-3, 4, 1e-4  # of the trace: first, how many, wanted beside gamma


@dataclass(frozen=True)
class Conditioning:
    """How well-conditioned a controller is preferred to the last digit of gamma.

    Attributes
    ----------
    trace_weight : eps in ``gamma + eps trace(X + Y) / n``; None: so small that the second term is at most
        2e-4 of the first, which is then that near to the optimum.
    gamma_slack : None: the first solution is used, and a second solve (`conditioned_problem`) only
        where its controller does not pass the check. r: the second solve at (1 + r) times the optimum.
    """

    trace_weight: float | None = None
    gamma_slack: float | None = None


def wide_area_damping(
    G: control.StateSpace,
    region: PoleRegion,
    *,
    weights: tuple[control.StateSpace, control.StateSpace],
    gamma_cap: float | None = 10.0,
    conditioning: Conditioning | None = None,
    engine: str = "structured",
) -> Synthesis:
    r"""H-infinity mixed sensitivity with a pole region. [Sundaria2016], chapter 3

    .. math:: \min_K \left\| \begin{bmatrix} W_1 S \\ W_2 K S \end{bmatrix} \right\|_\infty,
              \quad S = (I - G K)^{-1}, \quad \text{poles in the region}

    A speed difference has G(0) = 0, hence S(0) = 1 and no K brings the norm
    below \|W1(0)\|: with the thesis's weights gamma < 1 is infeasible, K = 0
    already reaches 1, and the damping comes from the region. gamma is
    reported as it is.

    Parameters
    ----------
    G : design plant, D = 0; speeds in rad/s. Reduced: the controller gets the order of G plus weights.
    region : where the closed-loop poles must lie.
    weights : W1, W2, single-input single-output.
    gamma_cap : largest acceptable norm; None: any.
    conditioning, engine : see `Conditioning`, `solve`.

    Raises
    ------
    InfeasibleDesign, UncertifiedDesign, ValueError
    """
    P = mixed_sensitivity(G, *weights)
    return hinf_region(
        P, region, gamma_cap=gamma_cap, conditioning=conditioning, engine=engine, what="wide-area damping"
    )


def conventional(
    G: control.StateSpace,
    region: PoleRegion,
    *,
    effort_cap: float | None = None,
    conditioning: Conditioning | None = None,
    engine: str = "structured",
) -> Synthesis:
    r"""Least effort with a pole region: min \|K (I - G K)^-1\|. [Sundaria2016], section 4.2.1

    Parameters
    ----------
    G : design plant, D = 0; outputs e.g. ``G2_dw``, ``G4_dw`` in rad/s. The weights of the thesis's
        eq. 5.1 are inert here and left out.
    region : where the closed-loop poles must lie with every signal there.
    effort_cap : largest acceptable effort (unit of u per unit of y); None: any.

    Raises
    ------
    InfeasibleDesign, UncertifiedDesign, ValueError
    """
    return hinf_region(
        effort_plant(G),
        region,
        gamma_cap=effort_cap,
        conditioning=conditioning,
        engine=engine,
        what="conventional control",
    )


def hinf_region(
    P: GeneralizedPlant,
    region: PoleRegion,
    *,
    gamma_cap: float | None = None,
    conditioning: Conditioning | None = None,
    engine: str = "structured",
    what: str = "H-infinity design",
) -> Synthesis:
    """Minimise the norm from w to z of any generalized plant with poles in a region.

    Raises
    ------
    InfeasibleDesign
        Names the constraint at fault, the modes suspected, and the largest damping ratio
        (or smallest gamma) that is feasible.
    UncertifiedDesign
        If the closed loop contradicts the solver.
    """
    conditioning = Conditioning() if conditioning is None else conditioning
    started = time.perf_counter()
    P = scaled(balanced_states(P))
    weak = require_reachable(P.A, P.B2, P.C2, region, what)

    if region.trivial:
        exact = without_region(P, region, slack=conditioning.gamma_slack, what=what)
        if exact is not None:
            _require_cap(exact.facts["gamma_optimum"], gamma_cap, region, weak, what)
            return exact
    problem, solution, solves = _least_norm(P, region, conditioning.trace_weight, engine)
    if solution.status not in ("optimal", "almost optimal"):
        _explain(P, region, problem, solution, weak, engine, what)
    optimum = solution.scalars["gamma"]
    _require_cap(optimum, gamma_cap, region, weak, what)

    def attempt(r: float) -> Synthesis | None:
        nonlocal solves
        gamma, trial, result = optimum, problem, solution
        if r > 0.0:
            gamma = (1.0 + r) * optimum
            trial = conditioned_problem(P, region, gamma)
            result = solve(trial, engine)
            solves += 1
        if not usable(trial, result):
            return None
        K = _recover(P, result, what)
        pattern = {"normal": (P.C2, P.D21)}
        poles_of, norm_of = checked(P, K, pattern, {"normal": region}, gamma, what=what)
        return Synthesis(
            controller=P.controller(*K),
            gamma=gamma,
            norm_of=norm_of,
            poles_of=poles_of,
            region_of={"normal": region},
            solves=solves,
            seconds=time.perf_counter() - started,
            engine=engine,
            facts={
                "gamma_optimum": optimum,
                "gamma_slack": r,
                "gap": result.gap,
                "iterations": result.iterations,
                "status": result.status,
            },
        )

    design = first_certified(from_slack(conditioning.gamma_slack, (0.0, *_SLACKS)), attempt)
    if design is not None:
        return design
    _explain(P, region, problem, solution, weak, engine, what)
    raise AssertionError("unreachable")


def _require_cap(
    optimum: float, cap: float | None, region: PoleRegion, weak: list[tuple[complex, float]], what: str
) -> None:
    if cap is not None and not optimum <= cap:
        raise InfeasibleDesign(
            f"{what}: the least norm in the region ({region.describe()}) is {optimum:.4g}, allowed is "
            f"{cap:.4g}; raise the cap to {1.01 * optimum:.4g} or loosen the region{weak_words(weak)}",
            constraint="gamma",
            asked=cap,
            reachable=optimum,
        )


def _least_norm(
    P: GeneralizedPlant, region: PoleRegion, weight: float | None, engine: str
) -> tuple[Problem, Solution, int]:
    """Return `region_problem`, its solution, and how many were solved until the trace was small."""
    eps = _FIRST_WEIGHT if weight is None else weight
    problem = region_problem(P, region, eps)
    solution, solves = solve(problem, engine), 1
    while weight is None and solves < _MOST_WEIGHTS and usable(problem, solution):
        size = float(np.trace(solution.values["X"]) + np.trace(solution.values["Y"])) / P.order
        share = eps * size / max(solution.scalars["gamma"], 1e-300)
        if share <= 2.0 * _SHARE:
            break
        eps *= _SHARE / share
        finer = region_problem(P, region, eps)
        result = solve(finer, engine)
        solves += 1
        if not usable(finer, result):
            break
        problem, solution = finer, result
    return problem, solution, solves


def region_problem(P: GeneralizedPlant, region: PoleRegion, trace_weight: float) -> Problem:
    """Return ``min gamma + eps trace(X + Y) / n`` with the poles in the region."""
    program = Program()
    u = Unknowns.of(program, P)
    loop = closed_loop(P, u)
    gamma = program.scalar("gamma")
    program.require("Lyapunov matrix", loop.N)
    program.require("norm", regions.hinf(loop.M, loop.Bw, loop.Cz, loop.D, gamma))
    require_region(program, loop, region)
    program.minimise(gamma)
    program.minimise(trace(u.X + u.Y) * (trace_weight / P.order))
    return program.problem()


def conditioned_problem(P: GeneralizedPlant, region: PoleRegion, gamma: float) -> Problem:
    """Return the second solve: at the norm `gamma`, keep I - X Y away from singular and X, Y small.

    Minimises ``-t + eps trace(X + Y) / n`` with ``[[X, t I], [t I, Y]] >= 0`` and t <= 2: the
    eigenvalues of X Y are at least t^2.
    """
    program = Program()
    u = Unknowns.of(program, P)
    loop = closed_loop(P, u)
    t = program.scalar("t")
    identity = np.eye(P.order)
    program.require("Lyapunov matrix", loop.N)
    program.require("apart", bmat([[u.X, t * identity], [t * identity, u.Y]]))
    program.require("t <= 2", 2.0 * np.eye(1) - t * np.eye(1))
    program.require("norm", regions.hinf(loop.M, loop.Bw, loop.Cz, loop.D, gamma))
    require_region(program, loop, region)
    program.minimise(linear(t) * -1.0)
    program.minimise(trace(u.X + u.Y) * (1e-3 / P.order))
    return program.problem()


def _explain(
    P: GeneralizedPlant,
    region: PoleRegion,
    problem: Problem,
    solution: Solution,
    weak: list[tuple[complex, float]],
    engine: str,
    what: str,
) -> None:
    """Raise InfeasibleDesign with the largest feasible damping ratio, or UncertifiedDesign."""

    def feasible(zeta: float) -> bool:
        trial = region_problem(P, PoleRegion(zeta, region.decay_rate, region.radius), 1e-3)
        result = solve(trial, engine)
        return usable(trial, result)

    reachable = largest_feasible(feasible, 0.0, region.damping_ratio) if region.damping_ratio > 0.0 else None
    if reachable is not None:
        raise InfeasibleDesign(
            f"{what}: no controller meets damping ratio >= {region.damping_ratio:.4g} ({region.describe()}); "
            f"the largest feasible damping ratio is {reachable:.3f}{weak_words(weak)}",
            constraint="damping_ratio",
            asked=region.damping_ratio,
            reachable=reachable,
        )
    for name, loosened in (
        ("decay_rate", PoleRegion(0.0, None, region.radius)),
        ("radius", PoleRegion(0.0, region.decay_rate, None)),
    ):
        if getattr(region, name) is None:
            continue
        trial = region_problem(P, loosened, 1e-3)
        if usable(trial, solve(trial, engine)):
            requested = getattr(region, name)
            nearest = _nearest(P, region, name, requested, engine)
            raise InfeasibleDesign(
                f"{what}: no controller meets {name} = {requested:.4g} ({region.describe()}); without it the "
                f"design is feasible, the nearest feasible value is {nearest:.4g}{weak_words(weak)}",
                constraint=name,
                asked=requested,
                reachable=nearest,
            )
    try:
        distance = infeasibility(problem, engine)
    except SolverError:
        distance = float("nan")
    if distance > 0.0:
        raise InfeasibleDesign(
            f"{what}: no controller stabilizes the plant (elastic distance {distance:.2g}); "
            f"check that (A, B2) is stabilizable and (C2, A) detectable{weak_words(weak)}",
            constraint="stability",
        )
    raise UncertifiedDesign(
        f"{what}: {solution.engine} stopped with {solution.status!r} ({solution.message}) and no strictly "
        "feasible point, while the problem is not proven infeasible; try the other engine or a milder region"
    )


def _nearest(P: GeneralizedPlant, region: PoleRegion, name: str, requested: float, engine: str) -> float:
    """Bisect for the feasible decay rate or radius nearest to the one asked for."""

    def feasible(x: float) -> bool:
        r = (
            PoleRegion(0.0, x, region.radius)
            if name == "decay_rate"
            else PoleRegion(0.0, region.decay_rate, 1 / x)
        )
        trial = region_problem(P, r, 1e-3)
        return usable(trial, solve(trial, engine))

    if name == "decay_rate":
        return largest_feasible(feasible, 0.0, requested) or 0.0
    result = largest_feasible(feasible, 1e-4 / requested, 1.0 / requested, steps=14)
    return float("inf") if result is None else 1.0 / result


def _recover(P: GeneralizedPlant, solution: Solution, what: str) -> tuple[Matrix, Matrix, Matrix]:
    """Recover K of one plant; a singular I - X Y becomes UncertifiedDesign."""
    v = solution.values
    try:
        return recover(P.A, P.B2, P.C2, v["X"], v["Y"], v["A^"], v["B^"], v["C^"])
    except ValueError as error:
        raise UncertifiedDesign(f"{what}: {error}") from error
