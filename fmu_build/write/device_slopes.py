"""Derivatives of a plant's devices with the network between them cut, for sparse linear models."""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Iterable
from ctypes import c_double, c_int, c_size_t, c_void_p
from pathlib import Path

import numpy as np
import numpy.typing as npt

from interarea.models.blocks.binary_table import pack_record
from interarea.models.blocks.variables import Block

from ..errors import BuildError
from .compile import compile_library, host_platform
from .sources import gather_sources, record_source

Vector = npt.NDArray[np.float64]
_REAL = ctypes.POINTER(c_double)
_SLOPES = Path(__file__).resolve().parents[1] / "c" / "group" / "device_slopes.c"


def slope_sources(plant: Iterable[Path]) -> dict[str, bytes]:
    """Return the C files of the library with the slopes of a plant's devices, by name.

    plant : C files of the plant (`plant_sources`, `Block.sources`).
    """
    return gather_sources((*plant, record_source(), _SLOPES))


@functools.cache
def _loaded(path: Path) -> ctypes.CDLL:
    try:
        c = ctypes.CDLL(str(path))
    except OSError as error:
        raise BuildError(f"cannot load the library of the plant's devices {path}: {error}") from error
    c.interarea_devices_size.restype = c.interarea_devices_sources.restype = c_size_t
    return c


class DeviceSlopes:
    """A plant at rest, run by the C of its FMU but without one, which takes a large grid half a minute.

    Attributes
    ----------
    states, inputs : their names. sources : machines and, after them, ports (loads that are not constant
        impedance, machines that saturate or have X''d != X''q).
    """

    def __init__(self, block: Block, *, cache: Path | None = None) -> None:
        table = block.table
        self._c = _loaded(
            compile_library("plant-slopes", slope_sources(block.sources), host_platform(), cache=cache)
        )
        packed = pack_record(block.data)
        self._record = np.frombuffer(packed, dtype=np.uint8).copy()
        layout = (c_size_t * 9)(*(int(n) for n in table.layout()))
        message = ctypes.create_string_buffer(256)
        record = (self._record.ctypes.data_as(c_void_p), c_size_t(len(packed)), layout)
        size = int(self._c.interarea_devices_size(*record, message))
        if not size:
            raise BuildError(f"plant of {block.name}: {message.value.decode(errors='replace')}")
        self._work = np.zeros(size // 8 + 1)
        self.states = tuple(v.name for v in table.of_role("state"))
        self.inputs = tuple(v.name for v in table.of_role("input"))
        values = [
            np.array([v.start or 0.0 for v in table.of_role(role)], dtype=float)
            for role in ("state", "input", "parameter")
        ]
        whole = np.array([v.start for v in table.of_role("parameter", integers=True)], dtype=np.intc)
        where = [a.ctypes.data_as(_REAL) for a in values] + [whole.ctypes.data_as(ctypes.POINTER(c_int))]
        if self._c.interarea_devices_open(self._at, *record, *where, message):
            raise BuildError(f"plant of {block.name}: {message.value.decode(errors='replace')}")
        self.sources = int(self._c.interarea_devices_sources(self._at))

    @property
    def _at(self) -> c_void_p:
        return self._work.ctypes.data_as(c_void_p)

    def slopes(
        self, vx: Vector, vu: Vector, vv: npt.NDArray[np.complex128]
    ) -> tuple[Vector, npt.NDArray[np.complex128]]:
        """Return how dx/dt (n,) and the currents of the sources move when x, u and their voltages move so.

        vv : (sources,) real and imaginary parts of the voltage at each source, pu; currents too, pu on the
        base of the case. Exact to rounding (complex step).

        Raises
        ------
        BuildError : the network's equations have no solution at rest.
        """
        vx, vu = np.ascontiguousarray(vx, dtype=float), np.ascontiguousarray(vu, dtype=float)
        volts = np.concatenate([vv.real, vv.imag])
        vdx, vi = np.empty(len(self.states)), np.empty(2 * self.sources)
        provided = (a.ctypes.data_as(_REAL) for a in (vx, vu, volts, vdx, vi))
        if self._c.interarea_devices_slopes(self._at, *provided):
            raise BuildError("the network of the plant has no solution at the equilibrium")
        return vdx, vi[: self.sources] + 1j * vi[self.sources :]
