"""What a user of the plant FMU sees when a trip cuts the grid: the step goes on, a remark in the log."""

from __future__ import annotations

from pathlib import Path

import pytest
from fmu_runner import Runner

from interarea.cosim.run.artefacts import plant_fmu
from interarea.models.blocks.plant import event_parameters
from interarea.models.case.case import load_case
from interarea.models.case.events import events_of

CASE = "two-area-thesis"


def test_a_cut_is_a_remark_and_no_error(cache: Path) -> None:
    case = load_case(CASE)
    around = [b.name for b in case.branches if 7 in (b.from_bus, b.to_bus)]
    trips = [{"kind": "branch_trip", "branch": name, "start_s": 0.025} for name in around]
    with Runner(plant_fmu(case, cache)) as plant:
        plant.start(event_parameters(case, events_of(trips, where="test")))
        before = list(plant.log)
        for k in range(10):
            plant.step(0.01 * k, 0.01)  # raises on any status but OK
        said = plant.log[len(before) :]
        assert [text for text in said if "removed" in text] == [
            "network: bus 7 removed, no running machine is connected to it; "
            "2 islands remain, each with its own centre of inertia"
        ]
        assert plant.get("bus7.v") == pytest.approx(0.0, abs=1e-12)
        assert abs(plant.get("G1_dw")) > 1e-6
