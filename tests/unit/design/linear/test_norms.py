"""Norms and Gramians against closed forms, integrals and SLICOT."""

import control
import numpy as np
import pytest
from independent.two_area import OMEGA_B, linear_plant

from interarea.design.linear.linearise import remove_reference, select, speeds_in_rad
from interarea.design.linear.norms import (
    UnstableSystem,
    frequency_response,
    gramian_factor,
    hankel_singular_values,
    hinf_norm,
    response,
)


def lag(gain: float = 3.0, T: float = 0.5) -> control.StateSpace:
    return control.ss([[-1.0 / T]], [[1.0 / T]], [[gain]], 0.0)


def resonance(zeta: float = 1e-4, omega: float = 4.0) -> control.StateSpace:
    return control.ss([[0.0, 1.0], [-(omega**2), -2 * zeta * omega]], [[0.0], [omega**2]], [[1.0, 0.0]], 0.0)


@pytest.fixture(scope="module")
def loop() -> control.StateSpace:
    full = speeds_in_rad(remove_reference(linear_plant("two-area-thesis")), OMEGA_B)
    return select(full, ["G4_vs"], {"dw24": {"G2_dw": 1.0, "G4_dw": -1.0}})


def test_first_order_lag() -> None:
    # Hankel: gain / 2; H-infinity: gain
    assert hankel_singular_values(lag())[0] == pytest.approx(1.5, rel=1e-13)
    assert hinf_norm(lag()).value == pytest.approx(3.0, rel=1e-7)


@pytest.mark.parametrize("zeta", [1e-6, 1e-3, 0.1, 0.6])
def test_resonance_peak(zeta: float) -> None:
    # 1 / (2 zeta sqrt(1 - zeta^2)) at omega sqrt(1 - 2 zeta^2)
    peak = hinf_norm(resonance(zeta))
    assert peak.value == pytest.approx(1 / (2 * zeta * np.sqrt(1 - zeta**2)), rel=1e-6)
    assert peak.frequency_rad == pytest.approx(4.0 * np.sqrt(1 - 2 * zeta**2), rel=1e-4)


def test_all_pass_is_flat() -> None:
    G = control.ss([[-2.0]], [[2.0]], [[2.0]], [[-1.0]])  # (2 - s)/(2 + s)
    assert hinf_norm(G).value == pytest.approx(1.0, rel=1e-7)
    assert hankel_singular_values(G)[0] == pytest.approx(1.0, rel=1e-13)


def test_gain_at_infinity_and_of_a_constant() -> None:
    assert hinf_norm(control.ss([[-1.0]], [[1.0]], [[-1.0]], [[5.0]])).value == pytest.approx(5.0, rel=1e-7)
    assert hinf_norm(control.ss([], [], [], [[3.0, 4.0]])).value == pytest.approx(5.0)


def test_peak_bounds_a_fine_grid(loop: control.StateSpace) -> None:
    peak = hinf_norm(loop)
    omega = np.linspace(0.99, 1.01, 4001) * peak.frequency_rad
    grid = np.abs(frequency_response(loop.A, loop.B, loop.C, loop.D, omega)).max()
    assert grid <= peak.value and peak.value == pytest.approx(grid, rel=1e-6)


def test_two_almost_equal_peaks() -> None:
    one, two = resonance(0.01, 2.0), resonance(0.00999, 50.0)
    G = control.append(one, two)
    # higher of two, by the closed form
    assert hinf_norm(G).value == pytest.approx(1 / (2 * 0.00999 * np.sqrt(1 - 0.00999**2)), rel=1e-7)


def test_gramian_factor_solves_the_lyapunov_equation(loop: control.StateSpace) -> None:
    A, B = np.asarray(loop.A), np.asarray(loop.B)
    L = gramian_factor(A, B)
    assert np.allclose(np.triu(L, 1), 0.0)
    P = L @ L.T
    # in states of unit variance, rounding is relative to the norm of A
    d = np.sqrt(np.diag(P))
    scaled = A * d / d[:, None]
    residual = (A @ P + P @ A.T + B @ B.T) / np.outer(d, d)
    assert np.max(np.abs(residual)) <= 1e-12 * np.linalg.norm(scaled)


def test_h2_is_the_energy_of_the_impulse_response() -> None:
    G = resonance(0.3)
    # closed form omega / (4 zeta) for omega^2 / (s^2 + 2 zeta omega s + omega^2)
    energy = np.linalg.norm(G.C @ gramian_factor(G.A, G.B)) ** 2
    assert energy == pytest.approx(4.0 / (4 * 0.3), rel=1e-12)


def test_agrees_with_slicot(loop: control.StateSpace) -> None:
    slicot = pytest.importorskip("ctrlsys")
    A, B, C, D = (np.asfortranarray(M, dtype=float) for M in (loop.A, loop.B, loop.C, loop.D))
    n = A.shape[0]
    gains = slicot.ab13dd(
        "C", "I", "N", "D", n, 1, 1, np.array([0.0, 1.0]), A, np.asfortranarray(np.eye(n)), B, C, D, 1e-9
    )
    assert hinf_norm(loop).value == pytest.approx(gains[0][0] / gains[0][1], rel=1e-6)


def test_hankel_values_are_the_roots_of_pq(loop: control.StateSpace) -> None:
    P, Q = (L @ L.T for L in (gramian_factor(loop.A, loop.B), gramian_factor(loop.A.T, loop.C.T)))
    roots = np.sort(np.sqrt(np.abs(np.linalg.eigvals(P @ Q))))[::-1]
    assert hankel_singular_values(loop)[:8] == pytest.approx(roots[:8], rel=1e-5)


def test_unstable_systems_are_refused_by_name() -> None:
    with pytest.raises(UnstableSystem, match=r"0\.5"):
        hinf_norm(control.ss([[0.5]], [[1.0]], [[1.0]], 0.0))
    with pytest.raises(UnstableSystem, match="Gramian"):
        gramian_factor(np.array([[0.0]]), np.array([[1.0]]))


def test_frequency_response_of_a_lag_is_its_closed_form() -> None:
    lag = control.ss([[-2.0]], [[2.0]], [[1.0]], [[0.5]])
    omega = np.array([0.0, 2.0, 20.0])
    got = response(lag, omega)[:, 0, 0]
    assert got == pytest.approx(2.0 / (1j * omega + 2.0) + 0.5, abs=1e-14)


def test_frequency_response_without_states_is_the_gain() -> None:
    got = response(control.ss([], [], [], [[3.0]]), np.array([1.0, 10.0]))
    assert np.array_equal(got, np.full((2, 1, 1), 3.0 + 0j))
