"""Drive the C of a block directly through block.h: compile its sources, no FMI in between."""

from __future__ import annotations

import ctypes
import os
import re
import shutil
import sys
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

import interarea.models.blocks.binary_table
from interarea.fmu_build.write.cache import artefact, content_hash, default_cache
from interarea.fmu_build.write.compile import compile_library, host_platform
from interarea.fmu_build.write.sources import gather_sources, record_source
from interarea.models.blocks.binary_table import pack_record
from interarea.models.blocks.variables import Block
from interarea.models.files import one_at_a_time
from interarea.models.processes import run_guarded, side_by_side

C = Path(interarea.models.blocks.binary_table.__file__).parents[1] / "c"
FLAGS = ["-std=c99", "-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror"]
_Real = ctypes.POINTER(ctypes.c_double)
_Integer = ctypes.POINTER(ctypes.c_int)


class _Record(ctypes.Structure):
    _fields_ = (("bytes", ctypes.c_void_p), ("size", ctypes.c_size_t), ("n_entries", ctypes.c_size_t))


class _Layout(ctypes.Structure):
    _fields_ = tuple((n, ctypes.c_size_t) for n in ("x", "u", "y", "w", "p", "iu", "iy", "iw", "ip"))


class _Needs(ctypes.Structure):
    _fields_ = (
        ("n_memory", ctypes.c_size_t),
        ("n_scratch", ctypes.c_size_t),
        ("n_notes", ctypes.c_size_t),
        ("n_decisions", ctypes.c_size_t),
        ("n_warm", ctypes.c_size_t),
    )


def _fields_of_block() -> list[tuple[str, type]]:
    """Members of `Block` in the order of block.h, so that the header stays the only place that says it."""
    text = (C / "block" / "block.h").read_text()
    body = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
    body = re.search(r"typedef struct \{([^}]*)\} Block;", body).group(1)
    kinds = {
        "double": _Real,
        "int": _Integer,
        "size_t": ctypes.c_size_t,
        "BlockLimits": ctypes.c_void_p,
        "const Record": ctypes.POINTER(_Record),
        "BlockLayout": _Layout,
    }
    members = re.findall(r"(const Record|BlockLayout|BlockLimits|double|int|size_t)\s+([^;]+);", body)
    return [(name.strip(" *"), kinds[kind]) for kind, names in members for name in names.split(",")]


class _Block(ctypes.Structure):
    _fields_ = _fields_of_block()


class BlockFailure(RuntimeError):
    """The block returned BLOCK_DISCARD (1) or BLOCK_ERROR (2) with this message."""

    def __init__(self, status: int, text: str) -> None:
        super().__init__(text)
        self.status = status


def compiler() -> list[str]:
    """Return $CC, gcc, or the zig that comes with ziglang."""
    if os.environ.get("CC"):
        return os.environ["CC"].split()
    if shutil.which("gcc"):
        return ["gcc"]
    return [sys.executable, "-m", "ziglang", "cc"]


@cache
def compile_shared(sources: tuple[Path, ...], flags: tuple[str, ...] = tuple(FLAGS)) -> Path:
    """Return the shared library of C sources, kept in the cache: a plant takes a compiler 45 s.

    A key holds every C file and header of the package, for any of them may be included.
    """
    everything = sorted(p for p in C.rglob("*.[ch]"))
    texts = [p.read_bytes() for p in (*sources, *everything)]
    key = content_hash(*texts, [p.name for p in (*sources, *everything)], flags, compiler(), _version())
    folder = default_cache()
    with one_at_a_time(folder / f"shim-{key}.lock"):
        return artefact(folder, "shim", key, ".so", lambda result: _compile(sources, flags, result))


def _compile(sources: tuple[Path, ...], flags: tuple[str, ...], result: Path) -> None:
    folders = [f"-I{source.parent}" for source in sources if source.suffix == ".h"]  # generated headers
    code = [source for source in sources if source.suffix == ".c"]
    folders += [f"-I{source.parent}" for source in sources if source.name == "flow.c"] if folders else []
    command = [*compiler(), *flags, "-fPIC", *folders]
    objects = [str(result.parent / f"{k}.o") for k in range(len(code))]

    def compiled(k: int) -> None:
        _run([*command, "-c", "-o", objects[k], str(code[k])])

    side_by_side(compiled, sorted(range(len(code)), key=lambda k: "flow" not in code[k].parts))
    _run([*command, "-shared", "-o", str(result), *objects, "-lm"])


