"""Runs of a sweep side by side: the rows of runs made one by one, whatever stands beside what."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from plant_lanes import PlantLanes

from interarea.cosim.sweep import lane_batches
from interarea.cosim.sweep import runner as runner_module
from interarea.cosim.sweep.lane_batches import Lanes, by_plant, common_s, host_lanes, how_many, lanes_for
from interarea.cosim.sweep.live_instances import TimeUpError
from interarea.cosim.sweep.plan import plan_sweep
from interarea.cosim.sweep.point import point_of
from interarea.cosim.sweep.runner import Runner
from interarea.cosim.sweep.shared_start import Job
from interarea.cosim.sweep.spec import load_sweep
from interarea.fmu_build.write.lane_library import GroupLibrary
from interarea.models.case.case import load_case
from interarea.models.grid.network_tables import has_many_ports

FAULT = {"kind": "bus_fault", "bus": 8, "start_s": 0.2, "end_s": 0.25, "x_pu": 0.01}
PULSE = {"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 1.5, "end_s": 1.7}
LATENCY = {"path": "channels.remote.latency_s", "values": [0.1, 0.033, 0.2]}
LOSS = {"path": "channels.*.loss.rate", "values": [0.0, 0.3]}
SIZES = {"path": "event.2.size_pu", "values": [0.01, 0.02, 0.05]}
STARTS = {"path": "event.2.start_s", "values": [1.2, 0.703, 1.61]}
LOADS = {"path": "case.load_scale", "values": [1.0, 0.95]}
GAINS = {"path": "controller.gain", "values": [1.0, 0.5, 1.5]}
NOT_FINITE = {"path": 'controller."A[1,1]"', "values": [-6.0, 1e6]}
OUTAGES = {"path": "channels.remote.outages_s", "values": [[], [[1.6, 2.0]], [[0.9, 1.31]]]}
#: cases that alternate, points that are invalid, FMUs that fail, runs that share their beginning
SWEEPS: dict[str, dict[str, Any]] = {
    "latency and loss": {"latency": LATENCY, "loss": LOSS},
    "sizes and grids": {"size": SIZES, "load": LOADS},
    "gains, one in two not finite": {"gain": GAINS, "pole": NOT_FINITE},
    "instants": {"start": STARTS, "outage": OUTAGES},
    "operating points that do not exist": {"load": LOADS | {"values": [1.0, 10.0, 0.9]}, "size": SIZES},
    "seeds, controllers and none": {
        "seed": {"path": "seed", "values": [1, 2, 3]},
        "controller": {"path": "controller", "values": ["none", "KEPT"]},
    },
}


@pytest.fixture
def sweep(document: Any, controller_file: Path) -> Any:
    def make(name: str, **change: Any) -> dict[str, Any]:
        parameters = {k: dict(p) for k, p in SWEEPS[name].items()}
        for p in parameters.values():
            p["values"] = [str(controller_file) if v == "KEPT" else v for v in p["values"]]
        base = {"event": [FAULT, PULSE], "stop_s": 2.5}
        return document(base, parameters=parameters, **change)  # type: ignore[no-any-return]

    return make


def rows_of(
    table: dict[str, Any], cache: Path, scratch: Path, *, lanes: int, order: int = 1, shares: bool = True
) -> list[dict[str, Any]]:
    plan = plan_sweep(load_sweep(table), cache)
    with Runner(plan, cache, scratch) as runner:
        runner.lanes, runner.shares = min(lanes, runner.lanes), shares
        result = [o.row for o in runner.outcomes(range(plan.sweep.size)[::order])]
        again = [o.row for o in runner.outcomes(range(plan.sweep.size))]  # on instances that were used
    assert list(scratch.iterdir()) == []
    key = lambda row: row["run"]  # noqa: E731
    assert repr(sorted(again, key=key)) == repr(sorted(result, key=key))
    return sorted(result, key=key)


@pytest.mark.slow
@pytest.mark.parametrize("name", SWEEPS)
def test_rows_are_the_same_to_the_bit_side_by_side_and_one_by_one(
    name: str, sweep: Any, cache: Path, tmp_path: Path
) -> None:
    expected = rows_of(sweep(name), cache, tmp_path, lanes=1, shares=False)
    assert len({repr({k: v for k, v in row.items() if k != "run"}) for row in expected}) == len(expected)
    assert [row["run"] for row in expected] == list(range(len(expected)))
    assert any(row["status"] == "ok" for row in expected)
    for lanes, order, shares in ((8, 1, True), (4, -1, False), (2, -1, True)):
        rows = rows_of(sweep(name), cache, tmp_path, lanes=lanes, order=order, shares=shares)
        assert repr(rows) == repr(expected), (lanes, order, shares)


@pytest.mark.slow
def test_company_that_computes_too_long_is_made_alone(
    sweep: Any, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The limit is that of a run; runs beside it must not use it up."""
    expected = rows_of(sweep("latency and loss"), cache, tmp_path, lanes=1)
    plan = plan_sweep(load_sweep(sweep("latency and loss")), cache)
    begun: list[tuple[int, ...]] = []
    with Runner(plan, cache, tmp_path) as runner:
        original = runner._watch

        def hasty() -> Any:
            def watch(now_s: float, stop_s: float) -> None:
                raise TimeUpError("in company")

            return watch if len(begun[-1]) > 1 else original()

        monkeypatch.setattr(runner, "_watch", hasty)
        runner.on_build = lambda *runs: begun.append(runs)
        result = sorted((o.row for o in runner.outcomes(range(plan.sweep.size))), key=lambda row: row["run"])
        together = [runs for runs in begun if len(runs) > 1]
    assert repr(result) == repr(expected)
    if host_lanes(cache).count > 1:
        assert len(together) == 1  # what is too long once is not tried again
        assert sorted(run for runs in begun if len(runs) == 1 for run in runs) == list(range(len(result)))


