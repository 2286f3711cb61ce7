"""Steps of the smoothed worst damping: second derivatives against differences, descent, start."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from interarea.design.robust.design import _descend, balanced_parameters
from interarea.design.robust.first_guess import _moves, first_guess
from interarea.design.robust.newton import Expansion, expansion, newton_descent
from interarea.design.robust.smoothed_objective import (
    STEEP,
    BandOffsets,
    DesignModel,
    EffortGrid,
    Objective,
)
from interarea.design.robust.stages import Stage, staged_search, with_best_gain

#: two parts of two states, each with a signal and an actuator of its own
PARTS = np.concatenate(
    [np.kron(np.eye(2), np.ones(shape)).ravel() for shape in ((2, 2), (2, 1), (1, 2), (1, 1))]
)


def _swinging(name: str, seed: int) -> DesignModel:
    """Three weakly damped oscillators, two inputs, two outputs; another seed, a little otherwise."""
    same, rng = np.random.default_rng(7), np.random.default_rng(seed)
    A = np.zeros((6, 6))
    for k, omega in enumerate((2.5, 3.7, 7.0) * rng.uniform(0.9, 1.1, 3)):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[-0.05 * omega, omega], [-omega, -0.05 * omega]]
    B, C = same.normal(size=(6, 2)), same.normal(size=(2, 6))
    return DesignModel(name, A, B + 0.1 * rng.normal(size=B.shape), C + 0.1 * rng.normal(size=C.shape))


@pytest.fixture(scope="module", params=[False, True], ids=["full", "decentralised, K(0) = 0"])
def objective(request: pytest.FixtureRequest) -> Objective:
    models = [_swinging("base: N", 1), _swinging("base: s100", 2), _swinging("other: N", 3)]
    omega, g = np.geomspace(0.5, 30.0, 15), models[0]
    response = g.C @ np.linalg.inv(1j * omega[:, None, None] * np.eye(6) - g.A) @ g.B
    return Objective(
        models,
        4,
        [EffortGrid("base: N", omega, response, np.full(15, 0.05))],
        offsets=BandOffsets((0.0, 30.0), (0.0, 0.0)),
        rho=40.0,
        mask=PARTS.astype(bool) if request.param else None,
        feedthrough=not request.param,
        dc_block=request.param,
    )


def _controller(objective: Objective, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return objective.pack(
        rng.normal(size=(4, 4)) * 0.3 - np.diag([1.0, 2.0, 4.0, 6.0]),
        rng.normal(size=(4, 2)),
        0.05 * rng.normal(size=(2, 4)),
        0.02 * rng.normal(size=(2, 2)),
    )


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_second_derivatives_agree_with_differences_of_the_gradient(objective: Objective, seed: int) -> None:
    free = replace(objective, efforts=[], slowest_pole=1e-3, fastest_pole=1e4)
    theta = _controller(objective, seed)
    near = expansion(free, theta, np.full(theta.size, 1.0))
    gradient, hessian = near.derivatives(np.zeros(theta.size))
    assert near.value(np.zeros(theta.size)) == pytest.approx(free.value(theta), abs=1e-4)
    assert gradient == pytest.approx(free(theta)[1], abs=2e-4 * np.abs(gradient).max())
    step = 1e-5
    numeric = np.array(
        [(free(theta + step * e)[1] - free(theta - step * e)[1]) / (2 * step) for e in np.eye(theta.size)]
    )
    # eigenvalues far below the worst are left out
    assert hessian == pytest.approx(numeric, abs=2e-3 * np.abs(numeric).max())
    scale = np.random.default_rng(seed).uniform(0.1, 3.0, theta.size)
    scaled = expansion(free, theta, scale).derivatives(np.zeros(theta.size))
    assert scaled[0] == pytest.approx(scale * gradient, abs=1e-9 * np.abs(gradient).max())
    bend = np.abs(hessian).max()
    assert scaled[1] == pytest.approx(np.outer(scale, scale) * hessian, abs=1e-3 * bend)


@pytest.mark.parametrize("margin", [0.0, 0.3])
def test_hinges_agree_with_differences_and_their_squares_with_the_penalty(
    objective: Objective, margin: float
) -> None:
    tight = replace(objective, slowest_pole=1.5, fastest_pole=5.0)
    theta = _controller(objective, 4)
    K = tight.unpack(theta)
    values, rows = tight.hinges(K, margin)
    assert values.size > 6
    assert tight.penalties(K)[0] == pytest.approx((np.maximum(values, 0.0) ** 2).sum())
    direction = np.random.default_rng(5).normal(size=theta.size)
    ahead, behind = (tight.hinges(tight.unpack(theta + s * direction), margin)[0] for s in (1e-6, -1e-6))
    assert rows @ direction == pytest.approx((ahead - behind) / 2e-6, rel=1e-4, abs=1e-5)


def test_the_least_value_of_an_expansion_is_below_that_of_any_other_move(objective: Objective) -> None:
    tight = replace(objective, slowest_pole=1.5, fastest_pole=5.0)
    theta, rng = _controller(objective, 4), np.random.default_rng(6)
    near = expansion(tight, theta, np.full(theta.size, 0.3)).convex()
    assert near.hinges.size > 6
    for held in (1e-4, 0.1, 10.0):
        move, fall = near.least(held)
        assert fall == pytest.approx(near.value(np.zeros(theta.size)) - near.value(move))
        assert fall > 0.0
        reached = near.value(move) + 0.5 * held * float(move @ move)
        for size in (1e-3, 0.1, 1.0):
            for other in move + size * rng.normal(size=(50, theta.size)):
                assert near.value(other) + 0.5 * held * float(other @ other) >= reached - 1e-9


def test_an_expansion_follows_the_objective_where_its_own_quadratic_does_not(objective: Objective) -> None:
    """Far enough for other eigenvalues to become the worst, and near enough for each to run straight."""
    free = replace(objective, efforts=[], slowest_pole=1e-3, fastest_pole=1e4, rho=2000.0)
    theta, rng = _controller(objective, 1), np.random.default_rng(8)
    theta, _ = newton_descent(free, theta, 15, balanced=balanced_parameters)
    near = expansion(free, theta, np.ones(theta.size))
    gradient, hessian = near.derivatives(np.zeros(theta.size))
    errors = []
    for _ in range(20):
        move = 0.002 * rng.normal(size=theta.size)
        real = free.value(theta + move) - free.value(theta)
        itself = near.value(move) - near.value(np.zeros(theta.size))
        quadratic = gradient @ move + 0.5 * move @ hessian @ move
        errors.append((abs(itself - real), abs(quadratic - real)))
    of_expansion, of_quadratic = np.median(errors, axis=0)
    assert of_expansion < 0.2 * of_quadratic


def test_a_direction_of_falling_curvature_is_held_back_as_one_of_rising() -> None:
    one = np.ones(1)
    near = Expansion(
        100.0, np.zeros(1), np.array([[1.0, 1.0]]), one, np.diag([4.0, -4.0]), np.zeros(0), np.zeros((0, 2))
    )
    move, _ = near.convex().least(1e-9)
    assert move == pytest.approx([-0.25, -0.25], rel=1e-4)


def test_a_bound_far_steeper_than_the_rest_does_not_end_a_search() -> None:
    """Rounding takes the least eigenvalues of the Hessian below 0; the least value is at the bound's edge."""
    rng = np.random.default_rng(0)
    n, steep = 40, 1e9 * rng.standard_normal((3, 40))
    near = Expansion(
        40.0, np.zeros(1), rng.standard_normal((1, n)), np.ones(1), np.zeros((n, n)), np.ones(3), steep
    )
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.cholesky(near.derivatives(np.zeros(n))[1] + 1e-6 * np.eye(n))
    move, fall = near.least(1e-6)
    assert fall > 2.9  # 3 is what the three bounds are exceeded by at rest, squared
    assert np.all(near.hinges + steep @ move < 1e-3)


