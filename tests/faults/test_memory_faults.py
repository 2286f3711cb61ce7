"""Memory that runs out at one allocation of many: told as that, never as anything of a file; no harm done.

A run makes some 35 000 allocations, a sweep's folder some 8000: tried are 1, 2 .. and on, each 1.6 or 1.25
times the one before; all of them in `make fuzz`.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from file_faults import EVERY, LONG, grid, no_memory
from fmu_runner import decay_block
from stored_runs import finished, session
from test_run_faults import written

from interarea.cli.terminal import complain
from interarea.cosim.errors import machine_error
from interarea.cosim.master import records
from interarea.fmu_build.write.package import build_fmu
from interarea.models.errors import InterareaError

pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
CLEAN = 5  # attempts in a row without an error: their numbers are beyond the last allocation


@pytest.fixture(autouse=True)
def _small_parts_and_no_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(records, "PART", 5)
    monkeypatch.setattr(os, "fsync", lambda handle: None)


def assert_of_the_machine(error: Exception, n: int) -> None:
    """Nothing of ours calls it an error of a file; the interpreter makes a TypeError of it here and there."""
    assert machine_error(error) is not None or not isinstance(error, InterareaError), (n, error)


@LONG
def test_a_run(tmp_path: Path, cache: Path) -> None:
    """One line or none; whole files or none; with memory the same bits."""
    build_fmu(decay_block(), tmp_path / "x.fmu", cache=cache)
    whole = written(tmp_path, tmp_path / "whole", cache)
    clean = told = 0
    for n in grid(ratio=1.6):
        out = tmp_path / str(n)
        try:
            with no_memory(n):
                written(tmp_path, out, cache)
        except Exception as error:
            assert_of_the_machine(error, n)
            told, clean = told + 1, 0
        else:
            clean += 1
        left = {p.name: p.read_bytes() for p in out.iterdir()} if out.is_dir() else {}
        left.pop("run.json", None)
        assert left.items() <= whole.items(), n
        assert written(tmp_path, out, cache) == whole, n
        if clean == CLEAN:
            break
    assert n > 10_000 and told > (20_000 if EVERY else 12)


@LONG
def test_the_folder_of_a_sweep(tmp_path: Path) -> None:
    work = [[0, 1, 2, 3], [4, 5, 6, 7, 8]]
    session(tmp_path / "whole", work)  # imports
    clean = told = 0
    for n in grid(ratio=1.25):
        folder = tmp_path / str(n)
        try:
            with no_memory(n):
                session(folder, work)
        except Exception as error:
            assert_of_the_machine(error, n)
            told, clean = told + 1, 0
        else:
            clean += 1
        finished(folder)
        if clean == CLEAN:
            break
    assert n > 2000 and told > (2000 if EVERY else 12)


def test_the_command_line_tells_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert complain(MemoryError("Unable to allocate 3. GiB")) == complain(MemoryError()) == 2
    lines = ["interarea: not enough memory: Unable to allocate 3. GiB", "interarea: not enough memory"]
    assert capsys.readouterr().err.splitlines() == lines
