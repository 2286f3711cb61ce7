"""How long the export of a new controller FMU takes, and with --cold the build of all platforms from nothing.

    python benchmarks/bench_export.py [--cold]

Export: wanted < 20 ms for a controller whose numbers were never seen before (binaries cached).
Cold: wanted < 180 s on 2 cores for plant, controller and channel on five platforms, empty cache.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from interarea.fmu_build.write.compile import PLATFORMS, compile_binary, host_platform
from interarea.fmu_build.write.package import build_fmu
from interarea.models.blocks.channel import channel_block
from interarea.models.blocks.controller import controller_block
from interarea.models.blocks.plant import plant_block
from interarea.models.blocks.variables import Block
from interarea.models.case.case import load_case

EXPORT_LIMIT_S = 0.020
COLD_LIMIT_S = 180.0


def new_controller(seed: int, order: int = 8) -> Block:
    """Return a controller of two signals and one actuator with numbers of its own."""
    rng = np.random.default_rng(seed)
    A, B, C = rng.normal(size=(order, order)), rng.normal(size=(order, 2)), rng.normal(size=(1, order))
    return controller_block("controller", A, B, C, np.zeros((1, 2)), ["G2_dw", "G4_dw"], ["G4_vs"])


def export_times(repeats: int, platforms: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Return wall and processor seconds of each export, the first (which may compile) left out."""
    wall, busy = [], []
    with tempfile.TemporaryDirectory() as folder:
        for k in range(repeats + 1):
            begin, used = time.perf_counter(), time.process_time()
            build_fmu(new_controller(k), Path(folder), platforms=platforms)
            wall.append(time.perf_counter() - begin)
            busy.append(time.process_time() - used)
    return np.array(wall[1:]), np.array(busy[1:])


def cold_build(workers: int) -> tuple[float, float]:
    """Return wall and processor seconds of compiling every kind for every platform, `workers` at a time."""
    blocks = [new_controller(0), channel_block(), plant_block(load_case("two-area-thesis"))]
    with tempfile.TemporaryDirectory() as cache:
        begin, used = time.perf_counter(), os.times()
        with ThreadPoolExecutor(workers) as pool:
            jobs = [
                pool.submit(compile_binary, b.kind, b.sources, name, cache=Path(cache))
                for name in PLATFORMS
                for b in blocks
            ]
            for job in jobs:
                job.result()
        now = os.times()
        busy = now.children_user + now.children_system - used.children_user - used.children_system
        return time.perf_counter() - begin, busy


def main() -> int:
    """Print the figures; return 1 if one misses its limit."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cold", action="store_true", help="also build everything with an empty cache")
    parser.add_argument("--repeats", type=int, default=50)
    chosen = parser.parse_args()
    missed = False
    wall, busy = export_times(chosen.repeats, [host_platform()])
    print(
        f"export of a new controller FMU: {1e3 * wall.min():.1f} ms at best, {1e3 * np.median(wall):.1f} ms "
        f"median (processor {1e3 * np.median(busy):.1f} ms); wanted < {1e3 * EXPORT_LIMIT_S:.0f} ms"
    )
    missed |= not wall.min() < EXPORT_LIMIT_S
    if chosen.cold:
        workers = min(2, os.cpu_count() or 1)
        seconds, busy_s = cold_build(workers)
        print(
            f"cold build of 3 kinds for {len(PLATFORMS)} platforms, {workers} at a time: {seconds:.0f} s "
            f"(processor {busy_s:.0f} s); wanted < {COLD_LIMIT_S:.0f} s"
        )
        missed |= not seconds < COLD_LIMIT_S
    return int(missed)


if __name__ == "__main__":
    sys.exit(main())
