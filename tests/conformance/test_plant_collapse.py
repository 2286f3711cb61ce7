"""A fault that leaves the network without a solution: the run ends with a reason, never with NaN."""

from __future__ import annotations

import numpy as np
import pytest
from plant_lanes import PlantLanes

from interarea.cosim.errors import NoSolutionError
from interarea.cosim.master.instances import FmuParticipant
from interarea.cosim.run.artefacts import plant_fmu
from interarea.fmu_build.open.fmu_file import FmuFile
from interarea.models.blocks.plant import event_parameters
from interarea.models.case.case import Case, load_case
from interarea.models.case.events import events_of

#: four times the load as an impedance, three times its power given back: no voltage answers it out of step
COLLAPSING = {"P_exponent": "none", "P_zip": [4.0, 0.0, -3.0], "Q_exponent": 2.0}
STEP_S = 0.02


@pytest.fixture(scope="module")
def case() -> Case:
    return load_case("kundur-manual").with_changes({"loads": {"L7": COLLAPSING, "L9": COLLAPSING}})


@pytest.fixture(scope="module")
def start(case: Case) -> dict[str, float | int]:
    fault = {"kind": "bus_fault", "bus": 8, "start_s": 0.1, "end_s": 1.6, "x_pu": 0.01}
    return event_parameters(case, events_of([fault], where="test"))


def test_the_step_is_discarded_with_the_bus_and_the_last_good_time(case, start, cache):
    plant = FmuParticipant("plant", FmuFile(plant_fmu(case, cache)), start)
    plant.begin(0.0, 10.0)
    plant.ready()
    steps = 0
    with pytest.raises(NoSolutionError, match=r"no voltage solution at bus [79] with a load") as stopped:
        for k in range(300):
            plant.advance(k * STEP_S, STEP_S)
            plant.receive(slopes=False)
            assert np.all(np.isfinite(plant.y))
            steps = k + 1
    assert "discard" in str(stopped.value)
    assert stopped.value.time_s == pytest.approx(steps * STEP_S, abs=1e-9)
    assert 1.6 < stopped.value.time_s < 6.0
    before = list(plant.y)
    plant.receive(slopes=False)  # the state before the step is intact
    assert list(plant.y) == before
    plant.close()


@pytest.mark.slow
def test_constant_power_finds_its_solution_through_faults_at_every_bus(cache):
    """The network of bounded injections always has a solution; after long faults it is one of low voltage."""
    change = {
        "loads": {"defaults": {"P_exponent": 0.0, "Q_exponent": 0.0}},
        "machines": {"defaults": {"saturation": {"use": "total"}}},
    }
    case, rows = load_case("kundur-thyristor").with_changes(change), []
    for bus in range(1, 12):
        for k, (length, x) in enumerate(((0.05, 1e-8), (0.1, 1e-4), (0.3, 0.02), (0.8, 1e-8))):
            events = [
                {"kind": "bus_fault", "bus": bus, "start_s": 0.1, "end_s": 0.1 + length, "x_pu": x},
                {"kind": "load_step", "load": "L9", "start_s": 0.5, "size_pu": 0.1 * k},
            ]
            if k == 1:
                events.append({"kind": "machine_trip", "machine": f"G{1 + bus % 4}", "start_s": 0.2})
            rows.append(event_parameters(case, events_of(events, where="test")))
    run = PlantLanes(case, cache).run(rows, stop_s=2.5, step_s=STEP_S)
    assert not any(run.errors)
    assert np.all(np.isfinite(run.outputs))
    lowest = min(run.of(f"G{k}_vt")[-1].min() for k in range(1, 5))
    assert lowest < 0.7  # some did collapse
