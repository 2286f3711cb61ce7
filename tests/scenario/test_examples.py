"""The examples run, and by hand and by master they agree as far as held inputs allow."""

from __future__ import annotations

import importlib.util
import re
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from interarea.cosim.run.artefacts import channel_fmu, plant_fmu
from interarea.cosim.run.controllers import controller_fmu
from interarea.cosim.run.run import run_scenario
from interarea.design.controllers.controller import Controller
from interarea.models.case.case import Case

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def _output(*command: str) -> str:
    done = subprocess.run(
        [sys.executable, *command], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


SCRIPTS = [p for p in sorted((EXAMPLES.parent / "docs").rglob("*.py")) if "__main__" in p.read_text("utf-8")]


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda p: p.name)
def test_help_of_what_draws_the_docs_starts_nothing(
    path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {p: p.stat().st_mtime_ns for p in path.parent.rglob("*") if p.is_file()}
    monkeypatch.setattr(sys, "argv", [str(path), "--help"])
    with pytest.raises(SystemExit) as stopped:
        runpy.run_path(str(path), run_name="__main__")
    assert stopped.value.code == 0 and capsys.readouterr().out.startswith("usage")
    assert before == {p: p.stat().st_mtime_ns for p in before}


def test_ten_lines() -> None:
    assert "inter-area damping 0.08" in _output(str(EXAMPLES / "ten_lines.py"))


@pytest.mark.slow
def test_a_system_in_python() -> None:
    text = _output(str(EXAMPLES / "any_loop.py"))
    assert "plant.G2_dw -> remote.u" in text
    assert re.search(r"\n1000 +10\.0\d* .* False\n", text)
    assert "units: pu, rad" in text


@pytest.mark.slow
def test_a_new_controller_moves_the_damping() -> None:
    match = re.search(r"damping ([\d.]+) -> ([\d.]+)", _output(str(EXAMPLES / "own_controller.py")))
    assert match is not None
    assert float(match[2]) > float(match[1]) + 0.02


@pytest.mark.slow
def test_the_pytest_file() -> None:
    assert "1 passed" in _output(
        "-m", "pytest", "-q", "-p", "no:cacheprovider", str(EXAMPLES / "test_my_scenario.py")
    )


def test_plain_fmpy_imports_fmpy_and_numpy_only_and_names_what_is_missing(tmp_path: Path) -> None:
    names = set(re.findall(r"^(?:from|import) (\w+)", (EXAMPLES / "plain_fmpy.py").read_text(), re.MULTILINE))
    assert names - set(sys.stdlib_module_names) == {"fmpy", "numpy"}
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / "plain_fmpy.py")], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 1 and "Traceback" not in done.stderr
    assert "fmus/robust.fmu not there; first run: interarea build two-area-thesis" in done.stderr


def test_by_hand_and_by_master_agree_but_for_the_delay_of_held_inputs(
    hand_controller: Controller, by_hand: Controller, two_area: Case, cache: Path
) -> None:
    spec = importlib.util.spec_from_file_location("plain_fmpy", EXAMPLES / "plain_fmpy.py")
    assert spec is not None and spec.loader is not None
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    rows = example.run(
        plant_fmu(two_area, cache),
        channel_fmu(cache),
        controller_fmu(hand_controller, two_area.omega_b, cache),
    )
    late = {"remote": {"signal": "G2_dw", "latency_s": 0.1}, "local": {"signal": "G4_dw", "latency_s": 0.1}}
    pulse = {"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 1.0, "end_s": 1.2}
    document = {"case": "two-area-thesis", "controller": "wdc", "stop_s": 5.0, "step_s": 0.01}
    run = run_scenario(document | {"channels": late, "event": [pulse]}, controller=by_hand)
    at = np.searchsorted(run.trajectory.time_s, rows[:, 0] - 1e-9)
    dw24 = (run.trajectory["plant.G2_dw"] - run.trajectory["plant.G4_dw"])[at]
    # one or two steps of delay in a loop of 0.6 Hz: a few per cent
    assert np.max(np.abs(dw24 - rows[:, 1])) <= 0.05 * np.max(np.abs(dw24))
