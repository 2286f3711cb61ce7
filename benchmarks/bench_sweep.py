"""What a sweep costs beside the arithmetic of its plants, and how it compares with loops of other tools.

    python benchmarks/bench_sweep.py                 # a few minutes
    python benchmarks/bench_sweep.py --runs 10000    # the full sweep with one and with two workers
    python benchmarks/bench_sweep.py --no-peers --memory 3000

Runs are closed loops of 20 s: plant, two channels, controller, H = 10 ms. Ratios within one process take
turns and the least processor time of all rounds counts, so other load of the machine cancels as far as it
can; what the clock on the wall measures (runs per second, two workers against one) needs an idle machine.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import resource
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from study_loop import SCENARIO

from interarea.cosim import sweep_local
from interarea.cosim.artefacts import default_cache
from interarea.cosim.master import Master
from interarea.cosim.run import assemble
from interarea.cosim.scenario import load_scenario
from interarea.cosim.sweep_engine import run_sweep
from interarea.cosim.sweep_plan import plan_sweep
from interarea.cosim.sweep_run import Runner
from interarea.cosim.sweep_spec import load_sweep

WANTED_RATIO, WANTED_OVERHEAD, WANTED_SCALING = 1.3, 0.05, 1.8


def document(runs: int) -> dict[str, Any]:
    """Return a sweep of `runs` runs over the size of the pulse."""
    size = {"path": "event.1.size_pu", "range": {"start": 0.01, "stop": 0.05, "count": runs}}
    return {"name": "bench", "scenario": SCENARIO, "parameters": {"size": size}}


def per_run(rounds: int, scratch: Path) -> dict[str, float]:
    """Return least milliseconds of processor time of a run and of what it is made of."""
    alone = load_scenario(SCENARIO | {"controller": "none", "channels": {}})
    plan = plan_sweep(load_sweep(document(2)), default_cache())
    bare = plan_sweep(load_sweep(document(2) | {"metrics": ["stable", "peak"]}), default_cache())
    best: dict[str, float] = {}

    def clock(title: str, what: Callable[[], object]) -> None:
        begin = time.process_time()
        what()
        best[title] = min(1e3 * (time.process_time() - begin), best.get(title, float("inf")))

    def rerun(master: Master) -> None:
        master.start()
        master.advance()

    with (
        assemble(alone) as plant,
        assemble(load_scenario(SCENARIO)) as loop,
        Runner(plan, default_cache(), scratch) as runner,
        Runner(bare, default_cache(), scratch) as simple,
    ):
        for master in (plant.master, loop.master):
            master.run()
        for each in (runner, simple):
            each.outcome(0)
        for _ in range(rounds):
            clock("plant alone: reset and steps", lambda: rerun(plant.master))
            clock("closed loop: reset and steps", lambda: rerun(loop.master))
            clock("run of a sweep, all metrics", lambda: runner.outcome(1))
            clock("run of a sweep, stable and peak only", lambda: simple.outcome(1))
    return best


def mean_run(runs: int, scratch: Path) -> float:
    """Return mean milliseconds of processor time of a run in this process, nothing around it."""
    plan = plan_sweep(load_sweep(document(runs)), default_cache())
    with Runner(plan, default_cache(), scratch) as runner:
        runner.outcome(0)
        begin = time.process_time()
        for run in range(runs):
            runner.outcome(run)
        return 1e3 * (time.process_time() - begin) / runs


def ssp_loop(scratch: Path) -> float:
    """Return milliseconds of processor time of one `fmpy.simulate_ssp` of the same system."""
    import fmpy.ssp.simulation

    from interarea.cosim.ssp import write_ssp

    file = write_ssp(load_scenario(SCENARIO), scratch / "loop.ssp", cache=default_cache())
    begin = time.process_time()
    fmpy.ssp.simulation.simulate_ssp(str(file), stop_time=20.0, step_size=0.01)
    return 1e3 * (time.process_time() - begin)


def whole(runs: int, workers: int) -> tuple[float, float]:
    """Return seconds by the clock and of processor time, children included, of a sweep."""
    spawned = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory() as folder, patched("_context", lambda: spawned):
        before, begin = _processor_s(), time.perf_counter()
        run_sweep(document(runs), Path(folder) / "out", workers=workers)
        return time.perf_counter() - begin, _processor_s() - before


@contextmanager
def patched(name: str, value: Callable[[], Any]) -> Iterator[None]:
    """Begin workers as children of this process while it holds, so that their processor time is counted."""
    kept = getattr(sweep_local, name)
    setattr(sweep_local, name, value)
    try:
        yield
    finally:
        setattr(sweep_local, name, kept)


def _processor_s() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in used)


def memory(runs: int, scratch: Path) -> list[tuple[int, float]]:
    """Return (runs made, resident MB) of one worker's process at ten moments."""
    short = document(runs)
    short["scenario"] = SCENARIO | {"stop_s": 1.5}
    plan = plan_sweep(load_sweep(short), default_cache())
    page = os.sysconf("SC_PAGE_SIZE")
    found = []
    with Runner(plan, default_cache(), scratch) as runner:
        for run in range(runs):
            runner.outcome(run)
            if (run + 1) % max(1, runs // 10) == 0:
                pages = int(Path("/proc/self/statm").read_text().split()[1])
                found.append((run + 1, pages * page / 1e6))
    return found


def _verdict(reached: bool) -> str:
    return "yes" if reached else "NO"


def main() -> int:
    """Print the tables; return 1 when a ratio that does not need an idle machine is missed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=40)
    parser.add_argument(
        "--runs", type=int, default=200, help="of the sweeps with one and two workers; 0: none"
    )
    parser.add_argument("--memory", type=int, default=1000, help="short runs for the memory table; 0: none")
    parser.add_argument("--no-peers", action="store_true")
    options = parser.parse_args()
    reached = True
    print(f"load of the machine: {os.getloadavg()[0]:.1f}")
    with tempfile.TemporaryDirectory() as name:
        scratch = Path(name)
        times = per_run(options.rounds, scratch)
        print("ms of processor time for 20 s of closed loop")
        for title, value in times.items():
            print(f"  {title:<40}{value:9.2f}")
        whole_run = times["run of a sweep, all metrics"]
        ratio = whole_run / times["plant alone: reset and steps"]
        reached &= ratio <= WANTED_RATIO
        print(f"run / plant alone = {ratio:.2f}, wanted <= {WANTED_RATIO}: {_verdict(ratio <= WANTED_RATIO)}")
        if not options.no_peers:
            peer = ssp_loop(scratch)
            print(f"fmpy.simulate_ssp of the same system: {peer:.0f} ms, {peer / whole_run:.0f} times a run")
        if options.memory:
            table = memory(options.memory, scratch)
            print("resident MB after short runs: " + ", ".join(f"{n}: {mb:.0f}" for n, mb in table))
    if options.runs:
        first_s, start = whole(2, 1)
        few = min(options.runs, 200)
        with tempfile.TemporaryDirectory() as name:
            plain = [mean_run(few, Path(name))]
        one_s, one = whole(options.runs, 1)
        with tempfile.TemporaryDirectory() as name:
            plain.append(mean_run(few, Path(name)))
        two_s, _ = whole(options.runs, 2)
        one_s, two_s = one_s - first_s, two_s - first_s  # loading the program apart
        each = 1e3 * (one - start) / (options.runs - 2)
        overhead = each / (sum(plain) / 2) - 1.0  # both means, before and after, under the same load
        print(f"{options.runs} runs: {each:.2f} ms of processor time each beyond the start ({start:.1f} s)")
        print(
            f"engine over the runs themselves: {100 * overhead:.1f} %, wanted < {100 * WANTED_OVERHEAD:.0f} %"
        )
        print(f"one worker {options.runs / one_s:.1f} runs/s, two {options.runs / two_s:.1f} runs/s")
        print(f"two workers / one = {one_s / two_s:.2f}, wanted >= {WANTED_SCALING} (on an idle machine)")
    return 0 if reached else 1


if __name__ == "__main__":
    sys.exit(main())
