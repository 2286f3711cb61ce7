"""Many scenarios of one grid at once: the plant's C over vectors of scenarios, no FMI in between."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from interarea.models.blocks.binary_table import pack_record
from interarea.models.blocks.plant import BATCH_SOURCES
from interarea.models.blocks.variables import STEP_PARAMETER, Block

from ..errors import BuildError, FmuError
from .compile import compile_library, gather_sources, host_platform

Array = npt.NDArray[np.float64]
LANES = (1, 2, 4, 8)  #: scenarios side by side that there is code for
_ALIGNMENT = 64
_Real, _Integer = ctypes.POINTER(ctypes.c_double), ctypes.POINTER(ctypes.c_int)


class _Record(ctypes.Structure):
    _fields_ = (("bytes", ctypes.c_void_p), ("size", ctypes.c_size_t), ("n_entries", ctypes.c_size_t))


class _Layout(ctypes.Structure):
    _fields_ = tuple((n, ctypes.c_size_t) for n in ("x", "u", "y", "w", "p", "iu", "iy", "iw", "ip"))


class _Needs(ctypes.Structure):
    _fields_ = (("n_memory", ctypes.c_size_t), ("n_scratch", ctypes.c_size_t))


class _Batch(ctypes.Structure):
    _fields_ = (
        ("record", ctypes.POINTER(_Record)),
        ("layout", _Layout),
        ("n", ctypes.c_size_t),
        ("x", _Real),
        ("p", _Real),
        ("ip", _Integer),
        ("u", _Real),
        ("y", _Real),
        ("n_steps", ctypes.c_size_t),
        ("start", ctypes.c_double),
        ("step", ctypes.c_double),
        ("substep", _Real),
        ("status", _Integer),
        ("ended", _Real),
        ("message", ctypes.c_char_p),
        ("work", _Real),
    )


_MESSAGE_SIZE = 256


@dataclass(frozen=True)
class BatchRun:
    """What a batch gave; scenarios in the order they were asked for, the last index everywhere."""

    times_s: Array  #: (steps + 1,)
    outputs: Array  #: (steps + 1, outputs, scenarios); NaN after the end of a scenario that failed
    output_names: tuple[str, ...]
    states: Array  #: (states, scenarios) at the end
    ended_s: Array  #: (scenarios,) last good time
    errors: tuple[str, ...]  #: (scenarios,) why a scenario ended early; empty when it did not

    def of(self, name: str) -> Array:
        """Return one output, (steps + 1, scenarios); KeyError when there is none of that name."""
        if name not in self.output_names:
            raise KeyError(f"output {name!r}; allowed: {', '.join(self.output_names)}")
        return self.outputs[:, self.output_names.index(name), :]


class PlantBatch:
    """The plant of one grid, ready to run many scenarios.

    >>> from interarea.models.case.case import load_case
    >>> from interarea.models.blocks.plant import plant_block
    >>> batch = PlantBatch(plant_block(load_case("two-area-thesis")))  # doctest: +SKIP
    >>> run = batch.run([{"G1.exciter.KA": 150.0}, {"G1.exciter.KA": 250.0}], stop_s=1.0)  # doctest: +SKIP
    >>> run.of("G1_dw").shape  # doctest: +SKIP
    (101, 2)
    """

    def __init__(self, block: Block, *, cache: Path | None = None) -> None:
        """Compile the batch of `block` (a plant) for this machine, or take it from the cache.

        Raises
        ------
        BuildError : a block that is no plant, or what the compiler says.
        """
        if block.kind != "plant":
            raise BuildError(f"block {block.name!r} is a {block.kind}, a batch runs blocks of kind plant")
        self.block, self._table = block, block.table
        library = compile_library(
            "plant-batch",
            gather_sources((*block.sources, *BATCH_SOURCES)),
            host_platform(),
            cache=cache,
        )
        self._c = ctypes.CDLL(str(library))
        self._c.batch_lanes.restype = self._c.batch_work.restype = ctypes.c_size_t
        self._layout = _Layout(*(int(n) for n in self._table.layout()))
        self._needs, self._record = _Needs(), _Record()
        packed = pack_record(block.data)
        self._bytes = np.frombuffer(packed, dtype=np.uint8).copy()
        message = ctypes.create_string_buffer(_MESSAGE_SIZE)
        status = self._c.batch_open(
            ctypes.byref(self._record),
            self._bytes.ctypes.data_as(ctypes.c_void_p),
            ctypes.c_size_t(len(packed)),
            ctypes.byref(self._layout),
            ctypes.byref(self._needs),
            message,
        )
        if status:
            raise BuildError(f"batch of {block.name}: {message.value.decode()}")

    @property
    def widest(self) -> int:
        """Scenarios side by side in the widest vectors of this processor."""
        return int(self._c.batch_lanes())

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs in order."""
        return tuple(v.name for v in self._table.of_role("input"))

    def run(
        self,
        scenarios: Sequence[Mapping[str, float | int]],
        *,
        stop_s: float,
        step_s: float = 0.01,
        substep_s: float | None = None,
        start_states: Array | None = None,
        inputs: Array | None = None,
        lanes: int | None = None,
    ) -> BatchRun:
        """Run `scenarios` from 0 to `stop_s`, outputs every `step_s`.

        Parameters
        ----------
        scenarios : start values of each: parameters and events as `event_parameters` gives them, states.
        stop_s, step_s : s; the last step ends at or just after `stop_s`.
        substep_s : longest Runge-Kutta step, s; default: the `solver.step` of each scenario.
        start_states : (states, scenarios) instead of the operating point.
        inputs : (steps, inputs, scenarios), constant over each step; default zero.
        lanes : 1, 2, 4 or 8 side by side; default as many as the processor has. A plant with ports
            (nonlinear loads, saturation) runs one at a time whatever is asked.

        Raises
        ------
        ValueError : arrays of another shape, an unknown start value, times that are not above zero.
        FmuError : lanes that the processor has not.
        """
        n, steps = len(scenarios), int(np.ceil(stop_s / step_s - 1e-9)) if step_s > 0.0 else 0
        if not (n > 0 and steps > 0):
            raise ValueError(
                f"{n} scenarios to {stop_s} s in steps of {step_s} s, allowed: at least one of each"
            )
        x, p, ip = self._start(scenarios, start_states)
        wide = self.widest if lanes is None else lanes
        if wide not in LANES:
            raise ValueError(f"lanes = {lanes}, allowed: {LANES}")
        u = None if inputs is None else self._array("inputs", inputs, (steps, self._layout.u, n))
        y = np.full((steps + 1, self._layout.y, n), np.nan)
        own = [v.name for v in self._table.of_role("parameter")].index(STEP_PARAMETER)
        substeps = np.array(p[own]) if substep_s is None else np.full(n, substep_s, dtype=float)
        status, ended = np.zeros(n, dtype=np.intc), np.zeros(n)
        texts = ctypes.create_string_buffer(_MESSAGE_SIZE * n)
        work, keep = self._work(wide)
        call = _Batch(
            record=ctypes.pointer(self._record),
            layout=self._layout,
            n=n,
            x=_real(x),
            p=_real(p),
            ip=ip.ctypes.data_as(_Integer),
            u=None if u is None else _real(u),
            y=_real(y),
            n_steps=steps,
            start=0.0,
            step=step_s,
            substep=_real(substeps),
            status=status.ctypes.data_as(_Integer),
            ended=_real(ended),
            message=ctypes.cast(texts, ctypes.c_char_p),
            work=work,
        )
        message = ctypes.create_string_buffer(_MESSAGE_SIZE)
        if self._c.batch_run(ctypes.byref(call), ctypes.c_size_t(wide), message):
            raise FmuError(self.block.name, "batch_run", message.value.decode())
        del keep
        raw = texts.raw
        errors = tuple(raw[_MESSAGE_SIZE * k :].split(b"\0", 1)[0].decode() for k in range(n))
        names = tuple(v.name for v in self._table.of_role("output"))
        return BatchRun(step_s * np.arange(steps + 1, dtype=float), y, names, x, ended, errors)

    def _start(
        self, scenarios: Sequence[Mapping[str, float | int]], states: Array | None
    ) -> tuple[Array, Array, npt.NDArray[np.intc]]:
        n = len(scenarios)
        columns: list[npt.NDArray[np.generic]] = []
        known: set[str] = set()
        groups = (
            (self._table.of_role("state"), float),
            (self._table.of_role("parameter"), float),
            (self._table.of_role("parameter", integers=True), np.intc),
        )
        for variables, kind in groups:
            names = [v.name for v in variables]
            known |= set(names)
            table = np.empty((len(names), n), dtype=kind)
            table[:] = np.array([v.start for v in variables], dtype=kind)[:, None]
            row_of = {name: k for k, name in enumerate(names)}
            for k, values in enumerate(scenarios):
                for name, value in values.items():
                    if name in row_of:
                        table[row_of[name], k] = value
            columns.append(table)
        unknown = sorted({name for values in scenarios for name in values} - known)
        if unknown:
            raise ValueError(f"{unknown[0]!r} is no parameter or state of {self.block.name}")
        x = np.ascontiguousarray(columns[0], dtype=float)
        if states is not None:
            x = self._array("start_states", states, x.shape).copy()
        return x, np.ascontiguousarray(columns[1], dtype=float), np.ascontiguousarray(columns[2], np.intc)

    def _array(self, what: str, values: Array, shape: tuple[int, ...]) -> Array:
        array = np.ascontiguousarray(values, dtype=float)
        if array.shape != shape:
            raise ValueError(f"{what} has shape {array.shape}, allowed: {shape}")
        return array

    def _work(self, lanes: int) -> tuple[ctypes._Pointer[ctypes.c_double], object]:
        """Aligned work space and what keeps it alive."""
        size = self._c.batch_work(
            ctypes.byref(self._layout), ctypes.byref(self._needs), ctypes.c_size_t(lanes)
        )
        raw = np.zeros(int(size) + _ALIGNMENT // 8)
        skip = -raw.ctypes.data % _ALIGNMENT // 8
        return _real(raw[skip:]), raw


def _real(array: Array) -> ctypes._Pointer[ctypes.c_double]:
    return array.ctypes.data_as(_Real)
