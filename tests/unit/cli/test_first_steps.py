"""What a person does first, and does wrong first: relative folders, wrong files, closed pipes."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import invoke

from interarea.cli import destination
from interarea.cli.destination import folder_for
from interarea.cli.terminal import complain, steady_streams
from interarea.cosim.designs.design_file import load_design
from interarea.cosim.errors import DestinationError, ScenarioError
from interarea.cosim.run.artefacts import channel_fmu
from interarea.cosim.run.run import run_scenario
from interarea.cosim.run.system import System
from interarea.cosim.scenario.names import NAMED_CONTROLLERS
from interarea.cosim.study.report import _number, _percent
from interarea.cosim.sweep.parts import read_rows
from interarea.fmu_build.open.fmu_file import FmuFile
from interarea.fmu_build.write.cache import default_cache
from interarea.models.bundled import bundled
from interarea.models.case.case import case_names, load_case

SWEEP = """
[scenario]
case = "two-area-thesis"
stop_s = 1.0
step_s = 0.02
[[scenario.event]]
kind = "vref_pulse"
machine = "G1"
size_pu = 0.05
start_s = 0.1
end_s = 0.3
[parameters.size]
path = "event.1.size_pu"
values = [0.01, 0.02]
"""


@pytest.fixture
def interarea(interarea, monkeypatch: pytest.MonkeyPatch, tmp_path: Path):  # type: ignore[no-untyped-def]
    """Return a call of the command in an empty folder: arguments -> (exit code, stdout, stderr)."""
    monkeypatch.chdir(tmp_path)
    return interarea


def test_an_fmu_is_unpacked_to_an_absolute_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("scratch").mkdir()
    monkeypatch.setattr("tempfile.tempdir", "scratch")
    file = FmuFile(channel_fmu(default_cache()))
    assert file.folder.is_absolute() and file.folder.is_relative_to(tmp_path / "scratch")
    file.close()


@pytest.mark.slow
def test_a_sweep_into_a_folder_named_from_here(interarea) -> None:  # type: ignore[no-untyped-def]
    Path("two.toml").write_text(SWEEP, encoding="utf-8")
    code, out, err = interarea("sweep", "two.toml", "--out", "out/two", "--workers", 1)
    assert code == 0, err
    assert "2 runs: 2 ok" in out
    assert list(read_rows(Path("out/two")).status) == ["ok", "ok"]


@pytest.fixture
def kinds() -> dict[str, str]:
    """One file of each kind in the folder of the call: kind -> file."""
    Path("empty.toml").write_text("", encoding="utf-8")
    Path("folder").mkdir()
    Path("loop.fmu").write_bytes(b"PK\x03\x04 and so on")
    Path("sweep.toml").write_text(SWEEP, encoding="utf-8")
    Path("scenario.toml").write_text('case = "two-area-thesis"\nstop_s = 1.0\n', encoding="utf-8")
    Path("case.toml").write_text('base = "kundur-manual"\n', encoding="utf-8")
    return {path.stem: path.name for path in Path().iterdir()}


@pytest.mark.parametrize(
    ("command", "document"),
    [("run", "scenario"), ("ssp", "scenario"), ("sweep", "sweep"), ("study", "study"), ("design", "design")],
)
def test_a_file_of_another_kind_is_named_as_what_it_is(interarea, kinds, command: str, document: str) -> None:  # type: ignore[no-untyped-def]
    words = {
        "empty": "is empty",
        "folder": "folder" if command != "study" else "not a bundled study",
        "loop": "archive" if command != "study" else "not a study",
        "sweep": "is a sweep (`interarea sweep`)",
        "scenario": "is a scenario (`interarea run`)",
        "case": "is a case",
    }
    for kind, name in kinds.items():
        if kind == document or (kind == "case" and command in ("study", "design")):  # a grid will do there
            continue
        results = "results.json" if command == "design" else "results"
        code, out, err = interarea(command, name, "--out", results)
        assert code == 2 and out == "" and err.count("\n") == 1, err
        assert words[kind] in err and document in err and name in err, err
        assert not Path(results).exists()


def test_a_case_command_names_what_it_was_given(interarea, kinds) -> None:  # type: ignore[no-untyped-def]
    for kind, word in {"sweep": "is a sweep", "loop": "is no .toml file", "empty": "is empty"}.items():
        code, _, err = interarea("modes", kinds[kind])
        assert code == 2 and word in err and err.count("\n") == 1
    assert "no such file" in interarea("modes", "missing.toml")[2]


@pytest.mark.parametrize(
    "arguments",
    [
        ("run", "scenario.toml", "--out"),
        ("study", "--out"),
        ("sweep", "sweep.toml", "--out"),
        ("build", "two-area-thesis", "--out"),
        ("modes", "two-area-thesis", "--plot"),
        ("design", "robust", "--out", "x.json", "--plots"),
    ],
)
def test_a_folder_that_cannot_be_is_refused_before_any_work(interarea, kinds, monkeypatch, arguments) -> None:  # type: ignore[no-untyped-def]
    forbidden = pytest.fail
    monkeypatch.setattr("interarea.cosim.run.artefacts.linear_matrices", forbidden)
    monkeypatch.setattr("interarea.fmu_build.write.package.block_fmu", forbidden)
    before = sorted(Path().rglob("*"))
    for place in ("empty.toml", "empty.toml/below"):
        code, out, err = interarea(*arguments, place)
        assert code == 2 and out == "" and err.count("\n") == 1
        assert f"{arguments[-1]} {place}" in err and "wanted: a folder" in err
    assert sorted(Path().rglob("*")) == before


@pytest.mark.parametrize(
    "arguments",
    [
        ("ssp", "scenario.toml", "--out"),
        ("container", "scenario.toml", "--out"),
        ("export", "two-area-thesis", "--out"),
        ("import", "grid.raw", "--out"),
        ("design", "robust", "--out"),
    ],
)
def test_a_file_that_cannot_be_is_refused_before_any_work(interarea, kinds, arguments) -> None:  # type: ignore[no-untyped-def]
    for place, word in (
        ("folder", "is a folder"),
        ("empty.toml/x", "is a file"),
        (os.devnull, "not a regular"),
    ):
        code, out, err = interarea(*arguments, place)
        assert code == 2 and out == "" and err.count("\n") == 1
        assert f"--out {place}" in err and word in err


def test_permission_is_looked_at_at_the_nearest_folder_there_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(folder: Path) -> None:
        if folder == tmp_path:
            raise PermissionError

    monkeypatch.setattr(destination, "_try_to_write", refused)
    for place in (tmp_path / "a" / "b", tmp_path):
        with pytest.raises(DestinationError, match=f"no permission to write in {tmp_path}, wanted"):
            folder_for(place)
    (tmp_path / "mine").mkdir()
    assert folder_for(tmp_path / "mine" / "x") == tmp_path / "mine" / "x"


def test_export_makes_the_folders_above_its_file(interarea) -> None:  # type: ignore[no-untyped-def]
    code, out, _ = interarea("export", "two-area-thesis", "--out", "new/folder/case.toml")
    assert code == 0 and out.strip() == "new/folder/case.toml"
    assert load_case("new/folder/case.toml").hash == load_case("two-area-thesis").hash


def outside(*arguments: str, **environment: str) -> subprocess.Popen[str]:
    """Start the command as a process of its own."""
    command = [sys.executable, "-m", "interarea.cli.app", *arguments]
    return subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | environment,
        preexec_fn=_listen,
    )


def _listen() -> None:
    """Tests that a shell started in the background ignore Ctrl-C, and so would what they start."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.mark.slow
