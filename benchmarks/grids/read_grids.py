"""Every published grid of a folder: which RAW files are read, which RAW + DYR pairs import and stand still.

    python benchmarks/grids/read_grids.py FOLDER [--still] [--fault] [--export] [--command] [--stop 20]
        [--converters current] [--release-limits] [--json FILE]

FOLDER is searched for .raw and .m files, plain or packed. Each RAW is read, its stored voltages compared
with the network (largest mismatch) and polished by Newton's method; the power flow of the case must then
find the same voltages. Of each DYR file the records without a model are counted. In each folder the first
RAW goes with the first DYR; with --still the plant FMU of that pair runs without any event and the largest
|dw| is shown (expected: below 1e-6 pu). With --fault it also runs with a bus at earth through j0.01 pu from
1 s for 50 ms (where that is too long, 25 ms), that of most branches without an infinite bus: shown are the
peak of |dw| and how far the rotor angles go from where they rest (about the centre of inertia; below 180
degrees nobody slips a pole). With --export it is written as RAW + DYR and as MATPOWER and read back: how
far the voltages are off, and every value of a machine or control that came back as another.
With --release-limits limits beyond which controls would start are widened, and counted. Time is of reading
the pair, memory of this process. Exit code 1 when a RAW is not read, or a pair that imports does not stand
still, does not ride its fault or does not come back.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from interarea.models.case.case import Case
from interarea.models.case.events import events_of
from interarea.models.devices.dyr import dyr_models
from interarea.models.errors import CaseError
from interarea.models.exporters.dyr import dyr_of
from interarea.models.exporters.matpower import matpower_of
from interarea.models.exporters.raw import raw_of
from interarea.models.grid.powerflow import solve_powerflow
from interarea.models.grid.start import release_limits
from interarea.models.importers.dynamics import MACHINES
from interarea.models.importers.dyr import KNOWN, read_dyr
from interarea.models.importers.imported import Imported, ImportOptions
from interarea.models.importers.matpower import import_matpower
from interarea.models.importers.psse import import_psse
from interarea.models.importers.raw.text import read_lines

STILL_PU = 1e-6
SAME_PU = 1e-9
FAULTS_S = (0.05, 0.025)
FAULT_PU = 0.01
SLIPS_DEG = 180.0
MOST_S, MOST_MB = 5.0, 500.0


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


def unmodelled(files: Sequence[Path]) -> tuple[int, dict[Path, Counter[str]]]:
    """Return how many distinct DYR files there are, and which records of each have no model."""
    known = set(dyr_models()) | set(MACHINES)
    distinct = {
        hashlib.sha256("\n".join(read_lines(path)).encode()).digest(): path for path in reversed(files)
    }
    result = {
        path: Counter(row.model for row in read_dyr(path, KNOWN | known).records if row.model not in known)
        for path in sorted(distinct.values())
    }
    return len(result), {path: models for path, models in result.items() if models}


def pair(raw: Path, dyr: Path, options: argparse.Namespace) -> dict[str, Any]:
    """Return what importing a pair gives, and how its plant runs without an event and with a fault."""
    start = time.perf_counter()
    row: dict[str, Any] = {"folder": raw.parent.name, "raw": str(raw), "dyr": str(dyr)}
    try:
        imported = import_psse(
            raw,
            dyr,
            options=ImportOptions(converters=options.converters),
        )
        row |= {"s": time.perf_counter() - start, "machines": len(imported.case.machines)}
        if options.release_limits:
            case, changed = release_limits(imported.case)
            imported, row["released"] = replace(imported, case=case), len(changed)
        if options.still:
            row["dw"] = largest_slip(imported.case, options.stop)
        if options.fault:
            row |= ride(imported.case, options.stop)
        if options.export:
            row |= written_and_read(imported.case)
        if options.command:
            row |= command(raw, dyr, options)
    except (CaseError, RuntimeError) as error:
        row["refused"] = str(error)
    return row


def command(raw: Path, dyr: Path, options: argparse.Namespace) -> dict[str, float]:
    """Return what `interarea import` of a pair takes as a whole: s on the clock, s of a processor, MB."""
    flags = ["--release-limits"] if options.release_limits else []
    with tempfile.TemporaryDirectory() as folder:
        words = ["import", raw, "--dyr", dyr, "--converters", options.converters, *flags]
        start = time.perf_counter()
        process = subprocess.Popen(
            [sys.executable, "-m", "interarea", *map(str, words), "--out", f"{folder}/grid.toml"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            raise RuntimeError(f"interarea import: exit code {process.returncode}")
        row = {"command_s": time.perf_counter() - start, "command_cpu_s": used.ru_utime + used.ru_stime}
        return row | {"command_mb": used.ru_maxrss / 1024}


def recorded(case: Case, stop_s: float, events: Sequence[Any] = ()) -> tuple[np.ndarray, np.ndarray]:
    """Return |dw| (pu) and rotor angles (rad) of the machines over a run of the plant FMU."""
    from fmu_run import PlantSlave

    plant = PlantSlave(case, events, show=["*_dw", "*_delta"])
    names = [f"{m.name}_{key}" for key in ("dw", "delta") for m in case.machines]
    result = plant.record(np.arange(0.0, stop_s + 0.05, 0.1).tolist(), names)
    plant.close()
    speeds, angles = np.split(result, 2, axis=1)
    return np.abs(speeds), angles


def largest_slip(case: Case, stop_s: float) -> float:
    """Return the largest |dw| of a run without events, pu."""
    return float(recorded(case, stop_s)[0].max())


def ride(case: Case, stop_s: float) -> dict[str, Any]:
    """Return bus and length (s) of the fault, the peak of |dw| (pu) and how far the angles go (degrees)."""
    infinite = {m.bus for m in case.machines if m.model == "infinite_bus"}
    ends = [bus for b in case.branches if b.in_service for bus in (b.from_bus, b.to_bus)]
    bus = Counter(bus for bus in ends if bus not in infinite).most_common(1)[0][0]
    row: dict[str, Any] = {}
    for length in FAULTS_S:
        fault = {"kind": "bus_fault", "bus": bus, "start_s": 1.0, "end_s": 1.0 + length, "x_pu": FAULT_PU}
        speeds, angles = recorded(case, stop_s, events_of([fault], where=case.name))
        swing = float(np.degrees(np.abs(angles - angles[0]).max()))
        row = {"fault_bus": bus, "fault_s": length, "peak_dw": float(speeds.max()), "swing_deg": swing}
        if swing < SLIPS_DEG:
            break
    return row


def written_and_read(case: Case) -> dict[str, Any]:
    """Return what differs after RAW + DYR and after MATPOWER, and what the writers name as lost."""
    flow = solve_powerflow(case)
    network, dynamics = raw_of(case, flow), dyr_of(case)
    with tempfile.TemporaryDirectory() as folder:
        raw, dyr, m = (Path(folder) / f"grid{suffix}" for suffix in (".raw", ".dyr", ".m"))
        for path, text in ((raw, network.text), (dyr, dynamics.text), (m, matpower_of(case, flow).text)):
            path.write_text(text, encoding="utf-8")
        back, static = import_psse(raw, dyr).case, import_matpower(m).case
    known = {bus.number: v for bus, v in zip(case.buses, flow.voltages, strict=True)}
    off = 0.0
    for copy in (back, static):
        ours = zip(copy.buses, solve_powerflow(copy).voltages, strict=True)
        off = max(off, *(abs(v - known[bus.number]) for bus, v in ours))
    changed = [
        f"{one.name}{key}"
        for one, other in zip(by_bus(case), by_bus(back), strict=True)
        for key, value in numbers(one.model_dump())
        if not same_value(value, dict(numbers(other.model_dump())).get(key))
    ]
    return {"written_pu": off, "changed": changed, "losses": [*network.losses, *dynamics.losses]}


def by_bus(case: Case) -> list[Any]:
    """Return the machines by bus and dispatch, whatever their names."""
    return sorted(case.machines, key=lambda m: (m.bus, m.P_mw, m.name))


def numbers(value: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Yield key and value of all that a machine holds but words."""
    if not isinstance(value, dict):
        yield key, value
        return
    for name, inner in value.items():
        if name not in ("name", "source"):
            yield from numbers(inner, f"{key}.{name}")


