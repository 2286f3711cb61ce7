"""Run-time topics of the check: instances, resets, saved states, step splitting, illegal calls."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from ctypes import byref, c_double, c_int, c_size_t, c_uint, c_void_p

import numpy as np
import numpy.typing as npt

from ..open.description import ModelDescription, ScalarVariable
from ..open.fmi2 import STATUS, WARNING, CallFailed, EventInfo, Instance, Library, numeric, start_time

#: Receives rule, where, message, fix.
Tell = Callable[[str, str, str, str], None]
_Rows = npt.NDArray[np.float64]
_STEPS = 10
_SAME = 1e-9  #: two runs agree when they differ by less, relative to the larger value


def load(library: Library, tell: Tell) -> None:
    """Version, platform, instantiate, wrong GUID, freeing nothing."""
    dll = library.dll
    for name, expected in (("fmi2GetVersion", b"2.0"), ("fmi2GetTypesPlatform", b"default")):
        got = getattr(dll, name)()
        if got != expected:
            tell(
                "FMI2 2.1.4 version",
                name,
                f"returned {got!r}, not {expected!r}",
                "compile with the standard's headers",
            )
    library.fresh().free()
    wrong = library.instantiate(guid="{00000000-0000-0000-0000-000000000000}")
    if wrong is not None:
        wrong.free()
        tell(
            "FMI2 2.1.5 guid",
            "fmi2Instantiate",
            "accepts any GUID, so a description of another model goes unnoticed",
            "compare fmuGUID with the one the binary was made for and return null when they differ",
        )
    dll.fmi2FreeInstance(c_void_p(None))


def start_values(library: Library, tell: Tell) -> None:
    """Nothing is set: every exact start value must be what the binary answers."""
    instance = library.fresh()
    instance.set_up()
    instance.do("EnterInitializationMode")
    declared = [
        v
        for v in numeric(library.d.variables)
        if v.start is not None and (v.initial == "exact" or v.causality in ("input", "parameter"))
    ]
    got = instance.get(declared)
    for v, value in zip(declared, got, strict=True):
        expected = {"true": 1.0, "false": 0.0}.get(v.start or "", v.number("start"))
        if expected is not None and not math.isclose(value, expected, rel_tol=1e-9, abs_tol=1e-12):
            tell(
                "FMI2 2.2.7 start is the binary's",
                v.name,
                f"the description says {expected:.17g}, the binary {value:.17g}",
                "write the value that the binary has when nothing is set",
            )
    instance.free()


class Drive:
    """A fixed sequence of steps and inputs; `rows` of every numeric variable after each step."""

    def __init__(self, d: ModelDescription, *, excited: bool = True, constant: bool = False) -> None:
        self.d = d
        self.h = step_size(d)
        self.variables = numeric(d.variables)
        self.excited, self.constant = excited, constant
        self.inputs = [v for v in self.variables if v.causality == "input" and v.type == "Real"]

    def start(self, instance: Instance) -> None:
        """Initialise, and in model exchange enter continuous-time mode."""
        instance.initialise()
        if instance.library.interface == "ModelExchange":
            instance.to_continuous()

    def run(self, instance: Instance, first: int, last: int, *, parts: int = 1) -> _Rows:
        """Take steps `first` to `last`, each in `parts` equal parts."""
        rows = []
        begin = start_time(self.d)
        for k in range(first, last):
            if self.excited:
                self._excite(instance, k)
            for part in range(parts):
                self._advance(instance, begin + self.h * (k + part / parts), self.h / parts)
            rows.append(instance.get(self.variables))
        return np.array(rows)

    def _excite(self, instance: Instance, k: int) -> None:
        """Move every Real input; in model exchange discrete ones only in event mode (FMI2, 3.2.3)."""
        constant: list[tuple[ScalarVariable, float]] = []
        moving: list[tuple[ScalarVariable, float]] = []
        for i, v in enumerate(self.inputs):
            size = 0.01 * abs(v.number("nominal") or 1.0)
            wave = 1.0 if self.constant else math.sin(1.3 * k + i)
            in_events = instance.library.interface == "ModelExchange" and v.variability == "discrete"
            (constant if in_events else moving).append((v, (v.number("start") or 0.0) + size * wave))
        if constant:
            instance.do("EnterEventMode")
            for v, value in constant:
                instance.set(v, value)
            instance.to_continuous()
        for v, value in moving:
            instance.set(v, value)

    def _advance(self, instance: Instance, t: float, h: float) -> None:
        if instance.library.interface == "CoSimulation":
            instance.step(t, h)
            return
        n = len(self.d.derivatives)
        slope = (c_double * n)()
        instance.do("SetTime", c_double(t))
        if n:
            instance.do("GetDerivatives", slope, c_size_t(n))
            # a thousandth of the step: the topic is repeatability, and Euler must not diverge
            instance.set_states(instance.states(n) + 1e-3 * h * np.array(slope))
        event, end = c_int(0), c_int(0)
        instance.do("CompletedIntegratorStep", c_int(1), byref(event), byref(end))

    def compare(self, what: str, a: _Rows, b: _Rows, tell: Tell, fix: str) -> None:
        """Tell the variable that differs most, if one does."""
        scale = np.maximum(np.maximum(np.abs(a), np.abs(b)), 1e-12)
        with np.errstate(invalid="ignore"):
            apart = np.where(
                np.isnan(a) & np.isnan(b), 0.0, np.nan_to_num(np.abs(a - b) / scale, nan=math.inf)
            )
        worst = np.unravel_index(int(np.argmax(apart)), apart.shape)
        if apart[worst] > _SAME:
            v = self.variables[int(worst[1])]
            count = int(np.sum(apart.max(axis=0) > _SAME))
            tell(
                what,
                v.name,
                f"{a[worst]:.17g} and {b[worst]:.17g} after step {worst[0] + 1}; {count} variables differ",
                fix,
            )


def step_size(d: ModelDescription) -> float:
    """Return the default experiment's step, else a hundredth of it, else 10 ms."""
    step_s = d.experiment_s("stepSize", 0.0)
    if step_s > 0.0:
        return step_s
    length = d.experiment_s("stopTime", 1.0) - d.experiment_s("startTime", 0.0)
    return length / 100.0 if length > 0.0 else 0.01


