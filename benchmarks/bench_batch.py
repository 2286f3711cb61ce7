"""What plants side by side gain: CPU time of many scenarios of one grid, one at a time over several at once.

    python benchmarks/bench_batch.py [--scenarios 64] [--repeat 5] [--case two-area-thesis --case new-england]

Every scenario has a fault of its own. The widths alternate within one process and the least CPU time of
the steps counts, not that of beginning the runs, so that other load of the machine cancels. All widths give
the same bits. A plant with many ports (loads that are no impedances) on a sparse network goes one at a time,
whatever is asked.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from plant_lanes import PlantLanes

from interarea.fmu_build.write.cache import default_cache
from interarea.models.blocks.plant import event_parameters
from interarea.models.case.case import Case, load_case
from interarea.models.case.events import events_of

STOP_S, STEP_S = 5.0, 0.02
TARGET = 3.0  #: AVX2 (four side by side) over one at a time


def faults(case: Case, count: int) -> list[dict[str, float | int]]:
    """Start values of `count` scenarios: a fault at each bus in turn, of several lengths."""
    rows = []
    for k in range(count):
        start = 0.1 + 0.003 * (k % 5)
        fault = {"kind": "bus_fault", "bus": case.buses[k % len(case.buses)].number, "x_pu": 0.02}
        fault |= {"start_s": start, "end_s": start + 0.05 + 0.01 * (k % 4)}
        rows.append(event_parameters(case, events_of([fault], where="bench_batch")))
    return rows


def measure(case: Case, scenarios: int, repeat: int) -> bool:
    """Print a line for each width; whether AVX2 gains the target (or is not there)."""
    plants = PlantLanes(case, default_cache())
    rows = faults(case, scenarios)
    widths = [lanes for lanes in (1, 2, 4, 8) if lanes <= plants.group.lanes]
    cpu = dict.fromkeys(widths, np.inf)
    results = {w: plants.run(rows[:w], stop_s=1.0, step_s=STEP_S, lanes=w) for w in widths}
    single = plants.run(rows[: widths[-1]], stop_s=1.0, step_s=STEP_S, lanes=1)
    for _ in range(repeat):
        for lanes in widths:
            run = plants.run(rows, stop_s=STOP_S, step_s=STEP_S, lanes=lanes, record=False)
            cpu[lanes] = min(cpu[lanes], run.cpu_s)
    for lanes in widths:
        same = np.array_equal(results[lanes].outputs, single.outputs[:, :, :lanes], equal_nan=True)
        per_second = 1e6 * cpu[lanes] / (scenarios * STOP_S)
        note = "same bits" if same else "OTHER BITS"
        print(
            f"{case.name}: {lanes} side by side  x {cpu[1] / cpu[lanes]:5.2f}  "
            f"{per_second:7.1f} us per simulated s  {note}",
            flush=True,
        )
    return 4 not in cpu or cpu[1] / cpu[4] >= TARGET


def main() -> int:
    """Print the table; return 1 when AVX2 is there and gains less than the target."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenarios", type=int, default=64)
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--case", action="append", help="may be repeated (default: two-area-thesis)")
    options = parser.parse_args()
    cases = [load_case(name) for name in options.case or ["two-area-thesis"]]
    reached = [measure(case, options.scenarios, options.repeat) for case in cases]
    return int(not all(reached))


if __name__ == "__main__":
    sys.exit(main())
