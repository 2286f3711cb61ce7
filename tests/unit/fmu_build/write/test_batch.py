"""A batch of scenarios: the bits of each alone, the numbers of the FMU, failures named by scenario."""

from __future__ import annotations

import fmpy
import numpy as np
import pytest
from plant_shim import BlockShim

from interarea.cosim.run.artefacts import plant_fmu
from interarea.fmu_build.errors import BuildError, FmuError
from interarea.fmu_build.write.plant_batch import LANES, PlantBatch
from interarea.models.blocks.channel import channel_block
from interarea.models.blocks.plant import event_parameters, plant_block
from interarea.models.case.case import load_case
from interarea.models.case.events import events_of

CASE = "two-area-thesis"


@pytest.fixture(scope="module")
def batch(cache):
    return PlantBatch(plant_block(load_case(CASE)), cache=cache)


def scenarios(count: int) -> list[dict]:
    """Faults at other buses, times and gains; every third with a machine that trips."""
    case, rows = load_case(CASE), []
    for k in range(count):
        end = 0.2 + 0.0137 * (k % 3)
        events = [
            {"kind": "bus_fault", "bus": 5 + k % 7, "start_s": 0.1, "end_s": end, "x_pu": 0.01},
            {"kind": "branch_trip", "branch": "8-9 a", "start_s": end},
        ]
        if k % 3 == 0:
            events.append({"kind": "machine_trip", "machine": "G2", "start_s": 0.31})
        row = event_parameters(case, events_of(events, where="test"))
        rows.append(row | {"G1.exciter.KA": 150.0 + k, "G3.exciter.Efd_max": 4.0 + 0.1 * k})
    return rows


def test_every_number_of_lanes_gives_the_same_bits(batch):
    rows = scenarios(11)
    alone = batch.run(rows, stop_s=0.5, lanes=1)
    assert np.all(np.isfinite(alone.outputs))
    assert not any(alone.errors)
    for lanes in LANES[1:]:
        if lanes > batch.widest:
            continue
        beside = batch.run(rows, stop_s=0.5, lanes=lanes)
        np.testing.assert_array_equal(beside.outputs, alone.outputs)
        np.testing.assert_array_equal(beside.states, alone.states)
        np.testing.assert_array_equal(beside.ended_s, alone.ended_s)


def test_a_scenario_has_the_bits_of_the_fmu(batch, cache):
    """Same record, same steps: what the FMU gives as a co-simulation slave is what the batch gives."""
    rows = scenarios(4)
    run = batch.run(rows, stop_s=0.4, step_s=0.01)
    fmu = plant_fmu(load_case(CASE), cache)
    for k, row in enumerate(rows):
        result = fmpy.simulate_fmu(
            str(fmu),
            stop_time=0.4,
            output_interval=0.01,
            step_size=0.01,
            start_values=row,
            output=run.output_names,
            fmi_type="CoSimulation",
        )
        outputs = np.array([list(r)[1:] for r in result])
        assert len(outputs) == len(run.times_s)
        # the slave's step from k h is (k + 1) h - k h, rounded
        np.testing.assert_allclose(run.outputs[:, :, k], outputs, rtol=0, atol=1e-12)


def test_inputs_and_start_states_reach_their_scenario(batch):
    steps, n = 20, 3
    inputs = np.zeros((steps, len(batch.input_names), n))
    inputs[5:, 0, 1] = 0.02
    rest = batch.run([{}] * n, stop_s=0.2, step_s=0.01)
    moved = batch.run([{}] * n, stop_s=0.2, step_s=0.01, inputs=inputs)
    np.testing.assert_array_equal(moved.of("G1_vt")[:, [0, 2]], rest.of("G1_vt")[:, [0, 2]])
    assert np.abs(moved.of("G1_vt")[:6, 1] - rest.of("G1_vt")[:6, 1]).max() == 0.0
    assert np.abs(moved.of("G1_vt")[7:, 1] - rest.of("G1_vt")[7:, 1]).max() > 1e-4
    again = batch.run([{}] * n, stop_s=0.1, step_s=0.01, start_states=moved.states)
    assert np.abs(again.of("G1_vt")[0] - moved.of("G1_vt")[-1]).max() < 1e-12


@pytest.mark.parametrize("name", ["kundur-thyristor", "nets-nyps"])
def test_a_plant_with_ports_has_the_bits_of_each_scenario_alone(cache, name):
    case, rows = load_case(name), []
    for k in range(6):
        bus = case.buses[(7 * k + 7) % len(case.buses)].number
        fault = {"kind": "bus_fault", "bus": bus, "start_s": 0.02, "end_s": 0.07 + 0.013 * k, "x_pu": 0.01}
        trip = {"kind": "machine_trip", "machine": "G2", "start_s": 0.1}
        rows.append(event_parameters(case, events_of([fault, *([trip] if k == 3 else [])], where="test")))
    batch = PlantBatch(plant_block(case), cache=cache)
    alone = batch.run(rows, stop_s=0.2, lanes=1)
    assert np.all(np.isfinite(alone.outputs))
    for lanes in LANES[1:]:
        if lanes <= batch.widest:
            np.testing.assert_array_equal(batch.run(rows, stop_s=0.2, lanes=lanes).outputs, alone.outputs)
    if name == "kundur-thyristor":
        plant = BlockShim(plant_block(case), rows[0])
        np.testing.assert_allclose(alone.outputs[:2, :, 0], plant.run(0.01, 0.001)[2][::10], atol=1e-12)


def test_a_scenario_that_fails_says_why_and_leaves_the_others_alone(batch):
    rows = scenarios(5)
    branch = next(k for k, b in enumerate(load_case(CASE).branches) if 1 in (b.from_bus, b.to_bus))
    rows[2] |= {
        "event[3].kind": 2,
        "event[3].target": branch + 1,
        "event[3].start": 0.25,
        "event[3].end": 1e30,
    }
    rows[4] |= {"event[1].target": 99}
    good, run = batch.run(scenarios(5), stop_s=0.4), batch.run(rows, stop_s=0.4)
    assert "is cut off" in run.errors[2]
    assert run.ended_s[2] == pytest.approx(0.25, abs=1e-12)
    assert np.all(np.isfinite(run.outputs[:25, :, 2]))
    assert np.all(np.isnan(run.outputs[25:, :, 2]))
    assert "event[1].target = 99" in run.errors[4]
    assert np.all(np.isnan(run.outputs[:, :, 4]))
    np.testing.assert_array_equal(run.outputs[:, :, [0, 1, 3]], good.outputs[:, :, [0, 1, 3]])


def test_what_cannot_be_run_is_refused(batch):
    with pytest.raises(ValueError, match=r"'G9\.H' is no parameter or state"):
        batch.run([{"G9.H": 1.0}], stop_s=0.1)
    with pytest.raises(ValueError, match="0 scenarios"):
        batch.run([], stop_s=0.1)
    with pytest.raises(ValueError, match="lanes = 3"):
        batch.run([{}], stop_s=0.1, lanes=3)
    with pytest.raises(ValueError, match=r"inputs has shape \(1,\)"):
        batch.run([{}], stop_s=0.1, inputs=np.zeros(1))
    with pytest.raises(FmuError, match="substep = 0"):
        batch.run([{}], stop_s=0.1, substep_s=0.0)
    with pytest.raises(KeyError, match="G1_dw"):
        batch.run([{}], stop_s=0.01).of("G1_speed")
    with pytest.raises(BuildError, match="blocks of kind plant"):
        PlantBatch(channel_block())
