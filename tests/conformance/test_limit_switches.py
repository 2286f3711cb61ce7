"""Steps in which limiters switch: the order of the error, and the bits side by side."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fmu_runner import Runner
from plant_lanes import LIMITED_EXCITERS, PlantLanes, limited_case

from interarea.cosim.run.artefacts import plant_fmu

STEPS_S = (0.005, 0.0025, 0.00125, 0.000625)


def plants(exciter: str, folder: Path, cache: Path) -> tuple[PlantLanes, dict[str, float | int]]:
    case, row = limited_case(exciter, folder)
    return PlantLanes(case, cache), row


def speeds(plant: PlantLanes, row: dict[str, float | int], step_s: float) -> np.ndarray:
    run = plant.run([row | {"solver.step": step_s}], stop_s=3.0, lanes=1)
    assert not any(run.errors)
    return np.array([run.of(f"G{k}_dw")[:, 0] for k in range(1, 5)])


@pytest.mark.parametrize("exciter", LIMITED_EXCITERS)
def test_errors_at_limits_fall_with_the_fourth_power_of_the_step(
    exciter: str, tmp_path: Path, cache: Path
) -> None:
    plant, row = plants(exciter, tmp_path, cache)
    exact = speeds(plant, row, 0.01 / 256)
    errors = [np.abs(speeds(plant, row, h) - exact).max() for h in STEPS_S]
    orders = np.log2(errors[0] / np.array(errors[1:])) / np.arange(1, len(errors))
    assert orders[-1] >= 3.5, (errors, orders)
    assert errors[0] <= 1e-8, errors


def test_a_state_saved_around_a_switch_goes_on_with_the_same_bits(tmp_path: Path, cache: Path) -> None:
    """Before, in and after steps in which a limiter switches, in the instance and, as bytes, in another."""
    case, row = limited_case("static", tmp_path)
    top, fmu = LIMITED_EXCITERS["static"]["Efd_max"], plant_fmu(case, cache)
    with Runner(fmu) as run, Runner(fmu) as other:
        run.start(row | {"solver.step": 0.005})
        other.start()

        def at_top() -> list[bool]:
            return [bool(run.get(f"G{k}.exciter.efd") == top) for k in range(1, 5)]

        def again(t: float, h: float) -> bool:
            """Step on in three ways; whether an exciter gets to its limit in the step, or leaves it."""
            saved, before = run.fmu.getFMUstate(), at_top()
            bits = run.fmu.serializeFMUstate(saved)
            run.step(t, h)
            wanted = run.every_real()
            run.fmu.setFMUstate(saved)
            assert run.fmu.serializeFMUstate(saved) == bits
            run.step(t, h)
            restored = other.fmu.deSerializeFMUstate(bits)
            other.fmu.setFMUstate(restored)
            other.step(t, h)
            np.testing.assert_array_equal(run.every_real(), wanted)
            np.testing.assert_array_equal(other.every_real(), wanted)
            run.fmu.freeFMUstate(saved)
            other.fmu.freeFMUstate(restored)
            return before != at_top()

        for k in range(10):
            again(0.01 * k, 0.01)
        switched = [k for k in range(10, 100) if again(0.01 * k, 0.01)]
        assert len(switched) >= 6


def test_switches_give_the_same_bits_side_by_side(tmp_path: Path, cache: Path) -> None:
    plant, row = plants("st1a", tmp_path, cache)
    rows = [row | {"G1.exciter.KA": 100.0 + 5.0 * k, "G3.exciter.VRmax": 3.0 + 0.1 * k} for k in range(7)]
    alone = plant.run(rows, stop_s=1.0, lanes=1)
    for lanes in (2, 4, 8):
        if lanes <= plant.group.lanes:
            beside = plant.run(rows, stop_s=1.0, lanes=lanes)
            np.testing.assert_array_equal(beside.outputs, alone.outputs)
