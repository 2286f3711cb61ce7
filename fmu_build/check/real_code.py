"""Check an IEEE/CIGRE DLL [CIGRE958]: its description, and how it behaves where a tool would call it.

Inputs swing about 1 and about 0; trajectories are compared bit by bit. What the interface leaves open is no
finding: a second Model_Outputs at the same time may go on, Model_Iterate may change states.
"""

from __future__ import annotations

import contextlib
import ctypes
import math
import re
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

from ..errors import FmuFileError
from ..finding import Report
from ..open.fmu_file import host_folders
from ..open.images import FOLDERS, ImageError, read_image
from ..open.real_code import ERROR, REQUIRED, RealCode, RealCodeLibrary, Values
from .runs import Tell

INTERFACE = "DLL"
_STEPS = 40
_GUARD = b"\xa5" * 64  #: beside each array of states
_Topic = Callable[[RealCodeLibrary, Tell], None]
_Swing = tuple[float, float]  #: mean and amplitude of the inputs
_NEAR_ONE: _Swing = (1.0, 0.1)
_SWINGS: tuple[_Swing, ...] = (_NEAR_ONE, (0.0, 1e-3))
_BITS = {"x86": 32, "x86_64": 64, "arm64": 64}
_SYSTEMS = {"PE": "Windows", "ELF": "Linux", "Mach-O": "macOS"}


def check_library(path: Path, report: Report) -> bool:
    """Check what the file itself says; return whether it can be loaded here."""
    try:
        image = read_image(path.read_bytes())
    except ImageError as error:
        report.add("DLL file", path.name, f"cannot be read: {error}", "give the compiled DLL")
        return False
    bits = _BITS.get(image.machine, 0)
    parts = (*path.parts[-3:-1], path.stem)
    declared = {b for part in parts for b in re.findall(r"(?:win|linux|bin|_)(32|64)$", part)}
    if declared and str(bits) not in declared:
        reason = f"has {bits} bits; its name or folder says {' and '.join(sorted(declared))}"
        advice = "build it for the tool that loads it: ATP takes 32 bits, PSCAD those of its Fortran compiler"
        report.add("DLL bits", path.name, reason, advice)
    missing = [name for name in REQUIRED if name not in image.exports]
    if missing:
        reason = f"no IEEE/CIGRE DLL: it does not have {', '.join(missing)}"
        report.add("DLL functions", path.name, reason, "export them under these names, as C functions")
    loads = False
    with contextlib.suppress(FmuFileError):  # a machine that no binary is made for
        loads = any(FOLDERS[name][:2] == (image.format, image.machine) for name in host_folders())
    if not loads:
        system = _SYSTEMS[image.format]
        report.not_run.append(f"a {bits}-bit library for {system} ({image.machine}) cannot be loaded here")
    return loads and not missing


def _run(model: RealCode, steps: Iterable[int], swing: _Swing) -> list[bytes]:
    """Outputs after each call of Model_Outputs."""
    return [_step(model, k, swing) for k in steps]


def _step(model: RealCode, k: int, swing: _Swing) -> bytes:
    _excite(model, k, swing)
    model.call("Model_Outputs", k * model.library.info.sample_time)
    return bytes(model.outputs.structure)


def _excite(model: RealCode, k: int, swing: _Swing) -> None:
    for i, port in enumerate(model.library.inputs):
        if port.type != 10:
            model.inputs[port.name] = swing[0] + swing[1] * math.sin(0.3 * k + 1.0 + i)


def _start(model: RealCode, swing: _Swing, times: int = 1, fill: int = 0) -> int:
    """What a tool calls before the first step; `fill`: bytes between the ports, which mean nothing."""
    for values in (model.inputs, model.outputs, model.parameters):
        _pad(values, fill)
    _excite(model, 0, swing)
    model.call("Model_FirstCall", 0.0)
    code = max(model.call("Model_CheckParameters") for _ in range(times))
    outputs = model.outputs.structure
    for _ in range(times):
        ctypes.memset(ctypes.addressof(outputs), 0, ctypes.sizeof(outputs))
        code = max(code, model.call("Model_Initialize"))
    return code


def _started(library: RealCodeLibrary, swing: _Swing, times: int = 1, fill: int = 0) -> RealCode:
    model = RealCode(library)
    _start(model, swing, times, fill)
    return model


def _gaps(values: Values) -> list[int]:
    """Bytes of the structure that belong to no port."""
    own = type(values.structure)
    fields = [getattr(own, name) for name, *_ in own._fields_]
    used = {at for field in fields for at in range(field.offset, field.offset + field.size)}
    return [at for at in range(ctypes.sizeof(own)) if at not in used]


