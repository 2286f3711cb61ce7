"""What a run costs in calls, and the hash of what it gives: both independent of how busy the machine is.

    python benchmarks/loop_calls.py             # calls of a warm run, by part
    python benchmarks/loop_calls.py --slow 30   # the functions with the most time of their own and below
    python benchmarks/loop_calls.py --hashes    # a hash for each bundled scenario; compare before and after

A warm run: the FMUs lie in the cache, the process has run the scenario once before.
"""

from __future__ import annotations

import argparse
import cProfile
import hashlib
import json
import pstats
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from interarea.cosim.results.result import Result
from interarea.cosim.run.run import run_scenario, run_system
from interarea.cosim.scenario.scenario import load_scenario
from interarea.models.bundled import bundled

TWO_AREAS = {
    "case": "two-area-thesis",
    "controller": "wdc",
    "stop_s": 5.0,
    "channels": {"remote": {"signal": "G2_dw", "latency_s": 0.1}, "local": {"signal": "G4_dw"}},
    "event": [{"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 1.0, "end_s": 1.2}],
}


def profiled(run: Callable[[], object]) -> tuple[pstats.Stats, float]:
    """Return the profile of a call and the time that another call takes without it, s."""
    run()
    begin = time.perf_counter()
    run()
    wall_s = time.perf_counter() - begin
    profile = cProfile.Profile()
    profile.enable()
    run()
    profile.disable()
    return pstats.Stats(profile), wall_s


def calls_of_a_run() -> int:
    """Return the calls of a warm two-area run of 5 s whose metrics nobody reads."""
    return int(profiled(lambda: run_scenario(TWO_AREAS))[0].total_calls)  # type: ignore[attr-defined]


def run_hash(name: str) -> str:
    """Return a hash of what a bundled scenario gives: trajectory, ledger and metrics, to the bit."""
    scenario = load_scenario(name)
    result: Result = run_scenario(scenario) if scenario.case else run_system(scenario)
    digest = hashlib.sha256()
    for column in ("time_s", *result.data.columns):
        values = result.data.index if column == "time_s" else result.data[column]
        digest.update(column.encode() + np.ascontiguousarray(values, dtype=float).tobytes())
    digest.update(repr(result.ledger.as_rows()).encode())
    metrics = getattr(result, "metrics", None)
    digest.update(repr(metrics).encode())
    return digest.hexdigest()[:16]


def fmu_hashes(cache: Path) -> dict[str, str]:
    """Return the hash of each FMU in a cache, by the hash in its name."""
    return {f.stem: hashlib.sha256(f.read_bytes()).hexdigest()[:16] for f in sorted(cache.rglob("*.fmu"))}


def main() -> None:
    """Print calls or hashes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--slow", type=int, default=0, metavar="N", help="the N slowest functions")
    parser.add_argument("--hashes", action="store_true", help="hashes of all bundled scenarios, as JSON")
    args = parser.parse_args()
    if args.hashes:
        print(json.dumps({name: run_hash(name) for name in bundled("scenario")}, indent=1))
        return
    scenario = load_scenario(TWO_AREAS)
    for what, run in (
        ("scenario read", lambda: load_scenario(TWO_AREAS)),
        ("scenario read and run", lambda: run_scenario(TWO_AREAS)),
        ("run, and its metrics read", lambda: run_scenario(scenario).metrics),
    ):
        stats, wall_s = profiled(run)
        print(f"{what}: {stats.total_calls} calls, {1e3 * wall_s:.0f} ms")  # type: ignore[attr-defined]
        if args.slow and what == "scenario read and run":
            stats.sort_stats("cumulative").print_stats(args.slow)


if __name__ == "__main__":
    main()
