"""Load an IEEE/CIGRE DLL [CIGRE958] and drive instances of it: any maker's, of this machine's architecture.

The library's code runs in this process. A strange one belongs into a process of its own.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from ctypes import POINTER, addressof, c_char_p, c_double, c_int32, c_uint8, c_void_p, sizeof, string_at
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from interarea.models.errors import nearest

from ..errors import FmuFileError

#: DataType of the interface -> ctypes type; a char is a number here
_C = "byte int8 uint8 int16 uint16 int32 uint32 float double char_p"
TYPES: dict[int, Any] = {k: getattr(ctypes, f"c_{name}") for k, name in enumerate(_C.split(), 1)}
TEXT = 10  #: the only DataType that is no number
OK, MESSAGE, ERROR = 0, 1, 2
#: functions that every tool calls; a library may leave out the others
REQUIRED = ("Model_GetInfo", "Model_CheckParameters", "Model_Initialize", "Model_Outputs", "Model_Terminate")
_GUARD = b"\xa5" * 64  #: beside each array of states


class _Value(ctypes.Union):
    _fields_ = [(f"t{k}", t) for k, t in TYPES.items()]


def structure(*fields: Any) -> Any:
    """Return a structure in natural alignment; fields : names with a space between, their type, names, ..."""
    named = [(name, kind) for names, kind in zip(*2 * [iter(fields)], strict=True) for name in names.split()]
    return type("Structure", (ctypes.Structure,), {"_fields_": named})


_Signal = structure("name description unit", c_char_p, "type width", c_int32)
_Parameter = structure(
    *("name group description unit", c_char_p, "type fixed", c_int32, "start min max", _Value)
)
Info = structure(
    *("version", c_uint8 * 4, "name model_version description general created creator", c_char_p),
    *("modified modified_by comment history", c_char_p, "sample_time", c_double, "mode", c_uint8),
    *("n_inputs", c_int32, "inputs", POINTER(_Signal), "n_outputs", c_int32, "outputs", POINTER(_Signal)),
    *("n_parameters", c_int32, "parameters", POINTER(_Parameter), "n_int n_float n_double", c_int32),
)
_Instance = structure(
    *("inputs outputs parameters", c_void_p, "time", c_double, "mode", c_uint8),
    *("error message int_states float_states double_states", c_void_p),
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
    texts = (text_of(p.name), text_of(p.description), text_of(p.unit))
    if isinstance(p, _Signal):
        return Port(*texts, p.type, p.width)
    start, low, high = (getattr(v, f"t{p.type}", None) for v in (p.start, p.min, p.max))
    return Port(*texts, p.type, 1, bool(p.fixed), text_of(start) if p.type == TEXT else start, low, high)


class RealCodeLibrary:
    """The functions of one DLL, what it tells of itself (`info`), and its ports.

    Raises
    ------
    FmuFileError : a file that the system cannot load, or one that does not keep to the interface.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        try:
            self.c = ctypes.CDLL(str(self.path.resolve()))
        except OSError as error:
            raise FmuFileError(f"{path}: the system cannot load it: {error}") from error
        missing = [name for name in REQUIRED if not hasattr(self.c, name)]
        if missing:
            raise FmuFileError(f"{path}: no IEEE/CIGRE DLL: it does not have {', '.join(missing)}")
        self.c.Model_GetInfo.restype = POINTER(Info)
        info = self.c.Model_GetInfo()
        if not info:
            raise FmuFileError(f"{path}: Model_GetInfo gives no description")
        i = self.info = info.contents
        lists = ((i.n_inputs, i.inputs), (i.n_outputs, i.outputs), (i.n_parameters, i.parameters))
        numbers = [i.n_inputs, i.n_outputs, i.n_parameters, i.n_int, i.n_float, i.n_double]
        if min(numbers) < 0 or any(count and not ports for count, ports in lists):
            raise FmuFileError(f"{path}: Model_GetInfo gives {numbers} ports and states, or no list of them")
        self.inputs, self.outputs, self.parameters = (tuple(map(_port, ports[:n])) for n, ports in lists)
        self.ports = (*self.parameters, *self.inputs, *self.outputs)
        bad = [p.name for p in self.ports if p.type not in TYPES or p.width < 1]
        if bad:
            raise FmuFileError(f"{path}: {', '.join(bad)}: type or width that the interface does not know")


