"""Steps in which limiters switch: the order of the error, and the bits side by side."""

from __future__ import annotations

from collections import Counter
from ctypes import c_double
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmu_runner import Runner
from plant_lanes import LIMITED_EXCITERS, PlantLanes, limited_case

from interarea.cosim.run.artefacts import plant_fmu
from interarea.models.blocks.plant import event_parameters
from interarea.models.case.case import load_case
from interarea.models.case.events import events_of

STEPS_S = (0.005, 0.0025, 0.00125, 0.000625)


def plants(exciter: str, folder: Path, cache: Path) -> tuple[PlantLanes, dict[str, float | int]]:
    case, row = limited_case(exciter, folder)
    return PlantLanes(case, cache), row


def speeds(plant: PlantLanes, row: dict[str, float | int], step_s: float) -> np.ndarray:
    run = plant.run([row | {"solver.step": step_s}], stop_s=3.0, lanes=1)
    assert not any(run.errors)
    return np.array([run.of(f"G{k}_dw")[:, 0] for k in range(1, 5)])


@pytest.mark.slow
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
            expected = run.every_real()
            run.fmu.setFMUstate(saved)
            assert run.fmu.serializeFMUstate(saved) == bits
            run.step(t, h)
            restored = other.fmu.deSerializeFMUstate(bits)
            other.fmu.setFMUstate(restored)
            other.step(t, h)
            np.testing.assert_array_equal(run.every_real(), expected)
            np.testing.assert_array_equal(other.every_real(), expected)
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


def against_co_simulation(
    fmu: Path, row: dict[str, float | int], tolerance: float
) -> tuple[float, Counter[str]]:
    """Largest difference of the speeds between model exchange by CVode and steps of 0.5 ms; calls made."""
    names = [f"G{k}_dw" for k in range(1, 5)]
    settings: dict[str, Any] = {"stop_time": 3.0, "output_interval": 0.01, "output": names}
    steps = fmpy.simulate_fmu(
        str(fmu), fmi_type="CoSimulation", start_values=row | {"solver.step": 0.0005}, **settings
    )
    calls: Counter[str] = Counter()
    solved = fmpy.simulate_fmu(
        str(fmu),
        fmi_type="ModelExchange",
        start_values=row,
        relative_tolerance=tolerance,
        fmi_call_logger=lambda line: calls.update([line.partition("(")[0]]),
        **settings,
    )
    last = np.searchsorted(solved["time"], steps["time"] + 1e-9, side="right") - 1  # after its events
    assert np.abs(solved["time"][last] - steps["time"]).max() < 1e-9
    return max(np.abs(solved[n][last] - steps[n]).max() for n in names), calls


@pytest.mark.slow
@pytest.mark.parametrize(("exciter", "within"), [("static", 5e-9), ("dc1", 2e-8), ("st1a", 1e-6)])
def test_an_importer_of_model_exchange_locates_the_switches(
    exciter: str, within: float, tmp_path: Path, cache: Path
) -> None:
    """CVode at 1e-8. ST1A's limits move with the voltage: a held state goes onto them at events only."""
    case, row = limited_case(exciter, tmp_path)
    error, calls = against_co_simulation(plant_fmu(case, cache), row, 1e-8)
    assert error <= within
    assert calls["fmi2EnterEventMode"] >= 20
    assert calls["fmi2GetDerivatives"] <= 5000


def test_limiters_of_model_exchange_switch_in_event_mode_once_indicators_are_asked_for(
    tmp_path: Path, cache: Path
) -> None:
    """Beyond its limit an exciter is free until then; what was decided travels with the state."""
    case, row = limited_case("static", tmp_path)
    fmu = plant_fmu(case, cache)
    with Runner(fmu, "me") as run, Runner(fmu, "me") as other, Runner(fmu, "me") as alone:
        n, most = len(run.description.derivatives), run.description.numberOfEventIndicators
        names = [d.variable.derivative.name for d in run.description.derivatives]
        efd, dt = names.index("G1.exciter.efd"), LIMITED_EXCITERS["static"]["TA"]
        x, rates, indicators = (c_double * n)(), (c_double * n)(), (c_double * most)()

        def seen(by: Runner) -> tuple[np.ndarray, np.ndarray]:
            by.fmu.getDerivatives(rates, n)
            if by is not alone:
                by.fmu.getEventIndicators(indicators, most)
            return np.array(rates), np.array(indicators)

        for each in (run, other, alone):
            each.start(row)
            each.fmu.newDiscreteStates()
            each.fmu.enterContinuousTimeMode()
        assert (seen(run)[1] > 0.0).all()
        run.fmu.getContinuousStates(x, n)
        x[efd] = LIMITED_EXCITERS["static"]["Efd_max"] + 0.5
        x[names.index("G1.exciter.v")] -= 0.05  # its input is beyond the limit as well
        for each in (run, alone):
            each.fmu.setContinuousStates(x, n)
        free, result = seen(run)
        assert free[efd] > 10.0  # on towards its input
        assert result.min() == pytest.approx(-0.5, abs=1e-6)
        assert seen(alone)[0][efd] == pytest.approx(-0.5 / dt, rel=1e-9)  # back to its limit
        saved = run.fmu.getFMUstate()
        other.fmu.setFMUstate(other.fmu.deSerializeFMUstate(run.fmu.serializeFMUstate(saved)))
        for one, two in zip(seen(other), (free, result), strict=True):
            np.testing.assert_array_equal(one, two)
        for each in (run, other):
            each.fmu.enterEventMode()
            assert each.fmu.newDiscreteStates()[3]  # valuesOfContinuousStatesChanged
            each.fmu.enterContinuousTimeMode()
            after, result = seen(each)
            assert (result > 0.0).all()
            assert after[efd] == pytest.approx(-0.5 / dt, rel=1e-9)


@pytest.mark.slow
def test_a_grid_out_of_step_is_told_once_that_not_every_switch_is_found(cache: Path) -> None:
    """Its limiters switch hundreds of times a second: that must not cost ten times as many evaluations."""
    case = load_case("nets-nyps")

    def row(cleared_s: float) -> dict[str, float | int]:
        fault = {"kind": "bus_fault", "bus": 2, "start_s": 0.1, "end_s": cleared_s, "x_pu": 1e-4}
        trip = {"kind": "branch_trip", "branch": "2-3", "start_s": cleared_s}
        return event_parameters(case, events_of([fault, trip], where="test")) | {"solver.step": 0.005}

    rows = [row(0.15), row(0.5)]
    plant = PlantLanes(case, cache)
    alone, beside = (plant.run(rows, stop_s=5.0, lanes=lanes) for lanes in (1, 2))
    angles = alone.of("G1_delta") - alone.of("G16_delta")
    assert np.abs(angles[:, 0]).max() < np.pi < np.abs(angles[:, 1]).max()
    np.testing.assert_array_equal(beside.outputs, alone.outputs)
    for parameters, reported in zip(rows, (0, 1), strict=True):
        with Runner(plant_fmu(case, cache)) as run:
            run.start(parameters)
            for k in range(500):
                run.step(0.01 * k, 0.01)
            assert len(run.log) == reported, run.log
            assert all("1500 evaluations were spent on the switching instants" in line for line in run.log)
