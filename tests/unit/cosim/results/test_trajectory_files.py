"""Files of a run written while it goes on: the same as at once, whole or not there, in little memory."""

from __future__ import annotations

import errno
import io
import json
import os
import resource
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from fmu_runner import decay_block

from interarea.cosim.errors import DestinationError, ScenarioError
from interarea.cosim.master import records
from interarea.cosim.results.run import Run
from interarea.cosim.results.trajectory_files import TrajectoryFiles
from interarea.cosim.run.run import run_system, write_run
from interarea.cosim.scenario.scenario import Scenario, load_scenario
from interarea.cosim.trajectory import TIME, Trajectory
from interarea.design.controllers.controller import Controller
from interarea.fmu_build.write.package import build_fmu

NAMES = ["trajectory.csv", "trajectory.parquet", "ledger.json", "scenario.toml", "run.json"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, cache: Path) -> Path:
    folder = tmp_path_factory.mktemp("plain")
    build_fmu(decay_block(), folder / "x.fmu", cache=cache)
    return folder


def scenario(folder: Path, **keys: object) -> Scenario:
    """Two FMUs and a channel, no case: 501 points."""
    table = {
        "folder": folder,
        "fmus": {"a": {"file": "x.fmu"}, "b": {"file": "x.fmu"}},
        "channels": {"line": {"latency_s": 0.05}},
        "connections": [["a.y", "line", "b.u"]],
        "stop_s": 5.0,
        "step_s": 0.01,
        **keys,
    }
    return load_scenario(table)