def test_a_terminal_without_our_letters_gets_plain_ones() -> None:
    process = outside("modes", "two-area-thesis", "--shapes", PYTHONIOENCODING="ascii")
    out, err = process.communicate()
    assert process.returncode == 0 and err == ""
    assert "-0.3164 +- 3.9127j" in out and "1.00 +0 deg" in out


def test_closed_streams_do_no_harm(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", None)
    monkeypatch.setattr(sys, "stderr", None)
    steady_streams()
    print("nobody reads this")
    assert sys.stdout.name == sys.stderr.name == os.devnull


@pytest.mark.slow
def test_a_stopped_command_says_so_and_leaves_nothing(tmp_path: Path) -> None:
    """Ctrl-C as soon as the command tells of its first stage."""
    out = tmp_path / "out"
    process = outside("study", "--out", str(out))
    assert process.stderr is not None
    assert process.stderr.readline() == "plant: done\n"
    process.send_signal(signal.SIGINT)
    _, err = process.communicate()
    assert process.returncode == 130
    assert err.splitlines()[-1] == "interarea: stopped" and "Traceback" not in err
    assert not (out / "study.json").exists()


def test_negative_zero_is_zero_in_a_report() -> None:
    assert _number(-0.0004) == "0.000" and _number(-0.25) == "−0.250"
    assert _percent(-0.0004) == "0.0 %"


def test_a_run_says_in_a_line_what_it_was(tmp_path: Path) -> None:
    """What pytest prints of `run` where an assertion of a user's test fails."""
    run = run_scenario("ring-down")
    text = repr(run)
    assert len(text) < 400 and "\n" not in text
    assert f"inter-area {run.damping_ratio():.3f}" in text and "'ring-down': two-area-thesis" in text
    assert repr(run.trajectory) == f"Trajectory(0 to 20 s, 2001 points, {len(run.data.columns) - 1} signals)"


def test_a_latency_without_its_unit_is_told_the_key(interarea) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ScenarioError, match=r"channels.remote.latency = 0.1, allowed: a table.*'latency_s'"):
        System(stop_s=1.0).channel("remote", latency=0.1)
    with pytest.raises(ScenarioError, match="add the plant first"):
        System(stop_s=1.0).event("vref_pulse", machine="G1")


