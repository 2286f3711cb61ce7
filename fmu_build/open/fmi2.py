"""An FMI 2.0 binary called function by function, every status returned instead of raised.

Runs only inside the process that `check_probe` is; a binary may crash it.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Sequence
from ctypes import byref, c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .description import ModelDescription, ScalarVariable

OK, WARNING, DISCARD, ERROR, FATAL = 0, 1, 2, 3, 4
STATUS = ("fmi2OK", "fmi2Warning", "fmi2Discard", "fmi2Error", "fmi2Fatal", "fmi2Pending")
CODE = {"ModelExchange": 0, "CoSimulation": 1}
_Vector = npt.NDArray[np.float64]

_LOGGER = ctypes.CFUNCTYPE(None, c_void_p, c_char_p, c_int, c_char_p, c_char_p)
_ALLOCATE = ctypes.CFUNCTYPE(c_void_p, c_size_t, c_size_t)
_FREE = ctypes.CFUNCTYPE(None, c_void_p)
_FINISHED = ctypes.CFUNCTYPE(None, c_void_p, c_int)


class _Callbacks(ctypes.Structure):
    _fields_ = (
        ("logger", _LOGGER),
        ("allocateMemory", _ALLOCATE),
        ("freeMemory", _FREE),
        ("stepFinished", _FINISHED),
        ("componentEnvironment", c_void_p),
    )


class EventInfo(ctypes.Structure):
    """fmi2EventInfo."""

    _fields_ = (
        ("newDiscreteStatesNeeded", c_int),
        ("terminateSimulation", c_int),
        ("nominalsOfContinuousStatesChanged", c_int),
        ("valuesOfContinuousStatesChanged", c_int),
        ("nextEventTimeDefined", c_int),
        ("nextEventTime", c_double),
    )


class CallFailed(Exception):
    """A call that the standard says must work did not."""


class Library:
    """The shared library of one interface."""

    def __init__(self, d: ModelDescription, interface: str, folder: Path, binary: Path) -> None:
        if sys.platform == "win32":
            self._c = ctypes.CDLL("msvcrt")
        else:
            self._c = ctypes.CDLL(None)
        self._c.calloc.restype, self._c.calloc.argtypes = c_void_p, (c_size_t, c_size_t)
        self._c.free.restype, self._c.free.argtypes = None, (c_void_p,)
        self.d, self.interface = d, interface
        self.resources = (folder / "resources").resolve().as_uri()
        self.dll = ctypes.CDLL(str(binary.resolve()))
        self.log: list[str] = []
        log = self.log

        def logger(_: Any, __: Any, ___: int, ____: Any, message: bytes | None) -> None:
            log.append((message or b"").decode("utf-8", "replace").replace("%%", "%"))

        allocate, free = self._c.calloc, self._c.free
        self.callbacks = _Callbacks(
            _LOGGER(logger),
            _ALLOCATE(lambda n, size: allocate(n, size)),
            _FREE(lambda p: free(p)),
            _FINISHED(),
            None,
        )
        self.dll.fmi2Instantiate.restype = c_void_p
        self.dll.fmi2GetVersion.restype = c_char_p
        self.dll.fmi2GetTypesPlatform.restype = c_char_p

    def instantiate(self, guid: str | None = None, name: str = "checked") -> Instance | None:
        """Return a new instance, or None when the binary refuses."""
        component = self.dll.fmi2Instantiate(
            name.encode(),
            c_int(CODE[self.interface]),
            (self.d.guid if guid is None else guid).encode(),
            self.resources.encode(),
            byref(self.callbacks),
            c_int(0),
            c_int(0),
        )
        return Instance(self, component) if component else None

    def fresh(self) -> Instance:
        """Return a new instance.

        Raises
        ------
        CallFailed : fmi2Instantiate returned null.
        """
        made = self.instantiate()
        if made is None:
            raise CallFailed(f"fmi2Instantiate returned null{self.said()}")
        return made

    def said(self) -> str:
        """Return what the binary logged last, as the end of a sentence."""
        return f"; it said: {self.log[-1][:300]}" if self.log else ""


@dataclass
class Instance:
    """One component; `call` gives the status, `do` raises unless it is OK or a warning."""

    library: Library
    component: int

    def call(self, name: str, *arguments: Any) -> int:
        """Call ``fmi2<name>(component, ...)`` and return its status."""
        function = getattr(self.library.dll, f"fmi2{name}")
        return int(function(c_void_p(self.component), *arguments))

    def do(self, name: str, *arguments: Any) -> None:
        """Call a function that has to work."""
        self.library.log.clear()
        status = self.call(name, *arguments)
        if status > WARNING:
            shown = STATUS[status] if status < len(STATUS) else str(status)
            raise CallFailed(f"fmi2{name} returned {shown}{self.library.said()}")

    def free(self) -> None:
        """Free the instance."""
        self.library.dll.fmi2FreeInstance(c_void_p(self.component))

    # Call sequences ------------------------------------------------------------

    def set_up(self) -> None:
        """fmi2SetupExperiment from the description's start time, no tolerance, no stop time."""
        start = start_time(self.library.d)
        self.do("SetupExperiment", c_int(0), c_double(0.0), c_double(start), c_int(0), c_double(0.0))

    def initialise(self) -> Instance:
        """Up to the first step or the first event mode."""
        self.set_up()
        self.do("EnterInitializationMode")
        self.do("ExitInitializationMode")
        return self

    def to_continuous(self) -> EventInfo:
        """Model exchange: settle the discrete states and enter continuous-time mode."""
        info = EventInfo()
        for _ in range(100):
            self.do("NewDiscreteStates", byref(info))
            if not info.newDiscreteStatesNeeded:
                break
        else:
            raise CallFailed("fmi2NewDiscreteStates asked for another round 100 times")
        self.do("EnterContinuousTimeMode")
        return info

    def step(self, t: float, h: float) -> None:
        """fmi2DoStep."""
        self.do("DoStep", c_double(t), c_double(h), c_int(1))

    # Values --------------------------------------------------------------------

    def get(self, variables: Sequence[ScalarVariable]) -> _Vector:
        """Return numeric and Boolean variables as floats, in the order given."""
        values = np.zeros(len(variables))
        for kind, ctype in (("Real", c_double), ("Integer", c_int), ("Boolean", c_int)):
            places = [k for k, v in enumerate(variables) if _getter(v) == kind]
            if places:
                out = (ctype * len(places))()
                self.do("Get" + kind, references([variables[k] for k in places]), c_size_t(len(places)), out)
                values[places] = list(out)
        return values

    def set(self, v: ScalarVariable, value: float) -> int:
        """Set one numeric or Boolean variable; return the status."""
        kind = _getter(v)
        held = c_double(value) if kind == "Real" else c_int(int(value))
        return self.call("Set" + kind, references([v]), c_size_t(1), byref(held))

    def directional(
        self, unknowns: Sequence[ScalarVariable], known: ScalarVariable, direction: float = 1.0
    ) -> _Vector:
        """Return d(unknowns) in the direction of one known."""
        out = (c_double * len(unknowns))()
        seed = c_double(direction)
        self.do(
            "GetDirectionalDerivative",
            references(unknowns),
            c_size_t(len(unknowns)),
            references([known]),
            c_size_t(1),
            byref(seed),
            out,
        )
        return np.array(out)

    def states(self, n: int) -> _Vector:
        """Return the continuous states."""
        out = (c_double * n)()
        self.do("GetContinuousStates", out, c_size_t(n))
        return np.array(out)

    def set_states(self, x: _Vector) -> None:
        """Set the continuous states."""
        self.do("SetContinuousStates", (c_double * x.size)(*x), c_size_t(x.size))

    def save(self) -> c_void_p:
        """Return a new FMU state."""
        state = c_void_p()
        self.do("GetFMUstate", byref(state))
        return state

    def restore(self, state: c_void_p) -> None:
        """Go back to an FMU state."""
        self.do("SetFMUstate", state)

    def forget(self, state: c_void_p) -> None:
        """Free an FMU state."""
        self.do("FreeFMUstate", byref(state))

    def serialise(self, state: c_void_p) -> bytes:
        """Return an FMU state as bytes."""
        size = c_size_t()
        self.do("SerializedFMUstateSize", state, byref(size))
        kept = ctypes.create_string_buffer(size.value)
        self.do("SerializeFMUstate", state, kept, size)
        return kept.raw

    def deserialise(self, kept: bytes) -> c_void_p:
        """Return an FMU state from bytes."""
        state = c_void_p()
        self.do("DeSerializeFMUstate", kept, c_size_t(len(kept)), byref(state))
        return state


def references(variables: Sequence[ScalarVariable]) -> Any:
    """Return the value references as a C array."""
    return (c_uint * len(variables))(*(v.reference for v in variables))


def _getter(v: ScalarVariable) -> str:
    return "Integer" if v.type == "Enumeration" else v.type


def numeric(variables: Sequence[ScalarVariable]) -> list[ScalarVariable]:
    """Return the variables that `Instance.get` reads."""
    return [v for v in variables if v.type != "String" and v.type and v.reference >= 0]


def start_time(d: ModelDescription) -> float:
    """Return the start time of the default experiment, 0 if there is none."""
    return float(d.experiment.get("startTime", 0.0))
