"""Twelve runs that are never simulated, and what a sweep's folder must hold of them in the end."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pyarrow as pa

from interarea.cosim.sweep.parts import read_rows, read_trajectory, summary_of
from interarea.cosim.sweep.plan import SweepPlan
from interarea.cosim.sweep.rows import Outcome, failed_row, start_row
from interarea.cosim.sweep.spec import load_sweep
from interarea.cosim.sweep.store import SweepStore

RUNS = 12


def plan_for(**change: Any) -> SweepPlan:
    """A plan of 12 runs that keep their trajectories; nothing of it is ever simulated."""
    event = {"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 0.5, "end_s": 0.7}
    document = {
        "scenario": {"case": "two-area-thesis", "stop_s": 4.0, "event": [event]},
        "parameters": {
            "size": {"path": "event.1.size_pu", "values": [0.1, 0.2, 0.3]},
            "stop": {"path": "stop_s", "values": [1.0, 2.0, 3.0, 4.0]},
        },
        "trajectories": {"keep": "all"},
    }
    return SweepPlan(load_sweep(document | change), {}, {}, ("inter-area",), "1")


PLAN = plan_for()


def outcome(run: int) -> Outcome:
    """What run `run` leaves: a function of its number, every fourth a failure."""
    if run % 4 == 3:
        return Outcome(failed_row(PLAN.sweep, run, "fmu", f"run {run} failed"))
    row = start_row(run, PLAN.sweep.values(run)) | {"stable": run % 2 == 0, "peak_pu": run / 7.0}
    curve = pa.table(
        {"run": pa.array([run] * 3, pa.int64()), "time_s": [0.0, 1.0, 2.0], "x": [run / 3.0] * 3}
    )
    return Outcome(row, curve)


def session(folder: Path, work: list[list[int]]) -> None:
    """Open the folder, append outcomes batch by batch."""
    with SweepStore(folder, PLAN) as store:
        for runs in work:
            store.append([outcome(run) for run in runs])


def finished(folder: Path) -> None:
    """Go on undisturbed, and check that everything is there once and as it was made."""
    with SweepStore(folder, PLAN) as store:
        todo = list(store.todo())
        store.append([outcome(run) for run in todo])
        assert list(store.todo()) == [] and store.count == RUNS
        store.finish()
    rows = read_rows(folder)
    assert list(rows.run) == list(range(RUNS))
    for run in range(RUNS):
        expected = outcome(run)
        for key, value in expected.row.items():
            assert rows[key][run] == value or (value is None and rows[key].isna()[run])
        curve = read_trajectory(folder, run)
        assert (curve is None) == (expected.trajectory is None)
        assert curve is None or list(curve.x) == [run / 3.0] * 3
    assert summary_of(folder)["failed"] == RUNS // 4
    assert (
        not [p for p in folder.rglob("*") if p.name.endswith(".partial")] and not (folder / ".work").exists()
    )
