"""Kill a sweep at random times, start it again, and compare what it leaves with an undisturbed run.

    python tests/sweep/kills.py --kills 100

Half of the kills (SIGKILL) hit a worker or the server that forks
them, half the main process with everything it is doing at that moment.
"""

from __future__ import annotations

import argparse
import copy
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from interarea.cosim.sweep.parts import read_rows
from interarea.cosim.sweep.plan import plan_sweep
from interarea.cosim.sweep.rows import schema_of
from interarea.cosim.sweep.runner import Runner
from interarea.cosim.sweep.spec import load_sweep
from interarea.fmu_build.write.cache import default_cache

SWEEP = """
seed = 1
[scenario]
case = "two-area-thesis"
controller = "robust"
stop_s = 3.0
step_s = 0.02
[scenario.channels.remote]
signal = "G2_dw"
latency_s = 0.1
on_loss = "hold"
reporting_interval_s = 0.02
[[scenario.event]]
kind = "vref_pulse"
machine = "G1"
size_pu = 0.05
start_s = 0.5
end_s = 0.7
[parameters.latency]
path = "channels.remote.latency_s"
range = {{ start = 0.02, stop = 0.4, step = 0.02 }}
[parameters.loss]
path = "channels.remote.loss.rate"
range = {{ start = 0.0, stop = 0.9, count = {losses} }}
"""


def undisturbed(file: Path) -> pd.DataFrame:
    """Return the rows of a sweep computed in this process, in order, through nothing but a `Runner`."""
    plan = plan_sweep(load_sweep(file), default_cache())
    schema = schema_of(plan)
    with tempfile.TemporaryDirectory() as scratch, Runner(plan, default_cache(), Path(scratch)) as runner:
        rows = [copy.copy(runner.outcome(k).row) for k in range(plan.sweep.size)]
    whole = [{name: row.get(name) for name in schema.names} for row in rows]
    return pa.Table.from_pylist(whole, schema=schema).to_pandas()


def children(pid: int) -> list[int]:
    """Return the processes that a main process has begun, and those that these have (Linux)."""
    parent_of: dict[int, int] = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            with suppress(OSError):
                parent_of[int(entry.name)] = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
    first = [child for child, parent in parent_of.items() if parent == pid]
    return first + [child for child, parent in parent_of.items() if parent in first]


def disturb(
    file: Path, folder: Path, kills: int, chance: random.Random, *, longest_s: float
) -> dict[str, int]:
    """Run the sweep into `folder`, killing it up to `kills` times; return how many of which."""
    done = {"worker": 0, "main": 0, "starts": 0}
    command = [
        sys.executable,
        "-m",
        "interarea.cli.app",
        "sweep",
        str(file),
        "--out",
        str(folder),
        "--workers",
        "2",
    ]
    while True:
        done["starts"] += 1
        with tempfile.TemporaryFile() as errors:
            main = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=errors)
            while done["worker"] + done["main"] < kills:
                try:
                    main.wait(timeout=chance.uniform(0.0, longest_s))
                    break
                except subprocess.TimeoutExpired:
                    workers = children(main.pid)
                if chance.random() < 0.5 and workers:
                    os.kill(chance.choice(workers), signal.SIGKILL)
                    done["worker"] += 1
                    continue
                main.kill()
                done["main"] += 1
                break
            code = main.wait()
            if code == 0:
                return done
            if code != -signal.SIGKILL:
                errors.seek(0)
                raise RuntimeError(f"the sweep ended with {code}: {errors.read().decode()}")


def check(folder: Path, expected: pd.DataFrame) -> None:
    """Raise unless the folder holds each run once, equal to `expected`, and nothing temporary."""
    parts = [
        pq.read_table(p, columns=["run"]).column("run").to_pylist() for p in (folder / "runs").glob("part-*")
    ]
    runs = sorted(run for part in parts for run in part)
    assert runs == list(range(len(expected))), "a run is missing or there twice"
    pd.testing.assert_frame_equal(read_rows(folder), expected, check_exact=True)
    leftovers = [p for p in folder.rglob("*") if p.name.endswith(".partial") or p.name == ".work"]
    assert not leftovers, f"left behind: {leftovers}"


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--losses", type=int, default=50, help="20 times as many runs in each sweep")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--longest", type=float, default=8.0, help="longest time between kills, s")
    options: Any = parser.parse_args()
    chance = random.Random(options.seed)
    with tempfile.TemporaryDirectory() as name:
        root = Path(name)
        file = root / "sweep.toml"
        file.write_text(SWEEP.format(losses=options.losses), encoding="utf-8")
        expected = undisturbed(file)
        print(f"undisturbed: {len(expected)} runs", flush=True)
        total = {"worker": 0, "main": 0, "starts": 0}
        begin = time.monotonic()
        sweeps = 0
        while total["worker"] + total["main"] < options.kills:
            folder = root / f"out-{sweeps}"
            left = options.kills - total["worker"] - total["main"]
            for key, count in disturb(file, folder, left, chance, longest_s=options.longest).items():
                total[key] += count
            check(folder, expected)
            shutil.rmtree(folder)
            sweeps += 1
            print(f"{sweeps} sweeps, {total}, {time.monotonic() - begin:.0f} s: all rows equal", flush=True)


if __name__ == "__main__":
    main()
