"""Exact delay analysis against Lambert W, closed-form margins and Padé of rising order."""

from __future__ import annotations

import control
import numpy as np
import pytest
from independent.two_area import AREAS, OMEGA_B, linear_plant
from scipy.linalg import matrix_balance
from scipy.optimize import brentq
from scipy.special import lambertw

from interarea.design.certificates.closed_loop import swing_poles
from interarea.design.delay.characteristic_roots import DelayedChannel, DelayedLoop, rightmost_roots
from interarea.design.delay.curves import (
    DelayError,
    damping_over_latency,
    delay_margin,
    delayed_loop,
    delayed_plant,
    pade,
    stability_map,
)
from interarea.design.delay.margin import delay_margin_of
from interarea.design.linear.linearise import remove_reference, select, speeds_in_rad
from interarea.design.modes.modes import modes_of
from interarea.design.synthesis.study_designs import design_ftc, design_wdc

INTEGRATOR = control.ss(0.0, 1.0, 1.0, 0.0, inputs=["u"], outputs=["y"])


def gain(k: float) -> control.StateSpace:
    return control.ss([], [], [], [[k]], inputs=["y"], outputs=["u"])


def scalar_loop(a: float, b: float, latency_s: float) -> DelayedLoop:
    """x' = a x(t) + b x(t - latency)."""
    one = np.ones(1)
    return DelayedLoop(np.array([[a]]), (DelayedChannel("y", latency_s, b * one, one),))


@pytest.mark.parametrize(
    ("a", "b", "tau"), [(0.0, -1.0, 1.0), (-0.5, -2.0, 0.4), (0.3, -1.0, 0.8), (-1, 0.9, 3)]
)
def test_rightmost_roots_are_those_of_lambert_w(a: float, b: float, tau: float) -> None:
    # s = a + b exp(-s tau)  <=>  s = a + W_k(b tau exp(-a tau)) / tau
    expected = [a + lambertw(b * tau * np.exp(-a * tau), k) / tau for k in range(-6, 7)]
    expected.sort(key=lambda s: -s.real)
    result = rightmost_roots(scalar_loop(a, b, tau), right_of=-1.0, least=4)
    for s in result[:4]:
        assert min(abs(s - e) for e in expected) < 1e-8
    assert result[0].real == pytest.approx(expected[0].real, abs=1e-8)


@pytest.mark.parametrize("k", [0.5, 2.0, 7.0])
def test_margin_of_a_delayed_integrator(k: float) -> None:
    # x' = -k x(t - tau) is stable for tau < pi / (2 k), crossing at k rad/s
    margin = delay_margin(INTEGRATOR, gain(-k))
    assert margin.margin_s == pytest.approx(np.pi / (2.0 * k), abs=1e-9)
    assert margin.frequency_rad == pytest.approx(k, rel=1e-9)


def test_margin_of_a_lag_with_delayed_feedback() -> None:
    # x' = a x + b x(t - tau), b < -|a|: omega = sqrt(b^2 - a^2), tau = arccos(-a / b) / omega
    a, b = -0.5, -2.0
    omega = np.sqrt(b * b - a * a)
    margin = delay_margin_of(scalar_loop(a, b, 0.0), ("y",))
    assert margin.margin_s == pytest.approx(np.arccos(-a / b) / omega, abs=1e-9)


def test_a_small_gain_has_no_margin_to_lose() -> None:
    # |b| < -a: stable at every latency
    assert delay_margin_of(scalar_loop(-2.0, 1.5, 0.0), ("y",)).margin_s == np.inf


@pytest.mark.parametrize("above", [1e-6, 1e-9])
def test_a_peak_between_grid_points_is_found(above: float) -> None:
    """A resonance that exceeds gain one by a hair does so over 1e-5 of its frequency: no grid sees that.

    |b|^2 = (1 - W)^2 + 4 z^2 W at W = omega^2 gives both crossings; the later root of L is reached first.
    """
    z = 0.5
    b = (1.0 + above) * 2.0 * z * np.sqrt(1.0 - z * z)
    spread = np.sqrt((1.0 - 2.0 * z * z) ** 2 - (1.0 - b * b))
    crossings = np.sqrt(1.0 - 2.0 * z * z + spread * np.array([1.0, -1.0]))
    angles = np.angle(-b / (1.0 - crossings**2 + 2j * z * crossings)) % (2.0 * np.pi)
    A, e = np.array([[0.0, 1.0], [-1.0, -2.0 * z]]), np.eye(2)
    loop = DelayedLoop(A, (DelayedChannel("y", 0.0, -b * e[1], e[0]),))
    margin = delay_margin_of(loop, ("y",))
    assert margin.margin_s == pytest.approx(np.min(angles / crossings), rel=1e-5 * np.sqrt(above / 1e-9))
    assert len(margin.crossings) == 2
    assert [w for _, w in margin.crossings] == pytest.approx(crossings, rel=1e-6)


def test_an_unstable_loop_has_no_margin() -> None:
    with pytest.raises(DelayError, match="not stable without latency"):
        delay_margin(INTEGRATOR, gain(1.0))


@pytest.mark.parametrize("order", [1, 2, 3, 5, 8])
def test_pade_is_all_pass_with_the_phase_of_the_delay(order: int) -> None:
    system = pade(0.1, order)
    omega = np.array([0.5, 2.0, 5.0])
    H = np.array([system(1j * w) for w in omega])
    assert np.allclose(np.abs(H), 1.0, atol=1e-12)
    # the error is of order (omega tau)^(2n+1)
    assert np.all(np.abs(H - np.exp(-0.1j * omega)) <= (0.1 * omega) ** (2 * order + 1) / 2 + 1e-11)


