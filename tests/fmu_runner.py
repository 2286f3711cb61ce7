"""FMUs driven call by call through fmpy, by variable names, for the tests of the FMI layer."""

from __future__ import annotations

import itertools
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy.fmi2 import (
    FMU2Model,
    FMU2Slave,
    fmi2CallbackAllocateMemoryTYPE,
    fmi2CallbackFreeMemoryTYPE,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
)

from interarea.models.blocks.variables import Block, Variable, VariableTable

DECAY_C = Path(__file__).resolve().parent / "conformance" / "blocks" / "decay.c"


def decay_block(**changes: Any) -> Block:
    """Return the block of conformance/blocks/decay.c: dx/dt = -rate x + u with one kick."""
    table = VariableTable(
        [
            Variable("x", "state", "State", start=1.0, nominal=2.0),
            Variable("der(x)", "derivative", "Slope", unit="1/s", derivative_of="x", depends_on=("x", "u")),
            Variable("u", "input", "Input", start=0.0),
            Variable("y", "output", "Output", depends_on=("x",)),
            Variable("w", "local", "A local"),
            Variable("rate", "parameter", "Decay rate", unit="1/s", start=1.0, max=1e6, tunable=True),
            Variable("ceiling", "parameter", "Largest x", start=1e30),
            Variable("kick.time", "parameter", "Time of the kick", unit="s", start=0.55),
            Variable("kick.size", "parameter", "Size of the kick", start=2.0),
            Variable("kicks", "output", "Kicks so far", type="Integer", depends_on=()),
            Variable("kicking", "parameter", "Whether there is a kick", type="Boolean", start=False),
        ]
    )
    fields: dict[str, Any] = {
        "kind": "decay",
        "name": "decay",
        "description": "First-order lag with a kick",
        "table": table,
        "data": {},
        "sources": (DECAY_C,),
        "step_s": 0.1,
        "stop_s": 2.0,
        "internal_step_s": 0.01,
    }
    return Block(**{**fields, **changes})


class Runner:
    """One instance of an FMU, `kind` "cs" or "me"; names instead of value references; the log kept."""

    def __init__(
        self, path: Path | str, kind: str = "cs", *, guid: str | None = None, folder: str | None = None
    ) -> None:
        self.log: list[str] = []
        self.own_folder = folder is None
        self.folder = tempfile.mkdtemp(prefix="fmu-test-") if folder is None else folder
        if folder is None:
            fmpy.extract(str(path), self.folder)
        self.description = fmpy.read_model_description(self.folder)
        interface = self.description.coSimulation if kind == "cs" else self.description.modelExchange
        self.variables = {v.name: v for v in self.description.modelVariables}
        self.fmu: Any = (FMU2Slave if kind == "cs" else FMU2Model)(
            guid=self.description.guid if guid is None else guid,
            modelIdentifier=interface.modelIdentifier,
            unzipDirectory=self.folder,
            instanceName="it",
        )
        callbacks = fmi2CallbackFunctions()
        callbacks.logger = fmi2CallbackLoggerTYPE(lambda e, n, s, c, m: self.log.append(m.decode()))
        callbacks.allocateMemory = fmi2CallbackAllocateMemoryTYPE(fmpy.calloc)
        callbacks.freeMemory = fmi2CallbackFreeMemoryTYPE(fmpy.free)
        self.callbacks = callbacks
        self.live = False
        try:
            self.fmu.instantiate(callbacks=callbacks)
        except Exception:  # one that refuses leaves no folder behind
            self.__exit__()
            raise
        self.live = True

    def __enter__(self) -> Runner:
        return self

    def __exit__(self, *_: object) -> None:
        if self.live:
            self.fmu.freeInstance()
            self.live = False
        if self.own_folder:
            shutil.rmtree(self.folder, ignore_errors=True)

    def reference(self, name: str) -> int:
        return int(self.variables[name].valueReference)

    def set(self, **values: float) -> None:
        self.set_of(values)

    def set_of(self, values: dict[str, float]) -> None:
        for name, value in values.items():
            kind = self.variables[name].type
            setter = {"Real": self.fmu.setReal, "Boolean": self.fmu.setBoolean}.get(kind, self.fmu.setInteger)
            setter([self.reference(name)], [value])

    def get(self, name: str) -> Any:
        kind = self.variables[name].type
        getter = {"Real": self.fmu.getReal, "Boolean": self.fmu.getBoolean}.get(kind, self.fmu.getInteger)
        return getter([self.reference(name)])[0]

    def start(self, values: dict[str, float] | None = None, **experiment: float) -> Runner:
        """Initialise with start values."""
        self.fmu.setupExperiment(**{"startTime": 0.0, **experiment})
        self.set_of(values or {})
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()
        return self

    def slopes(self, name: str, *derivatives: float) -> None:
        """Give derivatives 1.. of an input over the coming step."""
        n = len(derivatives)
        self.fmu.setRealInputDerivatives([self.reference(name)] * n, list(range(1, n + 1)), list(derivatives))

    def slope(self, name: str) -> float:
        """First derivative of an output."""
        return float(self.fmu.getRealOutputDerivatives([self.reference(name)], [1])[0])

    def step(self, t: float, h: float) -> None:
        self.fmu.doStep(t, h)

    def every_real(self) -> np.ndarray:
        names = [v.valueReference for v in self.description.modelVariables if v.type == "Real"]
        return np.array(self.fmu.getReal(names))

    def run(self, times: Sequence[float], output: str) -> np.ndarray:
        """Step along `times`, return the output at each of them."""
        values = [self.get(output)]
        for a, b in itertools.pairwise(times):
            self.step(a, b - a)
            values.append(self.get(output))
        return np.array(values)
