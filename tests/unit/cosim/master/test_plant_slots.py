"""Event slots of a plant that runs: set anew they count from the next event on, and are checked then."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from interarea.cosim.errors import StepError
from interarea.cosim.master.instances import FmuParticipant
from interarea.cosim.run.artefacts import plant_fmu
from interarea.fmu_build.open.fmu_file import FmuFile
from interarea.models.blocks.plant import event_parameters
from interarea.models.blocks.plant_variables import EVENT_CODES
from interarea.models.case.case import load_case
from interarea.models.case.events import VrefPulse


def power_after(plant: FmuParticipant, step_s: float, steps: int) -> float:
    for _ in range(steps):
        assert plant.time_s is not None
        plant.advance(plant.time_s, step_s)
    return plant.value_of("G1_pe")


@pytest.fixture
def plant(cache: Path) -> Iterator[FmuParticipant]:
    result = FmuParticipant("plant", FmuFile(plant_fmu(load_case("two-area-thesis"), cache)))
    result.begin(0.0, 10.0)
    result.ready()
    yield result
    result.close()


def test_a_fault_that_is_scheduled_while_the_plant_runs_happens(plant: FmuParticipant) -> None:
    rest = power_after(plant, 0.125, 2)
    fault = {"kind": EVENT_CODES["bus_fault"], "target": 3, "start": 0.5, "end": 0.75, "x": 0.01}
    plant.change({f"event[1].{key}": value for key, value in fault.items()})
    assert power_after(plant, 0.125, 1) == pytest.approx(rest, abs=1e-9)
    assert abs(power_after(plant, 0.125, 2) - rest) > 0.1


@pytest.mark.parametrize(
    ("slot", "message"),
    [
        ({"target": 1000}, r"event\[1\]\.target = 1000 for bus_fault, allowed: 1 to"),
        ({"target": -1}, r"event\[1\]\.target = -1 for bus_fault"),
        ({"x": 0.0}, r"allowed: r >= 0 and \|r \+ jx\|"),
    ],
)
def test_a_slot_that_makes_no_sense_is_refused_when_its_event_comes(
    plant: FmuParticipant, slot: dict[str, float], message: str
) -> None:
    fault = {"kind": EVENT_CODES["bus_fault"], "target": 3, "start": 0.5, "end": 0.75, "x": 0.01} | slot
    plant.change({f"event[1].{key}": value for key, value in fault.items()})
    with pytest.raises(StepError, match=message):
        power_after(plant, 0.125, 6)


def test_slots_set_later_or_from_the_start_give_the_same_bits(plant: FmuParticipant) -> None:
    case = load_case("two-area-thesis")
    event = VrefPulse(machine="G1", size_pu=0.05, start_s=0.5, end_s=0.8)
    slots = event_parameters(case, [event])
    power_after(plant, 0.125, 3)
    plant.change(slots)
    late = power_after(plant, 0.125, 7)
    plant.set_start(slots)
    plant.begin(0.0, 10.0)
    plant.ready()
    assert power_after(plant, 0.125, 10) == late
