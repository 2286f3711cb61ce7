"""Runs of a sweep: the numbers of single runs, failures as rows, the same rows however they are computed."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow.parquet as pq
import pytest

from interarea.cosim.errors import SweepError
from interarea.cosim.run.run import run_scenario
from interarea.cosim.sweep.front import Progress, run_sweep, task_size
from interarea.cosim.sweep.parts import read_plan, read_rows, read_trajectory
from interarea.cosim.sweep.plan import plan_sweep
from interarea.cosim.sweep.point import point_of
from interarea.cosim.sweep.runner import Runner
from interarea.cosim.sweep.spec import load_sweep


@pytest.mark.slow
def test_a_row_has_the_numbers_of_a_single_run(document: Any, finished: Any, cache: Path) -> None:
    sweep = load_sweep(document())
    _, rows = finished
    for k in (1, 11):
        run = run_scenario(point_of(sweep, sweep.values(k)).scenario, cache=cache)
        row = rows.iloc[k]
        assert (row.peak_pu, row.energy_pu2s, row.effort_pu2s) == (
            run.metrics.peak_pu,
            run.metrics.energy_pu2s,
            run.metrics.effort_pu2s,
        )
        assert row.damping_inter_area == run.metrics.damping_ratio["inter-area"]
        assert row.packets_lost == sum(c["dropped"] for c in run.packets.rows.values())
        assert row.packets_sent == 402  # two channels, a packet every 20 ms for 4 s, both ends
        assert bool(row.stable) == run.metrics.stable


def test_every_run_is_there_once_and_says_what_it_was(finished: Any, document: Any) -> None:
    folder, rows = finished
    sweep = load_sweep(document())
    assert list(rows.run) == list(range(12))
    assert [dict(r) for r in rows[["latency", "loss"]].to_dict("records")] == [
        sweep.values(k) for k in range(12)
    ]
    assert set(rows.status) == {"ok"}
    summary = json.loads((folder / "summary.json").read_text())
    assert (summary["runs"], summary["ok"], summary["failed"]) == (12, 12, 0)


@pytest.mark.slow
def test_the_order_of_runs_and_what_ran_before_do_not_matter(
    document: Any, cache: Path, tmp_path: Path
) -> None:
    plan = plan_sweep(load_sweep(document()), cache)
    with Runner(plan, cache, tmp_path) as one:
        forwards = [one.outcome(k).row for k in (0, 5, 11)]
    with Runner(plan, cache, tmp_path) as two:
        backwards = [two.outcome(k).row for k in (11, 5, 0)]
    assert forwards == backwards[::-1]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_the_same_rows_for_any_number_of_workers(
    document: Any, finished: Any, cache: Path, tmp_path: Path
) -> None:
    for workers in (2, 3):
        run_sweep(document(), tmp_path / str(workers), workers=workers, cache=cache)
        pd.testing.assert_frame_equal(read_rows(tmp_path / str(workers)), finished[1], check_exact=True)


def test_a_finished_sweep_is_not_run_again(document: Any, finished: Any, cache: Path, tmp_path: Path) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(finished[0], folder)
    before = {p: p.stat().st_mtime_ns for p in (folder / "runs").iterdir()}
    seen: list[Progress] = []
    run_sweep(document(), folder, workers=1, cache=cache, progress=seen.append)
    assert {p: p.stat().st_mtime_ns for p in (folder / "runs").iterdir()} == before
    assert seen == []


def test_another_specification_is_refused_with_the_difference(
    document: Any, finished: Any, cache: Path
) -> None:
    with pytest.raises(SweepError, match=r"another specification \(sweep.seed: stored 3, now 4\)"):
        run_sweep(document(seed=4), finished[0], cache=cache)
    with pytest.raises(SweepError, match=r"scenario.stop_s: stored 4.0, now 3.0"):
        run_sweep(document({"stop_s": 3.0}), finished[0], cache=cache)


def test_another_version_is_refused(
    document: Any, finished: Any, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("interarea.cosim.sweep.plan.code_version", lambda: "0123456789abcdef")
    with pytest.raises(
        SweepError, match=r"another version of the program \(version: stored .*now .0123456789"
    ):
        run_sweep(document(), finished[0], cache=cache)


def test_nothing_temporary_stays_and_nothing_appears_elsewhere(finished: Any) -> None:
    names = {p.name for p in finished[0].iterdir()}
    assert names == {".lock", "manifest.json", "runs", "summary.json", "sweep.json"}
    assert all(p.name.startswith("part-") for p in (finished[0] / "runs").iterdir())


def test_columns_say_their_unit_and_meaning(finished: Any) -> None:
    schema = pq.read_schema(next((finished[0] / "runs").glob("part-*")))
    assert schema.field("settling_time_s").metadata[b"unit"] == b"s"
    assert b"ring-down" in schema.field("damping_inter_area").metadata[b"description"]
    assert read_plan(finished[0]).hash.encode() == schema.metadata[b"specification"]


def _rows(table: dict[str, Any], cache: Path, scratch: Path) -> list[dict[str, Any]]:
    plan = plan_sweep(load_sweep(table), cache)
    with Runner(plan, cache, scratch) as runner:
        return [runner.outcome(k).row for k in range(plan.sweep.size)]


@pytest.mark.slow
def test_a_failing_run_is_a_row_with_its_reason(document: Any, cache: Path, tmp_path: Path) -> None:
    # Ten times the load has no power flow; the runs beside it are not touched by that.
    table = {"load": {"path": "case.load_scale", "values": [1.0, 10.0, 0.9]}}
    rows = _rows(document({"stop_s": 1.0}, parameters=table), cache, tmp_path)
    assert [r["status"] for r in rows] == ["ok", "failed", "ok"]
    assert rows[1]["failure"] == "invalid"
    assert "power flow" in rows[1]["reason"]
    assert "peak_pu" not in rows[1]


@pytest.mark.slow
def test_a_time_limit_is_a_row(document: Any, cache: Path, tmp_path: Path) -> None:
    rows = _rows(document({"stop_s": 4000.0}, parameters={}, time_limit_s=0.2), cache, tmp_path)
    assert [(r["status"], r["failure"]) for r in rows] == [("failed", "time limit")]
    assert "more than 0.2 s of computing" in rows[0]["reason"]


def test_an_fmu_that_gives_nan_is_a_row(document: Any, cache: Path, tmp_path: Path) -> None:
    table = {"gain": {"path": 'controller."A[1,1]"', "values": [-6.0, 1e6]}}
    rows = _rows(document(parameters=table), cache, tmp_path)
    assert rows[0]["status"] == "ok"
    assert rows[1]["failure"] in ("not finite", "fmu")
    assert "controller" in rows[1]["reason"]


@pytest.mark.slow
def test_bisection_finds_the_edge_that_the_grid_shows(document: Any, cache: Path, tmp_path: Path) -> None:
    base = {"stop_s": 8.0, "step_s": 0.02}
    search = {
        "size": {
            "path": "controller.gain",
            "bisect": {"low": 1.0, "high": 401.0, "tolerance": 1.0, "scan": 5},
        }
    }
    row = _rows(document(base, parameters=search), cache, tmp_path)[0]
    edge, beyond = row["size"], row["size_unstable"]
    assert 0.0 < beyond - edge <= 1.0
    grid = {"size": {"path": "controller.gain", "values": [edge, beyond]}}
    assert [r["stable"] for r in _rows(document(base, parameters=grid), cache, tmp_path)] == [True, False]
    assert row["evaluations"] >= 5 + math.log2(100.0) - 5


def test_trajectories_are_kept_on_request(document: Any, cache: Path, tmp_path: Path) -> None:
    keep = {"keep": "all", "columns": ["plant.G2_dw", "plant.G4_dw"], "every": 5}
    table = {"latency": {"path": "channels.remote.latency_s", "values": [0.1, 0.2]}}
    run_sweep(document(parameters=table, trajectories=keep), tmp_path / "t", workers=1, cache=cache)
    curves = read_trajectory(tmp_path / "t", 1)
    assert curves is not None
    assert list(curves) == ["time_s", "plant.G2_dw", "plant.G4_dw"]
    rows = read_rows(tmp_path / "t")
    assert (curves["plant.G2_dw"] - curves["plant.G4_dw"]).abs().max() <= rows.peak_pu[1]
    assert read_trajectory(tmp_path / "t", 7) is None


def test_tasks_are_hundreds_of_runs_and_fewer_where_all_must_have_a_share() -> None:
    assert task_size(100_000, 2) == 200
    assert task_size(80, 2) == 10
    assert task_size(1, 4) == 1
