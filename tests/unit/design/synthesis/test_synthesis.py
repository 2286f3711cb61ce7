"""What synthesis promises holds in the closed loop; what cannot be is refused with the nearest that can."""

from __future__ import annotations

from itertools import pairwise

import control
import numpy as np
import pytest

from interarea.design.errors import InfeasibleDesign
from interarea.design.linear.norms import hinf_of
from interarea.design.lmi.recover import recover
from interarea.design.synthesis.generalized_plant import (
    GeneralizedPlant,
    balanced_states,
    effort_plant,
    loop_shift,
    scaled,
)
from interarea.design.synthesis.hinf import (
    Conditioning,
    PoleRegion,
    conventional,
    fault_tolerant,
    hinf_region,
    wide_area_damping,
)
from interarea.design.synthesis.study_designs import WdcSpec


def two_mass() -> control.StateSpace:
    """Two lightly damped masses on a spring, force on the second, both speeds measured."""
    k, d = 8.0, 0.08
    A = np.array([[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0], [-k, k, -d, d], [k, -k, d, -d]])
    A[2, 0] -= 1.0
    A[3, 1] -= 1.0
    A[2, 2] -= 0.15
    A[3, 3] -= 0.15
    B = np.array([[0.0], [0.0], [0.0], [1.0]])
    C = np.array([[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    return control.ss(A, B, C, np.zeros((2, 1)), inputs=["u"], outputs=["remote", "local"])


def poles(G: control.StateSpace, K: control.StateSpace, keep: tuple[float, float] = (1.0, 1.0)) -> np.ndarray:
    A = np.block([[G.A, G.B @ K.C], [K.B @ np.diag(keep[: G.noutputs]) @ G.C, K.A]])
    return np.linalg.eigvals(A)


def damping(values: np.ndarray) -> float:
    return float(np.min(-values.real / np.abs(values)))


@pytest.mark.parametrize("engine", ["structured", "clarabel"])
def test_conventional_meets_its_region_on_the_plant(engine: str) -> None:
    G = two_mass()
    region = PoleRegion(0.25, 0.05, 60.0)
    design = conventional(G, region, engine=engine)
    values = poles(G, design.controller)
    assert damping(values) >= 0.25 - 1e-6
    assert values.real.max() <= -0.05 + 1e-6
    assert np.abs(values).max() <= 60.0 * (1 + 1e-6)
    assert np.all(design.controller.D == 0.0)
    assert (design.controller.input_labels, design.controller.output_labels) == (["remote", "local"], ["u"])


@pytest.mark.slow
def test_effort_is_the_norm_of_k_times_sensitivity() -> None:
    G = two_mass()
    design = conventional(G, PoleRegion(0.2))
    K = design.controller
    w = np.logspace(-2, 3, 4000)
    g, k = G(1j * w), K(1j * w)
    gains = [
        np.linalg.norm(k[:, :, i] @ np.linalg.inv(np.eye(2) - g[:, :, i] @ k[:, :, i]), 2)
        for i in range(w.size)
    ]
    assert design.norm_of["normal"] == pytest.approx(max(gains), rel=1e-3)
    assert design.norm_of["normal"] <= design.gamma


@pytest.mark.slow
def test_more_damping_costs_more_effort() -> None:
    efforts = [conventional(two_mass(), PoleRegion(z)).gamma for z in (0.1, 0.2, 0.3, 0.4)]
    assert all(b > a for a, b in pairwise(efforts))


def test_mixed_sensitivity_of_a_speed_is_never_below_one() -> None:
    """G(0) = 0 makes S(0) = 1: the published goal "< 1" cannot be met."""
    G = two_mass()
    difference = control.ss(G.A, G.B, np.array([[1.0, -1.0]]) @ G.C, 0, inputs=["u"], outputs=["difference"])
    design = wide_area_damping(difference, PoleRegion(0.05), weights=WdcSpec().weights())
    assert design.norm_of["normal"] >= 1.0
    with pytest.raises(InfeasibleDesign) as error:
        wide_area_damping(difference, PoleRegion(0.05), weights=WdcSpec().weights(), gamma_cap=0.9)
    assert error.value.constraint == "gamma"
    assert error.value.reachable == pytest.approx(design.gamma, rel=1e-6)


@pytest.mark.slow
def test_fault_tolerant_keeps_every_target() -> None:
    G = two_mass()
    targets = {"normal": 0.3, "remote_lost": 0.2}
    design = fault_tolerant(G, targets, loss_of={"remote_lost": ("remote",)})
    assert damping(poles(G, design.controller)) >= 0.3 - 1e-4
    assert damping(poles(G, design.controller, (0.0, 1.0))) >= 0.2 - 1e-4
    efforts = [gamma for margin, gamma in design.facts["history"] if margin >= 0.0]
    assert efforts[-1] <= efforts[0]


@pytest.mark.slow
def test_fault_tolerant_with_equal_targets_is_local() -> None:
    """A controller that ignores the remote signal damps the same whatever is lost; none is cheaper."""
    design = fault_tolerant(two_mass(), {"normal": 0.2, "remote_lost": 0.2})
    K = design.controller(1j * np.array([1.0, 4.0]))
    assert np.abs(K[0, 0]).max() < 1e-2 * np.abs(K[0, 1]).max()


@pytest.mark.slow
def test_several_loss_patterns() -> None:
    G = two_mass()
    patterns = {"remote_lost": ("remote",), "local_lost": ("local",)}
    design = fault_tolerant(G, {"normal": 0.08, "remote_lost": 0.055, "local_lost": 0.055}, loss_of=patterns)
    assert damping(poles(G, design.controller, (0.0, 1.0))) >= 0.055 - 1e-4
    assert damping(poles(G, design.controller, (1.0, 0.0))) >= 0.055 - 1e-4


@pytest.mark.slow
def test_infeasible_targets_name_what_was_reached() -> None:
    with pytest.raises(InfeasibleDesign) as error:
        fault_tolerant(two_mass(), {"normal": 0.99, "remote_lost": 0.99}, radius=6.0)
    assert error.value.constraint == "damping_ratio"
    reached = error.value.reachable
    assert 0.0 < reached["normal"] < 0.99
    design = fault_tolerant(two_mass(), {k: 0.95 * z for k, z in reached.items()}, radius=6.0)
    assert damping(poles(two_mass(), design.controller)) >= 0.95 * reached["normal"] - 1e-3


def hidden_mode(zeta: float) -> control.StateSpace:
    """Two resonances of which the input reaches only the first."""
    w = 3.0
    A = np.zeros((4, 4))
    A[:2, :2] = [[0.0, 1.0], [-1.0, -0.1]]
    A[2:, 2:] = [[0.0, 1.0], [-(w**2), -2 * zeta * w]]
    return control.ss(A, [[0], [1], [0], [0]], [[0.0, 1.0, 0.0, 1.0]], 0, inputs=["u"], outputs=["y"])


def test_mode_out_of_reach_is_named_before_solving() -> None:
    with pytest.raises(InfeasibleDesign, match=r"0\.4678 Hz.*cannot be moved") as error:
        conventional(hidden_mode(0.2), PoleRegion(0.3))
    assert error.value.constraint == "controllability"
    assert error.value.reachable == pytest.approx(0.2, rel=1e-6)
    assert conventional(hidden_mode(0.2), PoleRegion(0.15)).damping_ratio["normal"] >= 0.15 - 1e-6


def test_fixed_mode_outside_the_radius_is_named() -> None:
    with pytest.raises(InfeasibleDesign, match="radius >= 3 rad/s"):
        conventional(hidden_mode(0.2), PoleRegion(0.1, None, 2.5))
    conventional(hidden_mode(0.2), PoleRegion(0.1, None, 3.5))


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ((1.2,), "damping_ratio"),
        ((0.1, -1.0), "decay_rate"),
        ((0.1, None, 0.0), "radius"),
        ((0, 5, 4), "contradict"),
    ],
)
def test_bad_region(arguments: tuple[float, ...], word: str) -> None:
    with pytest.raises(ValueError, match=word):
        PoleRegion(*arguments)


@pytest.mark.parametrize(
    ("targets", "losses", "word"),
    [
        ({"remote_lost": 0.2}, None, "normal"),
        ({"normal": 0.2, "lost": 0.1}, {"lost": ("nothing",)}, "nothing"),
        ({"normal": 0.2, "lost": 0.1}, {"lost": ("remote", "local")}, "every signal"),
        ({"normal": 0.2, "a": 0.1, "b": 0.1}, None, "loss_of"),
    ],
)
def test_bad_loss_patterns(
    targets: dict[str, float], losses: dict[str, tuple[str, ...]] | None, word: str
) -> None:
    with pytest.raises(ValueError, match=word):
        fault_tolerant(two_mass(), targets, loss_of=losses)


def test_plant_with_feedthrough_is_refused_and_the_shift_offered() -> None:
    G = two_mass()
    D = np.array([[0.0], [0.3]])
    with pytest.raises(ValueError, match="loop_shift"):
        conventional(control.ss(G.A, G.B, G.C, D), PoleRegion(0.2))
    designed = conventional(G, PoleRegion(0.2)).controller
    K = loop_shift(designed, D)
    closed = control.feedback(control.ss(G.A, G.B, G.C, D), control.ss(K.A, K.B, K.C, K.D), sign=1)
    np.testing.assert_allclose(
        np.sort_complex(closed.poles()), np.sort_complex(poles(G, designed)), rtol=1e-6, atol=1e-6
    )


def test_not_finite_plant_is_refused() -> None:
    G = two_mass()
    G.A[0, 0] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        effort_plant(G)


def test_scaling_changes_no_gain() -> None:
    rng = np.random.default_rng(7)
    s = np.array([1e4, 1e-3, 1.0, 30.0])
    P = effort_plant(two_mass())
    bad = GeneralizedPlant(
        P.A * s / s[:, None], P.B1 / s[:, None], P.B2 / s[:, None], P.C1 * s, P.C2 * s, P.D11, P.D12, P.D21
    )
    good = scaled(balanced_states(bad))
    for w in rng.uniform(0.1, 10.0, 5):
        one = P.C2 @ np.linalg.solve(1j * w * np.eye(4) - P.A, P.B2)
        two = good.C2 @ np.linalg.solve(1j * w * np.eye(4) - good.A, good.B2)
        np.testing.assert_allclose(one, two, rtol=1e-8)
    assert hinf_region(bad, PoleRegion(0.2)).gamma == pytest.approx(
        hinf_region(P, PoleRegion(0.2)).gamma, rel=1e-5
    )


def test_change_of_variables_round_trip() -> None:
    """X, Y and the hatted matrices of a known closed loop: recovery gives its controller back."""
    rng = np.random.default_rng(11)
    G = two_mass()
    n = 4
    K = conventional(G, PoleRegion(0.2)).controller
    A = np.block([[G.A, G.B @ K.C], [K.B @ G.C, K.A]])
    R = rng.standard_normal((2 * n, 2 * n))
    Q = R @ R.T + np.eye(2 * n)
    from scipy.linalg import solve_continuous_lyapunov

    P = solve_continuous_lyapunov(A.T, -Q)
    X, U = P[:n, :n], P[:n, n:]
    S = np.linalg.inv(P)
    Y, V = S[:n, :n], S[:n, n:]
    Bh, Ch = U @ K.B, K.C @ V.T
    Ah = X @ G.A @ Y + X @ G.B @ Ch + Bh @ G.C @ Y + U @ K.A @ V.T
    A_K, B_K, C_K = recover(G.A, G.B, G.C, X, Y, Ah, Bh, Ch)
    for w in (0.1, 1.0, 10.0):
        ours = C_K @ np.linalg.solve(1j * w * np.eye(n) - A_K, B_K)
        np.testing.assert_allclose(ours, K(1j * w), rtol=1e-6, atol=1e-9)


def test_second_solve_slows_the_controller_within_its_slack() -> None:
    free = conventional(two_mass(), PoleRegion(0.2, None, None), conditioning=Conditioning(1e-7))
    slowed = conventional(two_mass(), PoleRegion(0.2, None, None), conditioning=Conditioning(1e-7, 0.05))
    assert slowed.fastest_pole < free.fastest_pole
    assert slowed.gamma == pytest.approx(1.05 * free.facts["gamma_optimum"], rel=1e-6)
    A = np.block(
        [
            [two_mass().A, two_mass().B @ slowed.controller.C],
            [slowed.controller.B @ two_mass().C, slowed.controller.A],
        ]
    )
    B = np.vstack([np.zeros((4, 2)), slowed.controller.B])
    C = np.hstack([np.zeros((1, 4)), slowed.controller.C])
    assert hinf_of(A, B, C, np.zeros((1, 2))).value <= slowed.gamma
