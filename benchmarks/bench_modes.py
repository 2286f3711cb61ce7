"""All modes of grids of any size: found, counted and dense, with seconds; and a reduction to design order.

    python benchmarks/bench_modes.py [FOLDER] [--grid NAME ..] [--below RATIO ..] [--late S ..]

Bundled cases below damping ratios of 0.15 and 0.3, or with FOLDER its published files under the names in
`GRIDS` (inverters as constant currents, loads as impedances; a MATPOWER file with devices by the rule of
`ruled_grid`) below those of `--below`, default 0.15, from 0.1 to 2 Hz. Dense: numpy's QR on the whole state
matrix, of grids up to `--dense` states. With `--late` also with three speed differences
fed back to exciters, where there are some, so many seconds late: against QR on plant and Chebyshev lines for
the delays. Exit code 1 where found, counted and dense differ, a residual is above 1e-9 or a late mode is off
by 1e-7.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import control
import numpy as np
from threadpoolctl import threadpool_limits

sys.path.insert(0, str(Path(__file__).resolve().parent / "grids"))
from ruled_grid import ruled_grid

from interarea.cosim.run.artefacts import sparse_linear_plant
from interarea.design.delay.characteristic_roots import discretised
from interarea.design.delay.curves import delayed_loop
from interarea.design.delay.late_plant import LatePlant
from interarea.design.linear.sparse_plant import SparsePlant
from interarea.design.modes.all_modes import RESIDUAL, all_modes
from interarea.design.modes.mode_count import Region
from interarea.design.reduction.low_rank import input_columns, low_rank_reduction, output_rows
from interarea.fmu_build.write.cache import default_cache
from interarea.models.case.case import Case, case_names, load_case
from interarea.models.importers.file import import_grid
from interarea.models.importers.imported import ImportOptions

BAND_HZ = (0.1, 2.0)
_NODES = 28  # of each line that stands for a delay
_OFF = 1e-7  # relative, of a late mode
#: RAW and DYR under FOLDER, or a MATPOWER file
GRIDS: dict[str, tuple[str, ...]] = {
    "IEEE14": ("IEEE14/IEEE14_PTIv33.raw", "IEEE14/IEEE14.dyr"),
    "IEEE39": ("IEEE39/IEEE39.raw", "IEEE39/IEEE39.dyr"),
    "IEEE145": ("IEEE145/IEEE145.raw", "IEEE145/IEEE145_classicGen.dyr"),
    "Nordic44": ("Nordic44/N44_BC.raw", "Nordic44/N44_BC.dyr"),
    "case118": ("matpower/case118.m",),
    "case300": ("matpower/case300.m",),
    "ACTIVSg200": ("ACTIVSg200/ACTIVSg200.RAW", "ACTIVSg200/ACTIVSg200_dynamics.dyr"),
    "ACTIVSg500": ("ACTIVSg500/ACTIVSg500.RAW", "ACTIVSg500/ACTIVSg500_dynamics.dyr"),
    "WECC240": (
        "WECC240/240busWECC_2018_PSS32_fixed_shunts.raw",
        "WECC240/240busWECC_2018_PSS.dyr",
    ),
    "ACTIVSg2000": ("ACTIVSg2000/ACTIVSg2000.RAW.xz", "ACTIVSg2000/ACTIVSg2000_dynamics.dyr"),
    "ACTIVSg2000-ruled": ("matpower/case_ACTIVSg2000.m",),  # of the Python package `matpower`
    "ACTIVSg10k": ("matpower/case_ACTIVSg10k.m.xz",),
}


def imported(folder: Path, name: str) -> Case:
    """Return a published grid with its loads as impedances."""
    raw, *dyr = GRIDS[name]
    if not dyr:
        return ruled_grid(folder / raw)
    case = import_grid(
        folder / raw, dyr=folder / dyr[0], options=ImportOptions(converters="current", release_limits=True)
    ).case
    change = {"P_zip": None, "Q_zip": None, "P_exponent": 2.0, "Q_exponent": 2.0}
    return case.model_copy(update={"loads": tuple(q.model_copy(update=change) for q in case.loads)})


def measured(case: Case, below: float, dense_up_to: int) -> dict[str, Any]:
    """Everything about one grid."""
    begin = time.process_time()
    plant = sparse_linear_plant(case, default_cache())
    row: dict[str, Any] = {"grid": case.name, "below": below, "states": plant.nstates}
    row["blocks_s"] = time.process_time() - begin
    begin, wall = time.process_time(), time.perf_counter()
    modes = all_modes(plant, case.areas, band_hz=BAND_HZ, below=below)
    row |= {"cpu_s": time.process_time() - begin, "wall_s": time.perf_counter() - wall}
    row |= {"found": len(modes.modes), "counted": modes.counted, "residual": modes.residual}
    row |= {"cells_and_refined": modes.searched, "factorisations": modes.factorisations, "dense": None}
    if plant.nstates <= dense_up_to:
        begin = time.process_time()
        values = np.linalg.eigvals(plant.state_matrix())
        row["dense_s"] = time.process_time() - begin
        region = Region((2 * np.pi * modes.band_hz[0], 2 * np.pi * modes.band_hz[1]), modes.below)
        row["dense"] = int(np.sum(region.holds(values)))
    return row


def late(case: Case, latency_s: float, below: float, gain: float) -> dict[str, Any]:
    """Modes with three loops through a washout, and how far they are from those of a discretisation."""
    plant = sparse_linear_plant(case, default_cache())
    names = [u.removesuffix("_vs") for u in plant.inputs]
    one = list(dict.fromkeys(names[len(names) * k // 4] for k in range(3)))
    other = [names[(names.index(name) + max(len(names) // 8, 1)) % len(names)] for name in one]
    signals = list(dict.fromkeys(f"{name}_dw" for name in (*one, *other)))
    both, eye = np.zeros((len(one), len(signals))), np.eye(len(one))
    for k, pair in enumerate(zip(one, other, strict=True)):
        both[k, [signals.index(f"{name}_dw") for name in pair]] = 1.0, -1.0
    K = control.ss(
        *(-0.2 * eye, both, -0.2 * gain * eye, gain * both),
        inputs=signals,
        outputs=[f"{name}_vs" for name in one],
    )
    delays = dict.fromkeys(signals, latency_s)
    begin = time.process_time()
    loop = LatePlant(plant, K, delays, omega_b=case.omega_b, high_hz=BAND_HZ[1])
    modes = all_modes(plant, case.areas, band_hz=BAND_HZ, below=below, loop=loop)
    row = {"grid": case.name, "late_s": latency_s, "below": below, "cpu_s": time.process_time() - begin}
    B, C = input_columns(plant, K.output_labels), output_rows(plant, {name: {name: 1.0} for name in signals})
    parts = plant.state_matrix(), B, case.omega_b * C, np.zeros((len(C), B.shape[1]))
    lines = delayed_loop(control.ss(*parts, inputs=K.output_labels, outputs=signals), K, delays)
    values = np.linalg.eigvals(discretised(lines.balanced(), _NODES))
    region = Region((2 * np.pi * modes.band_hz[0], 2 * np.pi * modes.band_hz[1]), modes.below)
    off = [np.min(np.abs(mode.eigenvalue - values)) / abs(mode.eigenvalue) for mode in modes.modes]
    row |= {"found": len(modes.modes), "counted": modes.counted, "dense": int(np.sum(region.holds(values)))}
    return row | {"off": float(max(off, default=0.0)), "residual": modes.residual}


def reduction(plant: SparsePlant, case: Case, order: int) -> dict[str, Any]:
    """Exciters of the four largest machines to their speed differences, as design takes them."""
    rating = {m.name: m.base_mva for m in case.machines if f"{m.name}_vs" in plant.inputs}
    picked = sorted(rating, key=lambda name: -rating[name])[:4]
    pairs = zip(picked, [*picked[1:], picked[0]], strict=True)
    outputs = {f"{a}-{b}": {f"{a}_dw": 1.0, f"{b}_dw": -1.0} for a, b in pairs}
    begin = time.process_time()
    model = low_rank_reduction(plant, order, inputs=[f"{m}_vs" for m in picked], outputs=outputs)
    row = {"grid": case.name, "order": order, "error": model.error, "cpu_s": time.process_time() - begin}
    peak = max(np.linalg.norm(model.system(2j * np.pi * f), 2) for f in np.geomspace(0.1, 2.5, 400))
    rest = order - len(model.kept)
    return row | {"any_model_at_least": float(model.hankel_values[rest] / peak)}


def main() -> None:
    """Print a line for each grid."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--grid", nargs="*", choices=list(GRIDS), help="default: those in FOLDER")
    parser.add_argument("--below", type=float, nargs="*", default=[0.15], metavar="RATIO")
    parser.add_argument("--dense", type=int, default=2000, metavar="STATES")
    parser.add_argument("--reduce", type=int, default=60, metavar="ORDER")
    parser.add_argument("--late", type=float, nargs="*", default=[], metavar="S")
    parser.add_argument("--gain", type=float, default=0.05, help="of the late loops, pu per rad/s")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    threadpool_limits(1)  # as the command line has it
    jobs: list[tuple[Any, float]] = [(load_case(name), z) for name in case_names() for z in (0.15, 0.3)]
    if options.folder:
        there = [name for name, (file, *_) in GRIDS.items() if (options.folder / file).exists()]
        jobs = [(name, z) for name in options.grid or there for z in options.below]
    rows, wrong = [], 0
    for grid, below in jobs:
        case = imported(options.folder, grid) if isinstance(grid, str) else grid
        row = measured(case, below, options.dense)
        rows.append(row)
        dense = "-" if row["dense"] is None else f"{row['dense']} in {row['dense_s']:.2f} s"
        good = row["found"] == row["counted"] == (row["counted"] if row["dense"] is None else row["dense"])
        wrong += not (good and row["residual"] <= RESIDUAL)
        print(
            f"{row['grid']}: {row['states']} states below {below:g}: {row['found']} found, "
            f"{row['counted']} counted, dense {dense}; {row['cpu_s']:.2f} CPU s, "
            f"blocks {row['blocks_s']:.2f}, residual {row['residual']:.0e}, "
            f"{row['factorisations']} points of the count",
            flush=True,
        )
        plant = sparse_linear_plant(case, default_cache())
        for latency in options.late if row["states"] <= options.dense and plant.inputs else ():
            row = late(case, latency, below, options.gain)
            rows.append(row)
            wrong += not (row["found"] == row["counted"] == row["dense"])
            wrong += not (row["residual"] <= RESIDUAL and row["off"] <= _OFF)
            print(
                f"  {latency:g} s late: {row['found']} found, {row['counted']} counted, "
                f"{row['dense']} discretised, off by {row['off']:.0e}; {row['cpu_s']:.2f} CPU s",
                flush=True,
            )
        if plant.nstates > 500:
            model = reduction(plant, case, options.reduce)
            rows.append(model)
            print(
                f"  to {model['order']} states: error {model['error']:.1e} of peak, "
                f"{model['cpu_s']:.1f} CPU s; "
                f"over all frequencies no model of so many is within {model['any_model_at_least']:.1e}"
            )
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
