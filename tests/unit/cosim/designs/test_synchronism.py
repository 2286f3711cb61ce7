"""The drive after a fault against closed forms, and what the certificate says of a fault that is run."""

from __future__ import annotations

from pathlib import Path

import control
import numpy as np
import pytest
from pydantic import ValidationError

from interarea.cosim.designs.first_swing import FaultTable, after_fault, fault_scenario, mean_drive
from interarea.design.controllers.bundled import shipped_controller
from interarea.models.case.case import Case
from interarea.models.case.variants import operating_variant

FAULT = FaultTable(bus=8, branch="8-9 a")


def lag(gain: float) -> control.StateSpace:
    """u = gain (G2_dw + 2 G4_dw) / (s + 1)."""
    return control.ss(
        [[-1.0]], [[gain, 2.0 * gain]], [[1.0]], [[0.0, 0.0]], inputs=["G2_dw", "G4_dw"], outputs=["G4_vs"]
    )


@pytest.mark.parametrize(("lost", "share"), [((), 3.0), (("G2_dw",), 2.0), (("G2_dw", "G4_dw"), 0.0)])
def test_drive_of_a_lag_behind_a_step(lost: tuple[str, ...], share: float) -> None:
    # speeds of 1 rad/s from t = 0 on: u = gain share (1 - e^-t), averaged from 1.5 to 3 s
    t = np.sort(np.concatenate([np.arange(0.0, 3.001, 0.01), [1.1333]]))  # an event's extra point
    ones = {"G2": np.ones_like(t), "G4": np.ones_like(t)}
    mean = 1.0 - (np.exp(-1.5) - np.exp(-3.0)) / 1.5
    drive = mean_drive(lag(0.05), t, ones, lost, FAULT)
    assert drive == pytest.approx(0.05 * share * mean, abs=1e-4)


def test_a_branch_that_is_out_is_not_tripped_again(two_area: Case, tmp_path: Path) -> None:
    kinds = [e["kind"] for e in fault_scenario(tmp_path, two_area, FAULT)["event"]]
    assert kinds == ["bus_fault", "branch_trip"]
    out = operating_variant(two_area, out=["8-9 a"])
    assert [e["kind"] for e in fault_scenario(tmp_path, out, FAULT)["event"]] == ["bus_fault"]


def test_the_fault_is_lost_by_the_one_and_kept_by_the_other(two_area: Case, cache: Path) -> None:
    weak = operating_variant(two_area, tie_flow_mw=100.0)
    lost = after_fault(shipped_controller("robust_linear"), "tie +100", weak, FAULT, ["G2_dw"], cache)
    assert not lost.synchronism
    assert not lost.passed
    stable = after_fault(shipped_controller("robust"), "tie +100", weak, FAULT, ["G2_dw"], cache)
    assert stable.passed
    assert stable.largest_angle < np.pi < lost.largest_angle
    assert stable.settled_s <= 10.0


def test_a_fault_has_positive_times() -> None:
    with pytest.raises(ValidationError, match="lost_s"):
        FaultTable(bus=8, branch="8-9 a", lost_s=-1.0)
