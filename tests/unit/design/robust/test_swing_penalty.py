"""The first-swing penalty: its integral against a convolution, its gradient against differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.signal import lsim

from interarea.design.delay.signal_conditions import Condition
from interarea.design.robust.design_models import tightened
from interarea.design.robust.smoothed_objective import DesignModel, Objective
from interarea.design.robust.spec import RobustSpec
from interarea.design.robust.swing_penalty import SwingCase, SwingPenalty


def _penalty(margin_deg: float, *, limit_pu: float = 0.05) -> SwingPenalty:
    rng = np.random.default_rng(2)
    time = 0.02 * np.arange(80)
    ramp = np.sin(np.pi * time / 1.6)[:, None]
    cases = [
        SwingCase(
            f"case {k}",
            ramp * rng.normal(size=2) + 0.3 * np.sin(5.0 * time[:, None] * rng.normal(size=2)),
            np.where(time[:, None] < 1.2, 500.0 * rng.normal(size=2), 0.0),
        )
        for k in range(3)
    ]
    return SwingPenalty(cases, 0.02, limit_pu, margin_deg)


def _objective(penalty: SwingPenalty, **options: bool) -> Objective:
    rng = np.random.default_rng(1)
    A = rng.normal(size=(5, 5))
    A -= (np.linalg.eigvals(A).real.max() + 0.5) * np.eye(5)
    model = DesignModel("plant", A, rng.normal(size=(5, 2)), rng.normal(size=(2, 5)))
    return Objective([model], 3, rho=50.0, swing=penalty, **options)


def _controller(objective: Objective, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(3, 3)) - 4.0 * np.eye(3)
    gains = rng.normal(size=(3, 2)), 0.3 * rng.normal(size=(2, 3)), 0.05 * rng.normal(size=(2, 2))
    return objective.pack(A, *gains)


@pytest.mark.parametrize("options", [{"feedthrough": True}, {"dc_block": True}, {}], ids=str)
def test_gradient_agrees_with_central_differences(options: dict[str, bool]) -> None:
    objective = _objective(_penalty(-200.0), **options)
    theta = _controller(objective, 4)
    assert objective.swing is not None
    assert objective.swing(objective.unpack(theta))[0] > 1.0  # the penalty, not the damping, is what is tried
    _, gradient = objective(theta)
    numeric = [
        (objective(theta + 1e-6 * e)[0] - objective(theta - 1e-6 * e)[0]) / 2e-6 for e in np.eye(theta.size)
    ]
    assert np.allclose(gradient, numeric, atol=1e-7 * np.abs(gradient).max())


def test_a_margin_that_holds_costs_nothing() -> None:
    objective = _objective(_penalty(-200.0))
    theta = _controller(objective, 4)
    K = objective.unpack(theta)
    most = float(_penalty(0.0).shifts_deg(K).max())
    assert _penalty(most + 1e-9)(K)[0] == 0.0
    value = _penalty(most - 10.0)(K)[0]
    assert value >= 1.0  # 10 degrees above the margin cost 1, the other cases what they cost
    assert value == pytest.approx(
        float((np.maximum(0.0, _penalty(0.0).shifts_deg(K) - most + 10.0) ** 2).sum() / 100.0), rel=1e-12
    )


def test_the_shift_is_the_integral_of_what_the_limit_lets_through() -> None:
    """Of an exponential sensitivity and a sine through a known controller, by quadrature."""
    step, limit = 0.001, 0.05
    time = step * np.arange(3001)
    y, s = np.sin(3.0 * time), 400.0 * np.exp(-((time - 1.5) ** 2) * 8.0)
    A, B, C, D = (np.array([[v]]) for v in (-2.0, 1.0, 0.1, 0.02))
    penalty = SwingPenalty([SwingCase("one", y[:, None], s[:, None])], step, limit, 0.0)

    def through(t: float) -> float:
        # x' = -2 x + sin 3 t from rest
        x = (2.0 * np.sin(3.0 * t) - 3.0 * np.cos(3.0 * t) + 3.0 * np.exp(-2.0 * t)) / 13.0
        u = 0.1 * x + 0.02 * np.sin(3.0 * t)
        return float(400.0 * np.exp(-((t - 1.5) ** 2) * 8.0) * limit * np.tanh(u / limit))

    expected, _ = quad(through, 0.0, 3.0)
    assert penalty.shifts_deg((A, B, C, D))[0] == pytest.approx(expected, rel=1e-5)


def test_a_washout_in_series_is_taken_into_the_signals() -> None:
    conditions = (Condition("N"),)
    spec = RobustSpec(
        ("a", "b"), ("u",), conditions, washout_s=2.0, dc_block=False, swing=_penalty(3.0), margins_deg=(3.0,)
    )
    case, behind = _penalty(3.0).cases[0], tightened(spec, 7.0).cases[0]
    time = 0.02 * np.arange(80)
    # s T / (1 + s T) of signals that are straight between samples
    _, expected, _ = lsim(([[-0.5]], [[0.5]], [[-1.0]], [[1.0]]), case.signals[:, 0], time)
    assert behind.signals[:, 0] == pytest.approx(np.ravel(expected), abs=2e-4)
    assert tightened(spec, 7.0).margin_deg == 7.0
    assert tightened(replace(spec, washout_s=0.0, dc_block=True), 1.0).cases[0] is spec.swing.cases[0]  # type: ignore[union-attr]