def test_an_operating_point_that_is_asked_more_is_that_much_worse(objective: Objective) -> None:
    theta = _controller(objective, 3)
    K = objective.unpack(theta)
    offsets = BandOffsets((0.0, 2.0, 3.0, 5.0, 6.0), (0.0, 0.0, 0.1, 0.1, 0.0))
    models = [replace(m, more=(offsets,) if m.name.startswith("base") else ()) for m in objective.models]
    raised = replace(objective, models=models)
    for (group, _, loops, before), (*_, after) in zip(objective.spectra(K), raised.spectra(K), strict=True):
        for k, model in enumerate(group):
            omega = np.abs(np.linalg.eigvals(loops[k]).imag)
            extra = offsets(omega)[0] if model.name.startswith("base") else np.zeros(omega.size)
            added = np.split(after[k] - before[k], 2)
            assert np.sort(added[0]) == pytest.approx(np.sort(extra), abs=1e-9)
            assert added[1] == pytest.approx(0.0, abs=1e-9)  # stability is asked everywhere
    step, direction = 1e-6, np.random.default_rng(9).normal(size=theta.size)
    ahead, behind = (raised.value(theta + s * direction) for s in (step, -step))
    assert raised(theta)[1] @ direction == pytest.approx((ahead - behind) / (2 * step), rel=1e-4)
    assert raised.value(theta) > objective.value(theta)


