"""The one binding of FMI 2.0: a binary called function by function, every status returned instead of raised.

Numbers go through ctypes; argument types are declared once, in `_SIGNATURES`. Who calls a function thousands
of times takes it from `Library.dll` by ``dll["fmi2DoStep"]``: without the declared types a call takes half
the time, and the caller wraps its arguments itself.
"""

from __future__ import annotations

import ctypes
import functools
import importlib.util
import itertools
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
_C_TYPES = {"p": c_void_p, "s": c_char_p, "d": c_double, "i": c_int, "n": c_size_t}
#: argument types of the functions: pointer, text, double, int, size_t
_SIGNATURES = {
    **dict.fromkeys(("GetVersion", "GetTypesPlatform"), ""),
    **dict.fromkeys(
        (
            *("FreeInstance", "EnterInitializationMode", "ExitInitializationMode", "Terminate", "Reset"),
            *("EnterEventMode", "EnterContinuousTimeMode", "CancelStep"),
        ),
        "p",
    ),
    **dict.fromkeys((f"{g}{t}" for g in ("Get", "Set") for t in ("Real", "Integer", "Boolean")), "ppnp"),
    **dict.fromkeys(("GetString", "SetString"), "ppnp"),
    **dict.fromkeys(("GetFMUstate", "SetFMUstate", "FreeFMUstate", "NewDiscreteStates"), "pp"),
    **dict.fromkeys(
        (
            *("SetContinuousStates", "GetContinuousStates", "GetDerivatives", "GetEventIndicators"),
            "GetNominalsOfContinuousStates",
        ),
        "ppn",
    ),
    **dict.fromkeys(("SetRealInputDerivatives", "GetRealOutputDerivatives"), "ppnpp"),
    **dict.fromkeys((f"Get{t}Status" for t in ("Real", "Integer", "Boolean", "String")), "pip"),
    "GetStatus": "pip",
    "Instantiate": "sisspii",
    "SetDebugLogging": "pinp",
    "SetupExperiment": "pidd" + "id",
    "SerializedFMUstateSize": "ppp",
    "SerializeFMUstate": "pppn",
    "DeSerializeFMUstate": "ppnp",
    "GetDirectionalDerivative": "ppnpnpp",
    "SetTime": "pd",
    "CompletedIntegratorStep": "pipp",
    "DoStep": "pddi",
}


class _Callbacks(ctypes.Structure):
    _fields_ = (
        ("logger", _LOGGER),
        ("allocateMemory", c_void_p),
        ("freeMemory", c_void_p),
        ("stepFinished", c_void_p),
        ("componentEnvironment", c_void_p),
    )


_MOST_LINES = 100


class Log(list[str]):
    """The last messages that the instances of a library logged."""

    def add(self, status: int, message: str) -> None:
        """Take one message, logged with an fmi2Status."""
        self.append(message)
        del self[:-_MOST_LINES]


_logs: dict[int, Log] = {}  # by componentEnvironment
_next_log = itertools.count(1)


@_LOGGER  # type: ignore[untyped-decorator]
def _logger(environment: int | None, _name: bytes, status: int, _category: bytes, message: bytes) -> None:
    """Hand a message to the log of its library: one logger for all, for the proxy knows only one."""
    log = _logs.get(environment or 0)
    if log is not None:
        log.add(status, message.decode("utf-8", "replace").strip() if message else "")


@functools.cache
def _proxy() -> Any | None:
    """Return what puts a logger in front of ours that fills in a message's placeholders; fmpy brings it."""
    spec = importlib.util.find_spec("fmpy")
    if spec is None or spec.origin is None:
        return None
    name = {"win32": "win64/logging.dll", "darwin": "darwin64/logging.dylib"}
    file = Path(spec.origin).parent / "logging" / name.get(sys.platform, "linux64/logging.so")
    try:
        add = ctypes.CDLL(str(file)).addLoggerProxy
    except OSError:
        return None  # a message keeps its %-placeholders
    add.argtypes, add.restype = (c_void_p,), None
    return add


@functools.cache
def _memory() -> tuple[int, int]:
    """Addresses of calloc and free."""
    c = ctypes.CDLL("msvcrt" if sys.platform == "win32" else None)
    return tuple(int(ctypes.cast(f, c_void_p).value or 0) for f in (c.calloc, c.free))  # type: ignore[return-value]


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
    """A call that the standard says must work did not; `call` and `reason` are the message's parts."""

    def __init__(self, call: str, reason: str) -> None:
        super().__init__(f"{call} {reason}")
        self.call, self.reason = call, reason


