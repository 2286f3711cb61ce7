"""An SVC against a record of PSS/E: a load on a grid of three buses falls from 455 to 400 MW."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from plant_shim import BlockShim

from interarea.models.blocks.plant import event_parameters, plant_block
from interarea.models.case.events import events_of
from interarea.models.errors import CaseError
from interarea.models.importers.file import import_grid

RECORD = Path(__file__).parents[5] / "shared" / "reference" / "psse_traces" / "CSVGN1"
#: the RAW of the record has no unit for the SVC; DYR values are those of its source's test
UNIT = "3, '1', 0.0, 80.0, 440.0, -60.0, 1.015, 0, 500.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1, 100.0, 0.0, 0.0, 1, 1.0"
SVC = "3 'CSVGN1' 1 0 20.0 0.0 1.0 0.154833 1.0 0.005167 0.0 1.0 0.0 60.0 /"
pytestmark = pytest.mark.skipif(not RECORD.exists(), reason="needs ../shared/reference")


def imported(folder, unit=UNIT, svc=SVC, more=""):
    text = (RECORD / "3_BUS_System.raw").read_text()
    (folder / "grid.raw").write_text(text.replace("0 / END OF GENERATOR", f"{unit}\n0 / END OF GENERATOR"))
    (folder / "grid.dyr").write_text(f"1 'GENCLS' 1 0.0 0.0 /\n{svc}\n{more}")
    return import_grid(folder / "grid.raw", dyr=folder / "grid.dyr").case


def test_csvgn1_follows_the_record(tmp_path):
    """The bound is a digit of the record: V of bus 1 moves by .007 pu and is printed to single precision."""
    case = imported(tmp_path)
    assert [s.name for s in case.svcs] == ["G3"]
    step = {"kind": "load_step", "bus": 2, "p_pu": (400.0 - 455.0) / 100.0, "start_s": 0.005}
    # the record's 400 MW are drawn at 1 pu, as its 455 are at the voltage of the start
    block = plant_block(case, more=["bus1.v", "bus2.v", "bus3.v"])
    plant = BlockShim(block, event_parameters(case, events_of([step], where="test")))
    t, _, y = plant.run(0.07, 0.0001)
    _, *rows = (RECORD / "CSVGN1.csv").read_text().splitlines()
    record = np.array([[float(v) for v in row.split(",")] for row in rows])
    away = np.abs(record[:, 0] - 0.005) > 1.5e-4  # at the step itself the record has both values
    for k in (1, 2, 3):
        own = np.interp(record[away, 0], t, y[:, plant.output_names.index(f"bus{k}.v")])
        error = np.max(np.abs(own - record[away, k])) / np.ptp(record[:, k])
        print(k, error)
        assert error <= 3e-4


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"unit": UNIT.replace("0.0, 80.0", "5.0, 80.0")}, "is an SVC in the DYR and gives 5 MW, allowed: 0"),
        ({"svc": SVC.replace(" 0 20.0", " 99 20.0")}, "svcs.G3.regulates = 99: no such bus"),
        ({"svc": SVC.replace("60.0 /", "/")}, "grid.dyr:2: CSVGN1 has 10 fields, allowed: 11, - K T1"),
        ({"more": "3 'SEXS' 1 0.1 10.0 100.0 0.1 -5.0 5.0 /\n"}, "G3 is an SVC and at"),
        ({"svc": SVC.replace("0 20.0", "0.5 20.0")}, "IB (field 1) = 0.5, allowed: a whole number"),
    ],
)
def test_records_that_make_no_svc_are_refused_with_their_line(tmp_path, changes, says):
    with pytest.raises(CaseError) as reported:
        imported(tmp_path, **changes)
    assert says in str(reported.value)
    assert "\n" not in str(reported.value)
    assert "grid." in str(reported.value)
