"""Check an IEEE/CIGRE DLL [CIGRE958]: its description, and how it behaves where a tool would call it.

Inputs swing about 1 and about 0; trajectories are compared bit by bit. What the interface leaves open is no
finding: a second Model_Outputs at the same time may go on, Model_Iterate may change states.
"""

from __future__ import annotations

import ctypes
import math
import platform
import re
import sys
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

from ..finding import Report
from ..open.images import ImageError, read_image
from ..open.real_code import ERROR, REQUIRED, RealCode, RealCodeLibrary, Values

INTERFACE = "DLL"
Tell = Callable[[str, str, str, str], None]
_STEPS = 40
_SWINGS = ((1.0, 0.1), (0.0, 1e-3))  #: mean and amplitude of the inputs
_BITS = {"x86": 32, "x86_64": 64, "arm64": 64}
_SYSTEMS = {"PE": "Windows", "ELF": "Linux", "Mach-O": "macOS"}
_FORMAT = {"win32": "PE", "darwin": "Mach-O"}.get(sys.platform, "ELF")
_NAMES = {"amd64": "x86_64", "aarch64": "arm64"}


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
        report.add(
            "DLL bits",
            path.name,
            f"has {bits} bits; its name or folder says {' and '.join(sorted(declared))}",
            "build it for the tool that loads it: ATP takes 32 bits, PSCAD those of its Fortran compiler",
        )
    missing = [name for name in REQUIRED if name not in image.exports]
    if missing:
        reason = f"no IEEE/CIGRE DLL: it does not have {', '.join(missing)}"
        report.add("DLL functions", path.name, reason, "export them under these names, as C functions")
    machine = platform.machine().lower()
    loads = (image.format, image.machine) == (_FORMAT, _NAMES.get(machine, machine))
    if not loads:
        system = _SYSTEMS[image.format]
        report.not_run.append(f"a {bits}-bit library for {system} ({image.machine}) cannot be loaded here")
    return loads and not missing


def _run(model: RealCode, steps: Iterable[int], swing: tuple[float, float]) -> list[bytes]:
    """Outputs after each call of Model_Outputs."""
    return [_step(model, k, swing) for k in steps]


def _step(model: RealCode, k: int, swing: tuple[float, float]) -> bytes:
    step = model.library.info.sample_time_s
    _excite(model, k, swing)
    model.call("Model_Outputs", k * step)
    return bytes(model.outputs.structure)


def _excite(model: RealCode, k: int, swing: tuple[float, float]) -> None:
    mean, size = swing
    for i, port in enumerate(model.library.info.inputs):
        if port.type != 10:
            model.inputs[port.name] = mean + size * math.sin(0.3 * k + 1.0 + i)


def _start(model: RealCode, swing: tuple[float, float], times: int = 1, fill: int = 0) -> int:
    """What a tool calls before the first step; `fill`: bytes between the ports, which mean nothing."""
    for values in (model.inputs, model.outputs, model.parameters):
        _pad(values, fill)
    _excite(model, 0, swing)
    model.call("Model_FirstCall", 0.0)
    code = 0
    for _ in range(times):
        code = max(code, model.call("Model_CheckParameters"))
    outputs = model.outputs.structure
    for _ in range(times):
        ctypes.memset(ctypes.addressof(outputs), 0, ctypes.sizeof(outputs))
        code = max(code, model.call("Model_Initialize"))
    return code


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
    for group in (info.inputs, info.outputs, info.parameters):
        names = [p.name for p in group]
        for p in group:
            if not re.fullmatch(r"[A-Za-z_]\w*", p.name, re.ASCII):
                tell("DLL names", repr(p.name), "is no C identifier", "use letters, digits and _ only")
            elif names.count(p.name) > 1:
                tell("DLL names", p.name, "is used twice", "give each port a name of its own")
    for p in info.parameters:
        if isinstance(p.start, int | float) and not p.low <= p.start <= p.high:
            reason = f"default {p.start:g} lies outside {p.low:g} to {p.high:g}"
            tell("DLL ranges", p.name, reason, "put the default into the range")
    if not info.sample_time_s > 0.0:
        tell("DLL sample time", INTERFACE, f"is {info.sample_time_s:g} s", "give a time above 0")
    if info.version[0] != 1:
        tell("DLL version", INTERFACE, f"is {info.version}, allowed: 1.x", "write the interface's version")
    model = RealCode(library)
    if _start(model, _SWINGS[0]) >= ERROR:
        tell(
            "DLL start", INTERFACE, f"refuses its own defaults: {model.text()}", "give defaults that it takes"
        )


