"""Load an IEEE/CIGRE DLL [CIGRE958] and drive instances of it: any maker's, of this machine's architecture.

The library's code runs in this process. A strange one belongs into a process of its own.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from ctypes import POINTER, c_char_p, c_double, c_float, c_int32, c_uint8, c_void_p
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import FmuFileError

#: DataType of the interface -> ctypes type
_C = "char int8 uint8 int16 uint16 int32 uint32 float double char_p"
TYPES: dict[int, Any] = {k: getattr(ctypes, f"c_{name}") for k, name in enumerate(_C.split(), 1)}
OK, MESSAGE, ERROR = 0, 1, 2
#: functions that every tool calls, and those that a library may leave out
REQUIRED = ("Model_GetInfo", "Model_CheckParameters", "Model_Initialize", "Model_Outputs", "Model_Terminate")
OPTIONAL = ("Model_FirstCall", "Model_Iterate", "Model_PrintInfo")


def _of(kind: Any, names: str) -> list[tuple[str, Any]]:
    """Return fields of one type; names : with a space between."""
    return [(name, kind) for name in names.split()]


class _Value(ctypes.Union):
    _fields_ = [(f"t{k}", t) for k, t in TYPES.items()]


class _Signal(ctypes.Structure):
    _fields_ = [*_of(c_char_p, "name description unit"), *_of(c_int32, "type width")]


class _Parameter(ctypes.Structure):
    _fields_ = [
        *_of(c_char_p, "name group description unit"),
        *_of(c_int32, "type fixed"),
        *_of(_Value, "start min max"),
    ]


_TEXTS = "name model_version description general created creator modified modified_by comment history"


class _Info(ctypes.Structure):
    _fields_ = [
        ("version", c_uint8 * 4),
        *_of(c_char_p, _TEXTS),
        ("sample_time", c_double),
        ("mode", c_uint8),
        ("n_inputs", c_int32),
        ("inputs", POINTER(_Signal)),
        ("n_outputs", c_int32),
        ("outputs", POINTER(_Signal)),
        ("n_parameters", c_int32),
        ("parameters", POINTER(_Parameter)),
        *_of(c_int32, "n_int n_float n_double"),
    ]


class _Instance(ctypes.Structure):
    _fields_ = [
        *_of(c_void_p, "inputs outputs parameters"),
        ("time", c_double),
        ("mode", c_uint8),
        *_of(c_char_p, "error message"),
        *_of(c_void_p, "int_states float_states double_states"),
    ]


@dataclass(frozen=True)
class Port:
    """An input, output or parameter. `start`, `low`, `high`, `fixed`: of parameters."""

    name: str
    description: str
    unit: str
    type: int
    width: int = 1
    fixed: bool = False
    start: Any = None
    low: Any = None
    high: Any = None


@dataclass(frozen=True)
class Info:
    """What Model_GetInfo tells."""

    version: tuple[int, ...]
    texts: dict[str, str]
    sample_time_s: float
    mode: int
    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    parameters: tuple[Port, ...]
    n_int: int
    n_float: int
    n_double: int


def _text(value: bytes | None) -> str:
    return (value or b"").decode("utf-8", "replace")


def _signals(array: Any, count: int) -> tuple[Port, ...]:
    return tuple(
        Port(_text(s.name), _text(s.description), _text(s.unit), s.type, s.width) for s in array[:count]
    )


def _parameter(p: _Parameter) -> Port:
    field = f"t{p.type}" if p.type in TYPES else "t9"
    value = [getattr(v, field) for v in (p.start, p.min, p.max)]
    if p.type == 10:
        value = [_text(value[0]), None, None]
    elif p.type == 1:
        value = [ord(v) for v in value]
    return Port(_text(p.name), _text(p.description), _text(p.unit), p.type, 1, bool(p.fixed), *value)


def _structure(ports: tuple[Port, ...]) -> type[ctypes.Structure]:
    """The structure of these ports, in natural alignment."""
    fields = [
        (f"f{k}", TYPES[p.type] * p.width if p.width > 1 else TYPES[p.type]) for k, p in enumerate(ports)
    ]
    return type("Values", (ctypes.Structure,), {"_fields_": fields})


class RealCodeLibrary:
    """The functions of one DLL.

    Raises
    ------
    FmuFileError : a file that the system cannot load, one without the interface's functions, one that gives
        no description, or one whose ports have types that the interface does not know.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        try:
            self._c = ctypes.CDLL(str(self.path.resolve()))
        except OSError as error:
            raise FmuFileError(f"{path}: the system cannot load it: {error}") from error
        missing = [name for name in REQUIRED if not hasattr(self._c, name)]
        if missing:
            raise FmuFileError(f"{path}: no IEEE/CIGRE DLL: it does not have {', '.join(missing)}")
        self._c.Model_GetInfo.restype = POINTER(_Info)
        for name in (*REQUIRED[1:], *OPTIONAL[:2]):
            if hasattr(self._c, name):
                getattr(self._c, name).argtypes = [c_void_p]
                getattr(self._c, name).restype = c_int32
        info = self._c.Model_GetInfo()
        if not info:
            raise FmuFileError(f"{path}: Model_GetInfo gives no description")
        i = info.contents
        self.info = Info(
            tuple(i.version),
            {name: _text(getattr(i, name)) for name in _TEXTS.split()},
            i.sample_time,
            i.mode,
            _signals(i.inputs, i.n_inputs),
            _signals(i.outputs, i.n_outputs),
            tuple(_parameter(p) for p in i.parameters[: i.n_parameters]),
            i.n_int,
            i.n_float,
            i.n_double,
        )
        ports = (*self.info.inputs, *self.info.outputs, *self.info.parameters)
        bad = [p.name for p in ports if p.type not in TYPES or p.width < 1]
        if bad:
            raise FmuFileError(f"{path}: {', '.join(bad)}: type or width that the interface does not know")

    def call(self, name: str, instance: _Instance) -> int:
        """Call a function of an instance; one that is left out does nothing."""
        if not hasattr(self._c, name):
            return OK
        return int(getattr(self._c, name)(ctypes.byref(instance)))


