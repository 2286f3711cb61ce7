"""Time records of PSS/E itself (5 ms steps): machines, exciters, governors and stabilizers."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from plant_shim import BlockShim

from interarea.models.blocks.plant import event_parameters, plant_block
from interarea.models.case.events import events_of
from interarea.models.grid.equilibrium import operating_point
from interarea.models.importers.psse import import_psse

HERE = Path(__file__).parent / "psse_records"
RECORDS = {k: v for k, v in tomllib.loads((HERE / "records.toml").read_text()).items() if isinstance(v, dict)}

QUICK = ("GENROU", "GENSAL", "ESAC1A", "PSS2B")


@pytest.mark.parametrize(
    "name", [n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in RECORDS]
)
def test_the_plant_follows_psse(name):
    """Within 2e-3 of the record's range: what PSS/E's own step of 5 ms leaves."""
    record = RECORDS[name]
    case = import_psse(HERE / record["raw"], HERE / record["dyr"]).case
    machine = next(m for m in case.machines if str(m.bus) == record["column"].split("_")[1])
    if "reference" in record:
        point = operating_point(case)
        vref = point.controls.of("exciter")[0].rest.instance.values["vref"]
        event = {"kind": "vref_step", "machine": machine.name, "size_pu": record["reference"] - vref}
    else:
        line = next(b.name for b in case.branches if {b.from_bus, b.to_bus} == {101, 102})
        event = {"kind": "branch_trip", "branch": line}
    parameters = event_parameters(case, events_of([event | {"start_s": 1.0}], where="record"))
    plant = BlockShim(plant_block(case), parameters)
    times, states, outputs = plant.run(6.0, 0.004)
    if record["column"].startswith("delta"):
        values = np.degrees(states[:, plant.state_names.index(f"{machine.name}.delta")])
    else:
        values = outputs[:, plant.output_names.index(f"{machine.name}_vt")]
    wanted = np.array(record["value"])
    error = np.abs(np.interp(record["time_s"], times, values) - wanted)
    assert error[0] < 5e-5 * max(1.0, abs(wanted[0]))  # the start, digit for digit as printed
    assert error.max() < 2e-3 * np.ptp(wanted)
