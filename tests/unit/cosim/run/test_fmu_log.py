"""Warnings and messages of FMUs reach the results; an FMU that ends the run leaves what there is."""

from __future__ import annotations

import json
import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from misbehaving import misbehaving_fmu

from interarea.cosim.errors import StepError
from interarea.cosim.master import fmu_log
from interarea.cosim.run.run import run_system, write_run
from interarea.cosim.run.system import System

SAID = "u = 0.00 is odd at 100% load"
WARNING = f"a: 4 steps with a warning, first at 0.01 s: '{SAID}'"
LINES = [f"a at {t:g} s: fmi2Warning: {SAID}" for t in (0.01, 0.02, 0.03, 0.04)]


@pytest.fixture(scope="module")
def misbehaving(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return misbehaving_fmu(tmp_path_factory.mktemp("misbehaving"))


def table(file: Path, *, isolate: bool = False, **start: float) -> dict[str, Any]:
    return {
        "stop_s": 0.05,
        "step_s": 0.01,
        "fmus": {"a": {"file": str(file), "start": start, "isolate": isolate}},
    }


@pytest.mark.slow
@pytest.mark.parametrize("isolate", [False, True])
def test_steps_with_a_warning_are_one_line_and_a_file(
    misbehaving: Path, tmp_path: Path, isolate: bool
) -> None:
    result, files = write_run(table(misbehaving, isolate=isolate, warn_at=0.015), tmp_path)
    assert result.warnings == (WARNING,)
    assert json.loads((tmp_path / "ledger.json").read_text())["warnings"] == [WARNING]
    assert (tmp_path / "fmu_log.txt").read_text().splitlines() == LINES
    assert tmp_path / "fmu_log.txt" in files


@pytest.mark.parametrize("engine", ["kernel", "python"])
def test_both_engines_count_the_same(misbehaving: Path, engine: str) -> None:
    result = System(stop_s=0.05, step_s=0.01, engine=engine).fmu("a", misbehaving, warn_at=0.015).run()
    assert result.trajectory.engine == engine
    assert (result.warnings, list(result.fmu_log)) == ((WARNING,), LINES)


def test_a_run_without_messages_has_no_log_and_removes_an_old_one(misbehaving: Path, tmp_path: Path) -> None:
    (tmp_path / "fmu_log.txt").write_text("of an earlier run\n")
    result, _ = write_run(table(misbehaving), tmp_path)
    assert result.warnings == () and result.fmu_log == ()
    assert not (tmp_path / "fmu_log.txt").exists()


def test_messages_are_shown_when_asked_for(misbehaving: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO, logger="interarea"):
        run_system(table(misbehaving, warn_at=0.045))
    assert f"a at 0.04 s: fmi2Warning: {SAID}" in caplog.messages


def test_what_is_beyond_the_room_for_lines_is_counted(
    misbehaving: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fmu_log, "MOST_LINES", 2)
    result = run_system(table(misbehaving, warn_at=0.0))
    assert result.fmu_log[2:] == ("a: 3 further messages were discarded, allowed: 2",)
    assert result.warnings[0].startswith("a: 5 steps with a warning")


@pytest.mark.slow
@pytest.mark.parametrize("isolate", [False, True])
def test_an_fmu_that_ends_the_run_leaves_results(misbehaving: Path, tmp_path: Path, isolate: bool) -> None:
    """dx/dt = 1 until it asks to end at 0.035 s: three steps are there, and metrics of before are not."""
    (tmp_path / "metrics.json").write_text("{}")
    with pytest.raises(StepError, match=r"end at t = 0\.035 s.*results up to t = 0\.03 s are in"):
        write_run(table(misbehaving, isolate=isolate, end_at=0.035, u=1.0), tmp_path)
    curve = np.loadtxt(tmp_path / "trajectory.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(curve[:, 1], [0.0, 0.01, 0.02, 0.03], atol=1e-15)
    (line,) = json.loads((tmp_path / "ledger.json").read_text())["warnings"]
    assert line.startswith("the run ended early: a: fmi2DoStep at t = 0.03 s")
    assert not (tmp_path / "metrics.json").exists() and (tmp_path / "run.json").exists()


def test_an_fmu_that_does_not_start_leaves_no_file(misbehaving: Path, tmp_path: Path) -> None:
    pair = {name: {"file": str(misbehaving), "start": {"alone": 0.0}} for name in ("a", "b")}
    with pytest.raises(StepError, match='its last log line: "2 instances"'):
        write_run({"stop_s": 0.05, "step_s": 0.01, "fmus": pair}, tmp_path)
    assert list(tmp_path.iterdir()) == []
