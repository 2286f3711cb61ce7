"""What a step of the detector of wrong signals costs, over a step of the controller it serves.

python benchmarks/control/detector_cost.py --design FILE [CONTROLLER ...]

FILE: of `design_detector` (wrong_signals.py makes one). Both FMUs take steps of 10 ms for a minute, with a
swing of 1 mpu and 1 mHz of noise in frames every 20 ms. The time of each call of fmi2DoStep is the least of
REPEAT runs, so that other load of the machine cancels; both include the same call from Python.
"""

from __future__ import annotations

import argparse
import ctypes
import shutil
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave

from interarea.cosim.run.artefacts import detector_fmu
from interarea.cosim.run.controllers import controller_fmu
from interarea.cosim.screen.wrong_runs import signals_of
from interarea.design.controllers.detector_record import load_detector
from interarea.fmu_build.write.cache import default_cache
from interarea.models.detector_defaults import INTERVAL_S
from interarea.synthesis import judged_and_design

STEP_S, STEPS, REPEAT = 0.01, 6000, 20
SWING_PU, SWING_HZ, NOISE_PU = 1e-3, 0.5, 1e-3 / 60.0


def step_us(path: Path, inputs: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the time of each step of an FMU, us; inputs : by name, (steps,) each; others keep theirs."""
    description = fmpy.read_model_description(str(path))
    references = {v.name: v.valueReference for v in description.modelVariables}
    folder = tempfile.mkdtemp(prefix="detector-cost-")
    slave = FMU2Slave(
        guid=description.guid,
        modelIdentifier=description.coSimulation.modelIdentifier,
        unzipDirectory=fmpy.extract(str(path), folder),
        instanceName="timed",
    )
    slave.instantiate()
    call = slave.dll.fmi2DoStep
    call.argtypes = [ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_int]
    taken = [name for name in inputs if name in references]
    rows = np.array([inputs[name] for name in taken]).T.tolist()
    least = np.full(len(rows), np.inf)
    for _ in range(REPEAT):
        slave.setupExperiment(startTime=0.0)
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        for k, row in enumerate(rows):
            slave.setReal([references[name] for name in taken], row)
            begin = time.perf_counter_ns()
            status = call(slave.component, k * STEP_S, STEP_S, 1)
            least[k] = min(least[k], time.perf_counter_ns() - begin)
            if status != 0:
                raise RuntimeError(f"{path.name} refuses the step at {k * STEP_S:g} s")
        slave.reset()
    slave.freeInstance()
    shutil.rmtree(folder, ignore_errors=True)
    return least / 1e3


def frames(latency_s_of: Mapping[str, float]) -> dict[str, np.ndarray]:
    """Return values, pu, and ages, s, of signals at each step."""
    random = np.random.default_rng(1)
    t = STEP_S * np.arange(STEPS)
    result = {}
    for k, (signal, latency_s) in enumerate(latency_s_of.items()):
        number = np.floor((t - latency_s) / INTERVAL_S + 1e-9)
        stamp = INTERVAL_S * number
        noise = random.standard_normal(STEPS)[np.maximum(number, 0).astype(int)]
        result[signal] = SWING_PU * np.sin(2.0 * np.pi * SWING_HZ * stamp + k) + NOISE_PU * noise
        result[f"{signal}_age"] = np.maximum(t - stamp, 0.0)
    return result


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("controllers", nargs="*", default=["wide_area"])
    parser.add_argument("--design", type=Path, required=True, help="file of the detector's patterns")
    options = parser.parse_args()
    print("| controller | signals compared | detector (us) | controller (us) | ratio |")
    print("|---|---|---|---|---|")
    for name in options.controllers:
        controller, table = judged_and_design(name, None, None)
        designed = load_detector(options.design)
        latency_s_of = signals_of(table.grid, controller, designed.signals).all
        patterns = designed.patterns.of([designed.signals.index(s) for s in latency_s_of])
        inputs, cache = frames(latency_s_of), default_cache()
        detector_us = step_us(detector_fmu(tuple(latency_s_of), cache, patterns), inputs).mean()
        own_us = step_us(controller_fmu(controller, table.grid.omega_b, cache, trust=True), inputs).mean()
        cells = (f"`{name}`", len(latency_s_of), f"{detector_us:.2f}", f"{own_us:.2f}")
        print("|", " | ".join(map(str, cells)), f"| {detector_us / own_us:.2f} |", flush=True)
