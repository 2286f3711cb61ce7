"""Compile and load the kernel; its structures, field by field as in structures.h."""

from __future__ import annotations

import ctypes
import logging
import os
from ctypes import c_double, c_int32, c_int64, c_void_p
from functools import cache
from pathlib import Path
from typing import Any

from interarea.fmu_build.errors import BuildError
from interarea.fmu_build.write.compile import compile_library, host_platform
from interarea.fmu_build.write.sources import gather_sources

_log = logging.getLogger("interarea")
_SOURCE = Path(__file__).resolve().parent / "kernel.c"

#: codes of structures.h
OK, STOPPED, CALL_FAILED, NOT_FINITE, NOT_SETTLED, PAUSED = range(6)
KIND_OF = {"hermite": 0, "points": 1, "linear": 2, "held": 3, "newest": 4}
TYPE_OF = {"Real": 0, "Integer": 1, "Enumeration": 1, "Boolean": 2}
STEP_EDGE, STEP_RECORDED = 1, 2
#: calls by number, as `FmuParticipant` names them
CALLS = (
    "fmi2SetReal",
    "fmi2SetRealInputDerivatives",
    "fmi2SetInteger",
    "fmi2DoStep",
    "fmi2GetReal",
    "fmi2GetInteger",
    "fmi2GetRealOutputDerivatives",
    "fmi2GetFMUstate",
    "fmi2SetFMUstate",
)
#: function pointers of a node in their order, and the FMI functions they are
FUNCTIONS = {
    "set_real": "fmi2SetReal",
    "set_derivatives": "fmi2SetRealInputDerivatives",
    "set_integer": "fmi2SetInteger",
    "set_boolean": "fmi2SetBoolean",
    "do_step": "fmi2DoStep",
    "get_real": "fmi2GetReal",
    "get_integer": "fmi2GetInteger",
    "get_boolean": "fmi2GetBoolean",
    "get_derivatives": "fmi2GetRealOutputDerivatives",
    "get_state": "fmi2GetFMUstate",
    "set_state": "fmi2SetFMUstate",
}


def _fields(kind: Any, names: str) -> list[tuple[str, Any]]:
    return [(name, kind) for name in names.split()]


class KernelSignal(ctypes.Structure):
    """See structures.h."""

    _fields_ = [
        *_fields(c_double, "v0 s0 v1 s1"),
        ("d", c_double * 4),
        *_fields(c_double, "h_last peak nominal"),
        ("ticks", c_int64 * 4),
        ("values", c_double * 4),
        *_fields(c_int32, "n_past kind index slope"),
    ]


class KernelFeed(ctypes.Structure):
    """See structures.h."""

    _fields_ = [*_fields(c_double, "gain offset"), *_fields(c_int32, "signal type")]


class KernelNode(ctypes.Structure):
    """See structures.h."""

    _fields_ = [
        ("component", c_void_p),
        *_fields(c_void_p, " ".join(FUNCTIONS)),
        *_fields(c_void_p, "lanes work state"),
        *_fields(c_double, "time first_warning"),
        ("warnings", c_int64 * len(CALLS)),
        *_fields(c_void_p, "feeds u_reference u du_reference du_order du"),
        *_fields(c_void_p, "y y_home y_place y_reference y_real y_integer dy dy_reference dy_order"),
        *_fields(c_int32, "n_u_real n_u order substeps n_real n_integer n_boolean n_y n_dy"),
        *_fields(c_int32, "first_signal n_signals column"),
    ]


class KernelGroup(ctypes.Structure):
    """See structures.h."""

    _fields_ = _fields(c_int32, "first count tearing n_tearing iterated unused")


DISCARDED = ctypes.CFUNCTYPE(c_int32, c_int32, c_double, c_double)


class KernelRun(ctypes.Structure):
    """`Kernel` of structures.h."""

    _fields_ = [
        ("discarded", DISCARDED),
        *_fields(c_void_p, "nodes signals groups members tearing points flags times records spare work"),
        *_fields(c_int64, "index row repeated"),
        *_fields(c_double, "tolerance budget value"),
        *_fields(c_int32, "stop n_nodes n_signals n_groups n_columns node group call status"),
    ]


_MIRRORED: tuple[type[ctypes.Structure], ...] = (KernelSignal, KernelFeed, KernelNode, KernelGroup, KernelRun)


@cache
def _library(path: Path) -> ctypes.CDLL:
    library = ctypes.CDLL(str(path))
    library.kernel_run.argtypes = [ctypes.POINTER(KernelRun), c_int64]
    library.kernel_run.restype = c_int32
    library.kernel_run_lockstep.argtypes = [
        ctypes.POINTER(c_void_p),
        ctypes.POINTER(c_int64),
        c_int32,
        c_double,
        ctypes.POINTER(c_int32),
    ]
    library.kernel_run_lockstep.restype = c_int32
    sizes = (c_int32 * len(_MIRRORED))()
    count = library.kernel_layout(sizes, len(_MIRRORED))
    if count != len(_MIRRORED) or list(sizes) != [ctypes.sizeof(s) for s in _MIRRORED]:
        raise BuildError(
            f"the kernel {path.name} has structures of {list(sizes)} bytes, Python as "
            f"{[ctypes.sizeof(s) for s in _MIRRORED]}; remove the file and run again"
        )
    return library


def kernel_sources() -> dict[str, bytes]:
    """Return the C files and headers of the kernel by flat name."""
    return gather_sources((_SOURCE,))


def load_kernel(folder: Path | None = None) -> ctypes.CDLL:
    """Return the kernel, compiled when the cache does not hold it.

    folder : cache of compiled binaries; default as for FMUs.

    Raises
    ------
    BuildError : no compiler, a platform without one, or a library that cannot be loaded.
    """
    path = compile_library("kernel", kernel_sources(), host_platform(), cache=folder)
    try:
        return _library(path)
    except OSError as error:
        raise BuildError(f"cannot load the kernel {path}: {error}") from error


_logged: set[str] = set()
_loaded: dict[tuple[str | None, ...], ctypes.CDLL] = {}  # by what decides where it is and what makes it
_DECIDES = ("INTERAREA_CACHE", "XDG_CACHE_HOME", "LOCALAPPDATA", "HOME", "CC")


def kernel_or_reason() -> tuple[ctypes.CDLL | None, str]:
    """Return the kernel, or None and why it cannot be had, which is logged once."""
    key = tuple(os.environ.get(name) for name in _DECIDES)
    if key in _loaded:
        return _loaded[key], ""
    try:
        _loaded[key] = load_kernel()
        return _loaded[key], ""
    except BuildError as error:
        reason = str(error).partition("\n")[0]
    if reason not in _logged:
        _log.warning("stepping in Python, which gives the same results but is slower: %s", reason)
        _logged.add(reason)
    return None, reason
