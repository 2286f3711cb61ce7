"""FMUs of the user's own in a sweep: found from anywhere, each in the process that the scenario says."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from misbehaving import misbehaving_fmu

from interarea.cosim.errors import SweepError
from interarea.cosim.master.isolated import WorkerParticipant
from interarea.cosim.sweep.front import run_sweep
from interarea.cosim.sweep.parts import read_rows
from interarea.cosim.sweep.plan import own_fmu, plan_of_document, plan_sweep
from interarea.cosim.sweep.runner import Runner
from interarea.cosim.sweep.spec import load_sweep
from interarea.fmu_build.errors import FmuFileError
from interarea.fmu_build.write.cache import keep

STOPS = {"stop": {"path": "stop_s", "values": [0.4, 0.8, 0.42]}}


@pytest.fixture
def own(tmp_path: Path, document: Any) -> Any:
    """Return a function that gives a sweep with a foreign FMU fed by a machine's speed."""
    (tmp_path / "fmus").mkdir()
    file = misbehaving_fmu(tmp_path / "fmus")

    def make(*, isolate: bool, **start: float) -> dict[str, Any]:
        fmu = {"file": str(file), "isolate": isolate, "start": start}
        scenario = {"fmus": {"mine": fmu}, "connections": [["plant.G1_dw", "mine.u"]], "event": []}
        return document(scenario, parameters=STOPS)  # type: ignore[no-any-return]

    return make


@pytest.mark.slow
def test_an_isolated_fmu_that_crashes_is_a_row_and_the_other_runs_are_there(
    own: Any, cache: Path, tmp_path: Path
) -> None:
    plan = plan_sweep(load_sweep(own(isolate=True, abort_at=0.5)), cache)
    with Runner(plan, cache, tmp_path) as runner:
        rows = [o.row for o in runner.outcomes(range(3))]
        system = next(iter(runner._live.values()))
        assert isinstance(system.participants["mine"], WorkerParticipant)
    assert [row["status"] for row in rows] == ["ok", "failed", "ok"]
    assert rows[1]["failure"] == "fmu"
    assert "mine: fmi2DoStep" in rows[1]["reason"] and "crashed its process" in rows[1]["reason"]


def test_the_file_goes_into_the_plan_by_its_content(own: Any, cache: Path, tmp_path: Path) -> None:
    table = own(isolate=False)
    plan = plan_sweep(load_sweep(table), cache)
    shutil.rmtree(tmp_path / "fmus")
    (tmp_path / "scratch").mkdir()
    again = plan_of_document(json.loads(json.dumps(plan.document())))
    with Runner(again, cache, tmp_path / "scratch") as runner:
        assert runner.outcome(0).row["status"] == "ok"
    with pytest.raises(FmuFileError, match="no such file, wanted: an FMU"):
        plan_sweep(load_sweep(table), cache)


@pytest.mark.parametrize("isolate", [False, True])
def test_a_connection_to_no_variable_of_it_is_refused_before_any_run(
    own: Any, cache: Path, tmp_path: Path, isolate: bool
) -> None:
    table = own(isolate=isolate)
    table["scenario"]["connections"] = [["plant.G1_dw", "mine.uu"]]
    with pytest.raises(SweepError, match="no run can be made: mine has no input 'uu'; did you mean 'u'"):
        run_sweep(table, tmp_path / "out", workers=1, cache=cache)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_worker_processes_give_the_same_rows_whether_isolated_or_not(
    own: Any, cache: Path, tmp_path: Path
) -> None:
    rows = []
    for isolate in (False, True):
        table = own(isolate=isolate)
        run_sweep(table, tmp_path / str(isolate), workers=2, cache=cache)
        rows.append(read_rows(tmp_path / str(isolate)))
        assert set(rows[-1].status) == {"ok"}
    assert rows[0].equals(rows[1])
    with pytest.raises(SweepError, match="another specification"):
        run_sweep(own(isolate=False), tmp_path / "True", workers=2, cache=cache)


def test_a_damaged_copy_of_an_own_fmu_is_refused_by_name(tmp_path: Path) -> None:
    path = keep(tmp_path / "own" / "0123.fmu", b"archive")
    assert own_fmu(tmp_path, "0123") == path
    path.write_bytes(b"archivf")
    with pytest.raises(SweepError, match=r"0123\.fmu: the copy of an FMU is damaged"):
        own_fmu(tmp_path, "0123")
