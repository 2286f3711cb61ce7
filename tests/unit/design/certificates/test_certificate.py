"""The certificate against hand-made loops: loss criterion, effort, remote utilisation, conditions."""

from __future__ import annotations

import control
import numpy as np
import pytest

from interarea.design.certificates.closed_loop import (
    _delayed_poles,
    certificate,
    closed_loop_matrix,
    effort,
    loss_criterion,
    remote_utilisation,
)
from interarea.design.controllers.controller import Controller
from interarea.design.delay.curves import delayed_loop, track_gain, track_roots
from interarea.design.delay.signal_conditions import Condition, condition_of, condition_of_many
from interarea.design.errors import UncertifiedDesign
from interarea.design.modes.modes import Mode, Modes, Participation


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


def test_effort_and_loss_of_a_plant_whose_common_speed_nothing_brings_back() -> None:
    # G = 1/s + 2/(s+1) for one signal, K = k s/(s+1)^2: K/(1 - G K) is finite at 0, and there K G = k
    A, B, C = np.diag([0.0, -1.0]), np.ones((2, 1)), np.array([[1.0, 2.0]])
    plant = control.ss(A, B, C, 0.0, inputs=["G4_vs"], outputs=["G4_dw"])
    for k in (-2.0, 0.3, 0.8):
        K = control.ss(
            [[-2.0, -1.0], [1.0, 0.0]], [[1.0], [0.0]], [[k, 0.0]], 0.0, inputs=["G4_dw"], outputs=["G4_vs"]
        )

        def gains(s: np.ndarray, k: float = k) -> tuple[np.ndarray, np.ndarray]:
            return k * s / (s + 1.0) ** 2, 1.0 / s + 2.0 / (s + 1.0)

        of_K, of_G = gains(1j * np.geomspace(1e-4, 1e3, 100_001))
        stable = np.linalg.eigvals(closed_loop_matrix(plant, K)).real.max() < 1e-6
        if stable:
            assert effort(plant, K) == pytest.approx(np.abs(of_K / (1.0 - of_K * of_G)).max(), rel=1e-5)
        of_K, of_G = gains(np.geomspace(1e-3, 1e3, 100_001))
        assert loss_criterion(plant, K, "G4_dw") == pytest.approx((of_K * of_G).max(), abs=1e-6)
        assert stable == (loss_criterion(plant, K, "G4_dw") < 1.0)


def test_remote_utilisation_is_the_share_of_the_gain() -> None:
    assert remote_utilisation(lag_controller(3.0, 4.0), "G2_dw", 3.9) == pytest.approx(0.6)
    assert remote_utilisation(lag_controller(0.0, 4.0), "G2_dw", 3.9) == 0.0


def test_codes_of_conditions() -> None:
    assert condition_of("N", "G4_dw", "G2_dw") == Condition("N")
    assert condition_of("L+s100", "G4_dw", "G2_dw") == Condition("L+s100", ("G2_dw",), {"G4_dw": 0.1})
    assert condition_of("ns150", "G4_dw", "G2_dw").latency_s_of == {"G2_dw": 0.15}
    several = condition_of_many("s100+L:G1_dw", ("G1_dw", "G2_dw"))
    assert several == Condition("s100+L:G1_dw", ("G1_dw",), {"G2_dw": 0.1})
    wrong = condition_of_many("s100+x-1:G1_dw+x0.5:G2_dw", ("G1_dw", "G2_dw"))
    assert wrong.scale_of == {"G1_dw": -1.0, "G2_dw": 0.5} and wrong.latency_s_of["G1_dw"] == 0.1
    for code in ("x2:G9_dw", "x:G1_dw", "x1e400:G1_dw"):
        with pytest.raises(ValueError, match=r"x<factor>:<one of them> joined by \+, got 'x"):
            condition_of_many(code, ("G1_dw", "G2_dw"))
    with pytest.raises(ValueError, match=r"L:<one of G1_dw, G2_dw>, s.* or x.* joined by \+, got 'L:G9_dw'"):
        condition_of_many("L:G9_dw", ("G1_dw", "G2_dw"))
    stamp = condition_of_many("s100+s300:G2_dw", ("G1_dw", "G2_dw"))
    assert stamp.latency_s_of == {"G1_dw": 0.1, "G2_dw": 0.3} and stamp.kind == "late"
    assert condition_of_many("s300:G2_dw", ("G1_dw", "G2_dw")).latency_s_of == {"G2_dw": 0.3}
    for code in ("ns100", "s300:G9_dw", "ns100:G1_dw"):
        with pytest.raises(ValueError, match=f"got '{code}'"):
            condition_of_many(code, ("G1_dw", "G2_dw"))
    with pytest.raises(ValueError, match="parts are N, L"):
        condition_of("x5", "G4_dw", "G2_dw")
    turned = condition_of_many("s300:G2_dw+s100", ("G1_dw", "G2_dw"))
    assert turned.latency_s_of == stamp.latency_s_of
    with pytest.raises(ValueError, match="finite and not negative"):
        Condition("late", (), {"G2_dw": -0.1})