def _pad(values: Values, fill: int) -> None:
    for at in _gaps(values):
        ctypes.memset(ctypes.addressof(values.structure) + at, fill, 1)


def description(library: RealCodeLibrary, tell: Tell) -> None:
    """Names, ranges, sample time, and that the DLL runs with its defaults."""
    info = library.info
    for group in (library.inputs, library.outputs, library.parameters):
        names = [p.name for p in group]
        for name in names:
            if not re.fullmatch(r"[A-Za-z_]\w*", name, re.ASCII):
                tell("DLL names", repr(name), "is no C identifier", "use letters, digits and _ only")
            elif names.count(name) > 1:
                tell("DLL names", name, "is used twice", "give each port a name of its own")
    for p in library.parameters:
        if isinstance(p.start, int | float) and not p.low <= p.start <= p.high:
            reason = f"default {p.start:g} lies outside {p.low:g} to {p.high:g}"
            tell("DLL ranges", p.name, reason, "put the default into the range")
    if not info.sample_time > 0.0:
        tell("DLL sample time", INTERFACE, f"is {info.sample_time:g} s", "give a time above 0")
    version = tuple(info.version)
    if version[0] != 1:
        tell("DLL version", INTERFACE, f"is {version}, allowed: 1.x", "write the interface's version")
    model = RealCode(library)
    if _start(model, _NEAR_ONE) >= ERROR:
        reason = f"refuses its own defaults: {model.text()}"
        tell("DLL start", INTERFACE, reason, "give defaults that it takes")


def finite(library: RealCodeLibrary, tell: Tell) -> None:
    """Finite inputs near 1 give finite outputs, or a return code of 2."""
    model = RealCode(library)
    if _start(model, _NEAR_ONE) >= ERROR:
        return
    reals = [p.name for p in library.outputs if p.type in (8, 9)]
    for k in range(1, 4 * _STEPS):
        _excite(model, k, _NEAR_ONE if k < 2 * _STEPS else (1.0, 0.5))
        code = model.call("Model_Outputs", k * library.info.sample_time)
        bad = [name for name in reals if not math.isfinite(model.outputs[name])]
        if bad and code < ERROR:
            reason = f"is {model.outputs[bad[0]]} after finite inputs with return code {code}"
            tell("DLL errors", bad[0], reason, "return 2 with LastErrorMessage")
            return


def padding(library: RealCodeLibrary, tell: Tell) -> None:
    """Bytes between the ports of a structure are neither read nor written."""
    for swing in _SWINGS:
        rows: list[list[bytes]] = []
        done = ""
        for fill in (0x00, 0x5A, 0x00):
            model = _started(library, swing, fill=fill)
            _pad(model.outputs, fill)
            gaps = _gaps(model.outputs)
            row = _run(model, range(1, _STEPS), swing)
            if any(r[at] != fill for r in row for at in gaps):
                done = "writes"
            rows.append([bytes(b for at, b in enumerate(r) if at not in gaps) for r in row])
        if not done and rows[0] == rows[2] != rows[1]:
            done = "reads"
        if done:
            reason = f"{done} bytes of a structure that lie between its ports"
            tell("DLL alignment", INTERFACE, reason, "lay structures out in natural alignment: no packing")
            return


def _repeated_start(library: RealCodeLibrary, swing: _Swing) -> bool:
    once, often = (_run(_started(library, swing, n), range(1, _STEPS), swing) for n in (1, 5))
    return once == often


def _time(library: RealCodeLibrary, swing: _Swing) -> bool:
    model = _started(library, swing)
    _run(model, range(1, _STEPS), swing)
    return bool(model.raw.time == (_STEPS - 1) * library.info.sample_time)


def _restart(library: RealCodeLibrary, swing: _Swing) -> bool:
    model = _started(library, swing)
    first = _run(model, range(1, _STEPS), swing)
    _start(model, swing)
    return _run(model, range(1, _STEPS), swing) == first


def _two_instances(library: RealCodeLibrary, swing: _Swing) -> bool:
    alone = _run(_started(library, swing), range(1, _STEPS), swing)
    beside = (swing[0] * 0.8, swing[1] * 2)
    one, other = _started(library, swing), _started(library, beside)
    rows = []
    for k in range(1, _STEPS):
        _step(other, k + 3, beside)
        rows.append(_step(one, k, swing))
    return rows == alone


