"""Processes that die: no run is lost, none is there twice, and one that kills its worker is a row."""

from __future__ import annotations

import errno
import multiprocessing
import os
import pickle
import random
import signal
import subprocess
import sys
from collections import Counter
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import kills  # this and the next beside this file
import pandas as pd
import pytest
import stand_ins

from interarea.cosim.errors import SweepError
from interarea.cosim.sweep import parts
from interarea.cosim.sweep.front import Progress, run_sweep
from interarea.cosim.sweep.parts import read_rows
from interarea.cosim.sweep.plan import plan_sweep
from interarea.cosim.sweep.rows import Outcome, start_row
from interarea.cosim.sweep.spec import load_sweep
from interarea.cosim.sweep.store import SweepStore
from interarea.cosim.sweep.workers import pool as sweep_local

needs_proc = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc")


@pytest.mark.slow
def test_a_killed_worker_costs_nothing(document: Any, finished: Any, cache: Path, tmp_path: Path) -> None:
    killed: list[int] = []

    def kill_once(p: Progress) -> None:
        if p.done and not killed:
            for child in multiprocessing.active_children():
                assert child.pid is not None
                killed.append(child.pid)
                os.kill(child.pid, signal.SIGKILL)

    run_sweep(document(), tmp_path / "out", workers=1, cache=cache, progress=kill_once)
    assert killed
    pd.testing.assert_frame_equal(read_rows(tmp_path / "out"), finished[1], check_exact=True)
    assert not (tmp_path / "out" / ".work").exists()


@needs_proc
@pytest.mark.slow
@pytest.mark.timeout(900)  # each start takes as long as the machine lets it
def test_kills_at_random_times_leave_every_row_once(tmp_path: Path) -> None:
    file = tmp_path / "sweep.toml"
    file.write_text(kills.SWEEP.format(losses=4), encoding="utf-8")
    expected = kills.undisturbed(file)
    chance, counts, longest_s = random.Random(2), Counter[str](), 2.0
    for k in range(12):  # however quick the machine is: kills come sooner until there are enough
        left = 10 - sum(counts[kind] for kind in kills.KINDS)
        if not left:
            break
        counts += kills.disturb(file, tmp_path / str(k), left, chance, longest_s=longest_s)
        kills.check(tmp_path / str(k), expected)
        longest_s /= 2.0
    assert sum(counts[kind] for kind in kills.KINDS) >= 10 and all(counts[kind] for kind in kills.KINDS)


def test_a_run_that_kills_its_worker_or_hangs_is_a_row(
    document: Any, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sweep_local, "work", stand_ins.crashing_work)
    monkeypatch.setattr(sweep_local, "_GRACE_S", 0.5)
    plan = plan_sweep(load_sweep(document(time_limit_s=0.1)), cache)
    outcomes = sweep_local.local_outcomes(plan, range(6), cache=cache, scratch=tmp_path, workers=1, task=6)
    rows = {o.row["run"]: o.row for batch in outcomes for o in batch}
    assert sorted(rows) == [0, 1, 2, 3, 4, 5]
    assert [rows[k]["failure"] for k in range(6)] == [None, None, "worker died", None, "time limit", None]
    assert "SIGSEGV" in rows[2]["reason"]


def test_of_runs_under_way_together_only_the_one_that_kills_the_worker_fails(
    document: Any, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sweep_local, "work", stand_ins.together_work)
    plan = plan_sweep(load_sweep(document()), cache)
    outcomes = sweep_local.local_outcomes(plan, range(9), cache=cache, scratch=tmp_path, workers=2, task=6)
    rows = [o.row for batch in outcomes for o in batch]
    assert sorted(row["run"] for row in rows) == list(range(9))
    assert [(row["run"], row["failure"]) for row in rows if row["failure"]] == [(4, "worker died")]


def test_workers_that_cannot_start_end_the_sweep(
    document: Any, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sweep_local, "work", stand_ins.idle_work)
    plan = plan_sweep(load_sweep(document()), cache)
    with pytest.raises(SweepError, match="worker processes end before any run: exit code 0"):
        list(sweep_local.local_outcomes(plan, range(6), cache=cache, scratch=tmp_path, workers=1, task=6))


