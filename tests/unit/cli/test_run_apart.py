"""`interarea run` with an FMU that was not built here: a crash of it is one line, and costs nothing else."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from fmu_runner import decay_block
from misbehaving import misbehaving_fmu

from interarea.fmu_build.write.package import block_fmu

Call = Callable[..., tuple[int, str, str]]


@pytest.fixture
def scenario(tmp_path: Path) -> Callable[..., Path]:
    """Return a function that writes a scenario of one FMU."""

    def write(fmu: Path, start: str, more: str = "") -> Path:
        file = tmp_path / "s.toml"
        table = f'[fmus.bad]\nfile = "{fmu.as_posix()}"\n{more}start = {{{start}}}\n'
        file.write_text(f"stop_s = 1.0\nstep_s = 0.1\n{table}", encoding="utf-8")
        return file

    return write


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="the FMU ends its process by a signal")
def test_a_crash_is_one_line(interarea: Call, scenario: Callable[..., Path], tmp_path: Path) -> None:
    fmu = misbehaving_fmu(tmp_path)
    code, out, said = interarea("run", scenario(fmu, "abort_at = 0.75"), "--out", tmp_path / "o", "--quiet")
    assert code == 2 and out == ""
    assert "bad: the run: the FMU ended the process of the run (SIGABRT)" in said
    assert "isolate = true" in said and len(said.strip().splitlines()) == 1
    assert not (tmp_path / "o").exists() or list((tmp_path / "o").iterdir()) == []


@pytest.mark.slow
def test_what_runs_apart_gives_what_it_gives_here(
    interarea: Call, scenario: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fmu = misbehaving_fmu(tmp_path)
    file = scenario(fmu, "u = 1.0")
    code, _, said = interarea("run", file, "--out", tmp_path / "apart")
    assert code == 0 and said.startswith("bad: third-party FMU, so the run has a separate process")
    monkeypatch.setenv("INTERAREA_GUARDED", "1")
    code, _, said = interarea("run", file, "--out", tmp_path / "here")
    assert code == 0 and "third-party FMU" not in said
    for name in ("trajectory.csv", "trajectory.parquet"):
        apart, local = (tmp_path / path / name for path in ("apart", "here"))
        assert apart.exists() == local.exists()
        assert not local.exists() or apart.read_bytes() == local.read_bytes()


@pytest.mark.slow
def test_a_mistake_there_has_its_own_code(
    interarea: Call, scenario: Callable[..., Path], tmp_path: Path
) -> None:
    code, _, said = interarea(
        "run", scenario(misbehaving_fmu(tmp_path), "nothing = 1.0"), "--out", tmp_path / "o", "--quiet"
    )
    assert code == 2 and "nothing" in said and len(said.strip().splitlines()) == 1


@pytest.mark.slow
def test_what_was_built_here_or_is_isolated_runs_here(
    interarea: Call, scenario: Callable[..., Path], tmp_path: Path, cache: Path
) -> None:
    ours = block_fmu(decay_block(), cache)
    assert "third-party FMU" not in interarea("run", scenario(ours, "u = 1.0"), "--out", tmp_path / "o")[2]
    file = scenario(misbehaving_fmu(tmp_path), "u = 1.0", "isolate = true\n")
    assert "third-party FMU" not in interarea("run", file, "--out", tmp_path / "p")[2]
