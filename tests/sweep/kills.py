"""Kill a sweep at random times, start it again, and compare what it leaves with an undisturbed run.

    python tests/sweep/kills.py --kills 500

Kills (SIGKILL) of four kinds, in turn: of a worker or the server that forks them; of the main process with
everything it is doing at that moment; of the whole tree at once; of the tree by a power cut, after which the
folder holds what was forced to disk, and of the rest what chance leaves (`power_cut`).
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
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from itertools import cycle
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from interarea.cosim.sweep.parts import read_rows

sys.path.append(str(Path(__file__).resolve().parents[1]))
import power_cut

from interarea.cosim.sweep.plan import plan_sweep
from interarea.cosim.sweep.rows import schema_of
from interarea.cosim.sweep.runner import Runner
from interarea.cosim.sweep.spec import load_sweep
from interarea.fmu_build.write.cache import default_cache

KINDS = ("worker", "main", "tree", "power")

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
    file: Path,
    folder: Path,
    kills: int,
    chance: random.Random,
    *,
    longest_s: float,
    kinds: Sequence[str] = KINDS,
) -> Counter[str]:
    """Run the sweep into `folder`, kill it up to `kills` times by `kinds` in turn; return how many of which.

    Under `lost` it counts what power cuts left otherwise than it was written.
    """
    done: Counter[str] = Counter()
    turn = cycle(kinds)
    while True:
        kind, done["starts"] = next(turn), done["starts"] + 1
        disk = folder.with_name(f"{folder.name}-disk")
        begin = ["-m", "interarea.cli.app"]
        if kind == "power" and sum(done[k] for k in KINDS) < kills:
            begin = [power_cut.__file__, str(disk), str(chance.randint(1, 30))]
        words = ["sweep", str(file), "--out", str(folder), "--workers", "2"]
        with tempfile.TemporaryFile() as errors:
            main = subprocess.Popen(
                [sys.executable, *begin, *words],
                stdout=subprocess.DEVNULL,
                stderr=errors,
                start_new_session=True,
            )
            while kind != "power" and sum(done[k] for k in KINDS) < kills:
                try:
                    main.wait(timeout=chance.uniform(0.0, longest_s))
                    break
                except subprocess.TimeoutExpired:
                    workers = children(main.pid)
                if kind == "worker" and not workers:
                    continue
                done[kind] += 1
                if kind == "worker":
                    with suppress(ProcessLookupError):  # ended in between
                        os.kill(chance.choice(workers), signal.SIGKILL)
                    kind = next(other for other in turn if other != "power")
                    continue
                main.kill() if kind == "main" else os.killpg(main.pid, signal.SIGKILL)
                break
            code = main.wait()
            if code not in (0, -signal.SIGKILL):
                errors.seek(0)
                raise RuntimeError(f"the sweep ended with {code}: {errors.read().decode()}")
        if disk.exists():
            if code:
                with suppress(ProcessLookupError):  # workers, which lost their main process
                    os.killpg(main.pid, signal.SIGKILL)
                done["power"], done["lost"] = (
                    done["power"] + 1,
                    done["lost"] + power_cut.cut(folder, disk, chance),
                )
            shutil.rmtree(disk, ignore_errors=True)
        if code == 0:
            return done


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
    parser.add_argument("--kills", type=int, default=500)
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
        total: Counter[str] = Counter()
        begin, sweeps = time.monotonic(), 0
        while (count := sum(total[kind] for kind in KINDS)) < options.kills:
            folder = root / f"out-{sweeps}"
            total += disturb(file, folder, options.kills - count, chance, longest_s=options.longest)
            check(folder, expected)
            shutil.rmtree(folder)
            sweeps += 1
            reported = f"{sweeps} sweeps, {dict(total)}, {time.monotonic() - begin:.0f} s"
            print(f"{reported}: every row once, same bits", flush=True)


if __name__ == "__main__":
    main()
