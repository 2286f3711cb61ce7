"""Exact delay analysis against Lambert W, closed-form margins and Padé of rising order."""

from __future__ import annotations

import control
import numpy as np
import pytest
from scipy.special import lambertw

from interarea.design.delay import DelayError, delay_margin, delayed_loop, delayed_plant, pade, stability_map
from interarea.design.delay_roots import DelayedChannel, DelayedLoop, delay_margin_of, rightmost_roots

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
    found = rightmost_roots(scalar_loop(a, b, tau), right_of=-1.0, least=4)
    for s in found[:4]:
        assert min(abs(s - e) for e in expected) < 1e-8
    assert found[0].real == pytest.approx(expected[0].real, abs=1e-8)


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