class Values:
    """A structure of ports in natural alignment, by name; of an array the first element."""

    def __init__(self, ports: tuple[Port, ...]) -> None:
        kind = structure(*(x for k, p in enumerate(ports) for x in (f"f{k}", TYPES[p.type] * p.width)))
        self.buffer = bytearray(sizeof(kind))
        self.structure = kind.from_buffer(self.buffer)
        self.arrays = {p.name: getattr(self.structure, f"f{k}") for k, p in enumerate(ports)}

    def __setitem__(self, name: str, value: float | str) -> None:
        array = self.arrays[name]
        if isinstance(value, str) != (array._type_ is c_char_p):
            raise TypeError("a number is no text")  # ctypes would take it for an address
        whole = isinstance(array[0], int)
        array[0] = value.encode() if isinstance(value, str) else int(value) if whole else value

    def __getitem__(self, name: str) -> float:
        return float(self.arrays[name][0])


class RealCode:
    """One instance: the arrays that a tool provides, parameters at their defaults.

    start : values of parameters, inputs and outputs by name.

    Raises
    ------
    FmuFileError : a name that no port has, or a value that is not of its type.
    """

    def __init__(self, library: RealCodeLibrary, start: Mapping[str, float | str] | None = None) -> None:
        self.library, info = library, library.info
        self.inputs, self.outputs = Values(library.inputs), Values(library.outputs)
        self.parameters = Values(library.parameters)
        groups = (self.inputs, self.outputs, self.parameters)
        for p in library.parameters:
            self.parameters[p.name] = p.start
        for name, value in (start or {}).items():
            places = [values for values in groups if name in values.arrays]
            if not places:
                known = nearest(name, (p.name for p in library.ports))
                raise FmuFileError(f"no {name!r} in {library.path.name}; {known}")
            try:
                for values in places:
                    values[name] = value
            except (TypeError, ValueError, OverflowError) as error:
                allowed = "allowed: a number of the port's type, or a text where the port is one"
                raise FmuFileError(f"{library.path.name}: {name} = {value!r}, {allowed}") from error
        words = {"IntStates": info.n_int, "FloatStates": info.n_float, "DoubleStates": 2 * info.n_double}
        self.states = {name: bytearray(_GUARD + bytes(4 * n) + _GUARD) for name, n in words.items()}
        states = (addressof(c_uint8.from_buffer(array, len(_GUARD))) for array in self.states.values())
        self.raw = _Instance(*(addressof(v.structure) for v in groups), 0.0, 1, None, None, *states)

    def call(self, name: str, time_s: float | None = None) -> int:
        """Call a function of the interface at a time, if it is there; return 0, 1 (message) or 2 (error)."""
        if time_s is not None:
            self.raw.time = time_s
        function = getattr(self.library.c, name, None)
        return OK if function is None else int(function(ctypes.byref(self.raw)))

    def text(self) -> str:
        """Return what the last call has said."""
        texts = [text_of(string_at(at)) for at in (self.raw.error, self.raw.message) if at]
        return next(filter(None, texts), "")

    def overrun(self) -> list[str]:
        """Return which arrays of states were written beside."""
        return [n for n, a in self.states.items() if not (a.startswith(_GUARD) and a.endswith(_GUARD))]

    def snapshot(self) -> list[bytes]:
        """Return states and outputs: all that a tool stores of an instance."""
        return [*map(bytes, self.states.values()), bytes(self.outputs.buffer)]

    def restore(self, snapshot: list[bytes]) -> None:
        """Continue from a snapshot of this or another process."""
        for array, saved in zip((*self.states.values(), self.outputs.buffer), snapshot, strict=True):
            memoryview(array)[:] = saved