def _snapshot(library: RealCodeLibrary, swing: _Swing) -> bool:
    model, rest = _started(library, swing), range(_STEPS // 2, _STEPS)
    _run(model, range(1, _STEPS // 2), swing)
    saved = model.snapshot()
    rows = _run(model, rest, swing)
    model.restore(saved)
    return _run(model, rest, swing) == rows


def _compared(same: Callable[[RealCodeLibrary, _Swing], bool], rule: str, reason: str, advice: str) -> _Topic:
    def topic(library: RealCodeLibrary, tell: Tell) -> None:
        if not all(same(library, swing) for swing in _SWINGS):
            tell(rule, INTERFACE, reason, advice)

    return topic


def messages(library: RealCodeLibrary, tell: Tell) -> None:
    """The texts of two instances do not lie in one place that the DLL writes to."""
    models = [_started(library, swing) for swing in _SWINGS]
    for model, swing in zip(models, _SWINGS, strict=True):
        _step(model, 1, swing)
    places = [model.text_addresses() for model in models]
    for name, at in places[0].items():
        if at and at == places[1][name] and _writable(at):
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


class _Heap(ctypes.Structure):
    _fields_ = [(f"f{k}", ctypes.c_size_t) for k in range(7)]
    _fields_ += [("uordblks", ctypes.c_size_t), ("fordblks", ctypes.c_size_t), ("keepcost", ctypes.c_size_t)]


def leaks(library: RealCodeLibrary, tell: Tell) -> None:
    """Memory that the DLL takes is given back by Model_Terminate, and none is taken while it steps."""
    mallinfo = getattr(ctypes.CDLL(None), "mallinfo2", None) if sys.platform == "linux" else None
    if mallinfo is None:  # not glibc: nothing counts the bytes in use
        return
    mallinfo.restype = _Heap
    model, step_s = RealCode(library), library.info.sample_time

    def lives(count: int) -> None:
        for _ in range(count):
            _start(model, _NEAR_ONE)
            model.call("Model_Outputs", step_s)
            model.call("Model_Terminate")

    def steps(count: int) -> None:
        for k in range(1, count):
            model.call("Model_Outputs", k * step_s)

    def growth(what: Callable[[int], None], count: int) -> int:
        _start(model, _NEAR_ONE)
        before = mallinfo().uordblks
        what(count)
        return int(mallinfo().uordblks) - int(before)

    for name, what in (("an instance started and terminated", lives), ("a call of Model_Outputs", steps)):
        growth(what, 20)
        lost = growth(what, 400) - growth(what, 100)
        if lost > 300 * 8:
            reason = f"{name} loses {lost / 300:.0f} bytes"
            tell("DLL memory", INTERFACE, reason, "free in Model_Terminate what Model_FirstCall took")


def bounds(library: RealCodeLibrary, tell: Tell) -> None:
    """Nothing is written beside the arrays of states."""
    info, model, guarded = library.info, RealCode(library), {}
    sizes = {
        "int_states": 4 * info.n_int,
        "float_states": 4 * info.n_float,
        "double_states": 8 * info.n_double,
    }
    for name, size in sizes.items():
        guarded[name] = ctypes.create_string_buffer(_GUARD + bytes(size) + _GUARD, size + 2 * len(_GUARD))
        setattr(model.raw, name, ctypes.addressof(guarded[name]) + len(_GUARD))
    _start(model, _NEAR_ONE)
    _run(model, range(1, _STEPS), _NEAR_ONE)
    for name, buffer in guarded.items():
        if not (buffer.raw.startswith(_GUARD) and buffer.raw.endswith(_GUARD)):
            tell("DLL states", name, "is written beyond its declared number", "declare as many as it writes")


TOPICS: dict[str, _Topic] = {
    "description": description,
    "bounds": bounds,
    "finite outputs": finite,
    "alignment": padding,
    "repeated start": _compared(
        *(_repeated_start, "DLL repeated calls"),
        "Model_Initialize called five times gives another run than called once",
        "start from the arguments alone: tools call it until the release time",
    ),
    "time": _compared(_time, "DLL time", "Model_Outputs changes Time", "leave Time to the tool"),
    "restart": _compared(
        *(_restart, "DLL restart"),
        "after a run, Model_Initialize at time 0 does not begin the same run",
        "set every state in Model_Initialize: time goes back in multiple runs",
    ),
    "two instances": _compared(
        *(_two_instances, "DLL instances"),
        "an instance runs otherwise when another one runs beside it",
        "keep no variable of a run outside the instance: no globals, no static",
    ),
    "snapshot": _compared(
        *(_snapshot, "DLL snapshots"),
        "continued from its state arrays it runs otherwise",
        "keep all states in IntStates, FloatStates and DoubleStates",
    ),
    "messages": messages,
    "leaks": leaks,
}