def reset(library: Library, tell: Tell) -> None:
    """After fmi2Reset an instance is as new."""
    drive = Drive(library.d)
    instance = library.fresh()
    drive.start(instance)
    first = drive.run(instance, 0, _STEPS)
    instance.do("Reset")
    drive.start(instance)
    again = drive.run(instance, 0, _STEPS)
    drive.compare(
        "FMI2 2.1.6 fmi2Reset", first, again, tell, "set every variable and every internal memory back"
    )
    instance.do("Terminate")
    instance.free()


def interleaved(library: Library, tell: Tell) -> None:
    """Two instances that take turns do not meet."""
    if library.d.flag(library.interface, "canBeInstantiatedOnlyOncePerProcess"):
        return
    drive, idle = Drive(library.d), Drive(library.d, excited=False)
    alone = library.fresh()
    drive.start(alone)
    expected = drive.run(alone, 0, _STEPS)
    alone.free()
    a, b = library.fresh(), library.fresh()
    drive.start(a)
    idle.start(b)
    rows = []
    for k in range(_STEPS):
        rows.append(drive.run(a, k, k + 1))
        if k < _STEPS // 2:
            idle.run(b, k, k + 1)
        elif k == _STEPS // 2:
            b.free()
    a.free()
    drive.compare(
        "FMI2 2.1.5 instances",
        expected,
        np.vstack(rows),
        tell,
        "keep no run-time data in global or static variables",
    )


def replay(library: Library, tell: Tell) -> None:
    """Go back to a saved state and run again; and from its bytes in another instance."""
    if not library.d.flag(library.interface, "canGetAndSetFMUstate"):
        return
    drive = Drive(library.d)
    instance = library.fresh()
    drive.start(instance)
    drive.run(instance, 0, 3)
    state = instance.save()
    first = drive.run(instance, 3, _STEPS)
    instance.restore(state)
    fix = "save everything that a step changes"
    drive.compare("FMI2 2.1.8 FMU state", first, drive.run(instance, 3, _STEPS), tell, fix)
    once = library.d.flag(library.interface, "canBeInstantiatedOnlyOncePerProcess")
    if library.d.flag(library.interface, "canSerializeFMUstate"):
        retained = instance.serialise(state)
        if once:
            instance.do("Reset")
        other = instance if once else library.fresh()
        drive.start(other)
        copy = other.deserialise(retained)
        other.restore(copy)
        other.forget(copy)
        drive.compare(
            "FMI2 2.1.8 serialised FMU state", first, drive.run(other, 3, _STEPS), tell, fix + ", no pointers"
        )
        if not once:
            other.free()
    instance.forget(state)
    instance.free()


