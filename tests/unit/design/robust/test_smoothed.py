"""The smoothed objective: its gradient against differences, its value against the plain worst damping."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import solve_continuous_lyapunov

from interarea.design.robust.design import balanced_parameters
from interarea.design.robust.smoothed_objective import (
    STEEP,
    BandOffsets,
    DesignModel,
    EffortGrid,
    Objective,
)


@pytest.fixture(scope="module")
def objective() -> Objective:
    rng = np.random.default_rng(1)

    def stable_plant(n: int) -> DesignModel:
        A = rng.normal(size=(n, n))
        A -= (np.linalg.eigvals(A).real.max() + 0.3) * np.eye(n)
        return DesignModel(f"n={n}, {A[0, 0]:.3f}", A, rng.normal(size=(n, 1)), rng.normal(size=(2, n)))

    models = [stable_plant(7), stable_plant(7), stable_plant(9)]
    omega = np.logspace(-1, 2, 20)
    g = models[0]
    response = g.C @ np.linalg.inv(1j * omega[:, None, None] * np.eye(7) - g.A) @ g.B
    efforts = [
        EffortGrid("normal", omega, response, np.full(20, 0.05)),
        EffortGrid("other cap", omega, 0.5 * response, np.geomspace(0.2, 0.01, 20)),
        EffortGrid("other grid", omega[::2], response[::2], np.full(10, 0.02)),
    ]
    return Objective(models, 4, efforts, rho=50.0, feedthrough=True)


@pytest.fixture(scope="module")
def blocking(objective: Objective) -> Objective:
    """The same without a free D: K(0) = 0 by D = C A^-1 B."""
    return replace(objective, feedthrough=False, dc_block=True)


def _controller(objective: Objective, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return objective.pack(
        rng.normal(size=(4, 4)) * 0.3 - 2.0 * np.eye(4),
        rng.normal(size=(4, 2)),
        rng.normal(size=(1, 4)),
        0.1 * rng.normal(size=(1, 2)),
    )


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_gradient_agrees_with_central_differences(objective: Objective, seed: int) -> None:
    theta = _controller(objective, seed)
    _, gradient = objective(theta)
    step = 1e-6
    numeric = [
        (objective(theta + step * e)[0] - objective(theta - step * e)[0]) / (2 * step)
        for e in np.eye(theta.size)
    ]
    # central differences of 1e-6 leave about 1e-6 of the size of the gradient
    assert np.allclose(gradient, numeric, atol=2e-6 * max(1.0, np.abs(gradient).max()))


@pytest.mark.parametrize("seed", [1, 2])
def test_gradient_with_the_dc_block_agrees_with_central_differences(blocking: Objective, seed: int) -> None:
    theta = _controller(blocking, seed)
    _, gradient = blocking(theta)
    A, B, C, D = blocking.unpack(theta)
    assert D - C @ np.linalg.solve(A, B) == pytest.approx(0.0, abs=1e-12)  # K(0) = 0
    for k in range(0, theta.size, 3):
        step = np.zeros_like(theta)
        step[k] = 1e-6
        difference = (blocking(theta + step)[0] - blocking(theta - step)[0]) / 2e-6
        assert gradient[k] == pytest.approx(difference, rel=2e-5, abs=2e-6 * np.abs(gradient).max())


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_balancing_changes_the_coordinates_and_nothing_else(blocking: Objective, seed: int) -> None:
    theta = _controller(blocking, seed)
    balanced = balanced_parameters(blocking, theta)
    assert np.abs(balanced - theta).max() > 0.01
    assert blocking(balanced)[0] == pytest.approx(blocking(theta)[0], rel=1e-9)
    A, B, C, _ = blocking.unpack(balanced)
    P, Q = solve_continuous_lyapunov(A, -B @ B.T), solve_continuous_lyapunov(A.T, -C.T @ C)
    assert pytest.approx(Q, abs=1e-9 * np.abs(Q).max()) == P
    assert pytest.approx(np.diag(np.diag(P)), abs=1e-9 * np.abs(P).max()) == P


def test_balancing_keeps_the_parts_of_a_decentralised_controller_apart(objective: Objective) -> None:
    mask = np.ones(16 + 8 + 4, dtype=bool)
    mask[:16] = np.kron(np.eye(2), np.ones((2, 2))).astype(bool).ravel()
    mask[16:24] = np.array([[1, 0], [1, 0], [0, 1], [0, 1]], dtype=bool).ravel()
    split = replace(objective, mask=mask, feedthrough=False, dc_block=True)
    assert split.parts == [[0, 1], [2, 3]]
    theta = np.random.default_rng(5).normal(size=mask.sum())
    A, B, C, _ = split.unpack(theta)
    theta = split.pack(A - 4.0 * np.eye(4), B, C)
    balanced = balanced_parameters(split, theta)
    assert np.abs(balanced - theta).max() > 0.01
    assert split(balanced)[0] == pytest.approx(split(theta)[0], rel=1e-9)


def test_gradient_of_the_pole_band(objective: Objective) -> None:
    theta = _controller(objective, 3)
    A, B, C, D = objective.unpack(theta)
    A = A - A + np.diag([-500.0, -0.01, -1.0, -400.0]) + 0.01 * A
    theta = objective.pack(A, B, C, D)
    _, gradient = objective(theta)
    direction = np.zeros_like(theta)
    direction[:16] = np.random.default_rng(4).normal(size=16)
    step = 1e-5
    numeric = (objective(theta + step * direction)[0] - objective(theta - step * direction)[0]) / (2 * step)
    assert gradient @ direction == pytest.approx(numeric, rel=1e-4)


def test_value_tends_to_the_worst_excess_as_rho_grows(objective: Objective) -> None:
    theta = _controller(objective, 5)
    sharp = Objective(objective.models, 4, rho=1e5, feedthrough=True)
    excess = []
    for A in sharp.closed_loops(theta):
        eigenvalues = np.linalg.eigvals(A)
        offset, _ = sharp.offsets(np.abs(eigenvalues.imag))
        offset = np.where(eigenvalues.real > 0.0, np.maximum(offset, 0.0), offset)
        damping = -eigenvalues.real / np.maximum(np.abs(eigenvalues), 0.2)
        excess.append((offset - damping + np.maximum(eigenvalues.real, 0.0) ** 2).max())
    # the poles of this controller lie inside their band, so no penalty is added
    assert sharp(theta)[0] == pytest.approx(max(excess), abs=1e-3)


@pytest.mark.parametrize("omega", [0.05, 4.0, 30.0])
def test_what_a_root_counts_has_no_jump_and_none_on_the_axis_counts_less_than_0(
    objective: Objective, omega: float
) -> None:
    """With an offset of -0.4 at 30 rad/s a pair on the axis counted -0.4, and 0 a hair beyond: the search
    ran into that step and stayed."""
    lenient = replace(objective, offsets=BandOffsets((0.0, 16.0, 30.0), (0.0, 0.0, -0.4)))

    def counted(growth: float) -> tuple[float, complex]:
        both, slopes = lenient.excess(np.array([growth + 1j * omega]))
        return float(both.max()), complex(slopes[both.argmax()])

    growths = np.linspace(-0.3, 0.3, 6001)
    counts = np.array([counted(growth)[0] for growth in growths])
    assert np.diff(counts).min() > 0.0
    steepest = STEEP * 1e-4 / max(omega, 0.2)
    assert np.diff(counts).max() < 1.01 * steepest
    assert counts[growths > -1e-9].min() > -1e-9
    for growth in (-0.29, -1e-3, 1e-5, 1e-3, 0.1, 1.0):
        step = 1e-7
        for turn in (1.0, 1j):
            z = growth + 1j * omega
            ends = [lenient.excess(np.array([z + d * turn]))[0].max() for d in (step, -step)]
            moved = (counted(growth)[1] * turn).real  # slope: d/da - j d/db
            assert (ends[0] - ends[1]) / (2 * step) == pytest.approx(moved, abs=2e-6)


def test_a_mask_fixes_the_structure(objective: Objective) -> None:
    mask = np.ones(28, dtype=bool)
    mask[:16] = np.eye(4, dtype=bool).ravel()
    masked = Objective(objective.models, 4, mask=mask)
    theta = np.arange(1.0, mask.sum() + 1.0)
    A, _, _, _ = masked.unpack(theta)
    assert np.array_equal(A, np.diag([1.0, 2.0, 3.0, 4.0]))
    assert np.array_equal(masked.pack(*masked.unpack(theta)), theta)


def test_narrowed_leaves_out_the_models_that_are_far_from_the_worst(objective: Objective) -> None:
    theta = _controller(objective, 5)
    tops = {}
    for model in objective.models:
        alone = replace(objective, models=[model], efforts=[])
        (A,) = alone.closed_loops(theta)
        tops[model.name, id(model)] = float(alone.excess(np.linalg.eigvals(A))[0].max())
    spread = max(tops.values()) - min(tops.values())
    assert objective.narrowed(theta, 1.01 * spread).models == objective.models
    few = objective.narrowed(theta, 1e-9).models
    assert [id(model) for model in few] == [max(tops, key=lambda key: tops[key])[1]]