@pytest.mark.parametrize(
    ("code", "says"),
    [
        ("s100+s200", "G1_dw is late twice"),
        ("s100:G2_dw+s200:G2_dw", "G2_dw is late twice"),
        ("x2:G2_dw+x3:G2_dw", "G2_dw is scaled twice"),
        ("L:G2_dw+L:G2_dw", "G2_dw is lost twice"),
        ("s300:G2_dw+L:G2_dw", "G2_dw is lost and also late or scaled"),
        ("L:G2_dw+x-1:G2_dw", "G2_dw is lost and also late or scaled"),
        ("s99999", "a latency of 99999 ms, allowed: at most 10000 ms"),
    ],
)
def test_a_code_that_contradicts_itself_is_refused(code: str, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        condition_of_many(code, ("G1_dw", "G2_dw"))


def swinging_plant() -> control.StateSpace:
    """Two swings of 0.05 damping at 3 and 7 rad/s behind one actuator, both seen by both signals."""
    blocks = [np.array([[0.0, 1.0], [-(w**2), -2.0 * 0.05 * w]]) for w in (3.0, 7.0)]
    A = np.block([[blocks[0], np.zeros((2, 2))], [np.zeros((2, 2)), blocks[1]]])
    B = np.array([[0.0], [1.0], [0.0], [0.7]])
    C = np.array([[0.0, 1.0, 0.0, -1.0], [0.0, 1.0, 0.0, 1.0]])
    return control.ss(A, B, C, np.zeros((2, 1)), inputs=["G4_vs"], outputs=["G2_dw", "G4_dw"])


def swings(**eigenvalue_of: complex) -> Modes:
    zero = np.zeros(4, complex)
    swings = {
        name.replace("_", "-"): Mode(name.replace("_", "-"), z, {}, Participation(), 1.0, zero, zero)
        for name, z in eigenvalue_of.items()
    }
    return Modes(swings, np.array(list(eigenvalue_of.values())))


def swing_root(omega: float) -> complex:
    return complex(-0.05 * omega, omega * np.sqrt(1.0 - 0.05**2))


def test_a_pole_followed_along_gain_is_the_one_followed_along_latency() -> None:
    plant, K = swinging_plant(), lag_controller(-0.5, -1.0)
    late = {"G2_dw": 0.1, "G4_dw": 0.1}
    for omega in (3.0, 7.0):
        at_gain = track_gain(delayed_loop(plant, K, late), swing_root(omega))
        undelayed = track_gain(delayed_loop(plant, K), swing_root(omega))
        along = track_roots(delayed_loop(plant, K), tuple(late), [0.1], undelayed)[-1]
        assert at_gain == pytest.approx(along, abs=1e-9)


def test_conditions_with_a_latency_of_each_signal_are_judged_at_those_latencies() -> None:
    plant, K = swinging_plant(), lag_controller(-0.5, -1.0)
    modes = swings(inter_area=swing_root(3.0), local=swing_root(7.0))
    condition = Condition("each its own", (), {"G2_dw": 0.2, "G4_dw": 0.05})
    controller = Controller("hand", K)
    row = certificate(plant, controller, modes, [condition])["conditions"][-1]
    loop = delayed_loop(plant, K, condition.latency_s_of)
    for name, mode in modes.items():
        pole = track_gain(loop, mode.eigenvalue)
        assert np.linalg.svd(loop.characteristic(pole)[0], compute_uv=False)[-1] < 1e-9
        assert row["damping_ratio"][name] == pytest.approx(-pole.real / abs(pole), abs=1e-9)


def test_a_swing_pole_that_cannot_be_told_apart_is_a_failure() -> None:
    plant, K = swinging_plant(), lag_controller(-0.5, -1.0)
    same = swings(inter_area=swing_root(3.0), local=swing_root(3.0))
    with pytest.raises(UncertifiedDesign, match=r"'late': .*'inter-area'.*'local'.*both tracked"):
        poles = {name: track_gain(delayed_loop(plant, K), swing_root(3.0)) for name in same}
        _delayed_poles(plant, K, same, poles, Condition("late", (), {"G4_dw": 0.1}))


def test_a_mode_that_the_plant_does_not_have_is_a_failure() -> None:
    plant, K = swinging_plant(), lag_controller(-0.5, -1.0)
    poles = {"inter-area": 40.0 + 40.0j}
    with pytest.raises(
        UncertifiedDesign, match=r"mode 'inter-area' could not be tracked .*not a root of the open loop"
    ):
        _delayed_poles(
            plant, K, swings(inter_area=40.0 + 40.0j), poles, Condition("late", (), {"G4_dw": 0.1})
        )
