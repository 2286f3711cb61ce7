"""The plant FMU through a fault and a trip: co-simulation against model exchange with CVode."""

from __future__ import annotations

from pathlib import Path

import fmpy
import numpy as np
import pytest

from interarea.fmu_build.write.package import build_fmu
from interarea.models.blocks.plant import event_parameters, plant_block
from interarea.models.case.case import load_case
from interarea.models.case.events import events_of

OUTPUTS = ["G1_dw", "G2_dw", "G4_dw", "G1_delta", "G1_pe", "G1_vt", "tie_p"]


@pytest.mark.slow
def test_both_kinds_agree_through_a_fault_and_a_trip(tmp_path: Path) -> None:
    case = load_case("two-area-thesis")
    fmu = build_fmu(plant_block(case), tmp_path / "plant.fmu")
    events = events_of(
        [
            {"kind": "bus_fault", "bus": 8, "start_s": 0.5, "end_s": 0.6333333, "x_pu": 1e-4},
            {"kind": "branch_trip", "branch": "8-9 a", "start_s": 0.6333333},
        ],
        where="test",
    )
    start = event_parameters(case, events)
    common = {"stop_time": 2.0, "output_interval": 0.01, "start_values": start, "output": OUTPUTS}
    stepped = fmpy.simulate_fmu(str(fmu), fmi_type="CoSimulation", **common)
    exact = fmpy.simulate_fmu(
        str(fmu), fmi_type="ModelExchange", solver="CVode", relative_tolerance=1e-9, step_size=1e-3, **common
    )
    rows = {round(float(t), 6): k for k, t in enumerate(exact["time"])}  # at an event the later row counts
    pairs = [
        (k, rows[round(float(t), 6)]) for k, t in enumerate(stepped["time"]) if round(float(t), 6) in rows
    ]
    assert len(pairs) >= 200
    for name in OUTPUTS:
        gap = max(abs(stepped[name][k] - exact[name][j]) for k, j in pairs)
        assert gap <= 1e-6, f"{name}: {gap:.2g}"
    assert np.ptp(exact["G1_dw"]) > 2e-3  # the fault did act
