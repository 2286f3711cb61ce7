"""Co-simulation against closed forms: input polynomials, output slopes, events, step splitting."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from fmu_runner import Runner


def test_cubic_inputs_are_integrated_over_the_step(decay: Path) -> None:
    """dx/dt = -x + u with u = a + b t + c t^2 + d t^3: one step of 0.5 s against the closed form.

    A particular solution is the cubic q with q' + q = u; x = q + (x0 - q(0)) exp(-t).
    """
    a, b, c, d = 0.3, -0.7, 1.1, 2.0
    q3 = d
    q2 = c - 3 * q3
    q1 = b - 2 * q2
    q0 = a - q1
    h = 0.5
    exact = q0 + q1 * h + q2 * h**2 + q3 * h**3 + (1.0 - q0) * np.exp(-h)
    with Runner(decay) as run:
        run.start()
        run.set(u=a)
        run.slopes("u", b, 2 * c, 6 * d)
        run.step(0.0, h)
        # Runge-Kutta of order 4 with steps of 0.01 s: |x0 - q0| h 0.01^4 / 120 = 4e-10.
        assert abs(run.get("x") - exact) < 4e-10
        u_end = a + b * h + c * h**2 + d * h**3
        assert abs(run.get("u") - u_end) < 1e-15
        assert abs(run.slope("y") - (u_end - exact)) < 4e-10
        # derivatives are consumed: the next step holds the input
        run.step(h, h)
        assert abs(run.get("x") - (u_end + (exact - u_end) * np.exp(-h))) < 8e-10


def test_kick_splits_the_step(decay: Path) -> None:
    """x jumps by 2 at 0.55 s, inside, at the end and at the start of steps."""
    t = 1.0
    exact = np.exp(-t) + 2.0 * np.exp(-(t - 0.55))
    for points in ([0, 1], [0, 0.55, 1], [0, 0.5500000000000002, 1], [0, 0.55 - 1e-9, 0.55, 0.55 + 1e-9, 1]):
        with Runner(decay) as run:
            run.start({"kicking": 1})
            x = run.run(points, "x")
            assert run.get("kicks") == 1
            assert abs(x[-1] - exact) < 1e-10, points


def test_kick_in_model_exchange_is_announced(decay: Path) -> None:
    with Runner(decay, "me") as run:
        run.start({"kicking": 1})
        info = run.fmu.newDiscreteStates()
        assert info[4:] == (True, 0.55) or info[-1] == 0.55
        run.fmu.enterContinuousTimeMode()
        run.fmu.setTime(0.55)
        run.fmu.enterEventMode()
        info = run.fmu.newDiscreteStates()
        assert run.get("x") == 3.0
        assert run.get("kicks") == 1


def test_splitting_a_step_changes_only_rounding(decay: Path) -> None:
    """Steps of 0.1 s and of 0.05 s have the same substeps of 0.01 s."""
    results = []
    for n in (10, 20, 100):
        with Runner(decay) as run:
            results.append(run.start({"rate": 3.0}).run(np.linspace(0, 1, n + 1), "x")[-1])
    assert np.ptp(results) < 1e-15


def test_tunable_parameter_takes_effect_at_once(decay: Path) -> None:
    with Runner(decay) as run:
        run.start()
        run.step(0.0, 0.5)
        run.set(rate=2.0)
        assert run.get("der(x)") == -2.0 * run.get("x")
        run.step(0.5, 0.5)
        assert abs(run.get("x") - np.exp(-1.5)) < 1e-9


def test_outputs_follow_a_set_before_the_next_step(decay: Path) -> None:
    with Runner(decay) as run:
        run.start()
        run.set(u=5.0)
        assert run.get("w") == run.get("x") - 5.0
        assert run.get("der(x)") == 5.0 - run.get("x")


def test_clipped_controller_output_has_no_slope(built: dict[str, Path]) -> None:
    with Runner(built["controller"]) as run:
        run.start({"limit": 1e-3})
        run.set(G2_dw=1.0)
        run.step(0.0, 0.5)
        assert run.get("G4_vs") in (1e-3, -1e-3)
        assert run.slope("G4_vs") == 0.0
        run.set(limit=10.0)
        slope, y, h = run.slope("G4_vs"), run.get("G4_vs"), 1e-6
        run.set(G2_dw=1.0)
        run.step(0.5, h)
        assert abs((run.get("G4_vs") - y) / h - slope) < 1e-4