def test_everything_listed_is_taken_by_its_command(interarea) -> None:  # type: ignore[no-untyped-def]
    code, out, _ = interarea("list", "--json")
    document = json.loads(out)
    assert code == 0 and all(document.values())
    assert set(document["cases"]) == set(case_names())
    assert set(document["scenarios"]) == set(bundled("scenario"))
    assert set(document["controllers"]) == set(NAMED_CONTROLLERS) - {"none"}
    for name in document["designs"]:
        assert load_design(name).name == name
    _, table, _ = interarea("list")
    assert all(name in table for rows in document.values() for name in rows)


def test_a_cache_that_cannot_be_written_is_named(capsys: pytest.CaptureFixture[str], monkeypatch) -> None:  # type: ignore[no-untyped-def]
    monkeypatch.delenv("INTERAREA_DEBUG", raising=False)
    refused = PermissionError(errno.EACCES, "Permission denied", str(default_cache() / "plant"))
    assert complain(refused) == 2
    assert "INTERAREA_CACHE" in capsys.readouterr().err
    assert complain(OSError(errno.ENOSPC, "No space left on device")) == 2
    assert capsys.readouterr().err == "interarea: No space left on device\n"


@pytest.mark.slow
def test_a_sweep_of_which_nothing_runs_says_why(interarea) -> None:  # type: ignore[no-untyped-def]
    tie = SWEEP.replace("event.1.size_pu", "case.tie_flow_mw").replace("[0.01, 0.02]", "[5000, 6000]")
    Path("far.toml").write_text(tie, encoding="utf-8")
    code, out, err = interarea("sweep", "far.toml", "--out", "far", "--workers", 1)
    assert code == 1 and "2 runs: 0 ok" in out and "2 failed" in out
    assert (
        "most frequent reason, 1 of 2: two-area-thesis-tie-plus-5000: the power flow does not converge" in err
    )


def test_a_run_without_a_folder_prints_and_writes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "s.toml").write_text(
        'case = "two-area-thesis"\nstop_s = 0.4\ncontroller = "robust"\n[channels.remote]\n'
        'signal = "G2_dw"\nlatency_s = 0.1\n',
        encoding="utf-8",
    )
    code, out, err = invoke(["run", "s.toml"], monkeypatch)
    assert code == 0, err
    assert "remote" in out and "100" in out  # the ledger, in ms
    assert "two-area-thesis, controller robust, 0.4 s: " in err
    assert "no files written; --out DIR" in err
    assert [p.name for p in tmp_path.iterdir()] == ["s.toml"]
