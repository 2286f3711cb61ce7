"""Runs that share their beginning start from a saved state: the same rows to the bit, in whatever way."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from interarea.cosim.sweep.front import run_sweep
from interarea.cosim.sweep.parts import read_rows, summary_of
from interarea.cosim.sweep.plan import plan_sweep
from interarea.cosim.sweep.point import Point, point_of
from interarea.cosim.sweep.runner import Runner
from interarea.cosim.sweep.shared_start import Job, in_order, late_parameters, shared_until_s
from interarea.cosim.sweep.spec import load_sweep

FAULT = {"kind": "bus_fault", "bus": 8, "start_s": 0.2, "end_s": 0.25, "x_pu": 0.01}
PULSE = {"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 2.5, "end_s": 2.7}
OUTAGES = {"path": "channels.remote.outages_s", "values": [[], [[2.6, 3.0]], [[2.2, 3.0]], [[2.2, 2.51]]]}
SIZES = {"path": "event.2.size_pu", "values": [0.01, 0.02, 0.05]}
ENDS = {"path": "event.2.end_s", "values": [2.9, 2.61, 2.7]}
STARTS = {"path": "event.2.start_s", "values": [2.0, 1.003, 2.65]}
SEEDS = {"path": "seed", "values": [1, 2]}
LOST = {
    "remote": {
        "signal": "G2_dw",
        "latency_s": 0.1,
        "reporting_interval_s": 0.02,
        "jitter_s": 0.03,
        "on_loss": "hold_then_zero",
        "hold_s": 0.2,
        "loss": {"kind": "bernoulli", "rate": 0.2},
    },
    "local": {"signal": "G4_dw", "latency_s": 0.04},
}
SMOOTH = {name: {"signal": f"{name.upper()}_dw", "latency_s": 0.1} for name in ("g2", "g4")}
SWEEPS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "outages": ({}, {"outage": OUTAGES}),
    "outages and lost packets": ({"channels": LOST}, {"outage": OUTAGES}),
    "sizes": ({"channels": SMOOTH}, {"size": SIZES}),
    "ends and sizes": ({}, {"end": ENDS, "size": SIZES}),
    "starts": ({}, {"start": STARTS}),
    "held inputs": ({"channels": {}, "master": {"inputs": "hold-jacobi"}}, {"size": SIZES, "end": ENDS}),
    "no channels": ({"channels": {}}, {"size": SIZES}),
}


@pytest.fixture
def sweep_of_forks(document: Any) -> Any:
    def make(name: str) -> dict[str, Any]:
        scenario, parameters = SWEEPS[name]
        return document({"event": [FAULT, PULSE], **scenario}, parameters=parameters)  # type: ignore[no-any-return]

    return make


def rows_of(table: dict[str, Any], cache: Path, scratch: Path, *, shares: bool, order: int = 1) -> Any:
    plan = plan_sweep(load_sweep(table), cache)
    with Runner(plan, cache, scratch) as runner:
        runner.shares = shares
        result = list(runner.outcomes(range(plan.sweep.size)[::order]))
    assert list(scratch.iterdir()) == []
    return sorted((o.row for o in result), key=lambda row: row["run"]), sum(o.forked for o in result)


@pytest.mark.slow
@pytest.mark.parametrize("name", SWEEPS)
def test_rows_are_the_same_to_the_bit_with_forks_and_without(
    name: str, sweep_of_forks: Any, cache: Path, tmp_path: Path
) -> None:
    table = sweep_of_forks(name)
    without, none = rows_of(table, cache, tmp_path, shares=False)
    for order in (1, -1):
        rows, forked = rows_of(table, cache, tmp_path, shares=True, order=order)
        assert rows == without
        assert forked == len(rows) - 1
    assert none == 0
    assert {row["status"] for row in rows} == {"ok"}
    assert len({tuple(v for k, v in row.items() if k != "run") for row in rows}) == len(rows)


@pytest.mark.slow
def test_a_run_that_fails_after_a_fork_leaves_the_others_as_they_are(
    sweep_of_forks: Any, cache: Path, tmp_path: Path
) -> None:
    table = sweep_of_forks("sizes")
    table["parameters"] = {"size": {"path": "event.2.size_pu", "values": [0.01, 1e200, 0.02, 0.05]}}
    without, _ = rows_of(table, cache, tmp_path, shares=False)
    rows, _ = rows_of(table, cache, tmp_path, shares=True)
    assert rows == without
    assert [row["status"] for row in rows] == ["ok", "failed", "ok", "ok"]


@pytest.mark.slow
def test_the_same_rows_whatever_the_workers_and_the_folder_says_how_many_were_forked(
    sweep_of_forks: Any, cache: Path, tmp_path: Path
) -> None:
    table = sweep_of_forks("ends and sizes")
    frames = []
    for workers in (1, 2):
        seen = []
        folder = tmp_path / str(workers)
        summary = run_sweep(table, folder, workers=workers, cache=cache, progress=seen.append)
        frames.append(read_rows(folder))
        assert summary["forked"] == summary_of(folder)["forked"] == seen[-1].forked > 0
    pd.testing.assert_frame_equal(*frames, check_exact=True)
    plan = plan_sweep(load_sweep(table), cache)
    (tmp_path / "scratch").mkdir()
    with Runner(plan, cache, tmp_path / "scratch") as runner:
        alone = [runner.outcome(run).row for run in range(plan.sweep.size)]
    alone = pd.DataFrame(alone)[list(frames[0])]
    pd.testing.assert_frame_equal(frames[0], alone, check_exact=True, check_dtype=False)


def test_only_what_acts_later_is_shared(document: Any) -> None:
    axes = {"size": SIZES, "outage": OUTAGES, "seed": SEEDS, "all": {"path": "channels.*.latency_s"}}
    axes["all"]["values"] = [0.1]
    sweep = load_sweep(document({"event": [FAULT, PULSE]}, parameters=axes))
    assert late_parameters(sweep) == {"size", "outage"}
    search = {"path": "controller.gain", "bisect": {"low": 1.0, "high": 2.0, "tolerance": 0.1}}
    sweep = load_sweep(document({"event": [FAULT, PULSE]}, parameters={"size": SIZES, "gain": search}))
    assert late_parameters(sweep) == frozenset()


actions = st.lists(st.tuples(st.sampled_from([1.0, 2.0, 3.0, 4.0]), st.sampled_from("abc")), max_size=4).map(
    lambda runs: tuple(sorted(runs))
)


@pytest.mark.slow
@given(st.lists(actions, min_size=3, max_size=3))
def test_the_time_until_which_runs_are_alike_is_an_ultrametric(acts: list[Any]) -> None:
    point: Any = Point  # a run that has one; its content does not matter here
    a, b, c = (Job(k, {}, point, (), actions) for k, actions in enumerate(acts))
    assert shared_until_s(a, b) == shared_until_s(b, a)
    assert shared_until_s(a, c) >= min(shared_until_s(a, b), shared_until_s(b, c))
    until = shared_until_s(a, b)
    assert [x for x in a.actions if x[0] < until] == [x for x in b.actions if x[0] < until]
    assert (until == math.inf) == (a.actions == b.actions)


def test_the_order_is_only_changed_where_that_saves_time(document: Any) -> None:
    def order(parameters: dict[str, Any], base: dict[str, Any]) -> list[int]:
        sweep = load_sweep(document({"event": [FAULT, PULSE], **base}, parameters=parameters))
        from interarea.cosim.sweep.shared_start import actions_of

        late = late_parameters(sweep)
        jobs = []
        for run in range(sweep.size):
            values = sweep.values(run)
            point = point_of(sweep, values)
            key = tuple(v for name, v in values.items() if name not in late)
            jobs.append(Job(run, values, point, key, actions_of(point.scenario)))
        return [job.run for job in in_order(jobs)]

    sizes = {"path": "event.1.x_pu", "values": [0.01, 0.001, 0.1]}
    assert order({"size": sizes}, {}) == [0, 1, 2]  # all alike until the same instant
    assert order({"start": STARTS}, {}) == [1, 0, 2]  # 1.003, 2.0, 2.65 s: each starts where the last was
