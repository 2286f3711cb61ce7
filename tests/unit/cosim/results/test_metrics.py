"""Metrics against signals whose answer is known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from interarea.cosim.results import matrix_pencil as pencil
from interarea.cosim.results import metrics as m

T = 0.05 * np.arange(300)


def swing(zeta: float, frequency_hz: float, phase: float = 0.0) -> np.ndarray:
    """Free oscillation of damping ratio zeta; frequency_hz is the damped one, Im / 2 pi."""
    w = 2 * np.pi * frequency_hz
    return np.exp(-zeta / np.sqrt(1 - zeta**2) * w * T) * np.cos(w * T + phase)


def test_three_modes_in_four_signals_are_told_apart() -> None:
    shapes = np.array([[1.0, 0.9, -0.8, -1.0], [0.5, -0.6, 0.0, 0.01], [0.0, 0.02, 0.4, -0.4]])
    expected = [(0.08, 0.62), (0.25, 1.14), (0.20, 1.21)]
    values = sum(np.outer(swing(z, f), s) for (z, f), s in zip(expected, shapes, strict=True))
    fit = m.ring_down(T, values, rank_tolerance=1e-8)
    result = sorted((mode.frequency_hz, mode.damping_ratio) for mode in fit.modes)
    np.testing.assert_allclose(result, [(f, z) for z, f in expected], rtol=1e-6)
    assert fit.error <= 1e-9


@pytest.mark.slow
@given(st.floats(-0.02, 0.5), st.floats(0.2, 2.5), st.floats(0.0, 6.0))
def test_one_mode_is_found_whatever_its_damping_frequency_and_phase(z: float, f: float, phase: float) -> None:
    (mode,) = m.ring_down(T, swing(z, f, phase)[:, None], rank_tolerance=1e-9).modes[:1]
    assert mode.damping_ratio == pytest.approx(z, abs=1e-6)
    assert mode.frequency_hz == pytest.approx(f, rel=1e-6)


def test_noise_moves_the_damping_by_its_own_size() -> None:
    noisy = swing(0.1, 0.6) + 1e-4 * np.random.default_rng(3).standard_normal(len(T))
    assert m.ring_down(T, noisy[:, None], rank_tolerance=1e-2).modes[0].damping_ratio == pytest.approx(
        0.1, abs=1e-3
    )


def test_silence_has_no_modes() -> None:
    assert m.ring_down(T, np.zeros((len(T), 2))).modes == ()


@pytest.mark.parametrize("times", [T[:5], np.sort(np.random.default_rng(0).uniform(0, 1, 50))])
def test_windows_that_cannot_be_fitted_are_refused(times: np.ndarray) -> None:
    with pytest.raises(ValueError, match="ring_down"):
        m.ring_down(times, np.ones((len(times), 1)))


def test_settling_time_of_an_exponential() -> None:
    t = np.linspace(0.0, 10.0, 100_001)
    assert m.settling_time_s(t, np.exp(-t), 0.0) == pytest.approx(np.log(50.0), abs=1e-6)
    assert m.settling_time_s(t, np.exp(-t), 1.0) == pytest.approx(np.log(50.0) - 1.0, abs=1e-6)
    assert m.settling_time_s(t, np.cos(t), 0.0) is None


def test_energy_of_a_sine() -> None:
    t = np.linspace(0.0, 2.0, 20_001)
    assert m.energy(t, np.sin(np.pi * t)) == pytest.approx(1.0, abs=1e-8)
    assert m.energy(t, np.sin(np.pi * t), 1.0) == pytest.approx(0.5, abs=1e-8)


def test_a_uniform_window_drops_extra_points_only() -> None:
    time = np.sort(np.append(T, [1.2345, 3.3333]))
    grid, values = m.uniform(time, [np.sin(time)], 1.0, 5.0, 0.1)
    assert grid[0] == 1.0 and grid[-1] == pytest.approx(5.0)
    np.testing.assert_allclose(values[:, 0], np.sin(grid), atol=1e-13)


def hankel_of(values: np.ndarray, rows: int) -> np.ndarray:
    return np.hstack([np.lib.stride_tricks.sliding_window_view(x, rows).T for x in values.T])


@given(st.integers(2, 30), st.integers(0, 40), st.integers(1, 5), st.integers(0, 2**32 - 1))
def test_the_product_of_windows_is_that_of_the_hankel_matrix(
    rows: int, more: int, signals: int, seed: int
) -> None:
    values = np.random.default_rng(seed).standard_normal((rows + more, signals))
    hankel = hankel_of(values, rows)
    product = np.triu(pencil.windows_product(values, rows))
    np.testing.assert_allclose(product, np.triu(hankel @ hankel.T), atol=1e-12 * (1 + rows + more))


@pytest.mark.parametrize("level", [0.0, 1e-9, 1e-3, 0.3])
@pytest.mark.parametrize("tolerance", [1e-4, 1e-7])
def test_the_signal_space_is_that_of_the_singular_vectors(level: float, tolerance: float) -> None:
    # A swing with a limit cycle's harmonics and noise: the spectrum falls slowly, the hard case.
    noise = np.random.default_rng(5).standard_normal((len(T), 4))
    shape = np.array([1.0, 0.9, -0.8, -1.0])
    values = np.outer(swing(0.05, 0.6) + 0.1 * swing(0.01, 1.8), shape) + level * noise
    left, sigma, _ = np.linalg.svd(hankel_of(values, 180), full_matrices=False)
    order = min(int(np.sum(sigma > tolerance * sigma[0])), 24)
    space = pencil.signal_space(values, 180, tolerance, 24)
    assert space.shape == (180, order)
    np.testing.assert_allclose(space.T @ space, np.eye(order), atol=1e-12)
    np.testing.assert_allclose(np.abs(np.diag(left[:, :4].T @ space[:, :4])), 1.0, atol=1e-9)
    assert np.linalg.norm(left[:, :order].T @ space, 2) == pytest.approx(1.0, abs=1e-9)


def test_amplitudes_have_size_and_phase_of_the_swings_they_come_from() -> None:
    values = np.column_stack([2.0 * swing(0.1, 0.6, 0.4) + 3.0 * np.exp(-0.2 * T), -swing(0.1, 0.6, 0.4)])
    fit = m.ring_down(T, values)
    (mode,) = fit.modes
    np.testing.assert_allclose(mode.amplitudes, np.array([2.0, -1.0]) * np.exp(0.4j), rtol=1e-7)
    assert fit.error <= 1e-9


def test_jolts_mislead_a_pencil_but_not_a_robust_fit_of_the_modes_there_are() -> None:
    """One sample in ten is off by up to a fifth of the signal, as where packets are lost."""
    rng = np.random.default_rng(7)
    clean = np.outer(swing(0.08, 0.62), [1.0, -0.8]) + np.outer(swing(0.2, 1.2), [0.3, 0.4])
    jolts = (rng.random(clean.shape) < 0.1) * rng.uniform(-0.2, 0.2, clean.shape)
    first = m.ring_down(T, clean + jolts)
    assert not first.good
    starts = [-0.2 + 3.5j, -1.0 + 8.0j]
    result = m.robust_ring_down(T, clean + jolts, first, starts)
    assert result.method == "variable projection" and len(result.modes) == 2
    slow = min(result.modes, key=lambda mode: mode.frequency_hz)
    assert slow.frequency_hz == pytest.approx(0.62, rel=5e-3)
    assert slow.damping_ratio == pytest.approx(0.08, abs=2e-3)
    near = min(first.modes, key=lambda mode: abs(mode.frequency_hz - 0.62))
    assert abs(near.damping_ratio - 0.08) > abs(slow.damping_ratio - 0.08)
