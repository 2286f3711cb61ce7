"""Every published grid of a folder: which RAW files are read, which RAW + DYR pairs import and stand still.

    python benchmarks/read_grids.py FOLDER [--still] [--stop 20] [--converters current] [--release-limits]
        [--json FILE]

FOLDER is searched for .raw and .m files, plain or packed. Each RAW is read, its stored voltages compared with
the network (largest mismatch) and polished by Newton's method; the power flow of the case must then find the
same voltages. In each folder the first RAW goes with the first DYR; with --still the plant FMU of that pair
runs without any event and the largest |dw| is shown (expected: below 1e-6 pu). With --release-limits limits
beyond which controls would start are widened, and counted. Time and memory are of this
process; a fresh one for each file would not change the times. Exit code 1 when a RAW is not read, or a pair
that imports does not stand still.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import resource
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from interarea.models.errors import CaseError
from interarea.models.grid.powerflow import solve_powerflow
from interarea.models.grid.start import release_limits
from interarea.models.importers.imported import Imported
from interarea.models.importers.matpower import import_matpower
from interarea.models.importers.psse import import_psse
from interarea.models.importers.raw.text import read_lines

STILL_PU = 1e-6
SAME_PU = 1e-9


def grids(folder: Path, kind: str) -> list[Path]:
    """Return the files of `kind` (.raw, .dyr, .m) in `folder` and below, packed ones too."""
    ends = (kind, f"{kind}.xz", f"{kind}.gz")
    return sorted(p for p in folder.rglob("*") if p.is_file() and p.name.lower().endswith(ends))


def read(path: Path) -> dict[str, Any]:
    """Return what reading one power flow gives: time, mismatch, how far the voltages move."""
    start = time.perf_counter()
    row: dict[str, Any] = {"file": str(path)}
    try:
        imported = import_matpower(path) if ".m" in path.suffixes else import_psse(path)
        row["s"] = time.perf_counter() - start
        row |= {"buses": len(imported.case.buses), "stored_mva": imported.solution.stored_mva}
        row |= {"moved_pu": imported.solution.moved_pu, "moved_deg": imported.solution.moved_deg}
        row["differs_pu"] = difference(imported)
    except CaseError as error:
        row["refused"] = str(error)
    return row


def difference(imported: Imported) -> float:
    """Return how far the power flow of the case is from the polished voltages, pu."""
    flow, known = solve_powerflow(imported.case), imported.solution.voltages
    ours = zip(imported.case.buses, flow.voltages, strict=True)
    return float(max(abs(v - known[bus.number]) for bus, v in ours if bus.number in known))


def pair(
    raw: Path, dyr: Path, stop_s: float | None, *, currents: bool, release: bool = False
) -> dict[str, Any]:
    """Return what importing a pair gives; with `stop_s` its plant runs that long without an event."""
    start = time.perf_counter()
    row: dict[str, Any] = {"folder": raw.parent.name, "raw": str(raw), "dyr": str(dyr)}
    try:
        imported = import_psse(raw, dyr, converters_as_current=currents)
        row |= {"s": time.perf_counter() - start, "machines": len(imported.case.machines)}
        if release:
            case, changed = release_limits(imported.case)
            imported, row["released"] = replace(imported, case=case), len(changed)
        if stop_s is not None:
            row["dw"] = largest_slip(imported, stop_s)
    except (CaseError, RuntimeError) as error:
        row["refused"] = str(error)
    return row


def largest_slip(imported: Imported, stop_s: float) -> float:
    """Return the largest |dw| of a run without events, pu."""
    from fmu_run import PlantSlave

    plant = PlantSlave(imported.case)
    names = [f"{m.name}_dw" for m in imported.case.machines]
    found = plant.record(np.arange(0.0, stop_s + 0.05, 0.1).tolist(), names)
    plant.close()
    return float(np.abs(found).max())


def main() -> int:
    """Print the tables; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--still", action="store_true", help="run the plant of each pair")
    parser.add_argument("--stop", type=float, default=20.0, metavar="S")
    parser.add_argument("--converters", choices=("refuse", "current"), default="refuse")
    parser.add_argument("--release-limits", action="store_true")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    raws = grids(options.folder, ".raw")
    files = [path for path in grids(options.folder, ".m") if any("mpc." in line for line in read_lines(path))]
    distinct = len({hashlib.sha256(p.read_bytes()).digest() for p in raws})
    rows = [read(path) for path in (*raws, *files)]
    for row in rows:
        name = str(Path(row["file"]).relative_to(options.folder))
        if "refused" in row:
            print(f"{name}: refused: {row['refused']}")
        else:
            print(
                f"{name}: {row['buses']} buses, stored {row['stored_mva']:.3g} MVA, moved "
                f"{row['moved_pu']:.2g} pu {row['moved_deg']:.2g} deg, case {row['differs_pu']:.1g} pu, "
                f"{row['s']:.2f} s"
            )
    good = [row for row in rows if row.get("differs_pu", 1.0) <= SAME_PU]
    count = sum(Path(row["file"]) in raws for row in good)
    print(f"RAW files read: {count} of {len(raws)} ({distinct} distinct)")
    print(f"MATPOWER files read: {len(good) - count} of {len(files)}")
    first = {p.parent: p for p in reversed(raws)}
    with_dyr = {folder: p for folder in first for p in reversed(grids(folder, ".dyr")) if p.parent == folder}
    pairs, currents = [], options.converters == "current"
    for folder, dyr in sorted(with_dyr.items()):
        stop = options.stop if options.still else None
        row = pair(first[folder], dyr, stop, currents=currents, release=options.release_limits)
        what = (
            f"refused: {row['refused']}"
            if "refused" in row
            else f"{row['machines']} machines, {row['s']:.2f} s"
        )
        if row.get("released"):
            what += f", {row['released']} limits widened"
        still = f", |dw| <= {row['dw']:.1e}" if "dw" in row else ""
        print(f"pair {folder.relative_to(options.folder)}: {what}{still}", flush=True)
        pairs.append(row)
    imported = [row for row in pairs if "refused" not in row]
    moving = [row for row in imported if not row.get("dw", 0.0) <= STILL_PU]
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    print(
        f"pairs imported: {len(imported)} of {len(pairs)}, of these moving: {len(moving)}; memory {memory} MB"
    )
    if options.json:
        options.json.write_text(json.dumps({"read": rows, "pairs": pairs}, indent=1))
    return int(len(good) < len(rows) or bool(moving))


if __name__ == "__main__":
    sys.exit(main())
