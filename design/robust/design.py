"""Fixed-order controllers that hold the worst damping up over operating points, losses and latencies.

The recipe: reduce each operating point's plant, put a Pade model of each latency
and a washout in, and minimise the smoothed objective of `smoothed.py` from
several random stable starts with its analytic gradient; polish the best. What
comes out is only a proposal: `certificate.py` judges it on the full plants with
exact delays.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import control
import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize

from ..delay.curves import pade
from ..delay.signal_conditions import Condition
from ..errors import InfeasibleDesign
from ..linear.linearise import select, speeds_in_rad
from ..linear.norms import frequency_response, gramian_factor
from ..lmi.solve import one_blas_thread
from ..reduction.balanced import balanced_truncation
from ..reduction.gramians import projections
from .smoothed_objective import Array, Complex, DesignModel, EffortGrid, Gains, Objective
from .spec import RobustSpec, check_plants

#: evaluations between two balancings of the controller
ROUND = 300


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
    progress: Callable[[str, float], object] | None = None,
) -> RobustDesign:
    """Return the best controller found for `spec` over all `plants` and conditions.

    Parameters
    ----------
    plants : operating point -> full linear plant without reference mode, outputs in pu as linearised.
    omega_b : rated speed, rad/s.
    progress : called with (what, objective) after each start.

    Raises
    ------
    InfeasibleDesign : no start led to a controller that keeps every design model stable, or an unstable
        mode is out of reach. ValueError : plants that no design model can be made of.
    """
    objective = build_objective(plants, spec, omega_b)
    rng = np.random.default_rng(spec.seed)
    best: tuple[float, Array] | None = None
    reached: list[float] = []
    tried: list[control.StateSpace] = []
    count = 0
    with one_blas_thread():
        for k in range(spec.starts):
            theta, used = _descend(objective, _stable_start(objective, rng), spec.evaluations // ROUND)
            count += used
            value = objective(theta)[0]
            reached.append(value)
            tried.append(_with_washout(objective.unpack(theta), spec))
            if best is None or value < best[0]:
                best = (value, theta)
            if progress is not None:
                progress(f"start {k + 1} of {spec.starts}", value)
        assert best is not None
        value, theta = best
        for k in range(0, spec.polishes, 3):
            theta, used = _descend(objective, theta, 3)
            count += used
            gained, value = value - objective(theta)[0], objective(theta)[0]
            if progress is not None:
                progress(f"polish {k + 3} of {spec.polishes}", value)
            if not gained > 1e-5:
                break
    rightmost, worst = objective.worst(theta)
    if not rightmost < 0.0:
        raise InfeasibleDesign(
            f"robust design: no controller of order {spec.order} kept all {len(objective.models)} design "
            f"models stable in {spec.starts} starts (largest real part {rightmost:.3g} 1/s); raise the "
            "order, lower the largest latency or take out the hardest operating point",
            constraint="stability",
            asked=spec.order,
        )
    K = _with_washout(objective.unpack(theta), spec)
    return RobustDesign(K, value, worst, rightmost, count, tuple(reached), tuple(tried))


def build_objective(plants: Mapping[str, control.StateSpace], spec: RobustSpec, omega_b: float) -> Objective:
    """Return the objective of `spec`: one design model per operating point and condition.

    Raises ValueError and InfeasibleDesign as `robust_check.check_plants` says.
    """
    check_plants(plants, spec)
    models: list[DesignModel] = []
    efforts: list[EffortGrid] = []
    omega = np.geomspace(0.3, 300.0, 60)
    for point, plant in plants.items():
        full = select(speeds_in_rad(plant, omega_b), list(spec.actuators), list(spec.signals))
        unstable = int(np.count_nonzero(np.linalg.eigvals(full.A).real >= 0.0))
        small = balanced_truncation(full, min(max(spec.plant_order, unstable + 2), full.nstates)).system
        response = frequency_response(full.A, full.B, full.C, full.D, omega)
        for condition in spec.conditions:
            name = f"{point}: {condition.name}"
            models.append(_design_model(name, small, spec, condition))
            if spec.effort_cap is not None:
                efforts.append(_effort_grid(name, omega, response, spec, condition))
    return Objective(
        models,
        _free_order(spec),
        efforts,
        offsets=spec.offsets,
        mask=_structure(spec),
        feedthrough=spec.feedthrough,
        dc_block=spec.dc_block,
        slowest_pole=spec.slowest_pole,
        fastest_pole=spec.fastest_pole,
    )


def _free_order(spec: RobustSpec) -> int:
    """States that are designed: all but those of the washouts."""
    order = sum(order for _, order in spec.sees.values()) if spec.sees else spec.order
    return order - len(spec.actuators) * (spec.washout_s > 0.0)


def _structure(spec: RobustSpec) -> npt.NDArray[np.bool_] | None:
    if not spec.sees:
        return None
    n, p, m = _free_order(spec), len(spec.signals), len(spec.actuators)
    A, B, C, D = (np.zeros(shape, bool) for shape in ((n, n), (n, p), (m, n), (m, p)))
    first = 0
    for row, actuator in enumerate(spec.actuators):
        signals, order = spec.sees[actuator]
        order -= int(spec.washout_s > 0.0)
        states = slice(first, first + order)
        A[states, states] = True
        C[row, states] = True
        for signal in signals:
            B[states, spec.signals.index(signal)] = True
            D[row, spec.signals.index(signal)] = spec.feedthrough
        first += order
    return np.concatenate([M.ravel() for M in (A, B, C, D)])


def _design_model(
    name: str, plant: control.StateSpace, spec: RobustSpec, condition: Condition
) -> DesignModel:
    """Chain washout, plant and Pade models; lost signals give zero."""
    A, B, C = (np.asarray(M, dtype=float) for M in (plant.A, plant.B, plant.C))
    if spec.washout_s > 0.0:
        # u_plant = u - w,  T w' = u - w, one per actuator
        m, T = B.shape[1], spec.washout_s
        A = np.block([[A, -B], [np.zeros((m, A.shape[0])), -np.eye(m) / T]])
        B = np.vstack([B, np.eye(m) / T])
        C = np.hstack([C, np.zeros((C.shape[0], m))])
    rows = []
    for k, signal in enumerate(spec.signals):
        row = np.zeros((1, A.shape[0]))
        latency = condition.latency_s_of.get(signal, 0.0)
        if signal in condition.lost:
            pass
        elif latency > 0.0:
            late = pade(latency, spec.pade_order)
            size = A.shape[0]
            delayed = late.B @ C[k : k + 1]
            A = np.block([[A, np.zeros((size, late.A.shape[0]))], [delayed, late.A]])
            B = np.vstack([B, np.zeros((late.A.shape[0], B.shape[1]))])
            C = np.hstack([C, np.zeros((C.shape[0], late.A.shape[0]))])
            row = np.hstack([late.D @ C[k : k + 1, :size], late.C])
        else:
            row = C[k : k + 1]
        rows.append(row)
    width = A.shape[0]
    C_seen = np.vstack([np.hstack([row, np.zeros((1, width - row.shape[1]))]) for row in rows])
    return DesignModel(name, A, B, C_seen)


def _effort_grid(
    name: str, omega: Array, response: Complex, spec: RobustSpec, condition: Condition
) -> EffortGrid:
    assert spec.effort_cap is not None
    nodes = np.array(spec.effort_cap)
    cap = np.exp(np.interp(np.log(omega), np.log(nodes[:, 0]), np.log(nodes[:, 1])))
    seen = response.copy()
    for k, signal in enumerate(spec.signals):
        late = np.exp(-1j * omega * condition.latency_s_of.get(signal, 0.0))
        seen[:, k, :] *= 0.0 if signal in condition.lost else late[:, None]
    if spec.washout_s > 0.0:
        s = 1j * omega * spec.washout_s
        # the filter belongs to the controller: its gain is taken out of the cap, put into the plant
        washout = s / (1.0 + s)
        seen = seen * washout[:, None, None]
        cap = cap / np.abs(washout)
    return EffortGrid(name, omega, seen, cap)


def _stable_start(objective: Objective, rng: np.random.Generator) -> Array:
    """A random stable controller, its gain lowered until every model is stable, the effort near its cap."""
    n, p, m = objective.order, objective.n_y, objective.n_u
    A = rng.normal(size=(n, n))
    A = A - A.T + np.diag(rng.normal(size=n))
    A = 6.0 * (A - (max(np.linalg.eigvals(A).real.max(), 0.0) + 0.5) * np.eye(n))
    B, C = rng.normal(size=(n, p)), rng.normal(size=(m, n))
    theta = objective.pack(A, B, C)
    A, B, C, _ = objective.unpack(theta)
    for _ in range(60):
        theta = objective.pack(A, B, C)
        if objective.worst(theta)[0] < 0.0 and objective(theta)[0] < 1.0:
            break
        C = 0.7 * C
    return objective.pack(A, B, C)


def _descend(objective: Objective, start: Array, rounds: int) -> tuple[Array, int]:
    """L-BFGS with the analytic gradient, K balanced before each round; return the best and evaluations.

    The objective is nearly non-smooth and does not see the coordinates of K: balanced ones, and dropping the
    Hessian's memory with the old ones, free a search that has stalled.
    """
    best, value, count = start, objective(start)[0], 0
    for _ in range(max(rounds, 1)):
        result = minimize(
            objective,
            balanced_parameters(objective, best),
            jac=True,
            method="L-BFGS-B",
            options={"maxfun": ROUND, "maxiter": ROUND, "maxcor": 30, "ftol": 1e-12, "gtol": 1e-9},
        )
        count += int(result.nfev)
        if not result.fun < value:
            break
        best, value = np.asarray(result.x), float(result.fun)
    return best, count


def balanced_parameters(objective: Objective, theta: Array) -> Array:
    """Return the same controller in coordinates where both its Gramians are equal and diagonal.

    Of a decentralised one each part by itself. One that is not stable, or not minimal, stays as it is.
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
