"""Check an IEEE/CIGRE DLL [CIGRE958]: its description, and how it behaves where a tool would call it.

Inputs swing about 1 and about 0; trajectories are compared bit by bit. What the interface leaves open is no
finding: a second Model_Outputs at the same time may go on, Model_Iterate may change states.
"""

from __future__ import annotations

import ctypes
import math
import re
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

from ..finding import Report
from ..open.images import ImageError, read_image
from ..open.real_code import ERROR, REQUIRED, TEXT, RealCode, RealCodeLibrary, Values, structure
from .load import loadable_on_host
from .runs import Tell

INTERFACE = "DLL"
_STEPS = 40
_UNWRITTEN = 0xA5  #: bytes between outputs
_Swing = tuple[float, float]  #: mean and amplitude of the inputs
_SWINGS: tuple[_Swing, ...] = ((1.0, 0.1), (0.0, 1e-3))
#: topic and rule -> where a run is another one than usual, what to do
_BESIDES = {
    "alignment": ("with other bytes between its ports", "lay structures out in natural alignment, unpacked"),
    "repeated calls": ("after five calls of Model_Initialize", "start from the arguments alone, each time"),
    "restart": ("begun again at time 0", "set all states in Model_Initialize: multiple runs go back in time"),
    "instances": ("beside another instance", "keep no variable of a run outside the instance: no globals"),
    "snapshots": ("continued from its state arrays", "keep states in IntStates, FloatStates, DoubleStates"),
}


def check_library(path: Path, report: Report) -> bool:
    """Check what the file itself says; return whether it can be loaded here."""
    try:
        image = read_image(path.read_bytes())
    except ImageError as error:
        report.add("DLL file", path.name, f"cannot be read: {error}", "give the compiled DLL")
        return False
    kind = next(iter(image.folders), "")
    bits = "32" if kind.endswith("32") else "64"
    parts = (*path.parts[-3:-1], path.stem)
    declared = {b for part in parts for b in re.findall(r"(?:win|linux|bin|_)(32|64)$", part)}
    if kind and declared and bits not in declared:
        reason = f"has {bits} bits; its name or folder says {' and '.join(sorted(declared))}"
        advice = "build it for the tool that loads it: ATP takes 32 bits, PSCAD those of its Fortran compiler"
        report.add("DLL bits", path.name, reason, advice)
    missing = [name for name in REQUIRED if name not in image.exports]
    if missing:
        reason = f"no IEEE/CIGRE DLL: it does not have {', '.join(missing)}"
        report.add("DLL functions", path.name, reason, "export them under these names, as C functions")
    loads = loadable_on_host(image)
    if not loads:
        report.not_run.append(f"a library for {kind or image.machine} cannot be loaded here")
    return loads and not missing


class _Tool(RealCode):
    """An instance as a tool drives it; `code` is what its start or its last step has returned."""

    def __init__(self, library: RealCodeLibrary, swing: _Swing = _SWINGS[0]) -> None:
        super().__init__(library)
        self.swing, self.step_s = swing, library.info.sample_time

    def start(self, times: int = 1, fill: int = 0) -> _Tool:
        """Do what a tool does before the first step; return the instance.

        times : how often it is to check and to initialise. fill : bytes between the ports that it reads.
        """
        _pad(self.inputs, fill)
        _pad(self.parameters, fill)
        self.excite(0)
        self.call("Model_FirstCall", 0.0)
        self.code = max(self.call("Model_CheckParameters") for _ in range(times))
        for _ in range(times):
            self.outputs.buffer[:] = bytes(len(self.outputs.buffer))
            self.code = max(self.code, self.call("Model_Initialize"))
        _pad(self.outputs, _UNWRITTEN)
        return self

    def excite(self, k: int) -> None:
        """Set the inputs of step k."""
        for i, port in enumerate(self.library.inputs):
            if port.type != TEXT:
                self.inputs[port.name] = self.swing[0] + self.swing[1] * math.sin(0.3 * k + 1.0 + i)

    def step(self, k: int) -> bytes:
        """Return the outputs after step k."""
        self.excite(k)
        self.code = self.call("Model_Outputs", k * self.step_s)
        return bytes(self.outputs.buffer)

    def run(self, first: int = 1) -> list[bytes]:
        """Return the outputs after each step."""
        return [self.step(k) for k in range(first, _STEPS)]


def _gaps(values: Values) -> list[int]:
    """Bytes of the structure that belong to no port."""
    own = type(values.structure)
    fields = [getattr(own, name) for name, *_ in own._fields_]
    used = {at for field in fields for at in range(field.offset, field.offset + field.size)}
    return [at for at in range(len(values.buffer)) if at not in used]


def _pad(values: Values, fill: int) -> None:
    for at in _gaps(values):
        values.buffer[at] = fill


def description(library: RealCodeLibrary, tell: Tell) -> None:
    """Names, ranges, sample time, and that the DLL runs with its defaults."""
    info = library.info
    for group in (library.inputs, library.outputs, library.parameters):
        names = [p.name for p in group]
        for name in names:
            if not (name.isascii() and name.isidentifier()):
                tell("DLL names", repr(name), "is no C identifier", "use letters, digits and _ only")
            elif names.count(name) > 1:
                tell("DLL names", name, "is used twice", "give each port a name of its own")
    for p in library.parameters:
        if p.type != TEXT and not p.low <= p.start <= p.high:
            reason = f"default {p.start:g} lies outside {p.low:g} to {p.high:g}"
            tell("DLL ranges", p.name, reason, "put the default into the range")
    if not info.sample_time > 0.0:
        tell("DLL sample time", INTERFACE, f"is {info.sample_time:g} s", "give a time above 0")
    if info.version[0] != 1:
        tell("DLL version", INTERFACE, f"is {[*info.version]}, allowed: 1.x", "write the interface's version")
    model = _Tool(library).start()
    if model.code >= ERROR:
        tell("DLL start", INTERFACE, f"refuses its defaults: {model.text()}", "give defaults that it takes")