def _run(command: list[str]) -> None:
    done = run_guarded(command)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}\n{done.stderr}")


@cache
def _version() -> str:
    return run_guarded([*compiler(), "--version"]).stdout


#: functions of block.h and record.h that a shim calls
_CALLED = (
    "record_open",
    *(f"block_{n}" for n in ("needs", "start", "derivatives", "outputs", "directional")),
)
_CALLED += ("block_next_event", "block_event")


def _functions(sources: tuple[Path, ...], flags: tuple[str, ...]) -> Any:
    """Return what has the C functions of a block as attributes.

    Without `flags` they are those of the objects of which its FMU is linked, found by a table: they have no
    names outside of their library.
    """
    if flags:
        return ctypes.CDLL(str(compile_shared(sources, (*FLAGS, *flags))))
    addresses = ", ".join(f"(Any){name}" for name in _CALLED)
    shown = "__declspec(dllexport)" if sys.platform == "win32" else '__attribute__((visibility("default")))'
    code = f'#include "block.h"\ntypedef void (*Any)(void);\n{shown} extern const Any shim_table[];\n'
    code += f"const Any shim_table[] = {{ {addresses} }};\n"
    files = gather_sources((*sources, record_source())) | {"shim.c": code.encode()}
    library = ctypes.CDLL(str(compile_library("shim", files, host_platform())))
    kind = ctypes.CFUNCTYPE(ctypes.c_int)
    return SimpleNamespace(
        **dict(zip(_CALLED, (kind * len(_CALLED)).in_dll(library, "shim_table"), strict=True))
    )