class Library:
    """The shared library of one interface of an unpacked FMU, which is not unpacked further or looked at.

    log : receives what its instances log.
    """

    def __init__(
        self,
        d: ModelDescription,
        interface: str,
        folder: Path,
        binary: Path,
        *,
        log: Log | None = None,
    ) -> None:
        self.d, self.interface, self.folder = d, interface, folder
        self.resources = (folder / "resources").resolve().as_uri()
        self.log = Log() if log is None else log
        self.dll = ctypes.CDLL(str(binary.resolve()))
        for name, arguments in _SIGNATURES.items():
            function = getattr(self.dll, f"fmi2{name}", None)
            if function is not None:
                function.argtypes = [_C_TYPES[c] for c in arguments]
                function.restype = c_char_p if name.startswith(("GetV", "GetT")) else c_int
        self.dll.fmi2Instantiate.restype = c_void_p
        self.dll.fmi2FreeInstance.restype = None
        self._number = next(_next_log)
        _logs[self._number] = self.log
        self.callbacks = _Callbacks(_logger, *_memory(), None, self._number)
        add = _proxy()
        if add is not None:
            add(byref(self.callbacks))

    def instantiate(
        self, guid: str | None = None, name: str = "checked", *, logging: bool = False
    ) -> Instance | None:
        """Return a new instance, or None when the binary refuses."""
        component = self.dll.fmi2Instantiate(
            name.encode(),
            CODE[self.interface],
            (self.d.guid if guid is None else guid).encode(),
            self.resources.encode(),
            byref(self.callbacks),
            0,
            int(logging),
        )
        return Instance(self, component) if component else None

    def close(self) -> None:
        """Unload the library; none of its instances may be left."""
        import _ctypes

        handle, self.dll._handle = self.dll._handle, 0
        _logs.pop(self._number, None)
        if handle:
            free: Any = getattr(_ctypes, "FreeLibrary" if sys.platform == "win32" else "dlclose")
            free(handle)

    def fresh(self) -> Instance:
        """Return a new instance.

        Raises
        ------
        CallFailed : fmi2Instantiate returned null.
        """
        instance = self.instantiate()
        if instance is None:
            raise CallFailed("fmi2Instantiate", f"returned null{self.said()}")
        return instance

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
        return int(getattr(self.library.dll, f"fmi2{name}")(self.component, *arguments))

    def do(self, name: str, *arguments: Any) -> None:
        """Call a function that has to work."""
        self.library.log.clear()
        status = self.call(name, *arguments)
        if status > WARNING:
            shown = STATUS[status] if status < len(STATUS) else str(status)
            raise CallFailed(f"fmi2{name}", f"returned {shown}{self.library.said()}")

    def free(self) -> None:
        """Free the instance."""
        self.library.dll.fmi2FreeInstance(self.component)

    # Call sequences ------------------------------------------------------------

    def set_up(self) -> None:
        """fmi2SetupExperiment from the description's start time, no tolerance, no stop time."""
        start = start_time(self.library.d)
        self.do("SetupExperiment", 0, 0.0, start, 0, 0.0)

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
            raise CallFailed("fmi2NewDiscreteStates", "asked for another round 100 times")
        self.do("EnterContinuousTimeMode")
        return info

    def step(self, t: float, h: float) -> None:
        """fmi2DoStep."""
        self.do("DoStep", t, h, 1)

    # Values --------------------------------------------------------------------

    def get(self, variables: Sequence[ScalarVariable]) -> _Vector:
        """Return numeric and Boolean variables as floats, in the order given."""
        values = np.zeros(len(variables))
        for kind, ctype in (("Real", c_double), ("Integer", c_int), ("Boolean", c_int)):
            places = [k for k, v in enumerate(variables) if _getter(v) == kind]
            if places:
                out = (ctype * len(places))()
                self.do("Get" + kind, references([variables[k] for k in places]), len(places), out)
                values[places] = list(out)
        return values

    def set(self, v: ScalarVariable, value: float) -> int:
        """Set one numeric or Boolean variable; return the status."""
        kind = _getter(v)
        converted = c_double(value) if kind == "Real" else c_int(int(value))
        return self.call("Set" + kind, references([v]), 1, byref(converted))

    def directional(
        self, unknowns: Sequence[ScalarVariable], known: ScalarVariable, direction: float = 1.0
    ) -> _Vector:
        """Return d(unknowns) in the direction of one known."""
        out = (c_double * len(unknowns))()
        seed = c_double(direction)
        knowns = references([known])
        self.do("GetDirectionalDerivative", references(unknowns), len(unknowns), knowns, 1, byref(seed), out)
        return np.array(out)

    def states(self, n: int) -> _Vector:
        """Return the continuous states."""
        out = (c_double * n)()
        self.do("GetContinuousStates", out, n)
        return np.array(out)

    def set_states(self, x: _Vector) -> None:
        """Set the continuous states."""
        self.do("SetContinuousStates", (c_double * x.size)(*x), x.size)

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
        retained = ctypes.create_string_buffer(size.value)
        self.do("SerializeFMUstate", state, retained, size)
        return retained.raw

    def deserialise(self, content: bytes) -> c_void_p:
        """Return an FMU state from bytes."""
        state = c_void_p()
        self.do("DeSerializeFMUstate", content, len(content), byref(state))
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
    return d.experiment_s("startTime", 0.0)
