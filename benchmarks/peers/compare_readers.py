"""The same RAW files through VeraGrid and pypowsybl: bus voltages and branch flows of the power flow.

    python benchmarks/peers/compare_readers.py FOLDER [--veragrid-python PYTHON] [--pypowsybl-python PYTHON]
        [--json FILE]

Each tool lies in an environment of its own (pip install veragridengine: 1.4 GB, pip install pypowsybl:
0.4 GB) and reads every distinct RAW of FOLDER by benchmarks/peers/readers_run.py. Both sides hold the stored
magnitudes at the units' buses; nothing else moves (limits, taps, shunts). Compared are the buses that both
have, angles from the slack's, and P and Q into both ends of the branches between each two buses, all circuits
together; each grid with its largest differences. Exit code 1 where one is above 1e-5 pu or 0.01 % of the
largest flow, unless `KNOWN` says why.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

sys.path.extend(str(Path(__file__).resolve().parent / name) for name in (".", "../grids"))
from read_grids import grids

from interarea.models.grid.network import series_stamps
from interarea.models.grid.powerflow import solve_powerflow
from interarea.models.importers.imported import Imported
from interarea.models.importers.psse import import_psse, static_grid
from interarea.models.importers.raw.file import read_raw
from interarea.models.importers.raw.text import read_lines
from interarea.models.importers.report import Report

SAME_PU, SAME_FLOW = 1e-5, 1e-4
#: (tool, file) -> why it differs or is refused
NO_SLACK = "the slack bus has no unit: here the bus of the unit is taken"
KNOWN: dict[tuple[str, str], str] = {
    ("pypowsybl", "IEEE145.raw"): "older than version 32",
    ("pypowsybl", "IEEE_145bus_v23_PSLF.raw"): "older than version 32",
    ("pypowsybl", "118_PTIv33.raw"): "it does not say what it dislikes; VeraGrid reads it as we do",
    ("pypowsybl", "240busWECC_2018_PSS32_fixed_shunts.raw"): "YQ of loads has the other sign there",
    ("pypowsybl", "OMIB_DARCO_PSR.raw"): NO_SLACK,
    ("veragrid", "IEEE145.raw"): "older than version 29",
    ("veragrid", "IEEE_145bus_v23_PSLF.raw"): "older than version 29",
    # each of these two comes out the same when we leave out the same
    ("veragrid", "N44_BC.raw"): "the shunts at the ends of lines (GI to BJ) are left out there",
    ("veragrid", "TVC_System_32.raw"): "the ratio of winding 2 is left out of the impedance there",
    ("veragrid", "OMIB_DARCO_PSR.raw"): NO_SLACK,
}
Flows = dict[tuple[int, int], complex]


def ask(python: str, tool: str, problem: list[dict[str, Any]]) -> dict[str, Any]:
    """Return what `tool` in the interpreter `python` makes of the grids."""
    script = str(Path(__file__).with_name("readers_run.py"))
    words = json.dumps({"tool": tool, "grids": problem})
    done = subprocess.run([python, script], input=words, capture_output=True, text=True, check=False)
    if done.returncode:
        last = done.stderr.strip().splitlines()[-1:] or ["no message"]
        raise RuntimeError(f"{tool} in {python}: {last[0]} (pip install it there)")
    return dict(json.loads(done.stdout[done.stdout.index('{"version"') :]))


def solved(imported: Imported, path: Path) -> tuple[dict[int, complex], Flows, int]:
    """Return the voltages, the MVA from each bus to each other (line shunts with it), and the slack."""
    case, grid = imported.case, static_grid(read_raw(path), Report())
    flow = solve_powerflow(case)
    volts = {bus.number: complex(v) for bus, v in zip(case.buses, flow.voltages, strict=True)}
    flows: Flows = defaultdict(complex)
    rows = [b for b in grid.branches if b.on and not b.joins and b.first in volts and b.second in volts]
    stamps = series_stamps(*np.array([(b.r, b.x, b.b, b.tap, b.shift) for b in rows], dtype=float).T)
    for branch, stamp in zip(rows, np.asarray(stamps).reshape(-1, 2, 2), strict=True):
        ends = np.array([volts[branch.first], volts[branch.second]])
        into = ends * np.conj(stamp @ ends) * grid.base_mva
        flows[branch.first, branch.second] += into[0]
        flows[branch.second, branch.first] += into[1]
    for shunt in grid.shunts:
        if shunt.letter in "EM" and shunt.on and shunt.bus in volts:  # of a line, of a transformer
            one, two = map(int, shunt.identity.split("_")[:2])
            flows[shunt.bus, two if shunt.bus == one else one] += (
                complex(shunt.p, -shunt.q) * abs(volts[shunt.bus]) ** 2
            )
    return volts, flows, case.slack.bus


def problem_of(imported: Imported, path: Path) -> dict[str, Any]:
    """Return what a tool is asked: the file, what its units hold, and its switched shunts as stored, Mvar."""
    machine_buses = {m.bus for m in imported.case.machines}
    volts = {str(bus): abs(v) for bus, v in imported.solution.voltages.items() if bus in machine_buses}
    shunts: dict[str, float] = defaultdict(float)
    for shunt in static_grid(read_raw(path), Report()).shunts:
        if shunt.letter == "S" and shunt.on:
            shunts[str(shunt.bus)] += shunt.q
    return {"file": str(path), "volts": volts, "shunts": shunts}


def differences(imported: Imported, path: Path, answer: dict[str, Any]) -> dict[str, Any]:
    """Return the largest differences of a voltage (pu) and of a flow (of the largest), and where they are."""
    volts, flows, slack = solved(imported, path)
    theirs = {int(bus): v * np.exp(1j * np.deg2rad(angle)) for bus, (v, angle) in answer["buses"].items()}
    if slack not in theirs:
        return {"refused": f"{len(volts.keys() & theirs.keys())} of {len(volts)} buses, not the slack's"}
    turn = np.exp(1j * (np.angle(volts[slack]) - np.angle(theirs[slack])))
    off = {bus: abs(v - theirs[bus] * turn) for bus, v in volts.items() if bus in theirs}
    other: Flows = defaultdict(complex)
    for first, second, p1, q1, p2, q2 in answer["flows"]:
        other[int(first), int(second)] += complex(p1, q1)
        other[int(second), int(first)] += complex(p2, q2)
    inside = {ends: s for ends, s in flows.items() if set(ends) <= off.keys()}
    largest = max([imported.case.base_mva / 100.0, *map(abs, flows.values())])
    apart = {ends: abs(s - other.get(ends, 0.0)) / largest for ends, s in inside.items()}
    worst_bus, worst_ends = max(off, key=off.__getitem__), max(apart, key=apart.__getitem__)
    return {
        "buses": len(off), "of": len(volts), "pu": off[worst_bus], "bus": worst_bus,
        "flow": apart[worst_ends], "ends": worst_ends,
    }  # fmt: skip


def main() -> int:
    """Print the table; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--veragrid-python", metavar="PYTHON")
    parser.add_argument("--pypowsybl-python", metavar="PYTHON")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    pythons = {"veragrid": options.veragrid_python, "pypowsybl": options.pypowsybl_python}
    distinct = {
        hashlib.sha256("\n".join(read_lines(p)).encode()).digest(): p
        for p in reversed(grids(options.folder, ".raw"))
    }
    paths = sorted(distinct.values())
    rows, bad = [], 0
    with tempfile.TemporaryDirectory() as folder:
        problem, ours = [], []
        for k, path in enumerate(paths):
            ours.append(import_psse(path))
            plain = Path(folder) / f"{k}.raw"
            plain.write_text("\n".join(read_lines(path)), encoding="utf-8")
            problem.append(problem_of(ours[-1], plain))
        for tool, python in pythons.items():
            if python is None:
                print(f"{tool}: not run (give --{tool}-python)")
                continue
            result = ask(python, tool, problem)
            print(f"{tool} {result['version']}")
            for path, imported, answer in zip(paths, ours, result["grids"], strict=True):
                name = str(path.relative_to(options.folder))
                row = {
                    "tool": tool,
                    "file": name,
                    "why": KNOWN.get((tool, path.name.removesuffix(".xz")), ""),
                }
                row |= answer if "refused" in answer else differences(imported, path, answer)
                rows.append(row)
                bad += _line(row)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))
    return int(bad > 0)


def _line(row: dict[str, Any]) -> bool:
    """Print a row; return whether it is neither the same nor explained."""
    same = "refused" not in row and row["pu"] <= SAME_PU and row["flow"] <= SAME_FLOW
    what = (
        f"refused: {row['refused']}"
        if "refused" in row
        else f"{row['buses']} of {row['of']} buses, {row['pu']:.1e} pu at {row['bus']}, {row['flow']:.1e} "
        f"of the largest flow at {row['ends'][0]}-{row['ends'][1]}"
    )
    print(
        f"  {row['file']}: {what}{'' if same else ' DIFFERS' if not row['why'] else ': ' + row['why']}",
        flush=True,
    )
    return not same and not row["why"]


if __name__ == "__main__":
    sys.exit(main())
