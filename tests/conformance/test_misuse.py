"""Illegal calls and absurd values: an error with a message, never a hang or a crash."""

from __future__ import annotations

import ctypes
import math
import struct
from pathlib import Path

import fmpy
import pytest
from fmpy.fmi1 import FMICallException
from fmu_runner import Runner

NAN, INF = math.nan, math.inf


def check_refused(run: Runner, text: str, call: object, *arguments: object) -> None:
    """The call fails with fmi2Error and says `text`."""
    run.log.clear()
    with pytest.raises(FMICallException) as error:
        call(*arguments)  # type: ignore[operator]
    assert error.value.status == 3
    assert text in run.log[-1], run.log


@pytest.mark.parametrize(
    ("point", "step", "text"),
    [
        (0.0, NAN, "finite"),
        (0.0, INF, "finite"),
        (NAN, 0.1, "finite"),
        (0.0, 0.0, "positive"),
        (0.0, -0.1, "positive"),
        (0.0, 1e300, "longer than the allowed"),
        (0.5, 0.1, "the last step ended at 0"),
        (0.0, 2.5, "passes the stop time"),
    ],
)
def test_absurd_steps(fmu: Path, point: float, step: float, text: str) -> None:
    with Runner(fmu) as run:
        run.start(stopTime=2.0)
        check_refused(run, text, run.step, point, step)
        check_refused(run, 'not allowed in state "error"', run.step, 0.0, 0.1)
        run.fmu.reset()
        run.start().step(0.0, 0.1)


def test_steps_of_one_ulp_and_lost_in_rounding(decay: Path) -> None:
    with Runner(decay) as run:
        run.start()
        run.step(0.0, 0.1)
        run.step(0.1, math.ulp(0.1))
        check_refused(run, "too small to change the time", run.step, 0.1, 1e-18)


def test_values_that_are_not_finite(fmu: Path) -> None:
    with Runner(fmu) as run:
        run.start()
        name = next((v.name for v in run.variables.values() if v.causality == "input"), None)
        if name is None:  # a loop: it has parameters only, which are set before
            run.fmu.reset()
            check_refused(run, "remote.latency was set to", run.set_of, {"remote.latency": NAN})
            return
        check_refused(run, f"{name} was set to", run.set_of, {name: NAN})
    with Runner(fmu) as run:
        run.start()
        check_refused(run, f"derivative 1 of {name}", run.slopes, name, INF)


def test_calls_in_the_wrong_state(decay: Path) -> None:
    cases = [
        ("instantiated", lambda r: r.step(0.0, 0.1)),
        ("instantiated", lambda r: r.get("y")),
        ("instantiated", lambda r: r.fmu.exitInitializationMode()),
        ("instantiated", lambda r: r.fmu.terminate()),
        ("step complete", lambda r: r.start().fmu.setupExperiment()),
        ("step complete", lambda r: r.start().fmu.enterInitializationMode()),
        ("terminated", lambda r: (r.start().fmu.terminate(), r.step(0.0, 0.1))),
        ("terminated", lambda r: (r.start().fmu.terminate(), r.set(u=1.0))),
    ]
    for state, call in cases:
        with Runner(decay) as run:
            check_refused(run, f'not allowed in state "{state}"', call, run)


def test_after_an_error_values_are_read_and_nothing_else(decay: Path) -> None:
    """Column "error" of the standard's tables: values for debugging; a reset or a saved state ends it.

    Nothing is computed: values and states stay what they were, whatever is called in between.
    """
    with Runner(decay, "me") as run:
        run.start({"u": 1.5})
        fmu, saved = run.fmu, run.fmu.getFMUstate()
        before = run.get("x"), run.get("y")
        check_refused(run, "is not finite", fmu.setTime, NAN)
        x, dx, nominals = ((ctypes.c_double * 1)() for _ in range(3))
        for _ in range(2):  # no answer changes what the next one is
            fmu.getContinuousStates(x, 1)
            fmu.getDerivatives(dx, 1)
            fmu.fmi2GetNominalsOfContinuousStates(fmu.component, nominals, 1)
            assert (x[0], run.get("y")) == before and nominals[0] > 0.0
        refused = [
            (fmu.setTime, 0.1),
            (fmu.setContinuousStates, x, 1),
            (fmu.enterEventMode,),
            (fmu.newDiscreteStates,),
            (fmu.enterContinuousTimeMode,),
            (fmu.completedIntegratorStep,),
            (fmu.getDirectionalDerivative, [1], [0], [1.0]),
            (fmu.getFMUstate,),
            (run.set_of, {"u": 0.0}),
            (fmu.terminate,),
        ]
        for call, *arguments in refused:
            check_refused(run, 'not allowed in state "error"', call, *arguments)
        fmu.setFMUstate(saved)
        assert run.get("x") == before[0]
        run.set(u=0.5)  # allowed again


def test_model_exchange_states(decay: Path) -> None:
    with Runner(decay, "me") as run:
        run.start()
        check_refused(run, 'in state "event mode"', run.fmu.completedIntegratorStep)
    with Runner(decay, "me") as run:
        run.start()
        run.fmu.newDiscreteStates()
        run.fmu.enterContinuousTimeMode()
        check_refused(run, "rate cannot be set in this state", run.set_of, {"rate": 2.0})


