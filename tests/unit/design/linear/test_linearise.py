"""Linearisation: exact against differences, the reference removed once and without a trace."""

import control
import numpy as np
import pytest
from independent.two_area import AREAS, OMEGA_B, TwoArea, linear_plant, two_area
from numpy.typing import NDArray

from interarea.design.linear.linearise import (
    LinearisationError,
    linearise,
    remove_reference,
    select,
    speeds_in_rad,
)
from interarea.design.linear.norms import frequency_response


class Pendulum:
    """A plant by hand: damped pendulum driven by a torque, exact derivatives."""

    state_names = ("angle", "rate")
    input_names = ("torque",)
    output_names = ("angle_out",)

    def __init__(self, rest: float = 0.3, wrong: float = 0.0, limit: float = np.inf) -> None:
        self.x0, self.u0 = np.array([rest, 0.0]), np.array([9.81 * np.sin(rest)])
        self.wrong, self.limit = wrong, limit

    def operating_point(self) -> tuple[NDArray, NDArray]:
        return self.x0, self.u0

    def derivatives(self, x: NDArray, u: NDArray) -> tuple[NDArray, NDArray]:
        torque = min(float(u[0]), self.limit)
        return np.array([x[1], torque - 9.81 * np.sin(x[0]) - 0.2 * x[1]]), np.array([x[0]])

    def jacobians(self, x: NDArray | None = None, u: NDArray | None = None) -> tuple[NDArray, ...]:
        A = np.array([[0.0, 1.0], [-9.81 * np.cos(self.x0[0]) + self.wrong, -0.2]])
        return A, np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]]), np.zeros((1, 1))


class Wrapped:
    """The independent two-area model behind the Plant protocol."""

    def __init__(self, plant: TwoArea) -> None:
        self.plant = plant
        self.state_names, self.input_names = plant.state_names, plant.input_names
        self.output_names = plant.output_names

    def operating_point(self) -> tuple[NDArray, NDArray]:
        return self.plant.x0, np.zeros(4)

    def derivatives(self, x: NDArray, u: NDArray) -> tuple[NDArray, NDArray]:
        return self.plant.derivatives(x, u)

    def jacobians(self, x: NDArray | None = None, u: NDArray | None = None) -> tuple[NDArray, ...]:
        return self.plant.jacobians()


def test_pendulum_has_its_closed_form_eigenvalues() -> None:
    system = linearise(Pendulum())
    stiffness = 9.81 * np.cos(0.3)
    expected = -0.1 + 1j * np.sqrt(stiffness - 0.01)
    assert np.max(system.poles().imag) == pytest.approx(expected.imag, rel=1e-14)
    assert system.state_labels == ["angle", "rate"]


@pytest.mark.parametrize(
    ("plant", "says"),
    [
        (Pendulum(wrong=1e-3), "exact Jacobian disagrees"),
        (Pendulum(limit=9.81 * np.sin(0.3), wrong=1e-3), "limit active"),
        (Pendulum(wrong=np.nan), "not finite"),
    ],
)
def test_derivatives_that_do_not_hold_are_refused(plant: Pendulum, says: str) -> None:
    with pytest.raises(LinearisationError, match=says):
        linearise(plant)


def test_a_limit_that_is_near_and_not_reached_is_none() -> None:
    # within the first steps of the differences (1e-5 of 2.9), not within the smaller ones
    near = linearise(Pendulum(limit=9.81 * np.sin(0.3) + 4e-5))
    assert np.array_equal(near.A, linearise(Pendulum()).A)


@pytest.mark.parametrize("room", [0.0, 4e-7])
def test_at_a_limit_the_exact_slope_is_that_of_one_side(room: float) -> None:
    assert np.array_equal(linearise(Pendulum(limit=9.81 * np.sin(0.3) + room)).A, linearise(Pendulum()).A)


def test_at_a_limit_any_other_slope_is_refused() -> None:
    class Wrong(Pendulum):
        def jacobians(self, x: NDArray | None = None, u: NDArray | None = None) -> tuple[NDArray, ...]:
            A, B, C, D = super().jacobians(x, u)
            return A, 0.3 * B, C, D

    with pytest.raises(LinearisationError, match="limit active"):
        linearise(Wrong(limit=9.81 * np.sin(0.3)))


def test_a_plant_that_moves_is_refused() -> None:
    plant = Pendulum()
    plant.u0 = plant.u0 + 0.01
    with pytest.raises(LinearisationError, match=r"d rate/dt = 0\.01"):
        linearise(plant)


def test_two_area_linearises_to_the_complex_step_matrices() -> None:
    system = linearise(Wrapped(two_area("two-area-thesis")))
    assert np.array_equal(system.A, linear_plant("two-area-thesis").A)


def test_reference_is_removed_once_and_nothing_else_changes() -> None:
    full = linear_plant("two-area-thesis")
    system = remove_reference(full)
    assert system.nstates == full.nstates - 1
    # transfer functions agree on the axis: removing an unobservable mode is exact
    omega = np.geomspace(0.05, 200.0, 25)
    before = frequency_response(full.A, full.B, full.C, full.D, omega)
    after = frequency_response(system.A, system.B, system.C, system.D, omega)
    assert after == pytest.approx(before, rel=1e-8, abs=1e-8)
    # the other 55 eigenvalues stay (close real ones of the governors are nearly defective)
    old = sorted(np.linalg.eigvals(full.A), key=abs)[1:]
    new = np.linalg.eigvals(system.A)
    assert all(np.min(np.abs(new - v)) < 1e-6 * max(1.0, abs(v)) for v in old)
    with pytest.raises(LinearisationError, match="reference"):
        remove_reference(system)


def test_common_speed_zero_remains_without_governor() -> None:
    # KD = 0 and constant torque: a double zero, of which one is the angle reference
    values = np.linalg.eigvals(remove_reference(linear_plant("kundur-thyristor-z")).A)
    assert np.sum(np.abs(values) < 1e-6) == 1


def test_infinite_bus_has_no_reference_to_remove() -> None:
    A = np.array([[0.0, 377.0], [-0.1, -0.2]])
    system = control.ss(A, [[0.0], [1.0]], [[0.0, 1.0]], 0.0, states=["G1.delta", "G1.slip"])
    with pytest.raises(LinearisationError, match="infinite bus"):
        remove_reference(system)


def test_speeds_scale_and_signals_combine_by_name() -> None:
    system = speeds_in_rad(remove_reference(linear_plant("two-area-thesis")), OMEGA_B)
    raw = remove_reference(linear_plant("two-area-thesis"))
    one = select(system, ["G4_vs"], {"dw24": {"G2_dw": 1.0, "G4_dw": -1.0}})
    rows = [raw.output_labels.index(f"{m}_dw") for m in ("G2", "G4")]
    assert one.C[0] == pytest.approx(OMEGA_B * (raw.C[rows[0]] - raw.C[rows[1]]))
    assert one.input_labels == ["G4_vs"] and list(AREAS) == ["G1", "G2", "G3", "G4"]
    with pytest.raises(ValueError, match="G9_dw"):
        select(system, None, ["G9_dw"])
