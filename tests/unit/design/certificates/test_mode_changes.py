"""What a controller takes from each mode, against eigenvalues of the loop and against a wrong polarity."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import control
import numpy as np
import pytest

from interarea.cosim.run.artefacts import linear_plant, sparse_linear_plant
from interarea.design.certificates.closed_loop import closed_loop_matrix
from interarea.design.certificates.large_loop import LargePlant
from interarea.design.certificates.mode_changes import ModeChange, mode_changes, most_taken
from interarea.design.delay.signal_conditions import Condition
from interarea.design.errors import UncertifiedDesign
from interarea.design.linear.linearise import remove_reference, speeds_in_rad
from interarea.models.case.case import load_case

CASE = load_case("new-england")


def _washed(gain: float) -> control.StateSpace:
    """A washout of 10 s with a gain, pu per rad/s, from the speed of G7 to its exciter."""
    return control.ss(-0.1, 1.0, -0.1 * gain, gain, inputs=["G7_dw"], outputs=["G7_vs"], name="washed")


@pytest.fixture(scope="module")
def plant(cache: Path) -> LargePlant:
    return LargePlant(sparse_linear_plant(CASE, cache), CASE.areas, CASE.omega_b)


def _changes(plant: LargePlant, gain: float) -> tuple[ModeChange, ...]:
    return mode_changes("base", plant, _washed(gain), [Condition("N")], {"N": -1.0})


def test_modes_end_at_eigenvalues_of_the_loop(plant: LargePlant, cache: Path) -> None:
    dense = speeds_in_rad(remove_reference(linear_plant(CASE, cache)), CASE.omega_b)
    roots = np.linalg.eigvals(closed_loop_matrix(dense, _washed(0.05)))
    damping = -roots.real / np.abs(roots)
    changes = _changes(plant, 0.05)
    assert len(changes) == 9
    for change in changes:
        assert np.abs(damping - change.least).min() < 1e-7


def test_a_gain_that_the_worst_swing_lets_pass_takes_from_another_mode(plant: LargePlant) -> None:
    helps, harms = _changes(plant, -0.05), _changes(plant, 0.05)
    assert max(change.taken for change in helps) <= 0.005
    worst_without = min(change.without for change in harms)
    assert min(change.least for change in harms) > worst_without - 0.005  # what a bound on all would see
    most = max(harms, key=lambda change: change.taken)
    assert most.taken == pytest.approx(0.016, abs=1e-3)
    assert (
        most_taken([asdict(change) for change in harms])
        == f"the damping ratio decreases most for {most.text}"
    )
    assert most.without > worst_without + 0.02


def test_what_is_calm_before_and_after_is_no_concern() -> None:
    assert ModeChange("base", "local", 1.2, 0.19, 0.12, "N").taken < 0.0
    assert ModeChange("base", "local", 1.2, 0.19, 0.05, "N").taken == pytest.approx(0.05)
    assert ModeChange("base", "local", 1.2, 0.03, 0.02, "N").taken == pytest.approx(0.01)
    assert most_taken([asdict(ModeChange("base", "local", 1.2, 0.19, 0.12, "N"))]).startswith("no mode loses")


def test_a_mode_that_is_lost_on_its_way_counts_as_the_worst_swing(
    plant: LargePlant, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lost(*_: object) -> complex:
        raise UncertifiedDesign("lost")

    monkeypatch.setattr(LargePlant, "follow", lost)
    assert {change.least for change in _changes(plant, 0.05)} == {-1.0}