class BlockShim:
    """One instance of a block; arrays are numpy views that the C side shares."""

    def __init__(
        self,
        block: Block,
        parameters: dict | None = None,
        *,
        start: bool = True,
        flags: tuple[str, ...] = (),
    ) -> None:
        self.table = block.table
        self._c = _functions(tuple(block.sources), flags)
        self._c.block_next_event.restype = ctypes.c_double
        packed = pack_record(block.data)
        self._bytes = np.frombuffer(packed, dtype=np.uint8).copy()
        self._record = _Record()
        why = ctypes.c_char_p()
        if self._c.record_open(
            ctypes.byref(self._record),
            self._bytes.ctypes.data_as(ctypes.c_void_p),
            ctypes.c_size_t(len(packed)),
            ctypes.byref(why),
        ):
            raise BlockFailure(2, why.value.decode())
        layout = _Layout(*(int(n) for n in self.table.layout()))
        self.message = ctypes.create_string_buffer(256)
        needs = _Needs()
        self._check(
            self._c.block_needs(
                ctypes.byref(self._record), ctypes.byref(layout), ctypes.byref(needs), self.message
            )
        )
        self._block = _Block(record=ctypes.pointer(self._record), layout=layout)
        sizes = {"x": layout.x, "dx": layout.x, "u": layout.u, "y": layout.y, "w": layout.w, "p": layout.p}
        sizes |= {"memory": needs.n_memory, "scratch": needs.n_scratch}
        self.n_warm = int(needs.n_warm)
        for name, size in sizes.items():
            self._share(name, np.zeros(size))
        for name in ("iu", "iy", "iw", "ip"):
            self._share(name, np.zeros(getattr(layout, name), dtype=np.intc))
        self._share("u_order", np.zeros(layout.u, dtype=np.intc))
        self.state_names = tuple(v.name for v in self.table.of_role("state"))
        self.input_names = tuple(v.name for v in self.table.of_role("input"))
        self.output_names = tuple(v.name for v in self.table.of_role("output"))
        self._fill("x", "state", parameters)
        self._fill("u", "input", parameters)
        self._fill("p", "parameter", parameters)
        self._fill("ip", "parameter", parameters, integers=True)
        if start:
            self.start(0.0)

    def _share(self, name: str, array: np.ndarray) -> None:
        setattr(self, name, array)
        kind = _Integer if array.dtype == np.intc else _Real
        setattr(self._block, name, array.ctypes.data_as(kind))

    def _fill(self, name: str, role: str, values: dict | None, *, integers: bool = False) -> None:
        for k, v in enumerate(self.table.of_role(role, integers=integers)):
            getattr(self, name)[k] = (values or {}).get(v.name, v.start)

    def _check(self, status: int) -> None:
        if status:
            raise BlockFailure(status, self.message.value.decode())

    def start(self, t: float) -> None:
        """block_start."""
        self._check(self._c.block_start(ctypes.byref(self._block), ctypes.c_double(t), self.message))

    def operating_point(self) -> tuple[np.ndarray, np.ndarray]:
        """Start values (x0, u0)."""
        return self.x.copy(), self.u.copy()

    def derivatives(
        self, x: np.ndarray, u: np.ndarray | None = None, t: float = 0.0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return (dx, y)."""
        x, u = np.ascontiguousarray(x, float), np.ascontiguousarray(self.u if u is None else u, float)
        dx, y = np.full(len(self.x), np.nan), np.full(len(self.y), np.nan)
        args = (ctypes.byref(self._block), ctypes.c_double(t), _p(x), _p(u))
        self._check(self._c.block_derivatives(*args, _p(dx), self.message))
        self._check(self._c.block_outputs(*args, _p(y), self.message))
        return dx, y

    def directional(
        self, vx: np.ndarray, vu: np.ndarray, x: np.ndarray | None = None, u: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the derivative of (dx, y) in the direction (vx, vu)."""
        x, u, vx, vu = (
            np.ascontiguousarray(a, float)
            for a in (self.x if x is None else x, self.u if u is None else u, vx, vu)
        )
        vdx, vy = np.full(len(self.x), np.nan), np.full(len(self.y), np.nan)
        call = self._c.block_directional
        args = (_p(x), _p(u), _p(vx), _p(vu), _p(vdx), _p(vy))
        self._check(call(ctypes.byref(self._block), ctypes.c_double(0.0), *args, self.message))
        return vdx, vy

    def jacobians(
        self, x: np.ndarray | None = None, u: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return exact (A, B, C, D)."""
        n, m = len(self.x), len(self.u)
        unit = np.eye(n + m)
        columns = [self.directional(v[:n], v[n:], x, u) for v in unit]
        whole = np.array([np.concatenate(c) for c in columns]).T
        return whole[:n, :n], whole[:n, n:], whole[n:, :n], whole[n:, n:]

    def directional_errors(self, spread: float, h: float) -> tuple[float, float]:
        """Return how far (dx, y) of `directional` is from differences of fourth order, over its largest.

        About random states and inputs within `spread` of the start, in a random direction; h : their step.
        """
        rng, n, m = np.random.default_rng(1), len(self.x), len(self.u)
        x, u = self.x + spread * rng.standard_normal(n), spread * rng.standard_normal(m)
        vx, vu = rng.standard_normal(n), rng.standard_normal(m)

        def at(k: float) -> np.ndarray:
            return np.concatenate(self.derivatives(x + k * h * vx, u + k * h * vu))

        slope = (8.0 * (at(1.0) - at(-1.0)) - (at(2.0) - at(-2.0))) / (12.0 * h)
        exact = np.concatenate(self.directional(vx, vu, x, u))
        off = np.abs(slope - exact)
        return (
            float(off[:n].max() / np.abs(exact[:n]).max()),
            float(off[n:].max() / np.abs(exact[n:]).max()),
        )

    def next_event(self, t: float) -> float:
        """block_next_event."""
        return float(self._c.block_next_event(ctypes.byref(self._block), ctypes.c_double(t)))

    def event(self, t: float, x: np.ndarray) -> None:
        """block_event: `x` is changed in place."""
        self._check(self._c.block_event(ctypes.byref(self._block), ctypes.c_double(t), _p(x), self.message))

    def run(
        self, stop_s: float, step_s: float, u: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Integrate with Runge-Kutta of order 4, steps cut at events; return (times, states, outputs)."""
        t, x = 0.0, self.x.copy()
        u = self.u if u is None else u
        times, states, outputs = [t], [x.copy()], [self.derivatives(x, u)[1]]
        while t < stop_s:
            event = self.next_event(t)
            target = min(t + step_s, stop_s, event)
            if stop_s - target < 1e-9 * step_s:
                target = stop_s
            h = target - t
            k1 = self.derivatives(x, u, t)[0]
            k2 = self.derivatives(x + h / 2 * k1, u, t + h / 2)[0]
            k3 = self.derivatives(x + h / 2 * k2, u, t + h / 2)[0]
            k4 = self.derivatives(x + h * k3, u, t + h)[0]
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            t = target
            if t == event:
                self.event(t, x)
            times.append(t)
            states.append(x.copy())
            outputs.append(self.derivatives(x, u, t)[1])
        return np.array(times), np.array(states), np.array(outputs)


def _p(array: np.ndarray) -> ctypes.c_void_p:
    return array.ctypes.data_as(_Real)
