"""Time records of OpenIPSL (Modelica): machines and their controls through a bolted fault."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from plant_shim import BlockShim

from interarea.models.blocks.plant import event_parameters, plant_block
from interarea.models.case.events import events_of
from interarea.models.importers.imported import ImportOptions
from interarea.models.importers.psse import import_psse

FOLDER = Path(__file__).parent / "openipsl_records"
RECORDS = {
    k: v for k, v in tomllib.loads((FOLDER / "records.toml").read_text()).items() if isinstance(v, dict)
}
QUICK = ("GENSAE", "SCRX")
#: share of the range; OpenIPSL limits the gate of HYGOV behind its integrator, which winds up there
WITHIN = {"HYGOV_PMECH_pu": 6e-3}


def local_names(plant):
    return [v.name for v in plant.table.of_role("local")]


@pytest.mark.parametrize(
    "name", [n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in RECORDS]
)
def test_the_plant_follows_openipsl(name):
    """Within 1e-3 of each column's range."""
    record = RECORDS[name]
    case = import_psse(
        FOLDER / "SMIB.raw", FOLDER / record["dyr"], options=ImportOptions(P_exponent=1.0, Q_exponent=2.0)
    ).case
    events = [
        {"kind": "bus_fault", "bus": 4, "x_pu": 1e-7, "start_s": 2.0, "end_s": 2.15},
        {"kind": "load_step", "load": case.loads[0].name, "p_pu": record["load_p_pu"], "q_pu": 0.0}
        | {"start_s": 2.0, "end_s": 2.15},
    ]
    plant = BlockShim(plant_block(case), event_parameters(case, events_of(events, where="record")))
    times, states, _ = plant.run(8.0, 0.001 if name == "IEEET1" else 0.002)  # its regulator has 1 ms
    at = [int(np.argmin(np.abs(times - t))) for t in record["time_s"] if t <= 8.0]
    shown = []
    for k in at:  # after the run the network is whole again, as at every sample
        outputs = plant.derivatives(states[k])[1]
        shown.append(dict(zip((*plant.output_names, *local_names(plant)), (*outputs, *plant.w), strict=True)))
    machine = case.machines[0].name
    variable = {"w": f"{machine}_dw", "EFD": f"{machine}.Efd", "PMECH": f"{machine}.Pm"}
    for column in [key for key in record if key.endswith("_pu") and key != "load_p_pu"]:
        result = np.array([row[variable[column.split("_")[-2]]] for row in shown])
        expected = np.array(record[column])[: len(result)]
        error = np.abs(result - expected).max() / np.ptp(expected)
        assert error < WITHIN.get(column, 1e-3), (column, error)
