"""Reductions: bounds, Glover's equality, SLICOT, modes that are kept, closed-loop weights."""

from collections.abc import Callable
from functools import partial

import control
import numpy as np
import pytest
from independent.two_area import OMEGA_B, linear_plant
from scipy.linalg import solve_continuous_are

from interarea.design.linear.linearise import remove_reference, select, speeds_in_rad
from interarea.design.linear.norms import frequency_response, hankel_singular_values, hinf_of
from interarea.design.reduction.balanced import (
    ReductionError,
    balanced_truncation,
    closed_loop_reduction,
    hankel_reduction,
    singular_perturbation,
    weighted_reduction,
)
from interarea.design.reduction.gramians import Reduction, difference, matrices


def two_area(name: str = "two-area-thesis") -> control.StateSpace:
    return speeds_in_rad(remove_reference(linear_plant(name)), OMEGA_B)


@pytest.fixture(scope="module")
def loop() -> control.StateSpace:
    """dw24 over G4_vs, 55 states."""
    return select(two_area(), ["G4_vs"], {"dw24": {"G2_dw": 1.0, "G4_dw": -1.0}})


@pytest.fixture(scope="module")
def speeds() -> control.StateSpace:
    """Four actuators to four speeds."""
    return select(two_area(), None, [f"G{k}_dw" for k in range(1, 5)])


def slicot_arguments(system: control.StateSpace) -> tuple[np.ndarray, ...]:
    return tuple(np.array(M, dtype=float, order="F") for M in matrices(system))


def distance(one: control.StateSpace, two: tuple[np.ndarray, ...]) -> float:
    """H-infinity norm of the difference relative to one."""
    return hinf_of(*difference(matrices(one), two)).value / hinf_of(*matrices(one)).value  # type: ignore[arg-type]


def test_three_states_by_hand() -> None:
    # 1/(s+1) + 1e-3/(s+100): truncation to order 1 keeps the slow pole
    G = control.ss([[-1.0, 0.0], [0.0, -100.0]], [[1.0], [1.0]], [[1.0, 1e-3]], 0.0)
    r = balanced_truncation(G, 1)
    assert r.system.poles()[0] == pytest.approx(-1.0, rel=1e-4)
    assert r.error <= r.bound * (1 + 1e-6)  # equal here; the norm is known to 1e-8


@pytest.mark.slow
@pytest.mark.parametrize("order", [2, 4, 6, 9, 12])
def test_errors_obey_their_bounds(loop: control.StateSpace, order: int) -> None:
    for r in (
        balanced_truncation(loop, order),
        singular_perturbation(loop, order),
        hankel_reduction(loop, order),
        hankel_reduction(loop, order, feedthrough="optimal"),
    ):
        assert r.order == order
        assert r.bound is not None
        # no reduction of this order is closer than sigma_{k+1}, none of these farther than its bound
        assert r.hankel_values[order] * (1 - 1e-6) <= r.error <= r.bound * (1 + 1e-6)


@pytest.mark.parametrize(
    "reduce",
    [
        balanced_truncation,
        singular_perturbation,
        hankel_reduction,
        partial(hankel_reduction, feedthrough="optimal"),
    ],
)
def test_bounds_are_reached_where_one_state_goes(reduce: Callable[..., Reduction]) -> None:
    """Relaxation (A = A^T, C = B^T): truncation errs by 2 sigma_n at rest, singular perturbation by that at
    infinite frequency; Glover's error is sigma_n times an all-pass, which meets -1 when D is kept."""
    A = np.diag([-0.5, -2.0, -7.0, -20.0])
    b = np.array([[1.0], [0.7], [2.0], [1.5]])
    r = reduce(control.ss(A, b, b.T, 0.0), 3)
    assert r.error == pytest.approx(r.bound, rel=1e-6)


@pytest.mark.parametrize("order", range(1, 13))
def test_hankel_norm_of_the_error_is_the_next_singular_value(loop: control.StateSpace, order: int) -> None:
    r = hankel_reduction(loop, order)
    assert r.hankel_error == pytest.approx(r.hankel_values[order], rel=1e-6)  # [Glover1984]


@pytest.mark.parametrize("order", [6, 8, 10, 14])
def test_hankel_norm_equality_with_four_inputs_and_outputs(speeds: control.StateSpace, order: int) -> None:
    r = hankel_reduction(speeds, order)
    assert r.hankel_error == pytest.approx(r.hankel_values[order], rel=1e-6)