def test_a_server_that_is_just_being_killed_is_waited_for(
    document: Any, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It takes calls and ends in the midst of them until it has its turn to end: 106 in a row were seen."""
    waited: list[float] = []
    began = BaseProcess.start

    def start(process: BaseProcess) -> None:
        if sum(waited) < 1.0:
            raise EOFError
        began(process)

    monkeypatch.setattr(BaseProcess, "start", start)
    monkeypatch.setattr(sweep_local.time, "sleep", waited.append)
    monkeypatch.setattr(sweep_local, "work", stand_ins.together_work)
    plan = plan_sweep(load_sweep(document()), cache)
    options = {"cache": cache, "scratch": tmp_path, "workers": 1, "task": 6}
    outcomes = sweep_local.local_outcomes(plan, range(3), **options)
    assert [o.row["run"] for batch in outcomes for o in batch] == [0, 1, 2]
    waited[:] = [-1e9]
    with pytest.raises(SweepError, match="its server exits each time"):
        list(sweep_local.local_outcomes(plan, range(3), **options))


# -- the store ----------------------------------------------------------------------------


@pytest.fixture
def plan(document: Any, cache: Path) -> Any:
    return plan_sweep(load_sweep(document()), cache)


def _outcomes(plan: Any, *runs: int) -> list[Outcome]:
    return [Outcome(start_row(k, plan.sweep.values(k)) | {"peak_pu": float(k)}) for k in runs]


def test_a_store_takes_a_run_once(plan: Any, tmp_path: Path) -> None:
    with SweepStore(tmp_path / "s", plan) as store:
        assert store.append(_outcomes(plan, 3, 1, 3)) == 2
        assert store.append(_outcomes(plan, 1, 2)) == 1
        assert list(store.todo()) == [0, 4, 5, 6, 7, 8, 9, 10, 11]
    with SweepStore(tmp_path / "s", plan) as again:
        assert again.count == 3
    assert list(read_rows(tmp_path / "s").run) == [1, 2, 3]


def test_what_a_killed_process_leaves_is_swept_away(plan: Any, tmp_path: Path) -> None:
    with SweepStore(tmp_path / "s", plan) as store:
        store.append(_outcomes(plan, 0, 1))
    runs = tmp_path / "s" / "runs"
    (runs / ".part-000001.parquet.partial").write_bytes(b"PAR1 half a pa")
    (tmp_path / "s" / ".work" / "worker-0").mkdir(parents=True)
    (tmp_path / "s" / ".work" / "worker-0" / "plant.fmu").write_bytes(b"x")
    with SweepStore(tmp_path / "s", plan) as store:
        assert store.count == 2
        assert [p.name for p in runs.iterdir()] == [next(runs.glob("part-000000-*.parquet")).name]
        assert list(store.work.iterdir()) == []


def test_a_damaged_part_is_done_again(plan: Any, tmp_path: Path) -> None:
    with SweepStore(tmp_path / "s", plan) as store:
        store.append(_outcomes(plan, 0, 1))
        store.append(_outcomes(plan, 2))
    part = next((tmp_path / "s" / "runs").glob("part-000000-*.parquet"))
    part.write_bytes(part.read_bytes()[:-20])
    with SweepStore(tmp_path / "s", plan) as store:
        assert len(store.dropped) == 1
        assert list(store.todo())[:3] == [0, 1, 3]


def test_two_processes_do_not_write_into_one_folder(plan: Any, tmp_path: Path) -> None:
    with SweepStore(tmp_path / "s", plan), pytest.raises(SweepError, match="another process is writing"):
        SweepStore(tmp_path / "s", plan)


def test_a_folder_with_other_files_is_left_alone(plan: Any, tmp_path: Path) -> None:
    (tmp_path / "letter.txt").write_text("dear")
    with pytest.raises(SweepError, match="contains other files and no manifest"):
        SweepStore(tmp_path, plan)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["letter.txt"]


def test_a_full_disk_is_an_error_and_what_was_written_stays_valid(
    plan: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with SweepStore(tmp_path / "s", plan) as store:
        store.append(_outcomes(plan, 0, 1))

        def full(partial: Path, path: Path) -> None:
            raise OSError(errno.ENOSPC, "No space left on device", str(partial))

        with monkeypatch.context() as m:
            m.setattr(parts, "settle", full)
            with pytest.raises(
                SweepError, match=r"the disk is full; 2 of 12 runs are safe in .*same command again"
            ):
                store.append(_outcomes(plan, 2, 3))
        assert store.append(_outcomes(plan, 2)) == 1
    assert list(read_rows(tmp_path / "s").run) == [0, 1, 2]
    assert not list((tmp_path / "s" / "runs").glob(".*"))


@pytest.mark.slow
@needs_proc
@pytest.mark.parametrize("message", [b"", pickle.dumps(list(range(1000)))[:50]], ids=["none", "half"])
def test_a_worker_whose_main_process_is_killed_at_its_start_ends_without_a_traceback(message: bytes) -> None:
    program = (
        "import os, signal\n"
        "from multiprocessing import forkserver\n"
        "from interarea.cosim.sweep.workers import pool\n"
        "pool._context()\n"
        "_, write = forkserver.connect_to_new_process([])\n"
        f"os.write(write, {message!r})\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    # the end of its error stream comes when the last process has ended
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert (ended.returncode, ended.stderr) == (-signal.SIGKILL, "")