def finite(library: RealCodeLibrary, tell: Tell) -> None:
    """Finite inputs near 1 give finite outputs, or a return code of 2."""
    model = RealCode(library)
    if _start(model, _SWINGS[0]) >= ERROR:
        return
    reals = [p.name for p in library.info.outputs if p.type in (8, 9)]
    for k in range(1, 4 * _STEPS):
        _excite(model, k, _SWINGS[0] if k < 2 * _STEPS else (1.0, 0.5))
        code = model.call("Model_Outputs", k * library.info.sample_time_s)
        bad = [name for name in reals if not math.isfinite(model.outputs[name])]
        if bad and code < ERROR:
            reason = f"is {model.outputs[bad[0]]} after finite inputs with return code {code}"
            tell("DLL errors", bad[0], reason, "return 2 with LastErrorMessage")
            return


def padding(library: RealCodeLibrary, tell: Tell) -> None:
    """Bytes between the ports of a structure are neither read nor written."""
    for swing in _SWINGS:
        rows = []
        for fill in (0x00, 0x5A, 0x00):
            model = RealCode(library)
            _start(model, swing, fill=fill)
            _pad(model.outputs, fill)
            gaps = _gaps(model.outputs)
            row = _run(model, range(1, _STEPS), swing)
            written = any(r[at] != fill for r in row for at in gaps)
            rows.append([bytes(b for at, b in enumerate(r) if at not in gaps) for r in row])
            if written:
                break
        if written or rows[0] == rows[2] != rows[1]:
            done = "writes" if written else "reads"
            tell(
                "DLL alignment",
                INTERFACE,
                f"{done} bytes of a structure that lie between its ports",
                "lay structures out in natural alignment: no packing",
            )
            return


def _repeated_start(library: RealCodeLibrary, swing: tuple[float, float]) -> bool:
    once, often = RealCode(library), RealCode(library)
    _start(once, swing)
    first = _run(once, range(1, _STEPS), swing)
    _start(often, swing, times=5)
    return _run(often, range(1, _STEPS), swing) == first


def _time(library: RealCodeLibrary, swing: tuple[float, float]) -> bool:
    model = RealCode(library)
    _start(model, swing)
    _run(model, range(1, _STEPS), swing)
    return bool(model.raw.time == (_STEPS - 1) * library.info.sample_time_s)


def _restart(library: RealCodeLibrary, swing: tuple[float, float]) -> bool:
    model, rows = RealCode(library), []
    for _ in range(2):
        _start(model, swing)
        rows.append(_run(model, range(1, _STEPS), swing))
    return rows[0] == rows[1]


def _two_instances(library: RealCodeLibrary, swing: tuple[float, float]) -> bool:
    alone, one, other = (RealCode(library) for _ in range(3))
    _start(alone, swing)
    first, beside = _run(alone, range(1, _STEPS), swing), (swing[0] * 0.8, swing[1] * 2)
    _start(one, swing)
    _start(other, beside)
    rows = []
    for k in range(1, _STEPS):
        _step(other, k + 3, beside)
        rows.append(_step(one, k, swing))
    return rows == first


