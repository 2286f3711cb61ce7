"""The first swing's sensitivity to each actuator, against a run in which the actuator really moves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from interarea.cosim.designs.design_tables import AcceptanceTable
from interarea.cosim.designs.fault_runs import FaultRun, FaultRuns
from interarea.cosim.designs.first_swing import after_clearing
from interarea.cosim.designs.swing_sensitivity import (
    STEP_S,
    FirstSwingTable,
    first_swing,
    swing_penalty,
)
from interarea.models.case.case import load_case
from interarea.models.case.variants import operating_variant

TABLE = AcceptanceTable(fault=({"bus": 8, "trip": "8-9 a"},))  # type: ignore[arg-type]
CASE = operating_variant(load_case("two-area-thesis"), tie_flow_mw=100.0)


@pytest.mark.slow
def test_the_sum_of_the_pulses_is_what_a_lasting_step_does(cache: Path) -> None:
    """+-.01 pu at G4 from the fault's end on move the first peak by +5.7/-5.3 degrees of 90."""
    swing = first_swing(CASE, TABLE.fault[0], TABLE, ["G4_vs", "G2_vs"], cache)
    assert swing is not None
    assert swing.peak_deg == pytest.approx(90.0, abs=0.5)
    clear_s = TABLE.start_s + TABLE.clear_cycles / 60.0
    events = after_clearing(CASE, 8, "8-9 a", TABLE.start_s, clear_s, x_pu=TABLE.x_pu)
    for machine in ("G4", "G2"):
        steps = [
            [*events, {"kind": "vref_step", "machine": machine, "size_pu": size, "start_s": 1.2}]
            for size in (0.01, -0.01)
        ]
        with FaultRuns(CASE, cache) as runs:
            up, down = runs.largest_angles([FaultRun(e, 3.0) for e in steps])
        s = swing.sensitivity[f"{machine}_vs"]
        predicted = 0.01 * STEP_S * s[STEP_S * np.arange(s.size) >= 0.2 - 1e-9].sum()
        assert np.degrees(up - down) / 2.0 == pytest.approx(predicted, rel=0.05)


@pytest.mark.slow
def test_signals_of_the_penalty_are_late_and_go(cache: Path) -> None:
    penalty = swing_penalty(
        {"tie +100": CASE},
        FirstSwingTable(latency_s=0.1),
        TABLE,
        ("G2_dw", "G4_dw"),
        ("G4_vs",),
        [(), ("G2_dw",)],
        0.05,
        cache,
    )
    there, lost = penalty.cases
    assert there.signals.shape == lost.signals.shape == (125, 2)
    assert np.abs(there.signals[:6]).max() < 1e-9  # 100 ms at steps of 20 ms, from rest
    gone = round((TABLE.lost_s - TABLE.start_s) / STEP_S)
    assert not lost.signals[gone:, 0].any()
    assert np.abs(there.signals[gone:, 0]).min() > 0.01
    assert np.array_equal(lost.signals[:, 1], there.signals[:, 1])
    assert np.array_equal(lost.signals[:gone, 0], there.signals[:gone, 0])
    # a controller that raises the importing area's voltage with the speed adds to the swing
    gains = np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), np.array([[0.0, 0.05]])
    assert penalty.shifts_deg(gains)[1] > 5.0
    assert penalty.shifts_deg(tuple(-M for M in gains))[1] < -5.0  # type: ignore[arg-type]


def test_a_first_swing_needs_faults_and_points_that_are_there() -> None:
    with pytest.raises(ValueError, match=r"needs \[acceptance\]"):
        FirstSwingTable().check(["base"], None)
    with pytest.raises(ValueError, match=r"points has \['elsewhere'\]; the design's are base"):
        FirstSwingTable(points=("elsewhere",)).check(["base"], TABLE)