def test_what_cannot_be_set(decay: Path) -> None:
    for name, value, text in [
        ("y", 1.0, "y cannot be set"),
        ("der(x)", 1.0, "der(x) cannot be set"),
        ("ceiling", 1.0, "ceiling cannot be set"),
        ("x", 1.0, "x cannot be set"),
        ("rate", 1e7, "allowed are"),
        ("kicking", 1, "kicking cannot be set"),
    ]:
        with Runner(decay) as run:
            run.start()
            check_refused(run, text, run.set_of, {name: value})


def test_unknown_value_references(decay: Path) -> None:
    calls = [
        lambda r: r.fmu.getReal([99]),
        lambda r: r.fmu.getReal([2**32 - 1]),
        lambda r: r.fmu.setReal([99], [0.0]),
        lambda r: r.fmu.getInteger([1]),  # kicking is a Boolean
        lambda r: r.fmu.getBoolean([0]),  # kicks is an Integer
        lambda r: r.fmu.getString([0]),
    ]
    for call in calls:
        with Runner(decay) as run:
            run.start()
            check_refused(run, "there is no", call, run)


def test_parameters_that_the_block_refuses(decay: Path) -> None:
    with Runner(decay) as run:
        check_refused(run, "rate is -1, must not be negative", run.start, {"rate": -1.0})


def test_discarded_step_leaves_the_state_intact(decay: Path) -> None:
    """x = exp(t) passes the ceiling: fmi2Discard, and everything is as before the step."""
    with Runner(decay) as run:
        run.start({"ceiling": 2.0})
        run.set(u=2.0)
        run.step(0.0, 0.5)
        before = run.get("x")
        run.set(u=20.0)
        with pytest.raises(FMICallException) as error:
            run.step(0.5, 0.5)
        assert error.value.status == 2
        assert run.get("x") == before
        assert run.get("u") == 20.0


def test_diverging_state_is_named(decay: Path) -> None:
    with Runner(decay) as run:
        run.start({"rate": 0.0, "x": -1e308, "u": -1e308})
        check_refused(run, "state x became", run.step, 0.0, 2.0)


def test_damaged_states_are_refused(fmu: Path) -> None:
    with Runner(fmu) as run:
        run.start()
        serialized = run.fmu.serializeFMUstate(run.fmu.getFMUstate())
        for damaged in (
            serialized[:-1],
            serialized + b"\0",
            serialized[:40] + bytes([serialized[40] ^ 1]) + serialized[41:],
            b"\0" * len(serialized),
        ):
            run.fmu.reset()
            check_refused(run, "fmi2DeSerializeFMUstate", run.fmu.deSerializeFMUstate, damaged)


def test_a_state_of_another_fmu_is_refused(built: dict[str, Path]) -> None:
    with Runner(built["decay"]) as a, Runner(built["controller"]) as b:
        state = a.start().fmu.getFMUstate()
        b.start()
        check_refused(b, "not saved by an instance of this FMU", b.fmu.setFMUstate, state)


def test_wrong_guid(decay: Path) -> None:
    run = None
    with pytest.raises(Exception, match="instantiate"):
        run = Runner(decay, guid="{00000000-0000-0000-0000-000000000000}")
    assert run is None


@pytest.mark.parametrize(
    ("damage", "text"),
    [
        (lambda b: b[: len(b) // 2], "truncated"),
        (lambda b: b"", "wrong first bytes"),
        (lambda b: b[:-8] + bytes([b[-8] ^ 1]) + b[-7:], "checksum"),
        (lambda b: b + b"x", "bytes appended"),
        (lambda b: b[:8] + struct.pack("<Q", 2**60) + b[16:], "truncated"),
        (None, "cannot open"),
    ],
)
def test_damaged_resources(
    decay: Path, tmp_path: Path, damage: object, text: str, capfd: pytest.CaptureFixture[str]
) -> None:
    fmpy.extract(str(decay), str(tmp_path))
    file = tmp_path / "resources" / "model.bin"
    if damage is None:
        file.unlink()
    else:
        file.write_bytes(damage(file.read_bytes()))  # type: ignore[operator]
    log: list[str] = []
    with pytest.raises(Exception, match="instantiate"):
        run = Runner.__new__(Runner)
        run.log = log
        Runner.__init__(run, decay, folder=str(tmp_path))
    assert text in run.log[-1]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["with space", "größe ü", "per%cent", "a#b"])
def test_folder_names_that_need_encoding(decay: Path, tmp_path: Path, name: str) -> None:
    folder = tmp_path / name
    fmpy.extract(str(decay), str(folder))
    with Runner(decay, folder=str(folder)) as run:
        run.start().step(0.0, 0.1)
        assert run.get("x") == pytest.approx(math.exp(-0.1), rel=1e-6)  # fourth order, one substep


def test_free_of_null_and_categories(decay: Path) -> None:
    with Runner(decay) as run:
        run.fmu.fmi2FreeInstance(None)
        run.fmu.setDebugLogging(True, ["logEvents"])
        run.start({"kicking": 1})
        for k in range(10):
            run.step(0.1 * k, 0.1)
        assert any("event at time 0.55" in line for line in run.log)
        check_refused(run, "there is no log category", run.fmu.setDebugLogging, True, ["logNothing"])
