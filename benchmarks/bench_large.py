"""Large grids: from RAW and DYR to a running FMU, and what 10 s with one fault cost beside GridKit's figures.

    python benchmarks/bench_large.py FOLDER [--grid NAME ..] [--json FILE]
    python benchmarks/bench_large.py FOLDER --power SHARE .. [--grid NAME ..]
    python benchmarks/bench_large.py --ruled FILE.m .. [--stop SECONDS] [--step SECONDS] [--fine SECONDS]

FOLDER holds the published files under the names in `GRIDS`. The fault is that of GridKit's comparison: at
its bus from 1 s to 1.15 s through j0.01 pu, nothing opened. CPU time of the process that computes, the least
of `REPEAT` runs; errors are the largest difference of any speed from steps of `REFERENCE_S`, over the peak
speed, and that of the voltages of about `BUSES` buses over the whole grid, over the largest. Every grid runs
in a process of its own, whose largest memory is shown. GridKit's seconds are those that its authors
published, of their machine: the ratio says what order they are of, no more. Side by side go as many runs as
the processor has lanes, at the longest step whose errors are below `ERROR`.
Source: repository ORNL/GridKit, examples/PhasorDynamics/HICSS-60/benchmark.

`--power` tells what loads cost that are constant power by that share: CPU time of half the run above over
that with impedances, both in turns, the least of `REPEAT` runs.

`--ruled` takes grids of MATPOWER with devices by the rule of `ruled_grid`: what they take to be built, how
far they drift in a second without a disturbance, what a simulated second costs after a fault of 100 ms
through j0.01 pu at the largest load and how far speeds are then from those at the fine step, over the peak.
Costs of a step are given per bus, so that grids of several sizes show by how much they grow beyond linearly.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import multiprocessing
import resource
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

sys.path.extend(str(Path(__file__).resolve().parent / name) for name in (".", "grids", "../tests"))
from fmu_run import PlantSlave
from plant_lanes import PlantLanes
from plant_shim import BlockShim
from ruled_grid import ruled_grid

from interarea.fmu_build.write.cache import default_cache
from interarea.models.blocks.plant import event_parameters, plant_block
from interarea.models.case.case import Case
from interarea.models.case.events import events_of
from interarea.models.importers.file import import_grid
from interarea.models.importers.imported import ImportOptions

WECC_240 = ("WECC240/240busWECC_2018_PSS32_fixed_shunts.raw", "WECC240/240busWECC_2018_PSS.dyr", 4005, 0.115)
MODELLED = "WECC 240, converters modelled"
#: RAW and DYR under FOLDER, the fault's bus, GridKit's CPU seconds
GRIDS = {
    "New England": ("IEEE39/IEEE39.raw", "IEEE39/IEEE39.dyr", 16, 0.011),
    "ACTIVSg200": ("ACTIVSg200/ACTIVSg200.RAW", "ACTIVSg200/ACTIVSg200_dynamics.dyr", 149, 0.029),
    "WECC 240": WECC_240,
    MODELLED: WECC_240,
    "ACTIVSg2000": (
        "ACTIVSg2000/ACTIVSg2000.RAW.xz",
        "ACTIVSg2000/ACTIVSg2000_dynamics.dyr",
        7346,
        0.993,
    ),
}
STOP_S = 10.0
COMMUNICATION_S = 1.0 / 8.0  #: between the points that are compared
TIMED_S = 0.25  #: communication step of runs that are timed: GridKit's time is without output
REFERENCE_S = 0.0005
STEPS_S = (0.001, 1.0 / 240.0, 1.0 / 184.0, 1.0 / 168.0, 1.0 / 144.0)
REPEAT = 9
ERROR = 1e-5  #: most of speeds and voltages at the step with which runs go side by side
BUSES = 50  #: whose voltages are looked at
ROUNDS = 200  #: of right-hand sides that are timed


def right_hand_side(case: Case, form: Any, fault: dict[str, float | int]) -> tuple[float, float]:
    """CPU seconds of a right-hand side and of the fault's event, with one form of the network."""
    plant = BlockShim(plant_block(case, network=form), fault)
    random = np.random.default_rng(1)
    pointer = ctypes.POINTER(ctypes.c_double)
    dx = np.zeros_like(plant.x)
    call, block, t0 = plant._c.block_derivatives, ctypes.byref(plant._block), ctypes.c_double(0.0)
    points = [plant.x + 1e-6 * k * random.standard_normal(len(dx)) for k in range(ROUNDS)]
    args = [
        (block, t0, *(a.ctypes.data_as(pointer) for a in (x, plant.u, dx)), plant.message) for x in points
    ]
    begin = time.process_time()
    for a in args:
        call(*a)
    each = (time.process_time() - begin) / ROUNDS
    begin = time.process_time()
    plant.event(1.0, plant.x)
    plant.derivatives(plant.x)
    return each, time.process_time() - begin


