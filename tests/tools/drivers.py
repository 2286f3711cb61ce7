"""One function per foreign tool: run an FMU or SSP there, write what came out as an NPZ.

Started as a process of its own (`python drivers.py TOOL FILE STEP STOP OUT NAME...`): libcosim ends the
process at what it does not understand, and two of the tools bring native libraries.
"""

from __future__ import annotations

import ctypes
import sys
from pathlib import Path

import numpy as np


def fmpy_ssp(file: str, step: float, stop: float, names: list[str]) -> dict[str, list[float]]:
    """FMPy labels a row with the start of the step it ends: moved to the end here."""
    from fmpy.ssp.simulation import simulate_ssp

    rows = simulate_ssp(file, stop_time=stop - step / 2, step_size=step)
    return {"time": list(rows["time"] + step), **{n: list(rows[n]) for n in names}}


def libcosim_ssp(file: str, step: float, stop: float, names: list[str]) -> dict[str, list[float]]:
    from libcosimpy.CosimExecution import CosimExecution

    return _libcosim(CosimExecution.from_ssp_file(file), step, stop, names)


def libcosim_fmu(file: str, step: float, stop: float, names: list[str]) -> dict[str, list[float]]:
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimSlave import CosimLocalSlave

    execution = CosimExecution.from_step_size(round(step * 1e9))
    execution.add_local_slave(CosimLocalSlave(fmu_path=file, instance_name="it"))
    return _libcosim(execution, step, stop, names)


def _libcosim(execution, step: float, stop: float, names: list[str]) -> dict[str, list[float]]:
    from libcosimpy.CosimObserver import CosimObserver

    observer = CosimObserver.create_last_value()
    execution.add_observer(observer)
    places = []
    for name in names:
        instance, variable = name.split(".", 1) if "." in name else ("it", name)
        index = execution.slave_index_from_instance_name(instance)
        outcome = {v.name.decode(): v.reference for v in execution.slave_variables(index)}
        places.append((index, outcome[variable]))
    result: dict[str, list[float]] = {"time": [], **{n: [] for n in names}}
    for _ in range(round(stop / step)):
        execution.step(1)
        result["time"].append(execution.status().current_time / 1e9)
        for name, (index, reference) in zip(names, places, strict=True):
            result[name].append(observer.last_real_values(index, [reference])[0])
    return result


def ecos_ssp(file: str, step: float, stop: float, names: list[str]) -> dict[str, list[float]]:
    EcosSimulation = _ecos().EcosSimulation
    with EcosSimulation(ssp_path=file, step_size=step) as simulation:
        return _ecos_run(simulation, step, stop, names, parameter_set="start")


def ecos_fmu(file: str, step: float, stop: float, names: list[str]) -> dict[str, list[float]]:
    ecospy = _ecos()
    structure = ecospy.EcosSimulationStructure()
    structure.add_model("it", file)
    with ecospy.EcosSimulation(structure=structure, step_size=step) as simulation:
        return _ecos_run(simulation, step, stop, names)


def _ecos():
    """Ecos's module; its wheel expects the library of the `tbb` wheel to be on the loader's path."""
    for folder in (Path(sys.prefix) / "lib", Path(sys.base_prefix) / "lib"):
        for library in sorted(folder.glob("libtbb.so.12*")):
            ctypes.CDLL(str(library), ctypes.RTLD_GLOBAL)
    import ecospy

    return ecospy


def _ecos_run(
    simulation, step: float, stop: float, names: list[str], parameter_set: str | None = None
) -> dict[str, list[float]]:
    simulation.init(parameter_set=parameter_set)
    result: dict[str, list[float]] = {"time": [], **{n: [] for n in names}}
    for _ in range(round(stop / step)):
        simulation.step(1)
        result["time"].append(simulation.get_time())
        for name in names:
            path = name.replace(".", "::", 1) if "." in name else f"it::{name}"
            result[name].append(simulation.get_real(path))
    return result


def cofmupy_fmu(file: str, step: float, stop: float, names: list[str]) -> dict[str, list[float]]:
    """cofmupy sets inputs that nothing feeds to zero unless its own configuration has their start values."""
    import fmpy
    from cofmupy.coordinator import Coordinator

    model = fmpy.read_model_description(file)
    inputs = {v.name: float(v.start) for v in model.modelVariables if v.causality == "input"}
    config = {
        "fmus": [{"id": "it", "path": file, "initialization": inputs}],
        "connections": [],
        "cosim_method": "jacobi",
        "iterative": False,
    }
    coordinator = Coordinator()
    coordinator.start(config)
    coordinator.run_simulation(step, stop)
    table = coordinator.get_results()
    time = np.asarray(table["time"])
    return {"time": list(time), **{n: list(table[("it", n)]) for n in names}}


def main() -> None:
    tool, file, step, stop, out, *names = sys.argv[1:]
    result = globals()[tool](file, float(step), float(stop), names)
    np.savez(out, **{k: np.asarray(v, dtype=float) for k, v in result.items()})


if __name__ == "__main__":
    main()