def test_not_square_and_with_feedthrough() -> None:
    rng = np.random.default_rng(5)
    A = rng.normal(size=(7, 7)) - 4.0 * np.eye(7)
    G = control.ss(A, rng.normal(size=(7, 3)), rng.normal(size=(2, 7)), rng.normal(size=(2, 3)))
    for order in range(7):
        r = hankel_reduction(G, order)
        assert r.hankel_error == pytest.approx(r.hankel_values[order], rel=1e-6)
        assert np.array_equal(r.system.D, G.D)
        assert hankel_reduction(G, order, feedthrough="optimal").error <= np.sum(r.hankel_values[order:]) * (
            1 + 1e-6
        )


def test_repeated_singular_values_are_taken_together() -> None:
    G = control.append(
        control.ss([[-1.0]], [[1.0]], [[1.0]], 0.0), control.ss([[-2.0]], [[2.0]], [[1.0]], 0.0)
    )
    assert hankel_singular_values(G) == pytest.approx([0.5, 0.5])
    with pytest.raises(ReductionError, match="2-fold; ask for 0 or 2"):
        hankel_reduction(G, 1)
    assert hankel_reduction(G, 0).hankel_error == pytest.approx(0.5)
    assert balanced_truncation(G, 0).bound == pytest.approx(1.0)  # counted once


@pytest.mark.parametrize("order", [4, 6, 8])
def test_slicot_agrees(loop: control.StateSpace, order: int) -> None:
    slicot = pytest.importorskip("ctrlsys")
    n = loop.nstates
    A, B, C, D = slicot_arguments(loop)
    ar, br, cr, dr, nr, hsv, *_ = slicot.ab09cd("C", "S", "F", n, 1, 1, order, A, B, C, D, 0.0, 0.0)
    ours = hankel_reduction(loop, order)
    assert ours.hankel_values[:12] == pytest.approx(np.ravel(hsv)[:12], rel=1e-6)
    # AB09CD leaves its own D in; the strictly proper part is unique for a single loop
    assert distance(ours.system, (ar[:nr, :nr], br[:nr], cr[:, :nr], ours.system.D)) < 1e-6
    A, B, C, D = slicot_arguments(loop)
    ar, br, cr, _, nr, *_ = slicot.ab09ad("C", "B", "S", "F", n, 1, 1, order, A, B, C, 0.0)
    assert (
        distance(balanced_truncation(loop, order).system, (ar[:nr, :nr], br[:nr], cr[:, :nr], loop.D)) < 1e-6
    )
    A, B, C, D = slicot_arguments(loop)
    ar, br, cr, dr, nr, *_ = slicot.ab09bd("C", "B", "S", "F", n, 1, 1, order, A, B, C, D, 0.0, 0.0)
    assert distance(singular_perturbation(loop, order).system, (ar[:nr, :nr], br[:nr], cr[:, :nr], dr)) < 1e-6


def test_singular_perturbation_is_exact_at_rest(loop: control.StateSpace) -> None:
    r = singular_perturbation(loop, 6)
    at_rest = [frequency_response(*matrices(s), [0.0])[0, 0, 0] for s in (loop, r.system)]
    assert at_rest[1] == pytest.approx(at_rest[0], abs=1e-9 * r.hankel_values[0])


def test_unstable_and_zero_modes_are_kept_and_named() -> None:
    plant = select(two_area("kundur-thyristor-z"), None, [f"G{k}_dw" for k in range(1, 5)])
    r = balanced_truncation(plant, 12)
    assert sorted(r.kept) == ["unstable mode 0.01415+-j3.829", "zero mode"]
    poles = r.system.poles()
    assert np.min(np.abs(poles - (0.014146 + 3.829094j))) < 1e-5
    assert np.min(np.abs(poles)) < 1e-6
    # the difference is that of the stable parts: compare both transfer functions on the axis
    omega = np.geomspace(0.1, 50.0, 40)
    gap = frequency_response(*matrices(plant), omega) - frequency_response(*matrices(r.system), omega)
    assert np.max(np.linalg.norm(gap, 2, axis=(1, 2))) <= r.error * (1 + 1e-6) <= r.bound * (1 + 1e-6)
    with pytest.raises(ReductionError, match="at least 3"):
        balanced_truncation(plant, 2)


@pytest.fixture(scope="module")
def lqg(loop: control.StateSpace) -> tuple[control.StateSpace, control.StateSpace]:
    """A 10-state design plant and an LQG controller for it, u = + K y."""
    design = balanced_truncation(loop, 10).system
    A, B, C, _ = matrices(design)
    X = solve_continuous_are(A, B, C.T @ C, 300.0 * np.eye(1))
    Y = solve_continuous_are(A.T, C.T, B @ B.T, 1e-2 * np.eye(1))
    F, L = -B.T @ X / 300.0, -Y @ C.T / 1e-2
    K = control.ss(A + B @ F + L @ C, -L, F, 0.0, inputs=["dw24"], outputs=["G4_vs"])
    return design, K