def fault_at(bus: int, start_s: float = 1.0) -> list[Any]:
    """Return the events of GridKit's fault."""
    fault = {"kind": "bus_fault", "bus": bus, "start_s": start_s, "end_s": start_s + 0.15, "x_pu": 0.01}
    return list(events_of([fault], where="bench_large"))


def as_impedances(case: Case) -> Case:
    """Loads and units without dynamic data as impedances: as constant power ACTIVSg2000's west slips."""
    change = {"P_zip": None, "Q_zip": None, "P_exponent": 2.0, "Q_exponent": 2.0}
    return case.model_copy(update={"loads": tuple(q.model_copy(update=change) for q in case.loads)})


def imported(name: str, folder: Path) -> Case:
    """Return a grid with all loads as impedances; converters as constant currents, or as in their records."""
    raw, dyr, _, _ = GRIDS[name]
    options = ImportOptions(converters="model" if name == MODELLED else "current", release_limits=True)
    return as_impedances(import_grid(folder / raw, dyr=folder / dyr, options=options).case)


def of_power(case: Case, share: float) -> Case:
    """Every load by that share constant power, the rest impedance."""
    mix = (1.0 - share, 0.0, share)
    change = {"P_zip": mix, "Q_zip": mix, "P_exponent": None, "Q_exponent": None}
    return case.model_copy(update={"loads": tuple(q.model_copy(update=change) for q in case.loads)})


def power_price(name: str, folder: Path, share: float, step_s: float = 1.0 / 240.0) -> float:
    """Return the cost of a run with loads of constant power over that of one with impedances."""
    bus = GRIDS[name][2]
    case = imported(name, folder)
    events = fault_at(bus)
    speeds = [f"{m.name}_dw" for m in case.machines]
    slaves = [PlantSlave(c, events, step_s) for c in (case, of_power(case, share))]
    cpu = []
    for _ in range(REPEAT):
        for slave in slaves:
            slave.restart(step_s)
        cpu.append([slave.cpu_s(STOP_S / 2.0, COMMUNICATION_S, speeds) for slave in slaves])
    for slave in slaves:
        slave.close()
    least = np.min(cpu, axis=0)
    return float(least[1] / least[0])


def side_by_side(case: Case, bus: int, step_s: float) -> float:
    """Return the CPU seconds of one of as many runs as go side by side; their faults are 4 ms apart."""
    plants = PlantLanes(case, default_cache())
    faults = [fault_at(bus, 1.0 + 0.004 * k) for k in range(plants.group.lanes)]
    rows = [event_parameters(case, events) | {"solver.step": step_s} for events in faults]
    runs = [plants.run(rows, stop_s=STOP_S, step_s=TIMED_S, record=False) for _ in range(REPEAT)]
    return min(run.cpu_s for run in runs) / len(rows)