@pytest.mark.slow
def test_without_the_library_runs_go_one_by_one(
    sweep: Any, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from interarea.fmu_build.errors import BuildError

    expected = rows_of(sweep("latency and loss"), cache, tmp_path, lanes=8)

    def missing(**_: Any) -> GroupLibrary:
        raise BuildError("no compiler")

    monkeypatch.setattr(lane_batches, "plant_group", missing)
    assert host_lanes(cache).count == 1
    assert repr(rows_of(sweep("latency and loss"), cache, tmp_path, lanes=8)) == repr(expected)


@pytest.mark.parametrize(("ports", "many"), [(2, False), (35, True)])
def test_plants_with_many_ports_are_known_before_they_are_compiled(
    ports: int, many: bool, cache: Path, tmp_path: Path
) -> None:
    """The C says the same: it has no memory for a group of such plants."""
    case = load_case("nets-nyps")
    impedance = {"P_zip": None, "Q_zip": None, "P_exponent": 2.0, "Q_exponent": 2.0}
    loads = [q if k < ports else q.model_copy(update=impedance) for k, q in enumerate(case.loads)]
    case = case.model_copy(update={"loads": tuple(loads)})
    assert has_many_ports(case, "sparse") is many
    plants = PlantLanes(case, cache, network="sparse")
    started = plants._started({})
    assert (plants.group.work(started.fmu.component, 2) is None) is many
    started.fmu.free()
    assert (plants.group.lanes > 1) is (host_lanes(cache, case).count > 1)  # this grid's network is dense


def test_no_library_is_compiled_for_plants_that_go_one_by_one(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = load_case("two-area-thesis")
    monkeypatch.setattr(lane_batches, "has_many_ports", lambda _: True)
    monkeypatch.setattr(lane_batches, "plant_group", None)  # not called
    assert host_lanes(cache, case) == lanes_for(cache, [case]) == Lanes(None, 1)


def jobs_of(sweep: Any, name: str, likes: list[float]) -> list[Job]:
    table = load_sweep(sweep(name))
    jobs = []
    for run, like in enumerate(likes):
        values = table.values(run % table.size)
        jobs.append(Job(run, values, point_of(table, values), like_next_s=like))
    return jobs


def test_runs_go_side_by_side_where_that_costs_less(sweep: Any) -> None:
    apart = jobs_of(sweep, "latency and loss", [-math.inf] * 6)
    assert how_many(apart, 8) == 6
    assert how_many(apart, 4) == 4
    assert how_many(apart, 1) == how_many(apart[:1], 8) == 1
    # all alike until 1.5 of 2.5 s
    assert how_many(jobs_of(sweep, "latency and loss", [1.5] * 5 + [-math.inf]), 8) == 6
    # two families, each alike almost to the end: what one by one shares is more
    assert how_many(jobs_of(sweep, "latency and loss", [0.0, *[2.4] * 6, -math.inf]), 8) == 1
    # the same run again and again costs nothing
    assert how_many(jobs_of(sweep, "latency and loss", [math.inf] * 5 + [-math.inf]), 8) == 1
    assert how_many([Job(0, {}), *apart], 8) == 1  # a point that cannot be described
    assert common_s(jobs_of(sweep, "latency and loss", [2.0, 1.5, math.inf, 0.3])) == 1.5
    assert common_s(apart) == 0.0


def test_runs_of_one_grid_follow_each_other(sweep: Any) -> None:
    jobs = jobs_of(sweep, "sizes and grids", [-math.inf] * 6)
    assert [job.values["load"] for job in jobs] == [1.0] * 3 + [0.95] * 3
    jobs = [jobs[k] for k in (1, 5, 0, 3, 2, 4)]
    assert [job.run for job in by_plant(jobs)] == [1, 0, 2, 5, 3, 4]
    assert how_many(jobs, 8) == 1
    assert how_many(by_plant(jobs), 8) == 3


@pytest.mark.slow
@pytest.mark.parametrize("gains", [True, False])
def test_plants_that_cannot_go_side_by_side_are_found_out(
    gains: bool, document: Any, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Loads of constant current can; many of them on a sparse network, for which False stands, cannot."""
    if not gains:
        monkeypatch.setattr(runner_module, "has_lanes", lambda _: False)
    case = {"path": "case.loads.L7.P_exponent", "values": [1.0]}
    sizes = {"path": "event.1.size_pu", "values": [0.01, 0.02, 0.03]}
    table = document({"stop_s": 0.8}, parameters={"load": case, "size": sizes})
    begun: list[tuple[int, ...]] = []
    plan = plan_sweep(load_sweep(table), cache)
    with Runner(plan, cache, tmp_path) as runner:
        runner.shares = False
        runner.on_build = lambda *runs: begun.append(runs)
        for _ in range(2):
            rows = [o.row for o in runner.outcomes(range(3))]
            assert [row["status"] for row in rows] == ["ok"] * 3
    if host_lanes(cache).count > 2:
        assert begun == [(0, 1, 2), *([(0, 1, 2)] if gains else [(0,), (1,), (2,)])]
