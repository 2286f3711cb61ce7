"""Behaviour under the standard's rules, for every block kind."""

from __future__ import annotations

from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmu_runner import Runner
from scipy.linalg import expm

#: the input that is driven; a loop has none
INPUT = {
    "decay": "u",
    "controller": "G2_dw",
    "channel": "u",
    "concentrator": "u1",
    "detector": "G1_dw",
    "pmu": "im",
    "plant": "G1_vs",
    "loop": None,
}
FAULT = {
    "event[1].kind": 1,
    "event[1].target": 8,
    "event[1].start": 0.3,
    "event[1].end": 0.35,
    "event[1].x": 1e-4,
}
PARAMETERS = {
    "decay": {"kicking": 1},
    "controller": {"limit": 0.02},
    "channel": {"latency": 0.123, "outage[1].start": 0.5, "outage[1].end": 0.7, "on_loss": 1},
    "concentrator": {"latency[1]": 0.03, "jitter[1]": 0.1, "loss[1]": 0.3, "seed": 4, "wait": 0.08},
    "detector": {"repeats": 3, "average": 0.4, "return_time": 0.5},
    "pmu": {"performance_class": 1, "half_window": 71},
    "plant": FAULT,
    "loop": {f"plant.{name}": value for name, value in FAULT.items()} | {"remote.latency": 0.123},
}


def kind_of(fmu: Path) -> str:
    return fmu.stem if fmu.stem in INPUT else "plant"


def drive(run: Runner, kind: str, first: int, last: int, h: float = 0.05) -> np.ndarray:
    """Steps `first` to `last` with a sine and its slope at the input; every Real after each."""
    rows = []
    for k in range(first, last):
        t = k * h
        if (name := INPUT[kind]) is not None:
            run.set_of({name: 0.05 * np.sin(5 * t)})
            run.slopes(name, 0.25 * np.cos(5 * t))
        run.step(t, h)
        rows.append(run.every_real())
    return np.array(rows)


def test_reset_is_fresh(fmu: Path) -> None:
    kind = kind_of(fmu)
    with Runner(fmu) as run:
        first = drive(run.start(PARAMETERS[kind]), kind, 0, 20)
        run.fmu.reset()
        again = drive(run.start(PARAMETERS[kind]), kind, 0, 20)
    assert np.array_equal(first, again)
    assert np.ptp(first, axis=0).max() > 1e-3


def test_saved_and_restored_is_uninterrupted(fmu: Path) -> None:
    """Run on, go back, run again; and continue in another instance from the serialised state."""
    kind = kind_of(fmu)
    with Runner(fmu) as run, Runner(fmu) as other:
        run.start(PARAMETERS[kind])
        drive(run, kind, 0, 7)
        state = run.fmu.getFMUstate()
        serialized = run.fmu.serializeFMUstate(state)
        first = drive(run, kind, 7, 20)
        run.fmu.setFMUstate(state)
        run.fmu.freeFMUstate(state)
        assert np.array_equal(first, drive(run, kind, 7, 20))
        copy = other.fmu.deSerializeFMUstate(serialized)
        other.fmu.setFMUstate(copy)
        other.fmu.freeFMUstate(copy)
        assert np.array_equal(first, drive(other, kind, 7, 20))


def test_interleaved_instances_do_not_meet(fmu: Path) -> None:
    kind = kind_of(fmu)
    with Runner(fmu) as a, Runner(fmu, folder=None) as b, Runner(fmu) as alone:
        a.start(PARAMETERS[kind])
        b.start()
        rows = []
        for k in range(12):
            rows.append(drive(a, kind, k, k + 1))
            drive(b, kind, k, k + 1)
        assert np.array_equal(np.vstack(rows), drive(alone.start(PARAMETERS[kind]), kind, 0, 12))


def test_step_plus_rounding_is_taken(fmu: Path) -> None:
    """Masters send 0.30000000000000004 and steps that are an ulp off."""
    with Runner(fmu) as run:
        run.start(stopTime=1.0)
        t = 0.0
        for _ in range(10):
            run.step(t, 0.1)
            t += 0.1
        assert t != 1.0


