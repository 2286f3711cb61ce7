"""Time records of PSS/E itself (5 ms steps): machines, exciters, governors and stabilizers."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from plant_shim import BlockShim

from interarea.models.blocks.plant import event_parameters, plant_block
from interarea.models.case.events import events_of
from interarea.models.devices.dyr import device_for_dyr
from interarea.models.devices.language.device import FBASE, MBASE
from interarea.models.devices.rest import rest_of
from interarea.models.grid.equilibrium import operating_point
from interarea.models.importers.dyr import read_dyr
from interarea.models.importers.psse import import_psse

FOLDER = Path(__file__).parent / "psse_records"
RECORDS = {
    k: v for k, v in tomllib.loads((FOLDER / "records.toml").read_text()).items() if isinstance(v, dict)
}

QUICK = ("GENROU", "GENSAL", "ESAC1A", "PSS2B")


@pytest.mark.parametrize(
    "name", [n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in RECORDS]
)
def test_the_plant_follows_psse(name):
    """Within 2e-3 of the record's range: what PSS/E's own step of 5 ms leaves.

    1e-3 for PSS2C, by steps of 1 ms. Its power crosses the thresholds at 1.608 and 2.033 s; PSS/E begins
    5 ms steps at 1.610 and 2.035 s. The record is followed best where the switch acts at 1.6120 and 2.0375:
    within 3.6e-4 (that of PSS2B, without a switch: 4.0e-4); with a lag of 2 ms, within 3.9e-3.
    """
    record = RECORDS[name]
    case = import_psse(FOLDER / record["raw"], FOLDER / record["dyr"]).case
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
    times, states, outputs = plant.run(6.0, 0.001 if name == "PSS2C" else 0.004)
    if record["column"].startswith("delta"):
        values = np.degrees(states[:, plant.state_names.index(f"{machine.name}.delta")])
    else:
        values = outputs[:, plant.output_names.index(f"{machine.name}_vt")]
    expected = np.array(record["value"])
    error = np.abs(np.interp(record["time_s"], times, values) - expected)
    assert error[0] < 5e-5 * max(1.0, abs(expected[0]))  # the start, digit for digit as printed
    assert error.max() < (1e-3 if name == "PSS2C" else 2e-3) * np.ptp(expected)


def test_pss2c_remembers_between_its_thresholds_whether_it_is_on() -> None:
    """On above 0.895 pu, off below 0.885, between them as before; off it gives nothing."""
    (record,) = [r for r in read_dyr(FOLDER / "OMIB_PSS2C.dyr").records if r.model == "PSS2C"]
    result = device_for_dyr(record)
    inputs = {"slip": 0.0, "pe": 0.9, "vt": 1.0, "vd": 0.6, "vq": 0.8, "pm": 0.9}
    rest = rest_of(result.model, dict(result.parameters) | {MBASE: 100.0, FBASE: 60.0}, inputs, None, "x")
    states = np.array(rest.states)
    for on, pe, then in ((1, 0.9, 1), (1, 0.89, 1), (1, 0.88, 0), (0, 0.89, 0), (0, 0.9, 1)):
        states[3:] = 1e-3
        states[-1] = on
        signals, rates = rest.instance.run(states, inputs | {"pe": pe})
        assert on + 0.0072 * rates[-1] == pytest.approx(then)
        assert (signals["vs"] != 0.0) == bool(on)
