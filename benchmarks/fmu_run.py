"""A plant FMU stepped as a co-simulation slave, with as little around it as Python allows."""

from __future__ import annotations

import ctypes
import shutil
import tempfile
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import numpy.typing as npt
from fmpy.fmi2 import FMU2Slave

from interarea.fmu_build.write.cache import default_cache
from interarea.fmu_build.write.package import build_fmu
from interarea.models.blocks.plant import event_parameters, plant_block
from interarea.models.case.case import Case


class PlantSlave:
    """The plant FMU of `case` with its events; substeps of `substep_s` at most, None: the FMU's default.

    show : patterns of its outputs, as `plant_block` takes them.
    """

    def __init__(
        self,
        case: Case,
        events: Iterable[Any] = (),
        substep_s: float | None = None,
        parameters: Mapping[str, float] | None = None,
        show: Sequence[str] | None = None,
    ) -> None:
        block = plant_block(case, show=show)
        self.folder = Path(tempfile.mkdtemp(prefix="plant-slave-"))
        path = build_fmu(block, self.folder / "plant.fmu", cache=default_cache())
        description = fmpy.read_model_description(str(path))
        self.references = {v.name: v.valueReference for v in description.modelVariables}
        self._types = {v.name: v.type for v in description.modelVariables}
        self._parameters = event_parameters(case, events) | dict(parameters or {})
        self.slave = FMU2Slave(
            guid=description.guid,
            modelIdentifier=description.coSimulation.modelIdentifier,
            unzipDirectory=fmpy.extract(str(path), str(self.folder / "unzipped")),
            instanceName="plant",
        )
        self.slave.instantiate()
        self._step = self.slave.dll.fmi2DoStep
        self._step.argtypes = [ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_int]
        self._start(substep_s)

    def _start(self, substep_s: float | None) -> None:
        chosen = {} if substep_s is None else {"solver.step": substep_s}
        for name, value in (self._parameters | chosen).items():
            if self._types[name] == "Real":
                self.slave.setReal([self.references[name]], [float(value)])
            else:
                self.slave.setInteger([self.references[name]], [int(value)])
        self.slave.setupExperiment(startTime=0.0)
        self.slave.enterInitializationMode()
        self.slave.exitInitializationMode()
        self.time_s = 0.0

    def restart(self, substep_s: float | None = None) -> None:
        """Begin again at 0 s, with other substeps."""
        self.slave.terminate()
        self.slave.reset()
        self._start(substep_s)

    def outputs(self, names: Sequence[str]) -> npt.NDArray[np.float64]:
        """Return the values of some variables now."""
        return np.array(self.slave.getReal([self.references[name] for name in names]))

    def advance(self, until_s: float) -> None:
        """One communication step."""
        if self._step(self.slave.component, self.time_s, until_s - self.time_s, 1) != 0:
            raise RuntimeError(f"the plant FMU refuses the step from {self.time_s:g} to {until_s:g} s")
        self.time_s = until_s

    def record(self, times: Sequence[float], names: Sequence[str]) -> npt.NDArray[np.float64]:
        """Return variables at `times` (rising from 0), one column each."""
        rows = []
        for t in times:
            if t > self.time_s:
                self.advance(float(t))
            rows.append(self.outputs(names))
        return np.array(rows)

    def cpu_s(self, stop_s: float, communication_s: float, names: Sequence[str]) -> float:
        """Return the CPU seconds of a run to `stop_s` that reads variables after every communication step."""
        count = round(stop_s / communication_s)
        references = (ctypes.c_uint * len(names))(*(self.references[name] for name in names))
        values = (ctypes.c_double * len(names))()
        read, step, component = self.slave.dll.fmi2GetReal, self._step, self.slave.component
        begin = time.process_time()
        for k in range(count):
            if step(component, k * communication_s, communication_s, 1) != 0:
                raise RuntimeError(f"the plant FMU refuses the step at {k * communication_s:g} s")
            read(component, references, len(names), values)
        return time.process_time() - begin

    def close(self) -> None:
        """Free the instance and its files."""
        self.slave.terminate()
        self.slave.freeInstance()
        shutil.rmtree(self.folder, ignore_errors=True)