@pytest.mark.parametrize("kind", ["decay", "controller", "plant"])
def test_directional_derivatives_are_differences(kind: str, built: dict[str, Path]) -> None:
    with Runner(built[kind], "me") as run:
        run.start()
        run.fmu.newDiscreteStates()
        run.fmu.enterContinuousTimeMode()
        unknowns = [u.variable for u in (*run.description.derivatives, *run.description.outputs)]
        unknowns = [v for v in unknowns if v.type == "Real"]
        names = [v.valueReference for v in unknowns]
        states = [d.variable.derivative.name for d in run.description.derivatives]
        x0 = np.array([run.get(s) for s in states])
        h = 1e-6
        for k in range(min(len(states), 20)):
            exact = run.fmu.getDirectionalDerivative(names, [run.reference(states[k])], [1.0])
            both = []
            for sign in (1.0, -1.0):
                x = x0.copy()
                x[k] += sign * h
                run.fmu.setContinuousStates(x.ctypes.data_as(run_double(run)), x.size)
                both.append(np.array(run.fmu.getReal(names)))
            run.fmu.setContinuousStates(x0.ctypes.data_as(run_double(run)), x0.size)
            # Central differences with h = 1e-6 lose 1e-16/h = 1e-10 of values up to 1e3.
            assert np.allclose((both[0] - both[1]) / (2 * h), exact, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(
    "parameters",
    [
        {"latency": 0.0},
        {"latency": 0.12},
        {"latency": 0.013},
        {"latency": 0.0, "reporting_interval": 0.02},
        {"latency": 0.03, "reporting_interval": 0.02, "jitter": 0.01},
        {"latency": 0.0, "reporting_interval": 0.02, "loss_good": 0.5, "on_loss": 0},
        {"latency": 0.013, "outage[1].start": 0.02, "outage[1].end": 0.06, "on_loss": 1},
        {"latency": 0.0, "quantum": 1e-3},
    ],
)
@pytest.mark.parametrize("slopes", [False, True])
def test_channel_directional_derivatives_are_differences(
    built: dict[str, Path], parameters: dict[str, float], slopes: bool
) -> None:
    """At every communication point, the first included: what y does when u is set anew there."""
    h = 1e-6
    with Runner(built["channel"]) as run:
        run.start(parameters)
        for k in range(10):
            t, u = 0.01 * k, 0.3 * np.sin(9.0 * k)
            both = []
            for value in (u - h, u + h):
                run.set(u=value)
                if slopes:
                    run.slopes("u", 2.7 * np.cos(9.0 * k))
                both.append(run.get("y"))
            run.set(u=u)
            exact = run.fmu.getDirectionalDerivative([run.reference("y")], [run.reference("u")], [1.0])[0]
            slope = (both[1] - both[0]) / (2.0 * h)
            # rounding to a quantum is flat or jumps: its derivative is told as 0
            assert exact == 0.0 if "quantum" in parameters else abs(exact - slope) < 1e-8, (k, slope, exact)
            run.step(t, 0.01)


def run_double(_: Runner) -> object:
    from ctypes import POINTER, c_double

    return POINTER(c_double)


def test_outputs_depend_on_what_they_declare(fmu: Path) -> None:
    """No output moves with an input that its dependencies leave out."""
    with Runner(fmu) as run:
        run.start()
        inputs = [v for v in run.description.modelVariables if v.causality == "input"]
        for unknown in run.description.outputs:
            if unknown.variable.type != "Real" or unknown.dependencies is None:
                continue
            for v in inputs:
                slope = run.fmu.getDirectionalDerivative(
                    [unknown.variable.valueReference], [v.valueReference], [1.0]
                )[0]
                assert slope == 0.0 or v in unknown.dependencies


def test_controller_agrees_with_the_matrix_exponential(built: dict[str, Path]) -> None:
    """CS, ME and exp(A t) for a constant input."""
    from fmu_blocks import A, B, C

    values = {"G2_dw": 0.3, "G4_dw": -0.2, "limit": 10.0}
    t = np.linspace(0.0, 4.0, 41)
    u = np.array([0.3, -0.2])
    exact = [float((C @ np.linalg.solve(A, (expm(A * s) - np.eye(3)) @ B @ u))[0]) for s in t]
    for kind in ("CoSimulation", "ModelExchange"):
        result = fmpy.simulate_fmu(
            str(built["controller"]),
            fmi_type=kind,
            stop_time=4.0,
            output_interval=0.1,
            relative_tolerance=1e-9,
            start_values=values,
        )
        assert np.allclose(np.interp(t, result["time"], result["G4_vs"]), exact, atol=1e-7)


def test_plant_agrees_with_itself_in_model_exchange(built: dict[str, Path]) -> None:
    """Own Runge-Kutta against CVode through a Vref pulse at exact times."""
    values = {
        "event[1].kind": 4,
        "event[1].target": 1,
        "event[1].start": 0.3,
        "event[1].end": 0.5,
        "event[1].size": 0.05,
    }
    results = [
        fmpy.simulate_fmu(
            str(built["plant"]),
            fmi_type=kind,
            stop_time=1.5,
            output_interval=0.01,
            relative_tolerance=1e-10,
            start_values=values,
        )
        for kind in ("CoSimulation", "ModelExchange")
    ]
    t = results[0]["time"]
    keep = np.min(np.abs(t[:, None] - np.array([0.3, 0.5])), axis=1) > 0.005
    for name in ("G1_dw", "G2_delta", "G4_vt", "tie_p"):
        cs, me = (np.interp(t, r["time"], r[name]) for r in results)
        assert np.max(np.abs(cs - me)[keep]) < 1e-6, name
