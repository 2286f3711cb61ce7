"""How long the export of a new controller takes, as FMU and DLL, and with --cold the build of all platforms.

    python benchmarks/bench_export.py [--cold]

Export: wanted < 20 ms as an FMU, <= 10 ms as a DLL of each platform, for a controller with new numbers
(binaries cached), best of all. TMPDIR says where it writes: each file is forced onto that disk.
Cold: wanted < 180 s on 2 cores for plant, controller and channel on five platforms, empty cache.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np

from interarea.fmu_build.write.compile import PLATFORMS, compile_binary, host_platform
from interarea.fmu_build.write.package import build_fmu
from interarea.fmu_build.write.real_code import DLL_PLATFORMS, build_dll
from interarea.models.blocks.channel import channel_block
from interarea.models.blocks.controller import controller_block
from interarea.models.blocks.plant import plant_block
from interarea.models.blocks.variables import Block
from interarea.models.case.case import load_case

EXPORT_LIMIT_S, DLL_LIMIT_S = 0.020, 0.010
COLD_LIMIT_S = 180.0


def new_controller(seed: int, order: int = 8) -> Block:
    """Return a controller of two signals and one actuator with numbers of its own."""
    rng = np.random.default_rng(seed)
    A, B, C = rng.normal(size=(order, order)), rng.normal(size=(order, 2)), rng.normal(size=(1, order))
    return controller_block("controller", A, B, C, np.zeros((1, 2)), ["G2_dw", "G4_dw"], ["G4_vs"])


def export_times(repeats: int, export: Callable[[Block, Path], object]) -> tuple[np.ndarray, np.ndarray]:
    """Return wall and processor seconds of each export, the first (which may compile) left out."""
    wall, busy = [], []
    with tempfile.TemporaryDirectory() as folder:
        for k in range(repeats + 1):
            block = new_controller(k)
            begin, used = time.perf_counter(), time.process_time()
            export(block, Path(folder))
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
    exports: dict[str, tuple[float, Callable[[Block, Path], object]]] = {
        "FMU": (EXPORT_LIMIT_S, partial(build_fmu, platforms=[host_platform()]))
    }
    for name in DLL_PLATFORMS:
        exports[f"DLL for {name}"] = (DLL_LIMIT_S, partial(build_dll, platform=name))
    for what, (limit_s, export) in exports.items():
        wall, busy = export_times(chosen.repeats, export)
        print(
            f"export of a new controller as {what}: {1e3 * wall.min():.1f} ms at best, "
            f"{1e3 * np.median(wall):.1f} ms median (processor {1e3 * np.median(busy):.1f} ms); "
            f"wanted <= {1e3 * limit_s:.0f} ms"
        )
        missed |= not wall.min() <= limit_s
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
