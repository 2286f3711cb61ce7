"""Converter plants against records of PSS/E: line 101-103 opens at 1 s, an infinite bus is left."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from plant_shim import BlockShim

from interarea.models.blocks.plant import event_parameters, plant_block
from interarea.models.case.events import events_of
from interarea.models.errors import CaseError
from interarea.models.importers.file import import_grid
from interarea.models.importers.imported import ImportOptions

RENA = Path(__file__).parents[5] / "shared" / "reference" / "psse_traces" / "RENA"
DYR = {
    "RENA_DEFAULT": "ThreeBus_REN_A_DEFAULT_FLAG",
    "RENA_FREQ_FLAG": "ThreeBus_REN_A_FREQ_FLAG",
    "RENA_REF_FLAG": "ThreeBus_REN_A_NOFREQFLAG_with_REF_FLAG",
}
pytestmark = pytest.mark.skipif(not RENA.exists(), reason="needs ../shared/reference")


def compared(name, **changes):
    """Return time, columns of the record by name, and what the plant gives there."""
    case = import_grid(RENA / "ThreeBusRenewable.raw", dyr=RENA / f"{DYR[name]}.dyr").case
    if changes:
        case = case.with_changes({"converters": {"G103": {"control": changes}}})
    events = events_of([{"kind": "branch_trip", "branch": "101-103", "start_s": 1.0}], where="test")
    block = plant_block(case, more=["bus103.v", "bus103.re", "bus103.im", "bus102.re", "bus102.im"])
    plant = BlockShim(block, event_parameters(case, events))
    t, _, y = plant.run(10.0 if name == "RENA_REF_FLAG" else 5.0, 0.0025)
    head, *rows = (RENA / f"{name}.csv").read_text().splitlines()
    record = np.array([[float(v) for v in row.split(",")] for row in rows])
    times = record[:, 0]
    seen = {key: y[:, plant.output_names.index(key)] for key in plant.output_names}
    volts = [seen[f"bus{k}.re"] + 1j * seen[f"bus{k}.im"] for k in (103, 102)]
    angle = np.angle(volts[0] / volts[1], deg=True)
    own = {"P_103_pu": seen["G103.p"], "Q_103_pu": seen["G103.q"], "V_103_pu": seen["bus103.v"]}
    own["theta_103_deg"] = angle
    keep = (times < 0.99) | (times > 1.001)
    columns = {k: v[keep] for k, v in zip(head.split(","), record.T, strict=True)}
    return times[keep], columns, {k: np.interp(times[keep], t, v) for k, v in own.items()}


def errors(name, **changes):
    """Return the largest error of each column as a share of its range; P, Q from .1 s after the trip."""
    times, record, own = compared(name, **changes)
    result = {}
    for key in set(record) - {"time_s"}:
        late = times > (1.1 if key[0] in "PQ" else 0.0)
        result[key[0]] = np.max(np.abs(own[key] - record[key])[late]) / np.ptp(record[key])
    return result


#: record -> largest error of each column, share of its range
BOUNDS = {
    "RENA_DEFAULT": {"V": 1e-3, "P": 2.5e-3, "Q": 2.5e-3},
    "RENA_FREQ_FLAG": {"V": 1e-3, "P": 9e-3, "Q": 2.5e-3},
    "RENA_REF_FLAG": {"V": 2.45e-2, "t": 3.6e-3},
}


@pytest.mark.slow
@pytest.mark.parametrize("name", BOUNDS)
def test_a_plant_follows_the_record(name):
    result = errors(name)
    assert all(result[key] <= bound for key, bound in BOUNDS[name].items()), result


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (
            "'REECB1' 1",
            "'REECB1' 2",
            "G103 has no REECB1 or REECA1 or REECC1, which sets its currents, allowed: one; --converters",
        ),
        ("'REGCA1' 1", "'REGCA1' 2", "G103 has no REGCA1 or REGCB1 or REGCC1, which is the converter itself"),
        (
            "103 'REPCA1' 1\n             0           0           0",
            "103 'REPCA1' 1\n 0 101 999",
            "REPCA1 measures branch 101-999 '0', allowed: a line or transformer of two windings in service",
        ),
    ],
)
def test_records_that_make_no_plant_are_refused_with_their_line(tmp_path, old, new, says):
    text = (RENA / f"{DYR['RENA_DEFAULT']}.dyr").read_text()
    assert old in text
    (tmp_path / "grid.dyr").write_text(text.replace(old, new))
    with pytest.raises(CaseError) as reported:
        import_grid(RENA / "ThreeBusRenewable.raw", dyr=tmp_path / "grid.dyr")
    assert says in str(reported.value)
    assert "grid.dyr:" in str(reported.value)


def test_as_currents_there_is_no_converter():
    case = import_grid(
        RENA / "ThreeBusRenewable.raw",
        dyr=RENA / f"{DYR['RENA_DEFAULT']}.dyr",
        options=ImportOptions(converters="current"),
    ).case
    assert case.converters == ()
    plant = next(load for load in case.loads if load.name == "G103")
    assert plant.P_mw == pytest.approx(-40.0, abs=1e-4)
    assert plant.P_exponent == plant.Q_exponent == 1.0