def _staged(objective: Objective, stages: tuple[Stage, ...]) -> tuple[np.ndarray, int]:
    theta, count, result = staged_search(
        objective,
        stages,
        [],
        1,
        0.2,
        np.random.default_rng(1),
        balanced=balanced_parameters,
        descend=lambda runs, at: _descend(runs, at, 1, each=60),
    )
    assert len(result) == 1
    return theta, count


def test_steps_never_go_up(objective: Objective) -> None:
    theta, value = _controller(objective, 5), np.inf
    for steps in (1, 3, 9):
        result, _ = newton_descent(objective, theta, steps, balanced=balanced_parameters)
        assert objective.value(result) < min(value, objective.value(theta))
        value = objective.value(result)


@pytest.mark.slow
def test_a_later_stage_goes_on_from_the_one_before(objective: Objective) -> None:
    first = Stage(points=("base",), rho=(40.0,), steps=10)
    only, _ = _staged(objective, (first,))
    both, _ = _staged(objective, (first, Stage(rho=(40.0,), steps=20)))
    assert objective.value(both) < objective.value(only) - 3e-4


def test_a_later_stage_begins_no_worse_than_without_control(objective: Objective) -> None:
    A, B, C, D = objective.unpack(_controller(objective, 5))
    harmful = objective.pack(A, B, 30.0 * C, 30.0 * D)
    without = objective.value(objective.pack(A, B, 0.0 * C, 0.0 * D))
    assert objective.value(harmful) > without + 0.1
    lowered = with_best_gain(objective, harmful)
    assert objective.value(lowered) < without + 5e-3  # the least gain is not quite none
    assert np.linalg.eigvals(objective.unpack(lowered)[0]) == pytest.approx(np.linalg.eigvals(A))
    good = with_best_gain(objective, _controller(objective, 5))
    assert objective.value(good) <= objective.value(_controller(objective, 5))


@pytest.mark.slow
def test_a_stage_without_time_leaves_what_it_got(objective: Objective) -> None:
    first = Stage(points=("base",), rho=(40.0,), steps=10)
    only, counted = _staged(objective, (first,))
    both, count = _staged(objective, (first, Stage(rho=(40.0, 80.0), steps=20, longest_s=1e-9)))
    assert objective.value(both) == pytest.approx(objective.value(only), abs=1e-12)
    assert count == counted + 1  # the value from which no step was made


def test_a_search_ends_stable_and_at_the_best_of_all_controllers_that_a_grid_has() -> None:
    """What damps the slow mode drives the fast one, of which nothing is asked but to decay."""

    def pair(damping: float, omega: float) -> np.ndarray:
        return omega * np.array([[-damping, 1.0], [-1.0, -damping]])

    A = np.block([[pair(0.03, 3.0), np.zeros((2, 2))], [np.zeros((2, 2)), pair(0.05, 9.0)]])
    B, C = np.array([[1.0], [0.0], [1.0], [0.0]]), np.array([[1.0, 0.0, -4.0, 0.0]])
    lenient = BandOffsets((0.0, 5.0, 8.0), (0.0, 0.0, -0.6))
    bounds = {"offsets": lenient, "rho": 900.0, "slowest_pole": 0.3, "fastest_pole": 60.0}
    objective = Objective([DesignModel("base: N", A, B, C)], 1, **bounds)
    theta, _ = _staged(objective, (Stage(rho=(60.0, 300.0, 900.0)),))
    (loop,) = objective.closed_loops(theta)
    reached = np.linalg.eigvals(loop)
    assert reached.real.max() < 0.0

    def worst(roots: np.ndarray) -> float:
        damping = -roots.real / np.abs(roots)
        return float(max((lenient(np.abs(roots.imag))[0] - damping).max(), (-STEEP * damping).max()))

    poles, gains = -np.geomspace(0.5, 20.0, 60), np.geomspace(0.1, 20.0, 60)
    loops = [np.block([[A, g * B], [C, np.full((1, 1), pole)]]) for pole in poles for g in (*gains, *-gains)]
    best = min(worst(roots) for roots in np.linalg.eigvals(np.array(loops)))
    assert best < -0.15  # without control -0.03
    assert worst(reached) < best + 1e-3