@pytest.mark.parametrize("engine", ["kernel", "python"])
def test_in_parts_as_at_once(
    engine: str, folder: Path, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Parts of 7 points: the same values, units and ledger as the trajectory that is kept whole."""
    if engine == "python":
        monkeypatch.setattr("interarea.cosim.master.master.kernel_or_reason", lambda: (None, "not asked for"))
    whole = run_system(scenario(folder), cache=cache)
    whole.save(tmp_path / "whole")
    monkeypatch.setattr(records, "PART", 7)
    result, files = write_run(scenario(folder), tmp_path / "parts", cache=cache)
    assert [f.name for f in files] == NAMES
    assert {f.name for f in (tmp_path / "parts").iterdir()} == set(NAMES)
    assert result.trajectory.engine.startswith(engine)
    texts = [(tmp_path / k / NAMES[0]).read_bytes() for k in ("parts", "whole")]
    assert texts[0] == texts[1]
    ledgers = [json.loads((tmp_path / k / NAMES[2]).read_text()) for k in ("parts", "whole")]
    ages = [ledger["packets"]["line"].pop("age mean") for ledger in ledgers]
    assert ledgers[0] == ledgers[1]
    assert ages[0] == pytest.approx(ages[1], rel=1e-12) and ages[0] > 0.0
    parts, at_once = (Trajectory.read_parquet(tmp_path / k / NAMES[1]) for k in ("parts", "whole"))
    pd.testing.assert_frame_equal(parts.data, at_once.data)
    assert (parts.units, parts.descriptions) == (at_once.units, at_once.descriptions)
    assert str(result.packets) == str(whole.packets) and result.warnings == whole.warnings


@pytest.mark.slow
def test_a_run_with_a_case_in_parts_as_at_once(
    hand_controller: Controller, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every file has the same bytes but for sums over all points, which may differ in the last digit."""
    loaded = load_scenario(
        {
            "case": "two-area-thesis",
            "controller": str(hand_controller.save(tmp_path / "k.json")),
            "stop_s": 4.0,
            "step_s": 0.01,
            "event": [{"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 0.5, "end_s": 0.7}],
            "channels": {"remote": {"signal": "G2_dw", "latency_s": 0.1}},
            "record": ["plant.*_dw", "remote.*"],
            "every": 3,
        }
    )
    whole = run_system(loaded, cache=cache)
    whole.save(tmp_path / "whole")
    monkeypatch.setattr(records, "PART", 23)
    run, files = write_run(loaded, tmp_path / "parts", cache=cache)
    names = [*NAMES, "metrics.json", "run.svg", "report.html"]
    assert [f.name for f in files] == names and {f.name for f in (tmp_path / "parts").iterdir()} == set(names)
    for name in (NAMES[0], NAMES[3], "run.svg"):
        assert (tmp_path / "parts" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes(), name
    metrics, at_once = (json.loads((tmp_path / k / names[5]).read_text()) for k in ("parts", "whole"))
    for key in ("energy_pu2s", "effort_pu2s"):
        assert metrics.pop(key) == pytest.approx(at_once.pop(key), rel=1e-13)
    assert metrics == at_once and metrics["settling_time_s"] != 0.0
    assert isinstance(run, Run) and run.summary == whole.summary  # type: ignore[attr-defined]
    parts, table = (Trajectory.read_parquet(tmp_path / k / NAMES[1]) for k in ("parts", "whole"))
    pd.testing.assert_frame_equal(parts.data, table.data)


@pytest.mark.parametrize("every", [1, 4, 50, 499, 500, 10_000])
def test_record_and_every(
    every: int, folder: Path, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The chosen columns at points 0, n, 2 n .. and the last, however the parts fall."""
    whole = run_system(scenario(folder), cache=cache).data
    monkeypatch.setattr(records, "PART", 33)
    write_run(scenario(folder, record=["b.*", "a.y"], every=every), tmp_path, cache=cache)
    result = Trajectory.read_parquet(tmp_path / NAMES[1]).data
    last = len(whole) - 1
    rows = [*range(0, last, every), last]
    expected = [c for c in whole.columns if c in (TIME, "a.y") or c.startswith("b.")]
    assert list(result.columns) == expected and len(expected) > 3
    pd.testing.assert_frame_equal(
        result, whole[expected].iloc[rows].reset_index(drop=True), check_dtype=False
    )
    text = pd.read_csv(tmp_path / NAMES[0])
    assert list(text.columns) == expected and np.array_equal(text["a.y"], result["a.y"])


def test_a_signal_that_is_not_there_is_refused_before_the_run(
    folder: Path, cache: Path, tmp_path: Path
) -> None:
    with pytest.raises(ScenarioError, match=r"record = 'a\.z': no signal has this name; did you mean 'a\.y'"):
        write_run(scenario(folder, record=["a.z"]), tmp_path / "out", cache=cache)
    assert not (tmp_path / "out").exists()


class _Full(io.TextIOBase):
    """A text file on a disk that is full from some byte on."""

    def __init__(self, file: io.TextIOBase, room: int) -> None:
        self.file, self.room = file, room

    def write(self, text: str) -> int:
        self.room -= len(text)
        if self.room < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return self.file.write(text)

    def close(self) -> None:
        self.file.close()


@pytest.mark.parametrize("room", [0, 500, 5000])
def test_a_full_disk_names_the_file_and_leaves_what_was_there(room: int, tmp_path: Path) -> None:
    columns = {TIME: np.arange(100.0), "x.y": np.sin(np.arange(100.0))}
    part = Trajectory(columns, {TIME: "s", "x.y": "1"})
    (tmp_path / NAMES[0]).write_text("before")
    with pytest.raises(DestinationError, match=r"trajectory\.csv: No space left on device: not written"):  # noqa: SIM117
        with TrajectoryFiles(tmp_path) as files:
            files._csv = _Full(files._csv, room)  # type: ignore[arg-type,assignment]
            for _ in range(5):
                files.add(part)
    assert list(tmp_path.iterdir()) == [tmp_path / NAMES[0]]
    assert (tmp_path / NAMES[0]).read_text() == "before"


SCRIPT = """
import resource, sys
from pathlib import Path
from interarea.cosim.run.run import write_run
folder, steps = Path(sys.argv[1]), int(sys.argv[2])
what = ({"case": "two-area-thesis", "record": ["plant.G1_dw"]} if sys.argv[5] == "case" else
        {"fmus": {"a": {"file": "x.fmu"}}, "record": ["a.y"]})
write_run({**what, "folder": folder, "stop_s": steps * 1e-4, "step_s": 1e-4, "every": int(sys.argv[3])},
          folder / "out", cache=Path(sys.argv[4]))
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def peak_mb(folder: Path, cache: Path, steps: int, every: int, what: str) -> float:
    """Largest resident memory of a run in a process of its own, MB."""
    command = [sys.executable, "-c", SCRIPT, str(folder), str(steps), str(every), str(cache), what]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return int(done.stdout) / (1024.0 if sys.platform == "linux" else 1048576.0)


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(resource, "RUSAGE_SELF"), reason="measures as POSIX does")
@pytest.mark.parametrize(("what", "every"), [("fmus", 1), ("case", 100)])
def test_ten_times_the_steps_take_no_more_memory(what: str, every: int, folder: Path, cache: Path) -> None:
    """1e6 steps beside 1e5: the clock's 10 bytes a step while it is made thrice, no results."""
    short, long = (peak_mb(folder, cache, steps, every, what) for steps in (100_000, 1_000_000))
    assert long < short + 60.0