def same_value(one: Any, other: Any) -> bool:
    """Return whether two values are the same to 1e-9 of their size."""
    if isinstance(one, float) and isinstance(other, float):
        return abs(one - other) <= SAME_PU * max(1.0, abs(one))
    return bool(one == other)


def main() -> int:
    """Print the tables; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--still", action="store_true", help="run the plant of each pair")
    parser.add_argument("--fault", action="store_true", help="run it with a fault as well")
    parser.add_argument("--export", action="store_true", help="write it and read it back as well")
    parser.add_argument("--command", action="store_true", help="measure the command of each pair as well")
    parser.add_argument("--stop", type=float, default=20.0, metavar="S")
    parser.add_argument("--converters", choices=("model", "current"), default="model")
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
    count, without = unmodelled(grids(options.folder, ".dyr"))
    for path, models in without.items():
        named = ", ".join(f"{n} {model}" for model, n in sorted(models.items()))
        print(f"{path.relative_to(options.folder)}: no model of {named}")
    print(f"DYR files with every record modelled: {count - len(without)} of {count} distinct")
    first = {p.parent: p for p in reversed(raws)}
    with_dyr = {folder: p for folder in first for p in reversed(grids(folder, ".dyr")) if p.parent == folder}
    pairs = []
    for folder, dyr in sorted(with_dyr.items()):
        row = pair(first[folder], dyr, options)
        what = (
            f"refused: {row['refused']}"
            if "refused" in row
            else f"{row['machines']} machines, {row['s']:.2f} s"
        )
        if row.get("released"):
            what += f", {row['released']} limits widened"
        if "dw" in row:
            what += f", |dw| <= {row['dw']:.1e}"
        if "swing_deg" in row:
            what += f", {1e3 * row['fault_s']:g} ms at {row['fault_bus']}: |dw| <= {row['peak_dw']:.2g}"
            what += f", angles move {row['swing_deg']:.0f} deg"
        if "changed" in row:
            what += f", written and read: {row['written_pu']:.0e} pu, changed {row['changed'] or 'nothing'}"
            what += f", named as lost: {row['losses'] or 'nothing'}"
        if "command_s" in row:
            what += f", command {row['command_s']:.1f} s ({row['command_cpu_s']:.1f} s of a processor), "
            what += f"{row['command_mb']:.0f} MB"
        print(f"pair {folder.relative_to(options.folder)}: {what}", flush=True)
        pairs.append(row)
    imported = [row for row in pairs if "refused" not in row]
    moving = [row for row in imported if not row.get("dw", 0.0) <= STILL_PU]
    slipping = [row for row in imported if not row.get("swing_deg", 0.0) < SLIPS_DEG]
    lossy = [row for row in imported if row.get("changed") or not row.get("written_pu", 0.0) <= SAME_PU]
    heavy = [
        row
        for row in imported
        if not (row.get("command_cpu_s", 0.0) < MOST_S and row.get("command_mb", 0.0) < MOST_MB)
    ]
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    print(
        f"pairs imported: {len(imported)} of {len(pairs)}, of these moving: {len(moving)}, slipping a pole: "
        f"{len(slipping)}, coming back as others: {len(lossy)}, heavy: {len(heavy)}; memory {memory} MB"
    )
    if options.json:
        options.json.write_text(json.dumps({"read": rows, "pairs": pairs}, indent=1))
    return int(len(good) < len(rows) or bool(moving or slipping or lossy or heavy))


if __name__ == "__main__":
    sys.exit(main())
