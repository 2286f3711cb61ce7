"""The smoothed objective: its gradient against differences, its value against the plain worst damping."""

from __future__ import annotations

import numpy as np
import pytest

from interarea.design.smoothed import DesignModel, EffortGrid, Objective


@pytest.fixture(scope="module")
def objective() -> Objective:
    rng = np.random.default_rng(1)

    def stable_plant(n: int) -> DesignModel:
        A = rng.normal(size=(n, n))
        A -= (np.linalg.eigvals(A).real.max() + 0.3) * np.eye(n)
        return DesignModel(f"n={n}", A, rng.normal(size=(n, 1)), rng.normal(size=(2, n)))

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
        damping = -eigenvalues.real / np.maximum(np.abs(eigenvalues), 0.2)
        excess.append((offset - damping).max())
    # the poles of this controller lie inside their band, so no penalty is added
    assert sharp(theta)[0] == pytest.approx(max(excess), abs=1e-3)


def test_a_mask_fixes_the_structure(objective: Objective) -> None:
    mask = np.ones(28, dtype=bool)
    mask[:16] = np.eye(4, dtype=bool).ravel()
    masked = Objective(objective.models, 4, mask=mask)
    theta = np.arange(1.0, mask.sum() + 1.0)
    A, _, _, _ = masked.unpack(theta)
    assert np.array_equal(A, np.diag([1.0, 2.0, 3.0, 4.0]))
    assert np.array_equal(masked.pack(*masked.unpack(theta)), theta)
