"""All swings of a loop with latency, packets and loss: against roots found in other ways."""

from __future__ import annotations

import control
import numpy as np
import pytest
from scipy.linalg import expm

from interarea.cosim.run.artefacts import linear_plant
from interarea.cosim.run.controllers import controller_of
from interarea.design.certificates.closed_loop import closed_loop_matrix, swing_poles
from interarea.design.controllers.bundled import shipped_controller
from interarea.design.controllers.controller import Controller
from interarea.design.delay.characteristic_roots import DelayError, discretised
from interarea.design.delay.curves import delayed_loop, rightmost_roots, track_roots
from interarea.design.delay.loop_modes import SWING_HZ, DelayedPath, LoopFunction, zeros_of
from interarea.design.delay.transfer_matrix import ModalForm, TransferMatrix
from interarea.design.linear.linearise import remove_reference, speeds_in_rad
from interarea.design.modes.modes import Modes, damping_ratio, modes_of
from interarea.fmu_build.write.cache import default_cache
from interarea.models.case.case import load_case

BAND = tuple(2.0 * np.pi * f for f in SWING_HZ)


@pytest.fixture(scope="module")
def plant() -> tuple[control.StateSpace, Modes]:
    case = load_case("two-area-thesis")
    relative = remove_reference(linear_plant(case, default_cache()))
    return speeds_in_rad(relative, case.omega_b), modes_of(relative, case.areas)


def controller(name: str) -> Controller:
    controller = controller_of(name, load_case("two-area-thesis"), default_cache())
    assert isinstance(controller, Controller)
    return controller


def poles_of(modes: Modes) -> dict[str, complex]:
    return {name: mode.eigenvalue for name, mode in modes.items()}


def in_band(roots: np.ndarray) -> np.ndarray:
    swings = roots[(BAND[0] < roots.imag) & (roots.imag < BAND[1])]
    return swings[np.argsort(swings.imag)]


@pytest.mark.parametrize("name", ["robust", "two_actuators"])
def test_without_latency_the_roots_are_the_eigenvalues(
    name: str, plant: tuple[control.StateSpace, Modes]
) -> None:
    K = controller(name).system
    result = LoopFunction(plant[0], K).modes({}, poles_of(plant[1]))
    values = np.linalg.eigvals(closed_loop_matrix(plant[0], K))
    inside = values[(values.real > -12.0) & (values.real < 2.0)]
    np.testing.assert_allclose(
        in_band(np.array(result.roots)), in_band(inside), rtol=1e-7, err_msg="a root is missing"
    )


def test_with_latency_they_are_those_of_the_discretised_loop(plant: tuple[control.StateSpace, Modes]) -> None:
    K = controller("wide_area").system
    late = dict.fromkeys(K.input_labels, 0.2)
    result = LoopFunction(plant[0], K).modes({s: DelayedPath(t) for s, t in late.items()}, poles_of(plant[1]))
    exact = rightmost_roots(delayed_loop(plant[0], K, late), right_of=-2.5)
    roots = np.array(result.roots)
    np.testing.assert_allclose(in_band(roots[roots.real > -2.5]), in_band(exact), rtol=1e-8)
    assert result.least is not None
    assert result.name_of(result.least) == ""  # no mode of the open loop is least here
    assert damping_ratio(result.least) == pytest.approx(min(map(damping_ratio, in_band(exact))), rel=1e-8)


def test_modes_have_the_names_that_certificates_give_them(plant: tuple[control.StateSpace, Modes]) -> None:
    """Two other ways: eigenvectors followed over the gain, a root and its vector over the latency."""
    K = controller("wdc").system
    late = dict.fromkeys(K.input_labels, 0.2)
    result = LoopFunction(plant[0], K).modes({s: DelayedPath(t) for s, t in late.items()}, poles_of(plant[1]))
    fixed = delayed_loop(plant[0], K)
    for name, pole in swing_poles(plant[0], K, plant[1]).items():
        root = track_roots(fixed, tuple(late), [0.2], pole, step_s=0.02)[-1]
        assert result.named[name] == pytest.approx(complex(root), abs=1e-7), name
    assert result.least is not None and result.name_of(result.least) == "local area 2"


@pytest.mark.parametrize("on_loss", ["hold", "zero"])
@pytest.mark.parametrize("loss", [0.0, 0.3, 0.7])
def test_lost_packets_act_in_the_mean_as_the_recursion_of_the_mean_does(loss: float, on_loss: str) -> None:
    """x' = A x + B u, u a packet every 20 ms, two intervals late: E[x] by its own linear recursion."""
    w, zeta, interval, gain = 4.0, 0.05, 0.02, 0.8
    A, B, C = (
        np.array([[0.0, 1.0], [-(w**2), -2 * zeta * w]]),
        np.array([[0.0], [1.0]]),
        np.array([[0.0, -gain]]),
    )
    step = expm(np.block([[A, B], [np.zeros((1, 3))]]) * interval)
    F, g = step[:2, :2], step[:2, 2:]
    # state: x, packets sent one and two intervals ago, what the channel shows
    M = np.zeros((5, 5))
    shown = np.zeros((1, 5))
    shown[0, 3] = 1.0 - loss  # the packet of two intervals ago arrives
    shown[0, 4] = loss if on_loss == "hold" else 0.0
    M[:2, :2] = F
    M[:2] += g @ shown
    M[2:3, :2] = C
    M[3, 2] = 1.0
    M[4] = shown
    shifts = np.linalg.eigvals(M).astype(complex)
    values = np.log(shifts[np.abs(shifts) > 1e-9]) / interval
    exact = min(values[values.imag > 1.0], key=lambda z: abs(z - 4.0j))
    plant = control.ss(A, B, [[0.0, 1.0]], 0.0, inputs=["u"], outputs=["y"])
    K = control.ss(
        [[-1e4]], [[1e4]], [[-gain]], [[0.0]], inputs=["y"], outputs=["u"]
    )  # a gain, but for 0.1 ms
    path = DelayedPath(2 * interval, interval, loss, "hold" if on_loss == "hold" else "zero")
    result = LoopFunction(plant, K).modes({"y": path}, {})
    near = min(result.roots, key=lambda z: abs(z - exact))
    assert damping_ratio(near) == pytest.approx(damping_ratio(exact), abs=2e-3)
    assert near.imag == pytest.approx(exact.imag, rel=2e-3)


