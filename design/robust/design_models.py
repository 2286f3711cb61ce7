"""From full plants and a specification to the objective: reduced plants, latencies, washouts, structure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import control
import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from ..delay.curves import pade
from ..delay.signal_conditions import Condition
from ..linear.linearise import select, speeds_in_rad
from ..linear.norms import frequency_response
from ..reduction.balanced import balanced_truncation
from ..reduction.gramians import assemble, matrices, separate_slow
from .smoothed_objective import COMMON_SPEED, Array, Complex, DesignModel, EffortGrid, Objective
from .spec import RobustSpec, check_plants
from .swing_penalty import SwingPenalty

#: share of the largest Hankel singular value below which a state is left out of a design model: with less
#: (from 5e-11 of it on two areas) a slow pole is rounding, and as no controller moves it, it sets the worst v
REACHED = 1e-9


def build_objective(plants: Mapping[str, control.StateSpace], spec: RobustSpec, omega_b: float) -> Objective:
    """Return the objective of `spec`: one design model per operating point and condition.

    Raises ValueError and InfeasibleDesign as `robust_check.check_plants` says.
    """
    check_plants(plants, spec)
    models: list[DesignModel] = []
    efforts: list[EffortGrid] = []
    omega = np.geomspace(0.1, 300.0, 70)
    for point, plant in plants.items():
        full = select(speeds_in_rad(plant, omega_b), list(spec.actuators), list(spec.signals))
        swinging, common = without_common_speed(full), _common_speed(full)
        unstable = int(np.count_nonzero(np.linalg.eigvals(swinging.A).real >= 0.0))
        order = min(max(spec.plant_order, unstable + 2), swinging.nstates)
        small = balanced_truncation(swinging, order, negligible=REACHED).system
        if common is not None:
            # without a Gramian it is not reduced; without it the loop's gain near rest would be another
            small = assemble(small, matrices(small), common)
        response = frequency_response(full.A, full.B, full.C, full.D, omega)
        for condition in spec.conditions:
            name = f"{point}: {condition.name}"
            requested = (spec.more.get(point), condition.target_of(spec.more_under))
            more = tuple(each for each in requested if each is not None)
            models.append(replace(_design_model(name, small, spec, condition), more=more))
            limited = not spec.effort_under or condition.name in spec.effort_under
            if spec.effort_cap is not None and limited:
                efforts.append(_effort_grid(name, omega, response, spec, condition))
    return Objective(
        models,
        _free_order(spec),
        efforts,
        offsets=spec.offsets,
        rho=spec.rho,
        mask=_structure(spec),
        feedthrough=spec.feedthrough,
        dc_block=spec.dc_block,
        slowest_pole=spec.slowest_pole,
        fastest_pole=spec.fastest_pole,
    )


def without_common_speed(plant: control.StateSpace, slower_than: float = COMMON_SPEED) -> control.StateSpace:
    """Return the plant without the mode of its common speed, if that speed does not return to its initial
    value.

    Without governors it is the slowest mode (0 if no torque depends on the speed). No controller with K(0) =
    0 moves it. slower_than : rad/s.
    """
    A, B, C, D = (np.asarray(M, dtype=float) for M in (plant.A, plant.B, plant.C, plant.D))
    if not np.abs(np.linalg.eigvals(A)).min(initial=np.inf) < slower_than:
        return plant
    return assemble(plant, separate_slow(A, B, C, D, slower_than).stable)


def _common_speed(plant: control.StateSpace) -> tuple[Array, Array, Array] | None:
    """Return A, B, C of the mode that `without_common_speed` takes out."""
    A, B, C, D = matrices(plant)
    if not np.abs(np.linalg.eigvals(A)).min(initial=np.inf) < COMMON_SPEED:
        return None
    return separate_slow(A, B, C, D, COMMON_SPEED).rest


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
    """Chain washout, plant and Pade models; lost signals give zero, scaled ones so much more."""
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
        rows.append(condition.scale_of.get(signal, 1.0) * row)
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
        late = condition.scale_of.get(signal, 1.0) * late
        seen[:, k, :] *= 0.0 if signal in condition.lost else late[:, None]
    if spec.washout_s > 0.0:
        s = 1j * omega * spec.washout_s
        # the filter belongs to the controller: its gain is taken out of the cap, put into the plant
        washout = s / (1.0 + s)
        seen = seen * washout[:, None, None]
        cap = cap / np.abs(washout)
    return EffortGrid(name, omega, seen, cap)


def tightened(spec: RobustSpec, margin_deg: float) -> SwingPenalty:
    """Return the penalty on the first swing at this margin, with its signals after the washout, if any.

    The washout is in series with each output, but it is linear and the same for all, so it commutes with K.
    """
    assert spec.swing is not None
    if not spec.washout_s > 0.0:
        return replace(spec.swing, margin_deg=margin_deg)
    ratio = spec.swing.step_s / (2.0 * spec.washout_s)
    # w' = (y - w) / T by the trapezoidal rule, as K is stepped; what goes on is y - w
    top, bottom = np.array([1.0, -1.0]) / (1.0 + ratio), np.array([1.0, (ratio - 1.0) / (1.0 + ratio)])
    cases = [
        replace(case, signals=np.asarray(lfilter(top, bottom, case.signals, axis=0)))
        for case in spec.swing.cases
    ]
    return replace(spec.swing, cases=cases, margin_deg=margin_deg)
