"""Stabilizers tuned by residue phase: the law that tunes them, the device they are, and the advice."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from interarea.cosim.grid_study.faults import TIME_OVER
from interarea.cosim.grid_study.local_stabilizers import (
    MOST_GAIN,
    WASHOUT_S,
    Stabilizer,
    as_controller,
    tuned_for,
    tuned_stabilizers,
    which_to_build,
)
from interarea.cosim.grid_study.weak_modes import WeakModes, modes_of_grid, weak_modes
from interarea.cosim.run.artefacts import linear_plant
from interarea.design.certificates.closed_loop import closed_loop_matrix
from interarea.design.controllers.controller import Controller
from interarea.design.linear.linearise import remove_reference, speeds_in_rad
from interarea.models.case.case import load_case


@pytest.fixture(scope="module")
def weak(cache: Path) -> WeakModes:
    return weak_modes(modes_of_grid(load_case("two-area-thesis"), cache))


def _roots(stabilizers: list[Stabilizer], cache: Path) -> np.ndarray[Any, Any]:
    case = load_case("two-area-thesis")
    plant = speeds_in_rad(remove_reference(linear_plant(case, cache)), case.omega_b)
    K = as_controller(stabilizers, case.omega_b, "local", 1.0)
    return np.linalg.eigvals(closed_loop_matrix(plant, K.system))


def test_a_small_gain_moves_the_mode_straight_to_the_left(weak: WeakModes, cache: Path) -> None:
    s, added = weak.weakest.eigenvalue, 1e-4
    units = tuned_stabilizers(weak)
    assert {one.machine for one in units} == {"G1", "G2", "G3", "G4"}
    for one in units:
        roots = _roots([replace(one, K=added * one.K)], cache)
        move = roots[np.argmin(np.abs(roots - s))] - s
        assert move == pytest.approx(-added * abs(s), rel=0.01)  # a damping ratio of 1e-4 more


def test_a_stabilizer_is_the_device_of_a_case_file(cache: Path) -> None:
    one = Stabilizer("G2", "inter-area", 12.0, 0.2, 0.05, 2)
    device = {"K": 12.0, "Tw": WASHOUT_S, "T1": 0.2, "T2": 0.05, "T3": 0.2, "T4": 0.05}
    case = load_case("two-area-thesis").with_changes({"machines": {"G2": {"stabilizer": device}}})
    inside = np.linalg.eigvals(remove_reference(linear_plant(case, cache)).A)
    beside = _roots([one], cache)
    assert len(inside) == len(beside)
    for root in beside:
        assert np.abs(inside - root).min() < 1e-6 * (1.0 + abs(root))


def test_a_machine_that_needs_too_much_phase_gets_none(weak: WeakModes) -> None:
    mode = weak.weakest
    washed = mode.eigenvalue * WASHOUT_S / (1.0 + mode.eigenvalue * WASHOUT_S)
    with_phase = [-np.exp(-1j * np.radians(deg)) / washed for deg in (100.0, 149.0, 155.0, 180.0)]
    result = [tuned_for(mode, "G1", residue) for residue in with_phase]
    assert [None if one is None else one.stages for one in result] == [2, 3, None, None]
    one = result[0]
    assert one is not None
    assert with_phase[0] * one.response(mode.eigenvalue) == pytest.approx(-abs(mode.eigenvalue), rel=1e-4)


def test_a_target_gets_a_second_machine_before_other_modes_have_one(weak: WeakModes) -> None:
    """As many machines for it in the first turn as stated; then each mode in turn, none twice."""
    target = weak.weakest
    locals_ = [m for m in weak.all_modes.modes if m.name.startswith("local")]
    dampings = (0.085, 0.09)  # equal ones would be sorted by their last digit
    others = [
        replace(m, eigenvalue=complex(-z, 1.0) * m.eigenvalue.imag)
        for z, m in zip(dampings, locals_, strict=True)
    ]
    modes = replace(weak, targets=(target,), others=tuple(others))
    once, twice = tuned_stabilizers(modes, 1), tuned_stabilizers(modes, 2)
    assert [one.mode for one in once][:2] == [target.name, others[0].name]
    assert [one.mode for one in twice][:2] == [target.name, target.name]
    assert len({one.machine for one in twice}) == len(twice)


def test_gains_beyond_what_is_built_are_no_stabilizers(weak: WeakModes) -> None:
    deaf = replace(weak.weakest, left=1e-3 * weak.weakest.left)
    assert tuned_stabilizers(weak)
    assert tuned_stabilizers(replace(weak, targets=(deaf,))) == []
    assert MOST_GAIN == 50.0


def _judged(name: str, inter_area: float, worst_swing: float, *violations: str) -> Controller:
    one = Stabilizer("G2", "inter-area", 12.0, 0.2, 0.05, 1)
    certificate = {
        "inter_area": inter_area,
        "worst_swing": worst_swing,
        "violations": list(violations),
        "passed": not violations,
        "rows": [{"stable": True}],
        "acceptance": {"standing": [line for line in violations if "standing" in line]},
    }
    return replace(as_controller([one], 377.0, name, 0.05), certificate=certificate)


def test_the_sentence_says_which_to_build() -> None:
    targets = (0.1, 0.03)
    good, also = _judged("wide", 0.2, 0.05), _judged("local", 0.11, 0.05)
    assert which_to_build(good, also, targets).startswith("local stabilizers are sufficient, a wide")
    assert which_to_build(good, also, targets).endswith(
        "the wide-area loop would add 0.090 inter-area damping"
    )
    assert which_to_build(_judged("wide", 0.05, 0.05), also, targets).endswith(
        "the wide-area loop alone reaches 0.060 less inter-area damping"
    )
    # good eigenvalues and a lost fault are no stabilizer to build
    loses = _judged("local", 0.3, 0.05, "base, fault at bus 7: synchronism lost; kept without the controller")
    assert which_to_build(good, loses, targets).startswith(
        "build the wide-area loop: the wide-area loop reaches"
    )
    short, shorter = _judged("wide", 0.08, 0.05, "inter-area"), _judged("local", 0.06, 0.05, "inter-area")
    assert "the wide-area loop is" in which_to_build(short, shorter, targets)
    assert "the local stabilizers are" in which_to_build(shorter, short, targets)
    assert which_to_build(good, None, targets).startswith("no local stabilizer can be tuned")
    # faults that were not run are no reason against stabilizers where the loop misses something
    unfinished = _judged("local", 0.11, 0.05, f"non-linear faults at base: {TIME_OVER}")
    assert "; not verified within the time limit: 1 requirement (first" in which_to_build(
        short, unfinished, targets
    )
    assert which_to_build(good, unfinished, targets).startswith("build the wide-area loop")
    both = which_to_build(good, shorter, targets, ("G2",))
    assert both.startswith("build both: local stabilizers at G2 reach")
    assert both.endswith("0.050 (worst swing) and meet all requirements")
    swings = _judged("wide", 0.2, 0.05, "base, fault at bus 7: standing swing")
    assert "the local stabilizers are closer" in which_to_build(swings, shorter, targets)
    assert "the stabilizers alone are closer" in which_to_build(swings, shorter, targets, ("G2",))
    neither = which_to_build(short, shorter, targets, ("G2",))
    assert neither.startswith("not all requirements are met: local stabilizers at G2 reach")