class _Polynomial:
    """A function with the zeros that are given."""

    def __init__(self, *zeros: complex) -> None:
        self.zeros = np.array(zeros)

    def value(self, s: np.ndarray) -> np.ndarray:
        return np.prod(s[:, None] - self.zeros[None, :], axis=1)

    def ratio(self, s: np.ndarray) -> np.ndarray:
        return np.sum(1.0 / (s[:, None] - self.zeros[None, :]), axis=1)


def zeros_within(*zeros: complex) -> np.ndarray:
    return zeros_of(_Polynomial(*zeros), np.zeros(0), (-3.0, 3.0), (0.5, 12.0), [])  # type: ignore[arg-type]


def test_zeros_are_complete_or_it_is_said() -> None:
    """Two zeros nearer than any grid are both found; a double one is one place, and the count tells."""
    near = (-1.0 + 2.0j, -1.0001 + 2.0001j, 0.5 + 9.0j)
    np.testing.assert_allclose(np.sort_complex(zeros_within(*near)), np.sort_complex(near), rtol=1e-9)
    with pytest.raises(DelayError, match=r"2 roots found .* 3 counted"):
        zeros_within(-1.0 + 2.0j, -1.0 + 2.0j, 0.5 + 9.0j)


@pytest.mark.slow
@pytest.mark.parametrize("lost", [None, "G10_dw", "G6_dw"])
@pytest.mark.parametrize("latency_s", [0.0, 0.15, 0.5])
def test_all_roots_of_a_grid_with_slow_controls_are_found(latency_s: float, lost: str | None) -> None:
    """New England: beside the swings its governors and the controller have roots far from every minimum."""
    case = load_case("new-england")
    relative = remove_reference(linear_plant(case, default_cache()))
    grid, modes = speeds_in_rad(relative, case.omega_b), modes_of(relative, case.areas)
    K = shipped_controller("new_england").system
    paths = {s: DelayedPath(latency_s, lost=s == lost) for s in K.input_labels}
    result = np.array(LoopFunction(grid, K).modes(paths, poles_of(modes)).roots)
    late = {s: latency_s for s in K.input_labels if s != lost and latency_s}
    heard = np.array([name != lost for name in K.input_labels], dtype=float)
    names = {"inputs": list(K.input_labels), "outputs": list(K.output_labels)}
    there = control.ss(K.A, K.B * heard, K.C, K.D * heard, **names)
    if late:
        values = np.linalg.eigvals(discretised(delayed_loop(grid, there, late).balanced(), 28))
    else:
        values = np.linalg.eigvals(closed_loop_matrix(grid, there))
    exact = in_band(values[(values.real > -12.0) & (values.real < 2.0)])
    np.testing.assert_allclose(in_band(result), exact, rtol=1e-7)


def test_nothing_arrives_over_a_lost_signal(plant: tuple[control.StateSpace, Modes]) -> None:
    K = controller("wdc").system
    paths = {"G2_dw": DelayedPath(lost=True), "G4_dw": DelayedPath()}
    result = LoopFunction(plant[0], K).modes(paths, poles_of(plant[1]))
    values = np.linalg.eigvals(closed_loop_matrix(plant[0], K, lost=["G2_dw"]))
    assert result.least is not None
    assert np.min(np.abs(values - result.least)) <= 1e-7


@pytest.mark.parametrize("latency_s", [0.0, 0.15])
def test_a_controller_with_poles_of_any_multiplicity(
    latency_s: float, plant: tuple[control.StateSpace, Modes]
) -> None:
    """A lead twice has a double pole, whose eigenvectors are one: there is no modal form."""
    A = np.array([[-5.0, 1.0, 0.0], [0.0, -5.0, 0.0], [0.0, 0.0, -5.0]])
    K = control.ss(A, [[0.0], [1.0], [1.0]], [[-12.0, 4.0, 1.0]], 0.0, inputs=["G2_dw"], outputs=["G4_vs"])
    function = LoopFunction(plant[0], K)
    assert not isinstance(function._K, ModalForm)
    result = np.array(function.modes({"G2_dw": DelayedPath(latency_s=latency_s)}, poles_of(plant[1])).roots)
    exact = rightmost_roots(delayed_loop(plant[0], K, {"G2_dw": latency_s}), right_of=-4.0)
    expected, got = in_band(exact), in_band(result[result.real > -4.0])
    assert len(expected) >= 3
    np.testing.assert_allclose(got, expected, rtol=1e-6)


def test_both_forms_of_a_transfer_matrix_agree(plant: tuple[control.StateSpace, Modes]) -> None:
    K = controller("robust").system
    s = np.array([0.2 + 4.0j, -1.0 + 9.0j, 0.01j])
    modal, exact = ModalForm(K), TransferMatrix(K)
    np.testing.assert_allclose(modal.at(s), exact.at(s), rtol=1e-8)
    np.testing.assert_allclose(modal.slope(s), exact.slope(s), rtol=1e-8)
    np.testing.assert_allclose(np.sort(modal.poles), np.sort(exact.poles), rtol=1e-6)
