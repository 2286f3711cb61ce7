"""Proofs for arbitrary switching, against closed forms and against simulated sequences."""

from __future__ import annotations

from pathlib import Path

import control
import numpy as np
import pytest
from scipy.linalg import expm

from interarea.cosim.run.artefacts import linear_plant
from interarea.design.certificates.switching import (
    BankLoop,
    common_lyapunov,
    dwell_time,
    proven_decay,
    switching_certificate,
)
from interarea.design.controllers.bank import ControllerBank
from interarea.design.controllers.bundled import shipped_bank
from interarea.design.controllers.controller import Controller
from interarea.design.errors import UncertifiedDesign
from interarea.design.linear.linearise import remove_reference, speeds_in_rad
from interarea.models.case.case import load_case


def pair(a: float) -> dict[str, np.ndarray]:
    """Two loops that have a common quadratic Lyapunov function exactly for a < 3 + sqrt(8) [Liberzon2003]."""
    return {"one": np.array([[-1.0, -1.0], [1.0, -1.0]]), "two": np.array([[-1.0, -a], [1.0 / a, -1.0]])}


@pytest.mark.parametrize("share", [0.5, 0.9, 0.99])
def test_common_function_up_to_the_closed_form(share: float) -> None:
    loops = pair(share * (3.0 + np.sqrt(8.0)))
    P = common_lyapunov(loops, 1e-4)
    assert P is not None and proven_decay(loops, P) >= 0.99e-4


@pytest.mark.parametrize("excess", [1.01, 1.5])
def test_none_beyond_the_closed_form(excess: float) -> None:
    assert common_lyapunov(pair(excess * (3.0 + np.sqrt(8.0))), 0.0) is None


def test_proven_decay_is_the_largest_rate() -> None:
    """For normal matrices and P = 1 the rate is the abscissa; a P that proves nothing gives none."""
    loops = {"a": np.diag([-1.0, -3.0]), "b": np.array([[-2.0, 5.0], [-5.0, -2.0]])}
    assert proven_decay(loops, np.eye(2)) == pytest.approx(1.0, abs=1e-12)
    assert proven_decay({"c": np.diag([-1.0, 0.5])}, np.eye(2)) < 0.0
    assert np.isnan(proven_decay(loops, np.diag([1.0, -1.0])))


def oscillator_bank(gain: float, **changes: float) -> tuple[control.StateSpace, ControllerBank]:
    """A swing of 1 Hz with 5 % damping and two static-like members behind a fast lag."""
    w = 2.0 * np.pi
    plant = control.ss(
        [[0.0, 1.0], [-w * w, -0.1 * w]], [[0.0], [w]], [[0.0, 1.0], [0.0, 0.8]], np.zeros((2, 1)),
        inputs=["G4_vs"], outputs=["G2_dw", "G4_dw"],
    )  # fmt: skip
    both = control.ss([[-50.0]], [[1.0, 1.0]], [[-50.0 * gain]], [[0.0, 0.0]],
                      inputs=["G2_dw", "G4_dw"], outputs=["G4_vs"])  # fmt: skip
    local = control.ss([[-50.0]], [[1.0]], [[-50.0 * gain]], [[0.0]], inputs=["G4_dw"], outputs=["G4_vs"])
    return plant, ControllerBank("two", (Controller("both", both), Controller("local", local)), **changes)


@pytest.mark.slow
def test_mild_bank_needs_no_dwell() -> None:
    plant, bank = oscillator_bank(0.2)
    result, P = switching_certificate(plant, bank)
    assert result.kind == "common Lyapunov function" and P is not None
    assert 0.0 < result.decay_rate <= result.slowest
    # both with any of 4 sets, local with G4_dw or nothing, off with G2_dw or nothing
    assert len(result.loops) == 4 + 2 + 2


@pytest.mark.slow
@pytest.mark.parametrize("fade_s", [0.0, 0.05])
def test_dwell_time_holds_for_sequences(fade_s: float) -> None:
    """No sequence of sets at least that far apart grows: the product of any cycle is a contraction."""
    plant, bank = oscillator_bank(0.8, fade_s=fade_s)
    loop = BankLoop(plant, bank)
    dwell = dwell_time(loop)
    sets = bank.signal_sets()
    rng = np.random.default_rng(4)
    steps = {s: expm(loop.matrix(bank.active(s), s) * dwell) for s in sets}
    for _ in range(20):
        product = np.eye(loop.order)
        for k in rng.integers(len(sets), size=40):
            product = steps[sets[k]] @ product
        assert np.linalg.norm(product, 2) < 1.0
    assert dwell > 25.0 * fade_s


def test_unstable_loop_is_named() -> None:
    plant, bank = oscillator_bank(-0.4)
    with pytest.raises(UncertifiedDesign, match="'both: G2_dw G4_dw'"):
        switching_certificate(plant, bank)


def test_unstable_member_cannot_stand_by() -> None:
    plant, bank = oscillator_bank(0.2)
    K = control.ss([[0.1]], [[1.0]], [[1.0]], [[0.0]], inputs=["G2_dw"], outputs=["G4_vs"])
    with pytest.raises(ValueError, match="grow"):
        BankLoop(plant, ControllerBank("bank", (*bank.members, Controller("grows", K))))


@pytest.mark.slow
def test_active_bank_decays_for_any_sequence(cache: Path) -> None:
    """The proof on the full plant of the study, and that no simulated sequence decays slower than it says."""
    case = load_case("two-area-thesis")
    bank = shipped_bank("active")
    plant = speeds_in_rad(remove_reference(linear_plant(case, cache)), case.omega_b)
    loop = BankLoop(plant, bank)
    corners = loop.corners()
    assert bank.lyapunov is not None and bank.certificate is not None
    rate = proven_decay(corners, bank.lyapunov)
    assert rate == pytest.approx(bank.certificate["decay_rate"], rel=1e-3) and rate > 0.04
    P = bank.lyapunov
    unit = np.sqrt(np.diag(P))
    root = np.linalg.cholesky(P / np.outer(unit, unit)).T * unit
    rng = np.random.default_rng(1)
    names = list(corners)
    for _ in range(5):
        x = rng.normal(size=loop.order) / unit
        value, time = np.linalg.norm(root @ x), 0.0
        for _ in range(30):
            h = float(rng.uniform(0.01, 1.0))
            weights = rng.dirichlet(np.ones(len(names)))
            x = expm(h * sum(w * corners[n] for w, n in zip(weights, names, strict=True))) @ x
            time += h
            assert np.linalg.norm(root @ x) <= value * np.exp(-rate * time) * (1.0 + 1e-6)
