"""Numbers: what is not finite never comes with fmi2OK; far from t = 0 a step is as long as was said."""

from __future__ import annotations

import ctypes
import math
from pathlib import Path

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmu_runner import Runner

NAN = math.nan
LARGEST = 1.7e308
DOUBLES = ctypes.POINTER(ctypes.c_double)


def check_refused(run: Runner, status: int, text: str, call: object, *arguments: object) -> None:
    """The call fails with `status` (2: fmi2Discard, 3: fmi2Error) and says `text`."""
    run.fmu.setDebugLogging(True, ["logAll"])
    run.log.clear()
    with pytest.raises(FMICallException) as error:
        call(*arguments)  # type: ignore[operator]
    assert error.value.status == status
    assert text in run.log[-1], run.log


def continuous(run: Runner) -> Runner:
    run.start()
    run.fmu.newDiscreteStates()
    run.fmu.enterContinuousTimeMode()
    return run


def test_continuous_states_are_finite(decay: Path) -> None:
    with Runner(decay, "me") as run:
        continuous(run)
        x = np.array([NAN])
        set_states = lambda: run.fmu.setContinuousStates(x.ctypes.data_as(DOUBLES), 1)  # noqa: E731
        check_refused(run, 3, "state x was set to nan", set_states)


def test_finite_values_that_overflow(decay: Path) -> None:
    """dx/dt = -rate x + u at the ends of the doubles: a discard, and with other values all is well again."""
    with Runner(decay, "me") as run:
        run.start({"rate": 1e6, "ceiling": 1.79e308})
        run.fmu.newDiscreteStates()
        run.fmu.enterContinuousTimeMode()
        x = np.array([LARGEST])
        run.fmu.setContinuousStates(x.ctypes.data_as(DOUBLES), 1)
        check_refused(run, 2, "der(x) is -inf", run.get, "der(x)")
        check_refused(run, 2, "the derivative of x is -inf", lambda: derivatives(run))
        x[0] = 1.0
        run.fmu.setContinuousStates(x.ctypes.data_as(DOUBLES), 1)
        assert run.get("der(x)") == -1e6


def derivatives(run: Runner) -> np.ndarray:
    out = np.zeros(1)
    run.fmu.getDerivatives(out.ctypes.data_as(DOUBLES), 1)
    return out


def test_directions(decay: Path) -> None:
    with Runner(decay) as run:
        run.start({"rate": 1e6, "ceiling": 1.79e308})
        names = [run.reference("der(x)")], [run.reference("x")]
        assert run.fmu.getDirectionalDerivative(*names, [2.0]) == [-2e6]
        check_refused(
            run, 2, "the derivative of der(x) is", run.fmu.getDirectionalDerivative, *names, [LARGEST]
        )
        check_refused(run, 3, "the direction of x is nan", run.fmu.getDirectionalDerivative, *names, [NAN])


def test_an_input_that_its_derivatives_lead_out_of_the_numbers(built: dict[str, Path]) -> None:
    with Runner(built["channel"]) as run:
        run.start()
        name = next(v.name for v in run.variables.values() if v.causality == "input" and v.type == "Real")
        run.slopes(name, LARGEST, LARGEST, LARGEST)
        check_refused(run, 3, f"input {name} became inf", run.step, 0.0, 9.0)


@pytest.mark.parametrize("begin", [0.0, 1e6, 9e9, -9e9])
def test_steps_are_as_long_as_was_said(decay: Path, begin: float) -> None:
    """dx/dt = -x: after 100 steps of 0.1 s x is exp(-10) wherever the clock began.

    At 9e9 s a double has a digit of 1.9e-6 s: the difference of two communication points is off by 1e-5.
    """
    with Runner(decay) as run:
        run.start(startTime=begin)
        for k in range(100):
            run.step(begin + 0.1 * k, 0.1)
        # the Runge-Kutta error of steps of 0.01 s: 10 * 0.01^4 / 120 = 8e-10 of x
        assert run.get("x") == pytest.approx(math.exp(-10.0), rel=1e-9)
        one = Runner(decay)
        with one:
            one.start(startTime=begin)
            one.step(begin, 0.1)
            assert one.get("x") == pytest.approx(math.exp(-0.1), rel=1e-11)


def test_a_step_that_the_clock_cannot_tell_is_refused(decay: Path) -> None:
    with Runner(decay) as run:
        run.start(startTime=9e9)
        check_refused(run, 3, "too small to change the time", run.step, 9e9, 1e-7)


def test_a_point_far_from_where_the_last_step_ended_is_refused(decay: Path) -> None:
    with Runner(decay) as run:
        run.start(startTime=9e9)
        check_refused(run, 3, "the last step ended at", run.step, 9e9 + 1.0, 0.1)


@pytest.mark.parametrize("event", [0.1, 0.7, 1.0, 1.1, 3.3, 1e3, 1e6 + 0.1])
def test_an_event_at_the_end_of_a_nanosecond_happens_once(decay: Path, event: float) -> None:
    points = [event - 0.1, event - 1e-9, event, event + 1e-9, event + 0.1]
    for before in (points, points[:1] + points[2:], points[:2] + points[3:]):
        with Runner(decay) as run:
            run.start({"kicking": 1, "kick.time": event}, startTime=before[0])
            run.run(before, "x")
            assert run.get("kicks") == 1, before


def test_an_event_far_from_zero(decay: Path) -> None:
    """x jumps by 2 in the middle of a step that begins at 1e9 s, where the clock has digits of 1.2e-7 s."""
    with Runner(decay) as run:
        run.start({"kicking": 1, "kick.time": 1e9 + 0.0625}, startTime=1e9)
        run.step(1e9, 0.125)
        assert run.get("kicks") == 1
        assert run.get("x") == pytest.approx(math.exp(-0.125) + 2.0 * math.exp(-0.0625), rel=1e-11)
