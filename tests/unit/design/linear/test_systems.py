"""What every entrance makes of things that are no linear system in continuous time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import control
import numpy as np
import pytest
import scipy.signal

import interarea as ia
from interarea.design.certificates.closed_loop import closed_loop_matrix, effort, loss_criterion
from interarea.design.delay.curves import delay_margin, delayed_loop, delayed_plant
from interarea.design.delay.loop_modes import LoopFunction
from interarea.design.linear.norms import hankel_singular_values, hinf_norm, response
from interarea.design.linear.systems import LinearSystemError, state_space
from interarea.design.reduction.balanced import balanced_truncation, hankel_reduction, singular_perturbation
from interarea.design.reduction.weighted import closed_loop_reduction, weighted_reduction
from interarea.design.synthesis.fault_tolerant import fault_tolerant
from interarea.design.synthesis.hinf import PoleRegion, conventional, wide_area_damping

PORTS: dict[str, Any] = {"inputs": ["G2_dw", "G4_dw"], "outputs": ["G4_vs"]}
MATRICES = (np.diag([-0.5, -0.2]), np.ones((2, 2)), np.ones((1, 2)), np.zeros((1, 2)))
TURNED = (np.diag([-0.5, -0.2]), np.ones((2, 1)), np.ones((2, 2)), np.zeros((2, 1)))
K = control.ss(*MATRICES, **PORTS)
G = control.ss(*TURNED, inputs=PORTS["outputs"], outputs=PORTS["inputs"])
LATE_K = control.ss(*MATRICES, 0.1, **PORTS)
LATE_G = control.ss(*TURNED, 0.1, inputs=PORTS["outputs"], outputs=PORTS["inputs"])
REGION = PoleRegion(0.3, None, 300.0)
WEIGHT = control.ss([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
SCENARIO = {"case": "two-area-thesis", "stop_s": 0.1}

PUBLIC: dict[str, Callable[[Any], object]] = {
    "reduce": lambda thing: ia.reduce(thing, 1),
    "reduce, Hankel": lambda thing: ia.reduce(thing, 1, method="hankel"),
    "simulate": lambda thing: ia.simulate(SCENARIO, controller=thing),
    "certify": lambda thing: ia.certify(thing),
    "build_fmu": lambda thing: ia.build_fmu(thing, "never.fmu"),
    "Controller": lambda thing: ia.Controller("mine", thing),
    "Controller.of": lambda thing: ia.Controller.of(thing),
    "System": lambda thing: ia.System(stop_s=0.1).plant("two-area-thesis").controller(thing),
}

DESIGN: dict[str, Callable[[], object]] = {
    "hinf_norm": lambda: hinf_norm(LATE_G),
    "hankel_singular_values": lambda: hankel_singular_values(LATE_G),
    "response": lambda: response(LATE_G, np.array([1.0])),
    "balanced_truncation": lambda: balanced_truncation(LATE_G, 1),
    "singular_perturbation": lambda: singular_perturbation(LATE_G, 1),
    "hankel_reduction": lambda: hankel_reduction(LATE_G, 1),
    "weighted_reduction": lambda: weighted_reduction(LATE_G, 1),
    "weighted_reduction, weight": lambda: weighted_reduction(G, 1, input_weight=control.ss(WEIGHT, dt=0.1)),
    "closed_loop_reduction": lambda: closed_loop_reduction(G, LATE_K, 1),
    "conventional": lambda: conventional(LATE_G, REGION),
    "wide_area_damping": lambda: wide_area_damping(LATE_G, REGION, weights=(WEIGHT, WEIGHT)),
    "fault_tolerant": lambda: fault_tolerant(LATE_G, {"normal": 0.3}),
    "delayed_loop": lambda: delayed_loop(G, LATE_K),
    "delayed_loop, plant": lambda: delayed_loop(LATE_G, K),
    "delayed_plant": lambda: delayed_plant(LATE_G, {"G2_dw": 0.1}, 2),
    "delay_margin": lambda: delay_margin(G, LATE_K),
    "LoopFunction": lambda: LoopFunction(G, LATE_K),
    "closed_loop_matrix": lambda: closed_loop_matrix(G, LATE_K),
    "effort": lambda: effort(LATE_G, K),
    "loss_criterion": lambda: loss_criterion(LATE_G, K, "G2_dw"),
}


@pytest.mark.parametrize("entrance", PUBLIC)
@pytest.mark.parametrize("poles", ([-0.5, -0.2], [0.5, 0.2]))  # the second: grows if taken as continuous
def test_every_public_entrance_refuses_discrete_time(entrance: str, poles: list[float]) -> None:
    thing = control.ss(np.diag(poles), *MATRICES[1:], 0.1, **PORTS)
    with pytest.raises(ia.UserError, match=r"discrete time \(dt = 0\.1 s\), wanted continuous"):
        PUBLIC[entrance](thing)


@pytest.mark.parametrize("entrance", DESIGN)
def test_every_function_of_design_refuses_discrete_time(entrance: str) -> None:
    with pytest.raises(ia.UserError, match="in discrete time"):
        DESIGN[entrance]()


@pytest.mark.parametrize("entrance", PUBLIC)
@pytest.mark.parametrize(
    ("thing", "words"),
    [
        (control.tf([1, 2], [1, 3, 2, 5]), "a TransferFunction"),
        (np.eye(3), "an ndarray"),
        ({"A": 1}, "a dict"),
        (scipy.signal.lti([1], [1, 1]), "a TransferFunctionContinuous"),
        (3.0, "a float"),
    ],
    ids=["tf", "ndarray", "dict", "scipy", "number"],
)
def test_what_is_no_system_is_told_for_what_it_is(entrance: str, thing: Any, words: str) -> None:
    with pytest.raises(ia.UserError, match=words) as caught:
        PUBLIC[entrance](thing)
    assert "StateSpace" in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("entrance", [ia.modes, ia.loops, ia.linearise])
@pytest.mark.parametrize(("thing", "kind"), [(G, "a StateSpace"), (np.eye(2), "an ndarray"), ({}, "a dict")])
def test_what_is_no_case_is_told_for_what_it_is(
    entrance: Callable[[Any], object], thing: Any, kind: str
) -> None:
    with pytest.raises(ia.UserError, match=f"case: is {kind}, wanted a Case"):
        entrance(thing)


@pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")
def test_matrices_are_taken_where_a_system_is() -> None:
    matrices = tuple(np.asmatrix(M) for M in MATRICES)
    by_matrices, by_system = ia.reduce(matrices, 1), ia.reduce(K, 1)
    assert by_matrices.error == by_system.error > 0.0
    assert np.array_equal(by_matrices.system.A, by_system.system.A)
    number = state_space((MATRICES[0].tolist(), MATRICES[1].tolist(), MATRICES[2].tolist(), 0))
    assert number.D.shape == (1, 2) and not number.D.any()


def test_matrices_without_names_are_no_controller() -> None:
    with pytest.raises(ia.UserError, match=r"are not names of signals and actuators; name them: control\.ss"):
        ia.certify(MATRICES)


@pytest.mark.parametrize(
    ("matrices", "words"),
    [
        (([[-1.0, 0.0]], [[1.0]], [[1.0]], 0), r"do not fit \(A \(1, 2\)"),
        ((np.eye(2), np.ones((3, 1)), np.ones((1, 2)), 0), "do not fit"),
        (([[1j]], [[1.0]], [[1.0]], 0), "A has complex numbers"),
        (([["a"]], [[1.0]], [[1.0]], 0), "A is no matrix of numbers"),
        (([[np.nan]], [[1.0]], [[1.0]], 0), "A has numbers that are not finite"),
        ((np.eye(2), np.eye(2), np.eye(2)), "is a tuple"),
    ],
)
def test_matrices_that_do_not_fit_are_told(matrices: Any, words: str) -> None:
    with pytest.raises(LinearSystemError, match=words):
        state_space(matrices)


def test_a_system_of_no_given_step_is_discrete_and_of_no_given_kind_continuous() -> None:
    with pytest.raises(LinearSystemError, match="of no given length"):
        state_space(control.ss(*MATRICES, True))
    assert state_space(control.ss(*MATRICES, None)).nstates == 2


def test_a_system_that_is_given_is_returned_itself() -> None:
    assert state_space(K) is K
