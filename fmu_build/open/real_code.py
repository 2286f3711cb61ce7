"""Load an IEEE/CIGRE DLL [CIGRE958] and drive instances of it: any maker's, of this machine's architecture.

The library's code runs in this process. A strange one belongs into a process of its own.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from ctypes import POINTER, c_char_p, c_double, c_float, c_int32, c_uint8, c_void_p
from dataclasses import dataclass, replace
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


class _Value(ctypes.Union):
    _fields_ = [(f"t{k}", t) for k, t in TYPES.items()]


def _structure(*fields: Any) -> Any:
    """Return a structure in natural alignment; fields : names with a space between, their type, names, ..."""
    named = [(name, kind) for names, kind in zip(*2 * [iter(fields)], strict=True) for name in names.split()]
    return type("Structure", (ctypes.Structure,), {"_fields_": named})


_Signal = _structure("name description unit", c_char_p, "type width", c_int32)
_Parameter = _structure(
    *("name group description unit", c_char_p, "type fixed", c_int32, "start min max", _Value)
)
Info = _structure(
    *("version", c_uint8 * 4, "name model_version description general created creator", c_char_p),
    *("modified modified_by comment history", c_char_p, "sample_time", c_double, "mode", c_uint8),
    *("n_inputs", c_int32, "inputs", POINTER(_Signal), "n_outputs", c_int32, "outputs", POINTER(_Signal)),
    *("n_parameters", c_int32, "parameters", POINTER(_Parameter), "n_int n_float n_double", c_int32),
)
_Instance = _structure(
    *("inputs outputs parameters", c_void_p, "time", c_double, "mode", c_uint8),
    *("error message", c_char_p, "int_states float_states double_states", c_void_p),
)


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


def text_of(value: bytes | None) -> str:
    """Return a text of the library."""
    return (value or b"").decode("utf-8", "replace")


def _port(p: Any) -> Port:
    port = Port(text_of(p.name), text_of(p.description), text_of(p.unit), p.type, getattr(p, "width", 1))
    if not isinstance(p, _Parameter):
        return port
    start, low, high = (
        getattr(v, f"t{p.type}" if p.type in TYPES else "t9") for v in (p.start, p.min, p.max)
    )
    if p.type == 10:
        start, low, high = text_of(start), None, None
    elif p.type == 1:
        start, low, high = ord(start), ord(low), ord(high)
    return replace(port, fixed=bool(p.fixed), start=start, low=low, high=high)


class RealCodeLibrary:
    """The functions of one DLL, what it tells of itself (`info`), and its ports.

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
        self._c.Model_GetInfo.restype = POINTER(Info)
        for name in (*REQUIRED[1:], *OPTIONAL[:2]):
            if hasattr(self._c, name):
                getattr(self._c, name).argtypes = [c_void_p]
                getattr(self._c, name).restype = c_int32
        info = self._c.Model_GetInfo()
        if not info:
            raise FmuFileError(f"{path}: Model_GetInfo gives no description")
        i = self.info = info.contents
        self.inputs = tuple(map(_port, i.inputs[: i.n_inputs]))
        self.outputs = tuple(map(_port, i.outputs[: i.n_outputs]))
        self.parameters = tuple(map(_port, i.parameters[: i.n_parameters]))
        ports = (*self.inputs, *self.outputs, *self.parameters)
        bad = [p.name for p in ports if p.type not in TYPES or p.width < 1]
        if bad:
            raise FmuFileError(f"{path}: {', '.join(bad)}: type or width that the interface does not know")

    def call(self, name: str, instance: ctypes.Structure) -> int:
        """Call a function of an instance; one that is left out does nothing."""
        if not hasattr(self._c, name):
            return OK
        return int(getattr(self._c, name)(ctypes.byref(instance)))


class Values:
    """A structure of ports in natural alignment, by name; of an array the first element."""

    def __init__(self, ports: tuple[Port, ...]) -> None:
        types = [TYPES[p.type] * p.width if p.width > 1 else TYPES[p.type] for p in ports]
        self.structure = _structure(*(x for k, kind in enumerate(types) for x in (f"f{k}", kind)))()
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
        self.library, info = library, library.info
        self.inputs, self.outputs = Values(library.inputs), Values(library.outputs)
        self.parameters = Values(library.parameters)
        self.ints = (c_int32 * max(info.n_int, 1))()
        self.floats = (c_float * max(info.n_float, 1))()
        self.doubles = (c_double * max(info.n_double, 1))()
        unknown = sorted(name for name in values or {} if name not in self.parameters)
        if unknown:
            allowed = ", ".join(p.name for p in library.parameters) or "none"
            raise FmuFileError(f"{library.path}: no parameter {', '.join(unknown)}; allowed: {allowed}")
        for p in library.parameters:
            self.parameters[p.name] = (values or {}).get(p.name, p.start)
        structures = (v.structure for v in (self.inputs, self.outputs, self.parameters))
        states = (ctypes.addressof(array) for array in (self.ints, self.floats, self.doubles))
        self.raw = _Instance(*map(ctypes.addressof, structures), 0.0, 1, None, None, *states)

    def call(self, name: str, time_s: float | None = None) -> int:
        """Call a function of the interface at a time; return 0, 1 (a message) or 2 (an error)."""
        if time_s is not None:
            self.raw.time = time_s
        return self.library.call(name, self.raw)

    def text(self) -> str:
        """Return what the last call has said."""
        return text_of(self.raw.error) or text_of(self.raw.message)

    def text_addresses(self) -> dict[str, int]:
        """Return where the texts of errors and messages lie, 0 where there is none."""
        names = {"LastErrorMessage": _Instance.error, "LastGeneralMessage": _Instance.message}
        return {n: c_void_p.from_buffer(self.raw, field.offset).value or 0 for n, field in names.items()}

    def snapshot(self) -> bytes:
        """Return states and outputs: all that a tool stores of an instance."""
        return b"".join(map(bytes, self._stored()))

    def restore(self, snapshot: bytes) -> None:
        """Continue from a snapshot of this or another process."""
        at = 0
        for array in self._stored():
            ctypes.memmove(ctypes.addressof(array), snapshot[at:], ctypes.sizeof(array))
            at += ctypes.sizeof(array)

    def _stored(self) -> tuple[Any, ...]:
        return (self.ints, self.floats, self.doubles, self.outputs.structure)