def test_exact_roots_are_the_limit_of_pade() -> None:
    plant = control.ss(
        [[0.0, 1.0], [-16.0, -0.4]], [[0.0], [1.0]], [[0.0, 1.0]], 0.0, inputs=["u"], outputs=["y"]
    )
    K = gain(-1.0)
    exact = rightmost_roots(delayed_loop(plant, K, {"y": 0.15}), right_of=-1.0, least=2)[0]
    late = delayed_plant(plant, {"y": 0.15}, 10)
    values = np.linalg.eigvals(late.A - late.B @ late.C)
    assert np.min(np.abs(values - exact)) < 1e-8


def test_stability_map_is_the_abscissa_of_each_pair() -> None:
    plant = control.ss(-1.0, 1.0, [[1.0], [1.0]], np.zeros((2, 1)), inputs=["u"], outputs=["a", "b"])
    K = control.ss([], [], [], [[-2.0, -1.0]], inputs=["a", "b"], outputs=["u"])
    table = stability_map(plant, K, ("a", [0.1, 0.6]), ("b", [0.0, 0.4]))
    for i, first in enumerate([0.1, 0.6]):
        for j, second in enumerate([0.0, 0.4]):
            roots = rightmost_roots(delayed_loop(plant, K, {"a": first, "b": second}))
            assert table[i, j] == pytest.approx(roots[0].real, abs=1e-8)


@pytest.fixture(scope="module")
def plant() -> control.StateSpace:
    """Full plant of the study, 55 states, speeds in rad/s."""
    return speeds_in_rad(remove_reference(linear_plant("two-area-thesis")), OMEGA_B)


@pytest.fixture(scope="module")
def wdc() -> control.StateSpace:
    return design_wdc(remove_reference(linear_plant("two-area-thesis")), omega_b=OMEGA_B).system


@pytest.fixture(scope="module")
def ftc() -> control.StateSpace:
    return design_ftc(remove_reference(linear_plant("two-area-thesis")), omega_b=OMEGA_B).system


@pytest.mark.slow
def test_synchronous_margin_is_the_phase_at_the_algebraic_unit_gain(
    plant: control.StateSpace, wdc: control.StateSpace
) -> None:
    # one loop L = k g: |L(jw)| = 1 where jw is an eigenvalue of the Hamiltonian matrix, no sweep needed
    G = select(plant, ["G4_vs"], {"dw24": {"G2_dw": 1.0, "G4_dw": -1.0}})
    n = wdc.nstates
    A = np.block([[G.A, G.B @ wdc.C], [np.zeros((n, G.nstates)), wdc.A]])
    B = np.vstack([G.B @ wdc.D[:, :1], wdc.B[:, :1]])
    C = np.hstack([G.C, np.zeros((1, n))])
    H = matrix_balance(np.block([[A, B @ B.T], [-C.T @ C, -A.T]]))[0]
    values = np.linalg.eigvals(H)
    latencies = [
        float(np.angle((C @ np.linalg.solve(1j * w * np.eye(A.shape[0]) - A, B))[0, 0]) % (2 * np.pi) / w)
        for w in values.imag[(np.abs(values.real) < 1e-6 * np.abs(values)) & (values.imag > 0)]
    ]
    assert delay_margin(plant, wdc).margin_s == pytest.approx(min(latencies), abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["wdc", "ftc"])
def test_margin_is_where_the_rightmost_root_crosses(
    plant: control.StateSpace, name: str, request: pytest.FixtureRequest
) -> None:
    K = request.getfixturevalue(name)
    margin = delay_margin(plant, K)
    loop = delayed_loop(plant, K)

    def abscissa(latency_s: float) -> float:
        return float(rightmost_roots(loop.at(dict.fromkeys(K.input_labels, latency_s)), right_of=0.0)[0].real)

    assert margin.margin_s == pytest.approx(
        brentq(abscissa, margin.margin_s - 2e-3, margin.margin_s + 2e-3, xtol=1e-12), abs=1e-6
    )
    # below it the loop is stable everywhere, not only next to it
    assert all(abscissa(t) < 0.0 for t in np.linspace(0.0, 0.999, 12) * margin.margin_s)


def test_late_remote_signal_alone_never_destabilizes(
    plant: control.StateSpace, wdc: control.StateSpace
) -> None:
    assert delay_margin(plant, wdc, ["G2_dw"]).margin_s == np.inf
    loop = delayed_loop(plant, wdc)
    for latency in (0.1, 0.5, 2.0):
        assert rightmost_roots(loop.at({"G2_dw": latency}), right_of=0.0)[0].real < 0.0


@pytest.mark.slow
def test_followed_roots_solve_the_exact_equation(plant: control.StateSpace, wdc: control.StateSpace) -> None:
    start = swing_poles(plant, wdc, modes_of(plant, AREAS))
    sweep = damping_over_latency(plant, wdc, [0.0, 0.1, 0.2, 0.3], roots=start)
    assert sweep.damping("inter-area")[0] == pytest.approx(
        -start["inter-area"].real / abs(start["inter-area"]), abs=1e-9
    )
    for k, latency in enumerate(sweep.latencies_s):
        late = {name: float(latency) for name in wdc.input_labels}
        # Padé of order 8: another model of the delay, exact to rounding at these frequencies
        design = delayed_plant(select(plant, ["G4_vs"], list(wdc.input_labels)), late, 8)
        A = np.block([[design.A + design.B @ wdc.D @ design.C, design.B @ wdc.C], [wdc.B @ design.C, wdc.A]])
        values = np.linalg.eigvals(A)
        for name in start:
            assert np.min(np.abs(values - sweep.roots[name][k])) < 1e-7