def _rows(library: RealCodeLibrary, swing: _Swing, besides: str = "") -> list[bytes]:
    """Return the outputs of a run; besides : what the tool does beside it, of `_BESIDES`."""
    times, fill = 5 if besides == "repeated calls" else 1, 0x5A if besides == "alignment" else 0
    model = _Tool(library, swing).start(times, fill)
    other = _Tool(library, (swing[0] * 0.8, swing[1] * 2)).start() if besides == "instances" else None
    rows = []
    if besides == "restart":
        model.run()
        model.start()
    for k in range(1, _STEPS):
        if other is not None:
            other.step(k + 3)
        if besides == "snapshots" and k == _STEPS // 2:
            saved = model.snapshot()
            model.run(first=k)
            model.restore(saved)
        rows.append(model.step(k))
    return rows


def _compare(besides: str, library: RealCodeLibrary, tell: Tell) -> None:
    """A run is the same one whatever the tool does beside it."""
    for swing in _SWINGS:
        one, other = (_rows(library, swing, act) for act in ("", besides))
        if one != other and (besides != "alignment" or _rows(library, swing) == one):
            when, fix = _BESIDES[besides]
            tell(f"DLL {besides}", INTERFACE, f"runs otherwise {when}", fix)
            return


def messages(library: RealCodeLibrary, tell: Tell) -> None:
    """The texts of two instances do not lie in one place that the DLL writes to."""
    models = [_Tool(library, swing).start() for swing in _SWINGS]
    for model in models:
        model.step(1)
    for name, field in (("LastErrorMessage", "error"), ("LastGeneralMessage", "message")):
        at, other = (getattr(model.raw, field) for model in models)
        if at and at == other and _writable(at):
            reason = "points to one text that all instances share and the DLL writes"
            tell("DLL messages", name, reason, "keep the text of each instance in its own states")


def _writable(address: int) -> bool:
    """Whether this process may write there; False where that cannot be read."""
    maps = Path("/proc/self/maps")  # of Linux
    for line in maps.read_text(encoding="utf-8").splitlines() if maps.exists() else ():
        low, high, rights = re.split("[- ]", line)[:3]
        if int(low, 16) <= address < int(high, 16):
            return "w" in rights
    return False


def leaks(library: RealCodeLibrary, tell: Tell) -> None:
    """Memory that the DLL takes is given back by Model_Terminate, and none is taken while it steps."""
    mallinfo = getattr(ctypes.CDLL(None), "mallinfo2", None) if sys.platform == "linux" else None
    if mallinfo is None:  # not glibc: nothing counts the bytes in use
        return
    sizes = "arena ordblks smblks hblks hblkhd usmblks fsmblks uordblks fordblks keepcost"
    mallinfo.restype = structure(sizes, ctypes.c_size_t)
    model = _Tool(library)

    def growth(calls: tuple[str, ...], count: int) -> int:
        model.start()
        before = int(mallinfo().uordblks)
        for k in range(1, count):
            for call in calls:
                model.call(call, k * model.step_s)
        return int(mallinfo().uordblks) - before

    life, step = ("Model_FirstCall", *REQUIRED[1:]), ("Model_Outputs",)
    for name, calls in (("an instance started and terminated", life), ("a call of Model_Outputs", step)):
        growth(calls, 20)
        lost = growth(calls, 400) - growth(calls, 100)
        if lost > 300 * 8:
            reason = f"{name} loses {lost / 300:.0f} bytes"
            tell("DLL memory", INTERFACE, reason, "free in Model_Terminate what Model_FirstCall took")


def bounds(library: RealCodeLibrary, tell: Tell) -> None:
    """Near 1 outputs are finite or the code is 2; no call writes beside states or outputs, nor Time."""
    reals = [p.name for p in library.outputs if p.type in (8, 9)]
    for mean, size in _SWINGS:
        model = _Tool(library, (mean, size)).start()
        for k in range(1, 4 * _STEPS):
            model.swing = (mean, size if k < 2 * _STEPS else 5.0 * size)
            model.step(k)
            bad = [name for name in reals if not math.isfinite(model.outputs[name])]
            if bad and mean == 1.0 and model.code < ERROR:
                reason = f"is {model.outputs[bad[0]]} after finite inputs with return code {model.code}"
                tell("DLL errors", bad[0], reason, "return 2 with LastErrorMessage")
                break
        for name in model.overrun():
            tell("DLL states", name, "is written beyond its declared number", "declare as many as it writes")
        if any(model.outputs.buffer[at] != _UNWRITTEN for at in _gaps(model.outputs)):
            tell("DLL alignment", INTERFACE, "writes bytes between its outputs", _BESIDES["alignment"][1])
        if model.raw.time != k * model.step_s:
            tell("DLL time", INTERFACE, "Model_Outputs changes Time", "leave Time to the tool")


TOPICS: dict[str, Callable[[RealCodeLibrary, Tell], None]] = {
    "description": description,
    "bounds": bounds,
    **{besides: partial(_compare, besides) for besides in _BESIDES},
    "messages": messages,
    "leaks": leaks,
}
