"""Trajectories of the plant against another tool's: bus fault cleared by a trip, line trip, limits acting."""

from __future__ import annotations

import json

import numpy as np
import printed
import pytest
from plant_shim import BlockShim

from interarea.models.blocks.plant import event_parameters, plant_block
from interarea.models.case.case import load_case
from interarea.models.case.events import events_of

STORED = json.loads((printed.PUBLISHED / "trajectories_andes.json").read_text())
ALLOWED = 1e-3  #: of the peak of dw24
#: ANDES takes an event in a step of 1e-4 s of its own, by the trapezoidal rule: 5e-5 s late in effect
LATE_S = 5e-5
ALLOWED_SHIFTED = 1.5e-4


@pytest.mark.slow
@pytest.mark.parametrize("row", STORED["row"], ids=lambda row: row["run"])
def test_dw24_is_that_of_another_tool(row):
    """ANDES with the same rows over 5 s; with its event times, ten times closer than asked."""
    case = load_case("kundur-thyristor-z").with_changes({"machines": {"defaults": row["machines"]}})
    events = event_parameters(case, events_of(row["events"], where="kept"))
    plant = BlockShim(plant_block(case), events)
    theirs = np.array(row["dw24"])
    times, _, outputs = plant.run(len(theirs) * STORED["step_s"], 0.001)
    g2, g4 = (plant.output_names.index(f"{m}_dw") for m in ("G2", "G4"))

    def ours(at):  # linear between steps of 1 ms: good to 1e-5 of the peak
        return np.interp(at, times, outputs[:, g2] - outputs[:, g4])

    at = STORED["step_s"] * np.arange(1, len(theirs) + 1)
    peak = np.abs(ours(at)).max()
    assert np.abs(ours(at) - theirs).max() < ALLOWED * peak
    assert np.abs(ours(at - LATE_S) - theirs).max() < ALLOWED_SHIFTED * peak
