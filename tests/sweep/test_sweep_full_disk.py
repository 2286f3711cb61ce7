"""A disk that really is full: a small file system of its own, which only root can mount."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from interarea.cosim.errors import SweepError
from interarea.cosim.sweep import front as sweep_engine
from interarea.cosim.sweep.front import Progress, run_sweep
from interarea.cosim.sweep.parts import read_rows

SIZE_MB = 48


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """Return a folder with a file system of its own."""
    if not sys.platform.startswith("linux") or os.geteuid() != 0 or shutil.which("mount") is None:
        pytest.skip("only root can mount")
    folder = tmp_path / "disk"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", f"size={SIZE_MB}m", "tmpfs", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"no mounting here: {done.stderr.strip()}")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def fill(file: Path) -> None:
    """Write until nothing more fits."""
    with contextlib.suppress(OSError), file.open("wb", buffering=0) as ballast:
        for size in (1 << 20, 1 << 12):
            with contextlib.suppress(OSError):
                while True:
                    ballast.write(b"x" * size)


def sweep_of(document: Any) -> Any:
    gains = {"gain": {"path": "controller.gain", "range": {"start": 0.5, "stop": 1.5, "count": 60}}}
    return document({"stop_s": 0.8}, parameters=gains)


@pytest.mark.slow
def test_a_disk_that_fills_up_ends_the_sweep_with_all_that_was_written_and_room_lets_it_go_on(
    disk: Path, document: Any, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sweep_engine, "_PART_ROWS", 1)  # a part for each message
    ballast = disk / "ballast"

    def progress(p: Progress) -> None:
        if p.done and not ballast.exists():
            fill(ballast)

    with pytest.raises(SweepError, match=r"the disk is full; \d+ of 60 runs are safe in .*same command"):
        run_sweep(sweep_of(document), disk / "out", workers=1, cache=cache, progress=progress)
    written = read_rows(disk / "out")
    assert 0 < len(written) < 60
    assert not list((disk / "out" / "runs").glob(".*"))
    ballast.unlink()
    run_sweep(sweep_of(document), disk / "out", workers=1, cache=cache)
    rows = read_rows(disk / "out")
    assert list(rows.run) == list(range(60))
    retained = rows[rows.run.isin(written.run)].reset_index(drop=True)
    pd.testing.assert_frame_equal(retained, written, check_exact=True)


@pytest.mark.slow
def test_a_disk_without_room_for_the_first_files_says_so(disk: Path, document: Any, cache: Path) -> None:
    fill(disk / "ballast")
    with pytest.raises(SweepError, match=r"the disk is full"):
        run_sweep(sweep_of(document), disk / "out", workers=1, cache=cache)
    (disk / "ballast").unlink()
    summary = run_sweep(sweep_of(document), disk / "out", workers=1, cache=cache)
    assert (summary["runs"], summary["ok"]) == (60, 60)


def test_workers_without_room_for_their_files_say_so(
    disk: Path, document: Any, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Room for the manifest, none for the FMUs that a worker unpacks.
    prepare = sweep_engine.prepare

    def and_fill(*args: Any) -> Any:
        files = prepare(*args)
        fill(disk / "ballast")
        return files

    monkeypatch.setattr(sweep_engine, "prepare", and_fill)
    with pytest.raises(SweepError, match=r"the disk is full; 0 of 60 runs are safe"):
        run_sweep(sweep_of(document), disk / "out", workers=1, cache=cache)