def closed_loop_matrix(plant: control.StateSpace, K: control.StateSpace) -> np.ndarray:
    return np.block([[plant.A + plant.B @ K.D @ plant.C, plant.B @ K.C], [K.B @ plant.C, K.A]])


def inter_area_damping(plant: control.StateSpace, K: control.StateSpace) -> float:
    w = np.linalg.eigvals(closed_loop_matrix(plant, K))
    w = w[(w.imag > 2.5) & (w.imag < 6.0)]
    return float(np.min(-w.real / np.abs(w)))


@pytest.mark.slow
def test_closed_loop_weights_keep_what_the_controller_does(
    loop: control.StateSpace, lqg: tuple[control.StateSpace, control.StateSpace]
) -> None:
    _, K = lqg
    full = inter_area_damping(loop, K)
    weighted = closed_loop_reduction(loop, K, 6)
    assert weighted.order == 6
    assert inter_area_damping(loop, weighted.system) == pytest.approx(full, abs=0.03)
    # the error it reports is that of the two closed loops, recomputed here on a grid
    omega = np.geomspace(0.05, 100.0, 2000)
    rows = []
    for k in (K, weighted.system):
        A = closed_loop_matrix(loop, k)
        n, nk = loop.nstates, k.nstates
        B, C = np.vstack([loop.B, np.zeros((nk, 1))]), np.hstack([loop.C, np.zeros((1, nk))])
        rows.append(frequency_response(A, B, C, np.zeros((1, 1)), omega)[:, 0, 0])
        assert A.shape[0] == n + nk
    assert np.max(np.abs(rows[0] - rows[1])) == pytest.approx(weighted.error, rel=1e-3)


def test_near_integrator_is_taken_out_first(
    loop: control.StateSpace, lqg: tuple[control.StateSpace, control.StateSpace]
) -> None:
    _, K = lqg
    A, B, C, D = matrices(K)
    n = A.shape[0]
    slow = control.ss(
        np.block([[A, np.zeros((n, 1))], [np.zeros((1, n)), np.full((1, 1), -1e-4)]]),
        np.vstack([B, [[1e-4]]]),
        np.hstack([C, [[1e-4]]]),
        D,
        inputs=["dw24"],
        outputs=["G4_vs"],
    )
    r = closed_loop_reduction(loop, slow, 6)
    assert r.removed == ("slow mode -0.0001",)
    assert distance(closed_loop_reduction(loop, K, 6).system, matrices(r.system)) < 1e-6


def test_weighted_reduction_with_unit_weights_is_balanced_truncation(loop: control.StateSpace) -> None:
    one = weighted_reduction(loop, 6)
    assert distance(balanced_truncation(loop, 6).system, matrices(one.system)) < 1e-8


@pytest.mark.slow
def test_weights_move_the_error_where_they_are_small(loop: control.StateSpace) -> None:
    band = control.ss([[-1.0, -16.0], [1.0, 0.0]], [[1.0], [0.0]], [[1.0, 0.0]], 0.0)  # around 4 rad/s
    weighted = weighted_reduction(loop, 4, output_weight=band)
    plain = balanced_truncation(loop, 4)

    def size(r: control.StateSpace) -> float:
        omega = np.linspace(3.0, 5.0, 800)
        gap = frequency_response(*matrices(loop), omega) - frequency_response(*matrices(r), omega)
        return float(np.max(np.abs(gap[:, 0, 0] * frequency_response(*matrices(band), omega)[:, 0, 0])))

    assert size(weighted.system) < size(plain.system)
    assert size(weighted.system) <= weighted.error * (1 + 1e-6)


def test_orders_and_numbers_that_make_no_sense(loop: control.StateSpace) -> None:
    for order in (-1, 56, True, 2.5):
        with pytest.raises(ReductionError, match="whole number"):
            balanced_truncation(loop, order)  # type: ignore[arg-type]
    bad = control.ss([[-1.0]], [[1.0]], [[1.0]], 0.0)
    bad.A = np.array([[np.nan]])
    with pytest.raises(ReductionError, match="not finite"):
        balanced_truncation(bad, 1)
    with pytest.raises(ReductionError, match="keep"):
        hankel_reduction(loop, 6, feedthrough="none")  # type: ignore[arg-type]