def _snapshot(library: RealCodeLibrary, swing: tuple[float, float]) -> bool:
    model, rest = RealCode(library), range(_STEPS // 2, _STEPS)
    _start(model, swing)
    _run(model, range(1, _STEPS // 2), swing)
    saved = model.snapshot()
    rows = _run(model, rest, swing)
    model.restore(saved)
    return _run(model, rest, swing) == rows


#: what is compared -> whether it is the same, the rule, what is wrong if it is not, what to do
_COMPARED: dict[str, tuple[Callable[[RealCodeLibrary, tuple[float, float]], bool], str, str, str]] = {
    "repeated start": (
        *(_repeated_start, "DLL repeated calls"),
        "Model_Initialize called five times gives another run than called once",
        "start from the arguments alone: tools call it until the release time",
    ),
    "time": (_time, "DLL time", "Model_Outputs changes Time", "leave Time to the tool"),
    "restart": (
        *(_restart, "DLL restart"),
        "after a run, Model_Initialize at time 0 does not begin the same run",
        "set every state in Model_Initialize: time goes back in multiple runs",
    ),
    "two instances": (
        *(_two_instances, "DLL instances"),
        "an instance runs otherwise when another one runs beside it",
        "keep no variable of a run outside the instance: no globals, no static",
    ),
    "snapshot": (
        *(_snapshot, "DLL snapshots"),
        "continued from its state arrays it runs otherwise",
        "keep all states in IntStates, FloatStates and DoubleStates",
    ),
}


def _compare(what: str, library: RealCodeLibrary, tell: Tell) -> None:
    same, rule, reason, advice = _COMPARED[what]
    if not all(same(library, swing) for swing in _SWINGS):
        tell(rule, INTERFACE, reason, advice)


def messages(library: RealCodeLibrary, tell: Tell) -> None:
    """The texts of two instances do not lie in one place that the DLL writes to."""
    places = []
    for swing in _SWINGS:
        model = RealCode(library)
        _start(model, swing)
        _step(model, 1, swing)
        places.append(model.text_addresses())
    for name, one, other in zip(("LastErrorMessage", "LastGeneralMessage"), *places, strict=True):
        if one and one == other and _writable(one):
            tell(
                "DLL messages",
                name,
                "points to one text that all instances share and the DLL writes",
                "keep the text of each instance in its own states",
            )


def _writable(address: int) -> bool:
    """Whether this process may write there; False where that cannot be reason."""
    try:
        lines = Path("/proc/self/maps").read_text(encoding="utf-8").splitlines()
    except OSError:
        return False
    for line in lines:
        span, rights = line.split()[:2]
        low, high = (int(x, 16) for x in span.split("-"))
        if low <= address < high:
            return "w" in rights
    return False


def leaks(library: RealCodeLibrary, tell: Tell) -> None:
    """Memory that the DLL takes is given back by Model_Terminate, and none is taken while it steps."""
    used = _heap()
    if used is None:
        return
    model = RealCode(library)

    def lives(count: int) -> int:
        before = used()
        for _ in range(count):
            _start(model, _SWINGS[0])
            model.call("Model_Outputs", library.info.sample_time_s)
            model.call("Model_Terminate")
        return used() - before

    def steps(count: int) -> int:
        _start(model, _SWINGS[0])
        before = used()
        for k in range(1, count):
            model.call("Model_Outputs", k * library.info.sample_time_s)
        return used() - before

    for what, growth in (("an instance started and terminated", lives), ("a call of Model_Outputs", steps)):
        growth(20)
        few, many = growth(100), growth(400)
        if many - few > 300 * 8:
            reason = f"{what} loses {(many - few) / 300:.0f} bytes"
            tell("DLL memory", INTERFACE, reason, "free in Model_Terminate what Model_FirstCall took")


class _Heap(ctypes.Structure):
    _fields_ = [(f"f{k}", ctypes.c_size_t) for k in range(10)]


def _heap() -> Callable[[], int] | None:
    """Bytes in use of glibc's heap, or None where they cannot be counted."""
    mallinfo = getattr(ctypes.CDLL(None), "mallinfo2", None) if sys.platform == "linux" else None
    if mallinfo is None:
        return None
    mallinfo.restype = _Heap
    return lambda: int(mallinfo().f7)


def bounds(library: RealCodeLibrary, tell: Tell) -> None:
    """Nothing is written beside the arrays of states."""
    info = library.info
    model = RealCode(library)
    guarded = []
    for name, kind, count in (
        ("int_states", ctypes.c_int32, info.n_int),
        ("float_states", ctypes.c_float, info.n_float),
        ("double_states", ctypes.c_double, info.n_double),
    ):
        buffer = (ctypes.c_ubyte * (128 + count * ctypes.sizeof(kind)))(*([0xA5] * 64))
        ctypes.memset(ctypes.addressof(buffer) + len(buffer) - 64, 0xA5, 64)
        setattr(model.raw, name, ctypes.addressof(buffer) + 64)
        guarded.append((name, buffer))
    _start(model, _SWINGS[0])
    _run(model, range(1, _STEPS), _SWINGS[0])
    for name, buffer in guarded:
        if any(b != 0xA5 for b in (*buffer[:64], *buffer[-64:])):
            tell("DLL states", name, "is written beyond its declared number", "declare as many as it writes")


TOPICS: dict[str, Callable[[RealCodeLibrary, Tell], None]] = {
    "description": description,
    "bounds": bounds,
    "finite outputs": finite,
    "alignment": padding,
    **{what: partial(_compare, what) for what in _COMPARED},
    "messages": messages,
    "leaks": leaks,
}