def split_steps(library: Library, tell: Tell) -> None:
    """One step of H is two of H/2, when the FMU says that steps may vary."""
    if library.interface != "CoSimulation" or not library.d.flag(
        library.interface, "canHandleVariableCommunicationStepSize"
    ):
        return
    drive = Drive(library.d, constant=True)
    rows = []
    for parts in (1, 2):
        instance = library.fresh()
        drive.start(instance)
        rows.append(drive.run(instance, 0, _STEPS, parts=parts))
        instance.free()
    moved = np.ptp(rows[0], axis=0) + np.ptp(rows[1], axis=0)
    apart = np.abs(rows[0] - rows[1]).max(axis=0)
    for k, v in enumerate(drive.variables):
        if v.causality == "output" and v.type == "Real" and apart[k] > 0.01 * moved[k] + 1e-9:
            tell(
                "FMI2 4.3.1 variable communication step",
                v.name,
                f"differs by {apart[k]:.3g} (its movement: {moved[k]:.3g}) when each step of "
                f"{drive.h:g} s is taken in two halves",
                "integrate with steps of its own, or do not declare canHandleVariableCommunicationStepSize",
            )


def illegal_calls(library: Library, tell: Tell) -> None:
    """Calls that the standard forbids must return fmi2Discard, fmi2Error or fmi2Fatal."""
    buffer, unknown = (c_double * 1)(), (c_uint * 1)(0xFFFFFFF0)

    def doing(name: str, *arguments: object) -> Callable[[Instance], int]:
        return lambda instance: instance.call(name, *arguments)

    step = doing("DoStep", c_double(start_time(library.d)), c_double(step_size(library.d)), c_int(1))
    cases: list[tuple[str, bool, Callable[[Instance], int]]] = [
        (
            "fmi2ExitInitializationMode before fmi2EnterInitializationMode",
            False,
            doing("ExitInitializationMode"),
        ),
        ("fmi2Terminate before initialization", False, doing("Terminate")),
        ("fmi2EnterInitializationMode after initialization", True, doing("EnterInitializationMode")),
        ("fmi2GetReal of an unknown value reference", True, doing("GetReal", unknown, c_size_t(1), buffer)),
        ("fmi2SetReal of an unknown value reference", True, doing("SetReal", unknown, c_size_t(1), buffer)),
    ]
    if library.interface == "CoSimulation":
        back = doing("DoStep", c_double(start_time(library.d)), c_double(-step_size(library.d)), c_int(1))
        cases += [
            ("fmi2DoStep before initialization", False, step),
            ("fmi2DoStep with a negative step", True, back),
            (
                "fmi2DoStep after fmi2Terminate",
                True,
                lambda i: 4 if i.call("Terminate") > WARNING else step(i),
            ),
        ]
    else:
        n = len(library.d.derivatives)
        too_many = (c_double * (n + 1))()
        cases += [
            ("fmi2EnterContinuousTimeMode before initialization", False, doing("EnterContinuousTimeMode")),
            ("fmi2EnterEventMode before initialization", False, doing("EnterEventMode")),
            (
                "fmi2NewDiscreteStates before initialization",
                False,
                doing("NewDiscreteStates", byref(EventInfo())),
            ),
            (
                "fmi2GetContinuousStates with the wrong number of states",
                True,
                doing("GetContinuousStates", too_many, c_size_t(n + 1)),
            ),
        ]
    for variable in _never_set(library.d):
        cases.append((f"setting {variable.name} after initialization", True, _setting(variable)))
    for what, initialised, call in cases:
        instance = library.fresh()
        if initialised:
            instance.initialise()
        status = call(instance)
        if status <= WARNING:
            shown = STATUS[status] if 0 <= status < len(STATUS) else str(status)
            tell(
                "FMI2 3.2.3, 4.2.4 call sequence",
                what,
                f"returned {shown}",
                "refuse it with fmi2Error and a message",
            )
        instance.free()
        ctypes.memset(buffer, 0, 8)


def _setting(v: ScalarVariable) -> Callable[[Instance], int]:
    return lambda instance: instance.set(v, v.number("start") or 0.0)


def _never_set(d: ModelDescription) -> list[ScalarVariable]:
    """One calculated output and one fixed parameter."""
    real = [v for v in numeric(d.variables) if v.type == "Real"]
    own = {(v.type, v.reference) for v in real if v.causality in ("input", "parameter")}
    output = [v for v in real if v.causality == "output" and (v.type, v.reference) not in own]
    fixed = [v for v in real if v.causality == "parameter" and v.variability == "fixed"]
    return output[:1] + fixed[:1]


__all__ = [
    "CallFailed",
    "Drive",
    "Tell",
    "illegal_calls",
    "interleaved",
    "load",
    "replay",
    "reset",
    "split_steps",
    "start_values",
]
