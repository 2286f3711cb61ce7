"""FMUs of the plant side by side: a library that is their binary and steps several instances at once."""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Iterable
from ctypes import c_size_t, c_void_p
from pathlib import Path

from interarea.models.blocks.plant import GROUP_SOURCES, plant_sources

from ..errors import BuildError
from .compile import compile_library, host_platform
from .sources import fmi_sources, gather_sources, record_source

_GROUP = Path(__file__).resolve().parents[1] / "c" / "group" / "fmu_group.c"
_ALIGNMENT = 64


class GroupLibrary:
    """The functions of c/group/fmu_group.h; the file also serves as binary of plant FMUs of this version.

    Instances made with it give the bits of those made with the FMU's own binary.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        c = self._c = ctypes.CDLL(str(path))
        c.interarea_group_lanes.restype = c.interarea_group_size.restype = c_size_t
        c.interarea_group_size.argtypes = [c_void_p, c_size_t]
        c.interarea_group_open.argtypes = [c_void_p, c_void_p, c_size_t]
        c.interarea_group_open.restype = None
        #: instances that this processor steps at once
        self.lanes = int(c.interarea_group_lanes())
        #: address of `interarea_group_step`
        self.step = int(ctypes.cast(c.interarea_group_step, c_void_p).value or 0)

    def work(self, component: int, count: int) -> GroupWork | None:
        """Return the memory in which up to `count` instances like `component` are stepped at once.

        None: they go one by one (many ports on a sparse network, a component of another kind, one alone).
        component : address of an instance made with this library, initialised.
        """
        lanes = next((n for n in (2, 4, 8) if n >= min(count, self.lanes)), self.lanes)
        size = self._c.interarea_group_size(component, lanes) if count > 1 else 0
        return GroupWork(self._c, component, lanes, int(size)) if size else None


class GroupWork:
    """Memory of one group; it knows instances by their addresses, so `open` it again for other ones."""

    def __init__(self, library: ctypes.CDLL, component: int, lanes: int, size: int) -> None:
        self.lanes = lanes
        self._library = library
        self._buffer = ctypes.create_string_buffer(size + _ALIGNMENT)
        address = ctypes.addressof(self._buffer)
        self.address = address + -address % _ALIGNMENT
        self.open(component)

    def open(self, component: int) -> None:
        """Prepare for instances like `component`."""
        self._library.interarea_group_open(self.address, component, self.lanes)


@functools.cache
def _loaded(path: Path) -> GroupLibrary:
    try:
        return GroupLibrary(path)
    except OSError as error:
        raise BuildError(f"cannot load the plants' library {path}: {error}") from error


def group_sources(plant: Iterable[Path] | None = None) -> tuple[Path, ...]:
    """Return the C files of the library; `plant`: those of the plants, default `plant_sources()`."""
    return (
        *fmi_sources(),
        *(plant_sources() if plant is None else plant),
        record_source(),
        *GROUP_SOURCES,
        _GROUP,
    )


def plant_group(plant: Iterable[Path] | None = None, *, cache: Path | None = None) -> GroupLibrary:
    """Return the library that steps plants side by side, compiled when the cache does not hold it.

    plant : C files of the plants (`plant_sources`, `Block.sources`); default: of any grid without devices of
        its own.
    cache : folder of compiled binaries; default ``$INTERAREA_CACHE``, else the user's cache folder.

    Raises
    ------
    BuildError : no compiler, a platform without one, or a library that cannot be loaded.
    """
    sources = gather_sources(group_sources(plant))
    return _loaded(compile_library("plant-group", sources, host_platform(), cache=cache))
