"""Plant FMUs through whole runs, alone or side by side in the lanes of the group library."""

from __future__ import annotations

import ctypes
import time
from collections.abc import Mapping, Sequence
from ctypes import c_double, c_int, c_size_t, c_void_p
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from interarea.cosim.run.artefacts import plant_fmu
from interarea.fmu_build.open.fmi2 import CallFailed, Instance, Library, Log
from interarea.fmu_build.open.fmu_file import FmuFile
from interarea.fmu_build.write.lane_library import GroupLibrary, GroupWork, plant_group
from interarea.fmu_build.write.package import build_fmu
from interarea.models.blocks.plant import event_parameters, plant_block
from interarea.models.case.case import Case, load_case
from interarea.models.case.events import events_of
from interarea.models.case.write_toml import toml_text
from interarea.models.grid.network_tables import Form

Array = npt.NDArray[np.float64]
_STEP = ctypes.CFUNCTYPE(
    None,
    c_void_p,
    c_size_t,
    ctypes.POINTER(c_void_p),
    ctypes.POINTER(c_double),
    ctypes.POINTER(c_double),
    c_int,
    ctypes.POINTER(c_int),
)


LIMITED_EXCITERS = {
    "static": {"kind": "static", "KA": 200.0, "TA": 0.06, "TR": 0.05, "Efd_min": -1.0, "Efd_max": 3.0},
    "dc1": {"kind": "dc1", "KA": 40.0, "TA": 0.08, "TR": 0.05, "KE": "self-excited", "TE": 0.36, "KF": 0.125,
            "TF": 1.8, "Aex": 0.0056, "Bex": 1.075, "VRmin": -1.0, "VRmax": 1.0},
    "st1a": {"kind": "st1a", "KA": 100.0, "TA": 0.06, "TR": 0.05, "TC": 0.0, "TB": 0.0, "VRmin": -3.0,
             "VRmax": 3.5, "KC": 0.05},
}  # fmt: skip
LIMITED_FAULT = [{"kind": "bus_fault", "bus": 8, "start_s": 0.1, "end_s": 0.25, "x_pu": 0.02}]


def limited_case(exciter: str, folder: Path) -> tuple[Case, dict[str, float | int]]:
    """The two-area system with limited exciters and stabilizers, and a fault that brings them there."""
    controls = {
        "exciter": LIMITED_EXCITERS[exciter] | {"source": "test"},
        "governor": {"Tsr": 0.05, "vg_min": -0.02, "vg_max": 0.02},
    }
    document = {"base": "two-area-thesis", "name": exciter, "title": exciter, "source": "test"}
    path = folder / "case.toml"
    path.write_text(toml_text(document | {"change": {"machines": {"defaults": controls}}}))
    case = load_case(path)
    return case, event_parameters(case, events_of(LIMITED_FAULT, where="test"))


@dataclass
class Runs:
    """What the runs gave, the run as last index."""

    times_s: Array  #: (steps + 1,)
    outputs: Array  #: (steps + 1, outputs, runs); NaN after a run has failed
    names: tuple[str, ...]
    errors: list[str]  #: why a run ended early, "" when it did not
    ended_s: list[float]
    cpu_s: float  #: of the steps alone: not of beginning the runs

    def of(self, name: str) -> Array:
        """Return one output, (steps + 1, runs)."""
        return self.outputs[:, self.names.index(name), :]


@dataclass
class _Run:
    fmu: Instance
    error: str = ""
    log: list[str] = field(default_factory=list)


class PlantLanes:
    """Runs of the plant FMU of a case; `lanes` = 1 lets each fmi2DoStep be called by itself."""

    def __init__(
        self, case: Case, cache: Path, more: Sequence[str] = (), network: Form | None = None
    ) -> None:
        """`network` : the form to take, whatever is cheaper."""
        self.group: GroupLibrary = plant_group(cache=cache)
        if network is None:
            fmu = plant_fmu(case, cache, more=more)
        else:
            fmu = cache / f"{case.name}-{network}.fmu"
            build_fmu(plant_block(case, network=network), fmu, cache=cache)
        self.file = FmuFile(fmu)
        self.outputs = [v for v in self.file.model.variables if v.causality == "output"]

    def run(
        self,
        rows: Sequence[Mapping[str, float | int]],
        *,
        stop_s: float,
        step_s: float = 0.01,
        lanes: int | None = None,
        inputs: Mapping[tuple[int, int, str], float] | None = None,
        record: bool = True,
    ) -> Runs:
        """Run `rows` of start values; inputs: (step, run, name) -> value from there on."""
        steps = round(stop_s / step_s)
        runs = [self._started(row) for row in rows]
        y = np.full((steps + 1, len(self.outputs), len(rows)), np.nan)
        ended = [0.0] * len(rows)
        cpu_s = 0.0
        self._record(runs, y[0])
        width = self.group.lanes if lanes is None else lanes
        works: dict[tuple[int, ...], GroupWork | None] = {}  # each knows the instances that it had last
        for k in range(steps):
            for (at, number, name), value in (inputs or {}).items():
                if at == k:
                    runs[number].fmu.set(self.file.variables[name], value)
            alive = [r for r in runs if not r.error]
            for first in range(0, len(alive), width):
                batch = alive[first : first + width]
                who = tuple(id(r) for r in batch)
                if who not in works and width > 1:
                    works[who] = self.group.work(batch[0].fmu.component, len(batch))
                begin = time.process_time()
                self._step(batch, works.get(who), k * step_s, step_s)
                cpu_s += time.process_time() - begin
            if record:
                self._record(runs, y[k + 1])
            ended = [(k + 1) * step_s if not r.error else e for r, e in zip(runs, ended, strict=True)]
        for r in runs:
            r.fmu.free()
        names = tuple(v.name for v in self.outputs)
        return Runs(step_s * np.arange(steps + 1), y, names, [r.error for r in runs], ended, cpu_s)

    def _started(self, row: Mapping[str, float | int]) -> _Run:
        log = Log()
        file = self.file
        library = Library(file.model, file.interface, file.folder, self.group.path, log=log)
        run = _Run(library.fresh(), log=log)
        try:
            run.fmu.set_up()
            for name, value in row.items():
                if run.fmu.set(file.variables[name], value) > 1:
                    run.error = log[-1]
            run.fmu.do("EnterInitializationMode")
            run.fmu.do("ExitInitializationMode")
        except CallFailed:
            run.error = log[-1]
        return run

    def _step(self, runs: list[_Run], work: GroupWork | None, time_s: float, step_s: float) -> None:
        n = len(runs)
        if work is None:
            status: Any = [r.fmu.call("DoStep", time_s, step_s, 1) for r in runs]
        else:
            status = (c_int * n)()
            components = (c_void_p * n)(*(r.fmu.component for r in runs))
            points, lengths = (c_double * n)(*[time_s] * n), (c_double * n)(*[step_s] * n)
            _STEP(self.group.step)(work.address, n, components, points, lengths, 0, status)
        for r, code in zip(runs, status, strict=True):
            if code > 1:
                r.error = r.log[-1]

    def _record(self, runs: list[_Run], row: Array) -> None:
        for k, r in enumerate(runs):
            if not r.error:
                row[:, k] = r.fmu.get(self.outputs)