class Values:
    """A structure of inputs, outputs or parameters, by name; of an array the first element."""

    def __init__(self, ports: tuple[Port, ...]) -> None:
        self.structure = _structure(ports)()
        self._fields = {p.name: f"f{k}" for k, p in enumerate(ports)}
        self._texts: list[bytes] = []

    def __setitem__(self, name: str, value: float | str) -> None:
        field = self._fields[name]
        current = getattr(self.structure, field)
        if isinstance(value, str):
            self._texts.append(value.encode())  # the structure only points to it
            setattr(self.structure, field, self._texts[-1])
        elif isinstance(current, ctypes.Array):
            current[0] = value
        else:
            setattr(self.structure, field, int(value) if isinstance(current, int | bytes) else value)

    def __getitem__(self, name: str) -> float:
        value = getattr(self.structure, self._fields[name])
        return float(value[0] if isinstance(value, ctypes.Array) else value)

    def __contains__(self, name: str) -> bool:
        return name in self._fields


class RealCode:
    """One instance: the arrays that a tool provides, parameters at their defaults.

    values : parameters by name, in place of the defaults.

    Raises
    ------
    FmuFileError : a parameter that the DLL does not have.
    """

    def __init__(self, library: RealCodeLibrary, values: Mapping[str, float | str] | None = None) -> None:
        info = library.info
        self.library = library
        self.inputs, self.outputs = Values(info.inputs), Values(info.outputs)
        self.parameters = Values(info.parameters)
        self.ints = (c_int32 * max(info.n_int, 1))()
        self.floats = (c_float * max(info.n_float, 1))()
        self.doubles = (c_double * max(info.n_double, 1))()
        unknown = sorted(set(values or {}) - {p.name for p in info.parameters})
        if unknown:
            allowed = ", ".join(p.name for p in info.parameters) or "none"
            raise FmuFileError(f"{library.path}: no parameter {', '.join(unknown)}; allowed: {allowed}")
        for p in info.parameters:
            self.parameters[p.name] = (values or {}).get(p.name, p.start)
        self.raw = _Instance(
            *(ctypes.addressof(v.structure) for v in (self.inputs, self.outputs, self.parameters)),
            mode=1,
            int_states=ctypes.addressof(self.ints),
            float_states=ctypes.addressof(self.floats),
            double_states=ctypes.addressof(self.doubles),
        )

    def call(self, name: str, time_s: float | None = None) -> int:
        """Call a function of the interface at a time; return 0, 1 (a message) or 2 (an error)."""
        if time_s is not None:
            self.raw.time = time_s
        return self.library.call(name, self.raw)

    def text(self) -> str:
        """Return what the last call has said."""
        return _text(self.raw.error) or _text(self.raw.message)

    def text_addresses(self) -> tuple[int, int]:
        """Return where the texts of errors and messages lie, 0 where there is none."""
        at = [
            c_void_p.from_buffer(self.raw, getattr(_Instance, name).offset) for name in ("error", "message")
        ]
        return at[0].value or 0, at[1].value or 0

    def snapshot(self) -> bytes:
        """Return states and outputs: all that a tool stores of an instance."""
        return b"".join(bytes(array) for array in self._stored())

    def restore(self, snapshot: bytes) -> None:
        """Continue from a snapshot of this or another process."""
        at = 0
        for array in self._stored():
            size = ctypes.sizeof(array)
            ctypes.memmove(ctypes.addressof(array), snapshot[at : at + size], size)
            at += size

    def _stored(self) -> tuple[Any, ...]:
        return (self.ints, self.floats, self.doubles, self.outputs.structure)
