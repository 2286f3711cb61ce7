"""Fixed-order controllers that maximise the worst damping over operating points, losses and latencies.

Each operating point's plant is reduced and extended by a Pade model of each latency and a washout. The
smoothed objective of `smoothed_objective.py` is minimised with L-BFGS from several random stable starts, or
in stages (`stages.py`) with steps that follow each eigenvalue (`newton.py`), from first guesses for the
loops. The result is only a proposal: `operating_points.py` evaluates it on the full plants with exact delays.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import control
import numpy as np
from scipy.optimize import minimize

from interarea.models.errors import UserError
from interarea.models.threads import one_blas_thread

from ..errors import InfeasibleDesign
from ..linear.norms import gramian_factor
from ..reduction.gramians import projections
from .design_models import build_objective, tightened
from .smoothed_objective import Array, Gains, Objective
from .spec import RobustSpec
from .stages import TURNS, Tell, stabilised, stage_parts, staged_search

#: evaluations between two balancings of the controller
ROUND = 300
#: evaluations of L-BFGS between steps of a stage, and what one of these costs
BETWEEN, STEP = 60, 5


@dataclass(frozen=True)
class RobustDesign:
    """A proposal and the figures of its design models (not of the full plants)."""

    system: control.StateSpace  #: signals (rad/s) -> actuators (pu), washout included
    objective: float
    worst_damping: float  #: over design models, Pade and filter modes counted
    rightmost: float  #: largest real part over design models, 1/s
    evaluations: int
    starts: tuple[float, ...]  #: objective reached from each start
    tried: tuple[control.StateSpace, ...]  #: the controller of each start


def design_robust(
    plants: Mapping[str, control.StateSpace],
    spec: RobustSpec,
    omega_b: float,
    *,
    progress: Tell | None = None,
) -> RobustDesign:
    """Return the best controller found for `spec` over all `plants` and conditions.

    Parameters
    ----------
    plants : operating point -> full linear plant without reference mode, outputs in pu as linearised.
    omega_b : rated speed, rad/s.
    progress : called with (present step, upper bound of the completed share, best objective).

    Raises
    ------
    InfeasibleDesign : no start led to a controller that stabilises every design model, or an unstable mode is
    not controllable. ValueError : plants without a design model.
    """
    objective = build_objective(plants, spec, omega_b)
    report = _whole(planned(spec, len(objective.models) / len(plants), len(plants)), progress)
    rng = np.random.default_rng(spec.seed)
    with one_blas_thread():
        if spec.stages:
            starts = [] if spec.start is None else [stated_start(objective, spec)]
            theta, count, result = staged_search(
                objective,
                spec.stages,
                starts,
                spec.starts,
                0.2 * min((cap for _, cap in spec.effort_cap or ()), default=0.5),
                rng,
                balanced=balanced_parameters,
                descend=_descend_briefly,
                progress=report,
            )
        else:
            theta, count, result = _from_random(objective, plants, spec, omega_b, rng, report)
        value = objective(theta)[0]
        for margin in spec.margins_deg if spec.swing is not None else ():
            objective = replace(objective, swing=tightened(spec, margin))
            what = f"first swing, {margin:g} degrees"
            theta, used = _descend(
                objective, theta, spec.evaluations // ROUND, spec.within, tell=partial(report, what)
            )
            count += used
            value = objective(theta)[0]
            report(what, 1.0, value)
    rightmost, worst = objective.worst(theta)
    if not objective.stable(theta):
        raise InfeasibleDesign(
            f"robust design: no controller of order {spec.order} stabilised all {len(objective.models)} "
            f"design models in {spec.starts} starts (largest real part {rightmost:.3g} 1/s); raise the "
            "order, lower the largest latency or remove the most difficult operating point",
            constraint="stability",
            asked=spec.order,
        )
    K = _with_washout(objective.unpack(theta), spec)
    reached = tuple(each for each, _ in result)
    ends = tuple(_with_washout(objective.unpack(start), spec) for _, start in result)
    return RobustDesign(K, value, worst, rightmost, count, reached, ends)


def planned(spec: RobustSpec, conditions: float, points: int) -> dict[str, float]:
    """Return the parts of a search in order, with the largest cost of each in evaluations of a design model.

    conditions : models of each of the `points`.

    >>> from .spec import Condition
    >>> spec = RobustSpec(("y",), ("u",), (Condition("N"),), starts=1, evaluations=600, polishes=3)
    >>> planned(spec, 1.0, 2)
    {'start 1 of 1': 1200.0, 'polish 3 of 3': 1800.0}
    """
    first_starts = int(spec.start is not None)
    models = conditions * points
    each = ROUND * max(spec.evaluations // ROUND, 1)
    parts: dict[str, float] = {}
    if spec.stages:
        for k, stage in enumerate(spec.stages, start=1):
            share = len(stage.points or range(points)) * (len(stage.conditions) or conditions)
            for what in stage_parts(k, len(spec.stages), spec.starts + first_starts):
                parts[what] = share * len(stage.rho) * TURNS * (stage.steps * STEP + BETWEEN)
    else:
        starts = conditions * (min(spec.starts_on, points) or points)
        count = spec.starts + first_starts
        parts |= {f"start {k} of {count}": starts * each for k in range(1, count + 1)}
        parts |= {
            f"polish {k + 3} of {spec.polishes}": models * 3 * ROUND for k in range(0, spec.polishes, 3)
        }
    swings = spec.margins_deg if spec.swing is not None else ()
    return parts | {f"first swing, {margin:g} degrees": models * each for margin in swings}


def _whole(parts: Mapping[str, float], progress: Tell | None) -> Tell:
    """Return what tells how much of all `parts` is done from how much of one of them is."""
    names, total = list(parts), sum(parts.values())

    def tell(what: str, share: float, reached: float) -> None:
        if progress is not None:
            before = sum(parts[name] for name in names[: names.index(what)])
            progress(what, (before + share * parts[what]) / total, reached)

    return tell


def _from_random(
    objective: Objective,
    plants: Mapping[str, control.StateSpace],
    spec: RobustSpec,
    omega_b: float,
    rng: np.random.Generator,
    tell: Tell,
) -> tuple[Array, int, list[tuple[float, Array]]]:
    """L-BFGS from each start, the best polished: parameters, evaluations, (objective, those) of each."""
    first = dict(list(plants.items())[: spec.starts_on or None])
    easier = build_objective(first, spec, omega_b) if len(first) < len(plants) else objective
    rows: list[tuple[float, Array]] = []
    count = 0
    starts = [] if spec.start is None else [stated_start(easier, spec)]
    starts += [_stable_start(easier, rng) for _ in range(spec.starts)]
    for k, start in enumerate(starts):
        what = f"start {k + 1} of {len(starts)}"
        start, before = stabilised(easier, start, _descend_briefly)
        theta, used = _descend(
            easier, start, spec.evaluations // ROUND, spec.within, tell=partial(tell, what)
        )
        count += before + used
        rows.append((easier(theta)[0], theta))
        tell(what, 1.0, rows[-1][0])
    theta, used = stabilised(objective, min(rows, key=lambda each: each[0])[1], _descend_briefly)
    count, value = count + used, objective(theta)[0]
    for k in range(0, spec.polishes, 3):
        what = f"polish {k + 3} of {spec.polishes}"
        theta, used = _descend(objective, theta, 3, spec.within, tell=partial(tell, what))
        count += used
        gained, value = value - objective(theta)[0], objective(theta)[0]
        tell(what, 1.0, value)
        if not gained > 1e-5:
            break
    return theta, count, rows


def _stable_start(objective: Objective, rng: np.random.Generator) -> Array:
    """A random stable controller, its gain lowered until every model is stable, the effort near its cap."""
    n, p, m = objective.order, objective.n_y, objective.n_u
    A = rng.normal(size=(n, n))
    A = A - A.T + np.diag(rng.normal(size=n))
    for states in objective.parts:
        part = A[np.ix_(states, states)]
        A[states, states] -= max(np.linalg.eigvals(part).real.max(), 0.0) + 0.5
    A = 6.0 * A
    B, C = rng.normal(size=(n, p)), rng.normal(size=(m, n))
    theta = objective.pack(A, B, C)
    A, B, C, _ = objective.unpack(theta)
    for _ in range(60):
        theta = objective.pack(A, B, C)
        if objective.stable(theta) and objective(theta)[0] < 1.0:
            break
        C = 0.7 * C
    return objective.pack(A, B, C)


def stated_start(objective: Objective, spec: RobustSpec) -> Array:
    """Return the parameters of the controller that `spec` starts from.

    Raises
    ------
    UserError : its signals, actuators or order differ from the design.
    """
    K, n, m = spec.start, objective.order, len(spec.actuators)
    assert K is not None
    states = n + m * (spec.washout_s > 0.0)
    names = (tuple(K.input_labels), tuple(K.output_labels))
    if K.nstates != states or names != (spec.signals, spec.actuators):
        raise UserError(
            f"robust design: the controller to start from has {K.nstates} states, {', '.join(names[0])} "
            f"-> {', '.join(names[1])}; wanted {states}, {', '.join(spec.signals)} -> "
            f"{', '.join(spec.actuators)}"
        )
    A, B, C, D = (np.asarray(M, dtype=float) for M in (K.A, K.B, K.C, K.D))
    # the washouts' states stand last, and their share of the outputs is not designed
    return objective.pack(A[:n, :n], B[:n], C[:, :n], D)


def _descend(
    objective: Objective,
    start: Array,
    rounds: int,
    within: float = np.inf,
    each: int = ROUND,
    *,
    tell: Callable[[float, float], object] | None = None,
) -> tuple[Array, int]:
    """L-BFGS with the analytic gradient, K balanced before each round; return the best and evaluations.

    The objective is nearly non-smooth and does not see the coordinates of K: balanced ones, and dropping the
    Hessian's memory with the old ones, free a search that has stalled. Below infinity `within` makes rounds a
    third as long, each over the models that were so near to the worst at its start; one after which another
    model is worse is thrown away, and the next takes twice as many. tell : called before each round with the
    share of the rounds that is done and the objective.
    """
    best, value, count = start, objective(start)[0], 0
    parts = 1 if np.isinf(within) else 3
    for k in range(parts * max(rounds, 1)):
        if tell is not None:
            tell(k / (parts * max(rounds, 1)), value)
        selected = objective if np.isinf(within) else objective.narrowed(best, within)
        result = minimize(
            selected,
            balanced_parameters(objective, best),
            jac=True,
            method="L-BFGS-B",
            options={
                "maxfun": each // parts,
                "maxiter": each // parts,
                "maxcor": 30,
                "ftol": 1e-12,
                "gtol": 1e-9,
            },
        )
        count += int(result.nfev)
        whole = len(selected.models) == len(objective.models)
        reached = float(result.fun) if whole else objective(result.x)[0]
        if reached < value:
            best, value = np.asarray(result.x), reached
        elif whole:
            break
        else:
            within *= 2.0
    return best, count


def _descend_briefly(objective: Objective, start: Array) -> tuple[Array, int]:
    """L-BFGS for a few evaluations, between steps of a stage or until a start is stable."""
    return _descend(objective, start, 1, each=BETWEEN)


def balanced_parameters(objective: Objective, theta: Array) -> Array:
    """Return the same controller in balanced coordinates (both Gramians equal and diagonal).

    Each part of a decentralised controller separately. An unstable or non-minimal one is not changed.
    """
    A, B, C, D = (M.copy() for M in objective.unpack(theta))
    for states in objective.parts:
        part = (A[np.ix_(states, states)], B[states], C[:, states])
        if not np.linalg.eigvals(part[0]).real.max() < -1e-9:
            return theta
        W, T, values = projections(gramian_factor(part[0], part[1]), gramian_factor(part[0].T, part[2].T))
        if W.shape[1] < len(states) or not values[-1] > 1e-9 * values[0]:
            return theta
        A[np.ix_(states, states)], B[states], C[:, states] = W.T @ part[0] @ T, W.T @ part[1], part[2] @ T
    return objective.pack(A, B, C, D)


def _with_washout(K: Gains, spec: RobustSpec) -> control.StateSpace:
    A, B, C, D = K
    n, m = A.shape[0], C.shape[0]
    if spec.washout_s > 0.0:
        # u = v - w, T w' = v - w for v = C x + D y
        T = spec.washout_s
        A = np.block([[A, np.zeros((n, m))], [C / T, -np.eye(m) / T]])
        B = np.vstack([B, D / T])
        C = np.hstack([C, -np.eye(m)])
    return control.ss(
        A,
        B,
        C,
        D,
        inputs=list(spec.signals),
        outputs=list(spec.actuators),
        name="robust",
    )