def measured(name: str, folder: Path) -> dict[str, Any]:
    """Everything about one grid."""
    bus, published = GRIDS[name][2:]
    begin = time.process_time()
    case = imported(name, folder)
    row: dict[str, Any] = {"grid": name, "buses": len(case.buses), "machines": len(case.machines)}
    row["import_s"] = time.process_time() - begin
    events = fault_at(bus)
    begin = time.process_time()
    slave = PlantSlave(case, events)
    row["fmu_s"] = time.process_time() - begin
    speeds = [f"{m.name}_dw" for m in case.machines]
    voltages = [f"bus{b.number}.v" for b in case.buses[:: -(-len(case.buses) // BUSES)]]
    looked_at = PlantSlave(case, events, REFERENCE_S, show=[*speeds, *voltages])
    times = np.arange(0.0, STOP_S + COMMUNICATION_S / 2, COMMUNICATION_S)
    reference = looked_at.record(times, [*speeds, *voltages])
    row["peak_speed_pu"] = float(np.abs(reference[:, : len(speeds)]).max())
    row["runs"] = []
    for step_s in STEPS_S:
        cpu = []
        for _ in range(REPEAT):
            slave.restart(step_s)
            cpu.append(slave.cpu_s(STOP_S, TIMED_S, speeds))
        looked_at.restart(step_s)
        off = np.abs(looked_at.record(times, [*speeds, *voltages]) - reference)
        of_speed, of_voltage = (
            float(off[:, part].max() / np.abs(reference[:, part]).max())
            for part in (np.s_[: len(speeds)], np.s_[len(speeds) :])
        )
        run = {
            "step_s": step_s,
            "cpu_s": min(cpu),
            "error": of_speed,
            "voltage_error": of_voltage,
            "gridkit_ratio": min(cpu) / published,
        }
        row["runs"].append(run)
    slave.close()
    looked_at.close()
    exact = [run for run in row["runs"] if max(run["error"], run["voltage_error"]) <= ERROR]
    chosen = max(exact, key=lambda run: run["step_s"])
    each_s = side_by_side(case, bus, chosen["step_s"])
    row["lanes"] = {"step_s": chosen["step_s"], "cpu_s": each_s, "gridkit_ratio": each_s / published}
    fault = event_parameters(case, events)
    for form in ("dense", "sparse") if len(case.buses) < 1000 else ("sparse",):
        each, event = right_hand_side(case, form, fault)
        row[form] = {"right_hand_side_us": 1e6 * each, "event_in_steps": event / (4.0 * each)}
    row["memory_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return row


def ruled_run(slave: PlantSlave, speeds: list[str], stop_s: float) -> tuple[Any, float]:
    """Return the speeds from 1 s on, (points, machines), and the CPU seconds of that part."""
    times = np.arange(1.0, stop_s + COMMUNICATION_S / 2, COMMUNICATION_S)
    slave.advance(1.0)
    begin = time.process_time()
    speeds_of_run = slave.record(times, speeds)
    return speeds_of_run, time.process_time() - begin


def measured_ruled(path: Path, stop_s: float, step_s: float, fine_s: float) -> dict[str, Any]:
    """Everything about one grid with devices by the rule."""
    begin = time.process_time()
    case = ruled_grid(path)
    row: dict[str, Any] = {"grid": path.stem, "buses": len(case.buses), "machines": len(case.machines)}
    row["import_s"] = time.process_time() - begin
    bus = max(case.loads, key=lambda load: load.P_mw).bus
    events = events_of(
        [{"kind": "bus_fault", "bus": bus, "start_s": 1.0, "end_s": 1.1, "x_pu": 0.01}], where=path.stem
    )
    begin = time.process_time()
    slave = PlantSlave(case, events, step_s, show=["*_dw"])
    row["fmu_s"] = time.process_time() - begin
    speeds = [f"{m.name}_dw" for m in case.machines]
    coarse, row["cpu_s"] = ruled_run(slave, speeds, stop_s)
    row["drift_pu"] = float(np.abs(coarse[0]).max())  # at 1 s, before the fault has moved anything
    row["cpu_per_s"] = row["cpu_s"] / (stop_s - 1.0)
    row["step_ns_per_bus"] = 1e9 * row["cpu_per_s"] * step_s / row["buses"]
    row["peak_speed_pu"] = float(np.abs(coarse).max())
    if fine_s:
        slave.restart(fine_s)
        fine, _ = ruled_run(slave, speeds, stop_s)
        row["error"] = float(np.abs(coarse - fine).max() / np.abs(fine).max())
    slave.close()
    row["memory_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return row


def apart(measure: Callable[..., dict[str, Any]], *options: Any) -> dict[str, Any]:
    """Call `measure` in a process of its own, which ends by itself: what it left on the disk goes with it."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(measure, *options).result()


def main() -> None:
    """Print a line for each run of each grid."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--power", type=float, nargs="+", metavar="SHARE", help="0 to 1, of every load")
    parser.add_argument("--ruled", type=Path, nargs="+", metavar="FILE.m")
    parser.add_argument("--stop", type=float, default=STOP_S, help="of a grid with devices by the rule")
    parser.add_argument("--step", type=float, default=0.005)
    parser.add_argument("--fine", type=float, default=0.001, help="0: no run at a fine step")
    parser.add_argument("--grid", nargs="*", choices=list(GRIDS), default=list(GRIDS))
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rows = []
    if (options.folder is None) == (options.ruled is None):
        parser.error("give FOLDER, or --ruled with files of MATPOWER")
    for path in options.ruled or ():
        rows.append(apart(measured_ruled, path, options.stop, options.step, options.fine))
        print(rows[-1], flush=True)
    for name in options.grid if options.power else ():
        for share in options.power:
            ratio = power_price(name, options.folder, share)
            print(f"{name}: {100 * share:g} % constant power / impedances: {ratio:.2f}", flush=True)
    for name in () if options.folder is None or options.power else options.grid:
        row = apart(measured, name, options.folder)
        rows.append(row)
        print(
            f"{name}: {row['buses']} buses, {row['machines']} machines; import {row['import_s']:.1f} s, FMU "
            f"{row['fmu_s']:.1f} s, {row['memory_mb']:.0f} MB; "
            + str({k: row.get(k) for k in ("dense", "sparse")})
        )
        for run in row["runs"]:
            print(
                f"  {1e3 * run['step_s']:.3g} ms: {run['cpu_s']:.3f} CPU s, {run['gridkit_ratio']:.2f} of "
                f"GridKit's published, error of speeds {run['error']:.1e}, of voltages "
                f"{run['voltage_error']:.1e} of peak",
                flush=True,
            )
        lanes = row["lanes"]
        print(
            f"  side by side, {1e3 * lanes['step_s']:.3g} ms: {lanes['cpu_s']:.4f} CPU s each, "
            f"{lanes['gridkit_ratio']:.3f} of GridKit's published",
            flush=True,
        )
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
