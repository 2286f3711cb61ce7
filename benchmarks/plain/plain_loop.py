"""The plant of a case in a plain C loop: the yardstick for what the FMU's interface costs."""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

from interarea.fmu_build.write.compile import compile_library, host_platform
from interarea.fmu_build.write.sources import gather_sources, source_files
from interarea.models.blocks.binary_table import pack_record
from interarea.models.blocks.plant import plant_block
from interarea.models.grid.network_tables import Form


@functools.lru_cache
def compiled(sources: tuple[Path, ...], own: str = "plain_loop.c", *, fmi: bool = True) -> ctypes.CDLL:
    """Compile a C file of this folder with the `sources` of a block, as its FMU is compiled.

    fmi : whether to compile the FMI layer too; the objects of the block are then shared with its FMU.
    """
    gather = source_files if fmi else gather_sources
    files = gather((Path(__file__).with_name(own), *sources))
    return ctypes.CDLL(str(compile_library(Path(own).stem, files, host_platform())))


class PlainPlant:
    """One plant at its operating point, stepped by `plain_loop.c`."""

    def __init__(
        self, case: object, parameters: Mapping[str, float] | None = None, network: Form | None = None
    ) -> None:
        block = plant_block(case, network=network)  # type: ignore[arg-type]
        self._c = compiled(block.sources)
        self._c.plain_open.restype = ctypes.c_void_p
        self._c.plain_run.restype = ctypes.c_double
        table = block.table
        self.state_names = tuple(v.name for v in table.of_role("state"))
        values = [
            np.array(
                [(parameters or {}).get(v.name, v.start) for v in table.of_role(role, integers=integers)],
                dtype=kind,
            )
            for role, integers, kind in (
                ("state", False, np.float64),
                ("parameter", False, np.float64),
                ("parameter", True, np.intc),
            )
        ]
        packed = pack_record(block.data)
        self._keep = [np.frombuffer(packed, dtype=np.uint8).copy(), *values]
        counts = (ctypes.c_size_t * 9)(*(int(n) for n in table.layout()))
        pointers = [a.ctypes.data_as(ctypes.c_void_p) for a in self._keep]
        self._plant = self._c.plain_open(pointers[0], ctypes.c_size_t(len(packed)), counts, *pointers[1:])
        if not self._plant:
            raise RuntimeError(f"{block.name}: the plant refuses to start")

    def states(self) -> npt.NDArray[np.float64]:
        """Return the states now, in the order of `state_names`."""
        values = np.empty(len(self.state_names))
        self._c.plain_states(ctypes.c_void_p(self._plant), values.ctypes.data_as(ctypes.c_void_p))
        return values

    def events(self, begin_s: float, stop_s: float, step_s: float) -> tuple[float, int, int, int]:
        """Return CPU seconds, evaluations, located switches and steps of a run with its events."""
        counts = (ctypes.c_long * 3)()
        self._c.plain_events.restype = ctypes.c_double
        times = [ctypes.c_double(t) for t in (begin_s, stop_s, step_s)]
        seconds = self._c.plain_events(ctypes.c_void_p(self._plant), *times, counts)
        if not seconds >= 0.0:
            raise RuntimeError(f"the plain loop fails before {stop_s:g} s in steps of {step_s:g} s")
        return float(seconds), *counts

    def cpu_s(self, stop_s: float, step_s: float) -> float:
        """Return the CPU seconds of a run of `stop_s` in steps of `step_s`."""
        plant, steps = ctypes.c_void_p(self._plant), ctypes.c_long(round(stop_s / step_s))
        return float(self._c.plain_run(plant, steps, ctypes.c_double(step_s)))
