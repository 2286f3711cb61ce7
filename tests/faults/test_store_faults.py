"""The folder of a sweep when the machine fails: at every file operation, and while runs go again."""

from __future__ import annotations

import contextlib
import errno
import os
from pathlib import Path

import pandas as pd
import pytest
from file_faults import Fault
from stored_runs import PLAN, RUNS, finished, outcome, session

from interarea.cosim.errors import SweepError
from interarea.cosim.sweep.parts import read_rows
from interarea.cosim.sweep.rows import Outcome, start_row
from interarea.cosim.sweep.store import SweepStore

WORK = [[0, 1, 2, 3], [4, 5, 6, 7, 8]]
FAULTS = {"ENOSPC": "the disk is full", "EDQUOT": "the disk is full", "EFBIG": "too large", "EIO": "error"}


@pytest.fixture(autouse=True)
def _no_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing here outlives the test: the disk need not be waited for."""
    monkeypatch.setattr(os, "fsync", lambda handle: None)


@pytest.mark.parametrize(
    "name", ["ENOSPC", *(pytest.param(name, marks=pytest.mark.slow) for name in list(FAULTS)[1:])]
)
def test_a_fault_at_every_operation_leaves_no_false_row(name: str, tmp_path: Path) -> None:
    """Every n: one line that says what is safe, or no harm; then, with room, all as if nothing had been."""
    whole = Fault(0, 0)
    with whole.injected():
        session(tmp_path / "whole", WORK)
    assert whole.count >= 20
    said = 0
    for n in range(1, whole.count + 1):
        folder = tmp_path / str(n)
        with Fault(n, getattr(errno, name)).injected():
            try:
                session(folder, WORK)
            except SweepError as error:
                assert FAULTS[name] in str(error) and f"of {RUNS} runs are safe" in str(error), error
                assert "\n" not in str(error)
                said += 1
        with contextlib.suppress(SweepError):  # no part yet
            for row in read_rows(folder).to_dict("records"):
                assert row["status"] == outcome(row["run"]).row["status"]
        finished(folder)
    assert said > whole.count // 2


def repaired(run: int) -> Outcome:
    """What a run that failed leaves when it is done again."""
    return Outcome(start_row(run, PLAN.sweep.values(run)) | {"stable": True, "peak_pu": 1.0})


def test_failed_runs_go_again(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    finished(folder)
    before = read_rows(folder).set_index("run")
    with SweepStore(folder, PLAN) as store:
        assert store.forget_failed() == RUNS // 4
        todo = list(store.todo())
        assert todo == [run for run in range(RUNS) if run % 4 == 3]
        store.append([repaired(run) for run in todo])
        assert store.finish()["failed"] == 0
        assert store.forget_failed() == 0
    after = read_rows(folder).set_index("run")
    assert list(after.index) == list(range(RUNS)) and set(after.status) == {"ok"}
    same = [run for run in range(RUNS) if run % 4 != 3]
    pd.testing.assert_frame_equal(after.loc[same], before.loc[same], check_dtype=False)


@pytest.mark.slow
def test_a_fault_while_failed_runs_are_taken_away_costs_nothing(tmp_path: Path) -> None:
    count = 0
    for n in range(1, 200):
        folder = tmp_path / str(n)
        session(folder, WORK)
        fault = Fault(n, errno.ENOSPC)
        with SweepStore(folder, PLAN) as store, fault.injected(), contextlib.suppress(SweepError):
            store.forget_failed()
        finished(folder)
        if fault.count < n:
            break
        count += 1
    assert 8 <= count < 199


def test_a_sweep_killed_while_it_wrote_its_first_file_goes_on(tmp_path: Path) -> None:
    """What stands there then: the lock, a folder, and a file that has no name yet."""
    (tmp_path / "runs").mkdir()
    for name in (".lock", ".sweep.json-17626-xj10z9m4.partial"):
        (tmp_path / name).touch()
    finished(tmp_path)
    assert not list(tmp_path.glob(".*.partial"))
