"""The certificate against hand-made loops: loss criterion, effort, remote utilisation, conditions."""

from __future__ import annotations

import control
import numpy as np
import pytest

from interarea.design.certificate import closed_loop_matrix, effort, loss_criterion, remote_utilisation
from interarea.design.conditions import Condition, condition_of


def first_order_plant() -> control.StateSpace:
    """Two lags behind one actuator: y_remote = 2/(s+1) u, y_local = 3/(s+2) u."""
    return control.ss(
        [[-1.0, 0.0], [0.0, -2.0]],
        [[1.0], [1.0]],
        [[2.0, 0.0], [0.0, 3.0]],
        np.zeros((2, 1)),
        inputs=["G4_vs"],
        outputs=["G2_dw", "G4_dw"],
    )


def lag_controller(remote: float, local: float) -> control.StateSpace:
    """u = (remote y_remote + local y_local) / (s + 1)."""
    return control.ss(
        [[-1.0]], [[remote, local]], [[1.0]], np.zeros((1, 2)), inputs=["G2_dw", "G4_dw"], outputs=["G4_vs"]
    )


@pytest.mark.parametrize("local", [-1.0, 0.1, 0.6, 0.7, 2.0])
def test_loss_criterion_decides_stability_of_the_local_loop(local: float) -> None:
    # K_local G_local = 3 local / ((s+1)(s+2)), largest at s = 0 for positive gains: 1.5 local
    plant, K = first_order_plant(), lag_controller(-5.0, local)
    value = loss_criterion(plant, K, "G4_dw")
    assert value == pytest.approx(max(1.5 * local, 0.0), abs=1e-5)
    rightmost = np.linalg.eigvals(closed_loop_matrix(plant, K, lost=("G2_dw",))).real.max()
    assert (rightmost >= 0.0) == (value >= 1.0)


def test_effort_is_the_gain_from_output_disturbance_to_input() -> None:
    # remote only: K/(1 - G K) with G K = 2 r/(s+1)^2; for r < 0 it peaks off zero, found here on a grid
    plant, K = first_order_plant(), lag_controller(-4.0, 0.0)
    s = 1j * np.geomspace(1e-3, 1e3, 200_001)
    k = -4.0 / (s + 1.0)
    assert effort(plant, K) == pytest.approx(np.abs(k / (1.0 - 2.0 / (s + 1.0) * k)).max(), rel=1e-6)


def test_remote_utilisation_is_the_share_of_the_gain() -> None:
    assert remote_utilisation(lag_controller(3.0, 4.0), "G2_dw", 3.9) == pytest.approx(0.6)
    assert remote_utilisation(lag_controller(0.0, 4.0), "G2_dw", 3.9) == 0.0


def test_codes_of_conditions() -> None:
    assert condition_of("N", "G4_dw", "G2_dw") == Condition("N")
    assert condition_of("L+s100", "G4_dw", "G2_dw") == Condition("L+s100", ("G2_dw",), {"G4_dw": 0.1})
    assert condition_of("ns150", "G4_dw", "G2_dw").latency_s_of == {"G2_dw": 0.15}
    with pytest.raises(ValueError, match="parts are N, L"):
        condition_of("x5", "G4_dw", "G2_dw")
    with pytest.raises(ValueError, match="finite and not negative"):
        Condition("late", (), {"G2_dw": -0.1})