def test_the_value_alone_is_that_with_the_gradient(objective: Objective) -> None:
    theta = _controller(objective, 3)
    assert objective.value(theta) == pytest.approx(objective(theta)[0], rel=1e-12)


def test_the_first_guess_damps_every_mode_and_turns_with_the_plant(objective: Objective) -> None:
    still = objective.pack(-np.eye(4), np.zeros((4, 2)), np.zeros((2, 4)))
    guess = first_guess(objective, np.random.default_rng(1), 0.2)
    assert objective.value(guess) < objective.value(still) - 1e-3
    turned = replace(objective, models=[replace(m, B=-m.B) for m in objective.models], efforts=[])
    other = first_guess(turned, np.random.default_rng(1), 0.02)
    free = replace(objective, efforts=[])
    guess = first_guess(free, np.random.default_rng(1), 0.02)
    A, B, C, _ = free.unpack(guess)
    again = turned.unpack(other)
    assert again[0] == pytest.approx(A)
    assert again[1] == pytest.approx(B)
    assert again[2] == pytest.approx(-C, abs=1e-9)


def test_the_first_guess_knows_how_every_gain_moves_every_mode(objective: Objective) -> None:
    rng = np.random.default_rng(2)
    poles = np.array([1.0, 2.0, 3.5, 6.0])
    A, B, C, _ = objective.unpack(
        objective.pack(-np.diag(poles), rng.normal(size=(4, 2)), rng.normal(size=(2, 4)))
    )
    moves, worst = _moves(objective, poles)
    predicted = np.einsum("ksij,is,sj->k", moves, C, B)
    small, k = 1e-6, 0
    for model in objective.models:
        (loop,) = replace(objective, models=[model]).closed_loops(objective.pack(A, small * B, C))
        moved = np.linalg.eigvals(loop)
        for value in np.linalg.eigvals(model.A):
            if value.imag > 0.0:
                after = moved[np.argmin(np.abs(moved - value))]
                v, w = (objective.excess(np.array([each]))[0][0] for each in (value, after))
                assert v == pytest.approx(worst[k])
                assert (w - v) / small == pytest.approx(predicted[k], rel=1e-3, abs=1e-4)
                k += 1
    assert k == len(worst)


def test_the_first_guess_of_many_signals_is_better_than_that_of_drawn_sums(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # one mode to damp, and one that most sums of the three signals drive
    A = np.zeros((4, 4))
    for k, omega in enumerate((3.0, 7.0)):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[-0.1, omega], [-omega, -0.1]]
    B = np.array([[1.0], [0.0], [-4.0], [0.0]])
    C = np.array([[1.0, 0.0, 1.0, 0.0], [1.0, 0.0, 1.0, 0.0], [1.0, 0.0, -2.0, 0.0]])
    offsets = BandOffsets((0.0, 5.0, 5.1, 30.0), (0.0, 0.0, 0.02, 0.02))
    objective = Objective([DesignModel("base: N", A, B, C)], 1, offsets=offsets, rho=200.0)

    def reached(covered: int) -> list[float]:
        monkeypatch.setattr("interarea.design.robust.first_guess.COVERED", covered)
        return [
            objective.value(first_guess(objective, np.random.default_rng(seed), 0.1)) for seed in range(4)
        ]

    with_inputs, drawn = reached(2), reached(3)
    assert all(more <= less for more, less in zip(with_inputs, drawn, strict=True))
    assert sum(with_inputs) < sum(drawn) - 0.02


def test_a_stage_looks_at_its_points_and_conditions_only(objective: Objective) -> None:
    def names(stage: Stage) -> list[str]:
        return [model.name for model in stage.of(objective).models]

    assert names(Stage()) == ["base: N", "base: s100", "other: N"]
    assert names(Stage(points=("base",))) == ["base: N", "base: s100"]
    assert names(Stage(conditions=("N",))) == ["base: N", "other: N"]
    assert [e.name for e in Stage(points=("other",)).of(objective).efforts] == []


def test_a_stage_with_a_band_of_its_own_wants_that_much_more_there(objective: Objective) -> None:
    theta = _controller(objective, 3)
    everywhere = BandOffsets((0.0, 1.0), (0.3, 0.3))
    plain, raised = Stage().of(objective), Stage(offsets=everywhere).of(objective)
    assert plain.offsets == objective.offsets
    own = replace(plain, offsets=BandOffsets((0.0, 1.0), (0.0, 0.0)))
    top = [max(float(v.max()) for *_, v in each.spectra(each.unpack(theta))) for each in (own, raised)]
    assert top[1] - top[0] == pytest.approx(0.3)
