"""What a description declares and only the binary can show: abilities, and one model for both interfaces."""

from __future__ import annotations

import math
from ctypes import byref, c_double, c_int, c_size_t
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ..open.description import ModelDescription, ScalarVariable
from ..open.fmi2 import WARNING, CallFailed, Instance, Library, numeric, references, start_time
from .runs import Tell, step_size
from .sensitivity import state_variables

_UNTOUCHED = -1.2345678901234567e222  #: in a buffer before the binary writes to it
_SPARE = 8
_MOST = 20  #: variables of one kind that are tried
_STEPS, _SUBSTEPS = 5, 40  #: communication steps, and Runge-Kutta steps of the check's own in each
_States = npt.NDArray[np.float64]


def abilities(library: Library, tell: Tell) -> None:
    """Event indicators, derivatives of inputs and outputs, tunable parameters."""
    instance = library.fresh().initialise()
    _tunable(instance, tell)
    if library.interface == "ModelExchange":
        instance.to_continuous()
        _indicators(instance, tell)
    else:
        instance.step(start_time(library.d), step_size(library.d))
        _output_derivatives(instance, tell)
        _input_derivatives(instance, tell)
    instance.free()


def _tunable(instance: Instance, tell: Tell) -> None:
    for v in numeric(instance.library.d.variables):
        if v.causality != "parameter" or v.variability != "tunable":
            continue
        value = float(instance.get([v])[0])
        if instance.set(v, value) > WARNING:
            tell(
                "FMI2 2.2.7 tunable",
                v.name,
                f"is declared tunable, yet cannot be set after initialization{instance.library.said()}",
                'declare it variability="fixed", or let it be set',
            )
            return  # the instance is in its error state now


def _indicators(instance: Instance, tell: Tell) -> None:
    count = instance.library.d.event_indicators
    buffer = (c_double * (count + _SPARE))(*[_UNTOUCHED] * (count + _SPARE))
    status = instance.call("GetEventIndicators", buffer, c_size_t(count))
    written = [k for k, value in enumerate(buffer) if value != _UNTOUCHED]
    message = ""
    if status > WARNING:
        message = f"the binary refuses {count}{instance.library.said()}"
    elif written != list(range(count)):
        message = f"the binary writes {len(written)}"
    if message:
        tell(
            "FMI2 2.2.1 numberOfEventIndicators",
            "ModelExchange",
            f"{count} are declared, {message}",
            "declare as many as fmi2GetEventIndicators gives",
        )


def _reals(d: ModelDescription, causality: str) -> list[ScalarVariable]:
    reals = [v for v in d.variables if v.type == "Real" and v.causality == causality]
    return [v for v in reals if v.variability in (None, "", "continuous")][:_MOST]


def _output_derivatives(instance: Instance, tell: Tell) -> None:
    d = instance.library.d
    most = _whole(d.interfaces["CoSimulation"].get("maxOutputDerivativeOrder"))
    for order in range(1, most + 1):
        for v in _reals(d, "output")[:1]:
            out = c_double(0.0)
            arguments = references([v]), c_size_t(1), byref(c_int(order)), byref(out)
            if instance.call("GetRealOutputDerivatives", *arguments) > WARNING:
                tell(
                    "FMI2 4.3.1 maxOutputDerivativeOrder",
                    v.name,
                    f"order {most} is declared, order {order} is refused{instance.library.said()}",
                    "declare the highest order that fmi2GetRealOutputDerivatives gives",
                )
                return


def _input_derivatives(instance: Instance, tell: Tell) -> None:
    d = instance.library.d
    if not d.flag("CoSimulation", "canInterpolateInputs"):
        return
    slope, order = c_double(0.0), c_int(1)
    for v in numeric(d.variables):
        if v.causality != "input" or v.type != "Real":
            continue
        status = instance.call("SetRealInputDerivatives", references([v]), 1, byref(order), byref(slope))
        discrete = v.variability == "discrete"
        if (status > WARNING) != discrete:
            what = (
                "is declared discrete, yet the binary interpolates it"
                if discrete
                else (f"cannot be interpolated as canInterpolateInputs says{instance.library.said()}")
            )
            fix = "declare it continuous" if discrete else "take back canInterpolateInputs"
            tell("FMI2 4.2.1 input derivatives", v.name, what, fix)
            return


