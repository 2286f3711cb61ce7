"""Our pool of workers against dask's LocalCluster: the same short runs, undisturbed and with a worker killed.

    python benchmarks/bench_pool.py [--runs 2000] [--workers 2] [--rounds 3]

Both make every row of the same sweep, with the same tasks; they take turns; ratios of medians are printed.
With the start of the workers, as a user waits for it. The killed worker is the first that a process has, when
a tenth of the runs is there. Exit code 1 where rows differ.
"""

from __future__ import annotations

import argparse
import os
import signal
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil
from distributed import LocalCluster
from study_loop import SCENARIO

from interarea.cosim.sweep.front import Progress, run_sweep
from interarea.cosim.sweep.parts import read_rows

SHORT = SCENARIO | {"stop_s": 1.5}
KINDS = ("pool", "LocalCluster")


def document(runs: int) -> dict[str, Any]:
    """Return a sweep of short runs over the gain of the controller: nothing is shared."""
    gain = {"path": "controller.gain", "range": {"start": 0.8, "stop": 1.2, "count": runs}}
    return {"name": "pool", "scenario": SHORT, "parameters": {"gain": gain}}


def killer(runs: int) -> Callable[[Progress], None]:
    """Return what kills one worker process when a tenth of the runs is there."""
    done = False

    def kill(progress: Progress) -> None:
        nonlocal done
        if done or progress.done < runs // 10:
            return
        busy = [p for p in psutil.Process().children(recursive=True) if p.cpu_times().user > 0.5]
        if busy:
            os.kill(max(busy, key=lambda p: p.cpu_times().user).pid, signal.SIGKILL)
            done = True

    return kill


def seconds(kind: str, runs: int, workers: int, folder: Path, kill: bool) -> float:
    """Return how long a sweep takes from nothing to its last row, s."""
    progress = killer(runs) if kill else None
    start = time.perf_counter()
    if kind == "pool":
        run_sweep(document(runs), folder, workers=workers, progress=progress)
    else:
        with LocalCluster(
            n_workers=workers, threads_per_worker=1, dashboard_address=None, silence_logs=50
        ) as cluster:
            address = cluster.scheduler_address
            run_sweep(document(runs), folder, scheduler=address, progress=progress)
    return time.perf_counter() - start


def main() -> int:
    """Print seconds and ratios; return 1 when the two ways gave different rows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=2000)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    cells = [(kind, kill) for kind in KINDS for kill in (False, True)]
    times: dict[tuple[str, bool], list[float]] = {cell: [] for cell in cells}
    same = True
    with tempfile.TemporaryDirectory() as scratch:
        run_sweep(document(4), Path(scratch) / "warm", workers=1)
        for turn in range(options.rounds):
            for kill in (False, True):
                rows = []
                for kind in KINDS if turn % 2 else KINDS[::-1]:
                    out = Path(scratch) / f"{kind}-{kill}-{turn}"
                    times[kind, kill].append(seconds(kind, options.runs, options.workers, out, kill))
                    took = times[kind, kill][-1]
                    print(f"{kind}{', a worker killed' if kill else ''}: {took:.2f} s", file=sys.stderr)
                    rows.append(read_rows(out).drop(columns="reason"))
                same &= rows[0].equals(rows[1])
    for kill in (False, True):
        ours, theirs = (statistics.median(times[kind, kill]) for kind in KINDS)
        what = "one worker killed" if kill else "undisturbed"
        seen = f"pool {ours:.2f} s, LocalCluster {theirs:.2f} s, ratio {theirs / ours:.2f}"
        print(f"{options.runs} runs, {what}: {seen}")
    print("rows are the same" if same else "ROWS DIFFER")
    return int(not same)


if __name__ == "__main__":
    sys.exit(main())
