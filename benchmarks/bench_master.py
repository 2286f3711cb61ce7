"""Time the master: chains of trivial FMUs against other masters, and the closed-loop study scenario.

    python benchmarks/bench_master.py                 # everything (a few minutes)
    python benchmarks/bench_master.py --chains 10 --rounds 9
    python benchmarks/bench_master.py --no-peers --json out.json

A chain: N FMUs that do next to nothing, each output feeding the next input. The unit is one communication
step of one FMU: set one input, step, get one output, keep it (Ecos also without keeping; cubic inputs: also
three input derivatives and an output slope). All routes take turns in one process, the least processor time
of all rounds counts. The FMU is compiled once and the same for all.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from chain.peers import PEERS, Route, plain_c
from chain.trivial import H, trivial_fmu
from study_loop import SCENARIO

from interarea.cosim.master.instances import FmuParticipant
from interarea.cosim.master.master import Master
from interarea.cosim.master.plan import LoopPlan
from interarea.cosim.run.run import system_of
from interarea.cosim.scenario.scenario import load_scenario
from interarea.fmu_build.open.fmu_file import FmuFile

#: microseconds per step and FMU at N = 10, every output recorded
LIMIT_KERNEL, LIMIT_PYTHON = 0.15, 3.5
#: cost of the closed loop over that of the plant alone
LIMIT_LOOP = 1.25
KERNEL_HELD, KERNEL, PYTHON_HELD, PYTHON = (
    "interarea kernel, inputs held",
    "interarea kernel, cubic inputs",
    "interarea Python, inputs held",
    "interarea Python, cubic inputs",
)
PLAIN = "plain C loop"


def our_route(file: FmuFile, n: int, inputs: str, engine: str) -> Route:
    """Return the master on a chain; a run starts again and counts the steps, every output recorded."""
    steps = 100_000 if engine == "kernel" else 2_000
    parts = [FmuParticipant(f"t{k}", file) for k in range(n)]
    wires = [(f"t{k - 1}.y", f"t{k}.u") for k in range(1, n)]
    master = Master(LoopPlan(wires, stop_s=steps * H, step_s=H, inputs=inputs, engine=engine), parts)  # type: ignore[arg-type]
    master.start()
    master.run(until_s=H)  # the kernel is compiled and bound

    def run(count: int) -> None:
        master.advance(until_s=round(count * H, 9))

    return Route(run, steps, before=master.start, close=master.close)


@contextmanager
def quiet() -> Iterator[None]:
    """Send what other tools write to standard output and error to nowhere."""
    sys.stdout.flush()
    sys.stderr.flush()
    descriptors = os.dup(1), os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
        yield
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        for k, fd in zip((1, 2), descriptors, strict=True):
            os.dup2(fd, k)
            os.close(fd)
        os.close(nowhere)


def seconds_of(route: Route) -> float:
    """Return the processor time of one step of the whole chain in one round."""
    if route.fixed:  # each run sets everything up: the difference of two lengths
        long, short = (_clocked(route, count) for count in (3 * route.steps, route.steps))
        return (long - short) / (2 * route.steps)
    return _clocked(route, route.steps) / route.steps


def _clocked(route: Route, count: int) -> float:
    route.before()
    gc.collect()
    begin = time.process_time()
    route.run(count)
    return time.process_time() - begin


def chain_times(n: int, rounds: int, peers: bool) -> dict[str, float | str]:
    """Return microseconds per step and FMU by route, or why a route is not there."""
    row: dict[str, float | str] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        fmu = trivial_fmu(folder / "trivial.fmu")
        file = FmuFile(fmu)
        makers: dict[str, Callable[[], Route]] = {
            PLAIN: lambda: plain_c(fmu, n, folder),
            KERNEL_HELD: lambda: our_route(file, n, "hold-gauss-seidel", "kernel"),
            KERNEL: lambda: our_route(file, n, "hermite", "kernel"),
            PYTHON_HELD: lambda: our_route(file, n, "hold-gauss-seidel", "python"),
            PYTHON: lambda: our_route(file, n, "hermite", "python"),
        }
        if peers:
            for title, make in PEERS.items():
                makers[title] = lambda make=make: make(fmu, n, folder)
        routes: dict[str, Route] = {}
        for title, maker in makers.items():
            try:
                with quiet():
                    routes[title] = maker()
            except ImportError as error:
                row[title] = f"not installed ({error})"
            except Exception as error:  # another tool's failure is a row of the table, not the end of the run
                row[title] = f"fails: {type(error).__name__}: {error}"[:100]
        best: dict[str, float] = {}
        for _ in range(rounds):
            for title, route in routes.items():
                with quiet():
                    each = 1e6 * seconds_of(route) / n
                best[title] = min(each, best.get(title, float("inf")))
        with quiet():
            for route in routes.values():
                route.close()
        file.close()
    return {title: best.get(title, row.get(title, "")) for title in makers}


def study_times(rounds: int) -> dict[str, float]:
    """Return milliseconds of a 20 s run on live instances: the loop and the plant alone."""
    alone = SCENARIO | {"controller": "none", "channels": {}}
    with (
        system_of(load_scenario(SCENARIO)).master() as loop,
        system_of(load_scenario(alone)).master() as plant,
    ):
        best: dict[str, float] = {}

        def clock(title: str, what: Callable[[], object]) -> None:
            begin = time.process_time()
            what()
            spent = 1e3 * (time.process_time() - begin)
            best[title] = min(spent, best.get(title, float("inf")))

        loop.run()
        plant.run()
        for _ in range(rounds):
            for title, master in (("closed loop", loop), ("plant alone", plant)):
                begin = time.process_time()
                clock(f"{title}: reset and start", master.start)
                clock(f"{title}: steps", master.run)
                spent = 1e3 * (time.process_time() - begin)
                best[f"{title}: rerun"] = min(spent, best.get(f"{title}: rerun", float("inf")))
    return best


def print_chains(times: dict[int, dict[str, float | str]]) -> None:
    """Print microseconds per step and FMU, and ratios at the largest N."""
    largest = max(times)
    titles = list(times[largest])
    plain, ours = times[largest][PLAIN], times[largest][KERNEL_HELD]
    print("microseconds per communication step and FMU (least processor time)")
    head = "".join(f"{f'N = {n}':>9}" for n in times)
    print(f"{'':<32}{head}{'/ plain C':>11}{'/ kernel':>10}   (ratios at N = {largest})")
    for title in titles:
        cells = [times[n][title] for n in times]
        if isinstance(cells[-1], str):
            print(f"{title:<32}  {cells[-1]}")
            continue
        shown = "".join(f"{c:9.3f}" if isinstance(c, float) else f"{'-':>9}" for c in cells)
        ratios = ""
        if isinstance(plain, float) and isinstance(ours, float):
            ratios = f"{cells[-1] / plain:11.1f}{cells[-1] / ours:10.1f}"
        print(f"{title:<32}{shown}{ratios}")
    kernel, python = times[largest][KERNEL], times[largest][PYTHON_HELD]
    if isinstance(kernel, float) and isinstance(python, float):
        print(
            f"wanted at N = {largest}: kernel <= {LIMIT_KERNEL}: {_verdict(kernel <= LIMIT_KERNEL)}; ",
            end="",
        )
        print(f"Python <= {LIMIT_PYTHON}: {_verdict(python <= LIMIT_PYTHON)}")
    slower = [
        f"{title} at N = {n}"
        for n, row in times.items()
        for title in PEERS
        if isinstance(row.get(title), float) and row[title] < row[KERNEL_HELD]  # type: ignore[operator]
    ]
    print("faster than every peer: " + _verdict(not slower) + (f" ({', '.join(slower)})" if slower else ""))


def print_study(times: dict[str, float]) -> None:
    """Print the closed loop against the plant alone."""
    print(
        "20 s of the study's closed loop (plant, two channels, controller; H = 10 ms), ms of processor time"
    )
    for title, value in times.items():
        print(f"{title:<32}{value:9.2f}")
    ratio = times["closed loop: rerun"] / times["plant alone: rerun"]
    print(f"closed loop / plant alone = {ratio:.3f}, wanted <= {LIMIT_LOOP}: {_verdict(ratio <= LIMIT_LOOP)}")


def _verdict(reached: bool) -> str:
    return "yes" if reached else "NO"


def main() -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--chains", type=int, nargs="*", default=[2, 5, 10], help="numbers of FMUs")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--no-peers", action="store_true")
    parser.add_argument("--no-study", action="store_true")
    parser.add_argument("--json", type=Path, default=None)
    options = parser.parse_args()
    results: dict[str, Any] = {}
    if options.chains:
        times = {n: chain_times(n, options.rounds, not options.no_peers) for n in sorted(options.chains)}
        print_chains(times)
        results["chains_us"] = times
    if not options.no_study:
        study = study_times(3 * options.rounds)
        print_study(study)
        results["study_ms"] = study
    if options.json is not None:
        options.json.write_text(json.dumps(results, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