def one_model(library: Library, tell: Tell) -> None:
    """Co-simulation follows the equations that model exchange gives: shorter steps lead no further away.

    A solver of its own may be coarse; but what it is off may not grow when the same time is taken in twice
    as many steps, as it does where each step adds something that is not in the equations.
    """
    d = library.d
    states = state_variables(d)
    if (
        library.interface != "CoSimulation"
        or not states
        or "ModelExchange" not in d.interfaces
        or not d.flag("CoSimulation", "canHandleVariableCommunicationStepSize")
    ):
        return
    exact = _integrated(library, len(states))
    if exact is None:
        return
    try:
        off = [np.abs(_stepped(library, states, parts) - exact[-1]) for parts in (1, 2, 4)]
    except CallFailed:
        return  # steps of that length are refused: another topic's finding
    size = np.maximum(np.ptp(exact, axis=0), np.abs(exact).max(axis=0)) + 1e-300
    grows = (off[1] > 1.5 * off[0]) & (off[2] > 1.5 * off[1]) & (off[2] > 1e-4 * size)
    if not grows.any():
        return
    k = int(np.argmax(np.where(grows, off[2] / size, 0.0)))
    tell(
        "FMI2 4.3.1 one model",
        states[k].name,
        f"is {off[0][k]:.3g}, {off[1][k]:.3g}, {off[2][k]:.3g} off the solution of the equations that model "
        f"exchange gives, after {_STEPS}, {2 * _STEPS} and {4 * _STEPS} steps to the same time",
        "integrate the same equations in fmi2DoStep",
    )


def _stepped(library: Library, states: list[ScalarVariable], parts: int) -> _States:
    instance = library.fresh().initialise()
    try:
        h = step_size(library.d)
        for k in range(_STEPS):
            for part in range(parts):
                instance.step(start_time(library.d) + h * (k + part / parts), h / parts)
        return instance.get(states)
    finally:
        instance.free()


def _integrated(library: Library, n: int) -> _States | None:
    """States along the equations of model exchange by Runge-Kutta steps; None where there are events."""
    d = library.d
    same = {a.get("modelIdentifier") for a in d.interfaces.values()}
    if len(same) != 1:  # another binary, which is checked in a process of its own
        return None
    try:
        instance = Library(d, "ModelExchange", library.folder, Path(library.dll._name)).fresh()
        return _solution(instance.initialise(), n)
    except CallFailed:
        return None


def _solution(instance: Instance, n: int) -> _States | None:
    d = instance.library.d
    info = instance.to_continuous()
    begin, length = start_time(d), step_size(d)
    if info.nextEventTimeDefined and info.nextEventTime <= begin + _STEPS * length:
        return None
    x = instance.states(n)
    signs = _signs(instance)
    rows, h = [x], length / _SUBSTEPS
    for k in range(_STEPS * _SUBSTEPS):
        t = begin + k * h
        k1 = _slopes(instance, t, x)
        k2 = _slopes(instance, t + h / 2.0, x + h / 2.0 * k1)
        k3 = _slopes(instance, t + h / 2.0, x + h / 2.0 * k2)
        k4 = _slopes(instance, t + h, x + h * k3)
        x = x + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
        instance.set_states(x)
        event, end = c_int(0), c_int(0)
        instance.do("CompletedIntegratorStep", c_int(1), byref(event), byref(end))
        if event.value or end.value or _signs(instance) != signs:
            return None
        rows.append(x)
    instance.free()
    states = np.array(rows)
    return states if np.all(np.isfinite(states)) else None


def _slopes(instance: Instance, t: float, x: _States) -> _States:
    out = (c_double * x.size)()
    instance.do("SetTime", c_double(t))
    instance.set_states(x)
    instance.do("GetDerivatives", out, c_size_t(x.size))
    return np.array(out)


def _signs(instance: Instance) -> list[bool]:
    count = instance.library.d.event_indicators
    buffer = (c_double * (count + _SPARE))()
    if count and instance.call("GetEventIndicators", buffer, c_size_t(count)) > WARNING:
        return []
    return [math.copysign(1.0, value) > 0.0 for value in buffer[:count]]


def _whole(text: str | None) -> int:
    return int(text) if text is not None and text.isdecimal() and len(text) < 3 else 0
