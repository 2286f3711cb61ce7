"""A closed loop by hand: plant, channels and controller stepped in plain fmpy, nothing of interarea imported.

The FMUs are those that `interarea build two-area-thesis --controller robust --out fmus` writes; another
folder may be named as the argument. The channels are 100 ms late and the step is 10 ms, so at each step they
go first: what comes out of them depends on the past only. Then the controller, then the plant. Inputs are
simply held here, which adds half a step of delay at each of the two inputs; the master of interarea hands
over cubics instead.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave

STEP_S, STOP_S, LATENCY_S = 0.01, 5.0, 0.1
BUILD = "interarea build two-area-thesis --controller robust --out"

#: event 1 of the plant: kind 4 is a pulse on a voltage reference, target 1 is the first machine
PULSE = {"kind": 4, "target": 1, "start": 1.0, "end": 1.2, "size": 0.05}


class Instance:
    """An FMU with its variables by name."""

    def __init__(self, path: Path, name: str, start: dict[str, float] | None = None) -> None:
        model = fmpy.read_model_description(str(path))
        self.reference = {v.name: v.valueReference for v in model.modelVariables}
        self.type = {v.name: v.type for v in model.modelVariables}
        self.inputs, self.outputs = (
            [v.name for v in model.modelVariables if v.causality == causality and v.type == "Real"]
            for causality in ("input", "output")
        )
        self.folder = fmpy.extract(str(path))
        self.fmu = FMU2Slave(
            instanceName=name,
            guid=model.guid,
            modelIdentifier=model.coSimulation.modelIdentifier,
            unzipDirectory=self.folder,
        )
        self.fmu.instantiate()
        self.fmu.setupExperiment(startTime=0.0, stopTime=STOP_S)
        for variable, value in (start or {}).items():
            self[variable] = value
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def __setitem__(self, name: str, value: float) -> None:
        if self.type[name] == "Real":
            self.fmu.setReal([self.reference[name]], [value])
        else:
            self.fmu.setInteger([self.reference[name]], [int(value)])

    def __getitem__(self, name: str) -> float:
        return float(self.fmu.getReal([self.reference[name]])[0])

    def close(self) -> None:
        self.fmu.terminate()
        self.fmu.freeInstance()
        shutil.rmtree(self.folder, ignore_errors=True)


def run(plant_fmu: Path, channel_fmu: Path, controller_fmu: Path) -> np.ndarray:
    """Return rows (time in s, speed of G2 less speed of G4 in pu)."""
    plant = Instance(plant_fmu, "plant", {f"event[1].{key}": value for key, value in PULSE.items()})
    controller = Instance(controller_fmu, "controller")
    channels = {s: Instance(channel_fmu, s, {"latency": LATENCY_S}) for s in controller.inputs}
    actuators = [name for name in controller.outputs if name in plant.inputs]
    rows = []
    for k in range(round(STOP_S / STEP_S)):
        t = k * STEP_S
        rows.append((t, plant["G2_dw"] - plant["G4_dw"]))
        for signal, channel in channels.items():
            channel["u"] = plant[signal]
            channel.fmu.doStep(t, STEP_S)
            controller[signal] = channel["y"]
        controller.fmu.doStep(t, STEP_S)
        for actuator in actuators:
            plant[actuator] = controller[actuator]
        plant.fmu.doStep(t, STEP_S)
    for instance in (plant, controller, *channels.values()):
        instance.close()
    return np.array(rows)


if __name__ == "__main__":
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "fmus")
    files = [folder / f"{name}.fmu" for name in ("two-area-thesis", "channel", "robust")]
    missing = [str(file) for file in files if not file.is_file()]
    if missing:
        sys.exit(f"{', '.join(missing)} not there; first run: {BUILD} {folder}")
    for time_s, dw24 in run(*files)[::50]:
        print(f"{time_s:5.2f} s  {dw24:+.3e} pu")
