"""A run whose files the machine refuses: at every file operation whole files or none, then the same bits."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest
from file_faults import Fault
from fmu_runner import decay_block

from interarea.cosim.errors import DestinationError
from interarea.cosim.master import records
from interarea.cosim.run.run import write_run
from interarea.fmu_build.write.package import build_fmu

SAME = (
    "trajectory.csv",
    "trajectory.parquet",
    "ledger.json",
    "scenario.toml",
)  # run.json: commits


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory, cache: Path) -> Path:
    made = tmp_path_factory.mktemp("fmus")
    build_fmu(decay_block(), made / "x.fmu", cache=cache)
    return made


@pytest.fixture(autouse=True)
def _small_parts_and_no_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    """Parts of 5 points; nothing here outlives the test, so the disk need not be waited for."""
    monkeypatch.setattr(records, "PART", 5)
    monkeypatch.setattr(os, "fsync", lambda handle: None)


def written(fmus: Path, out: Path, cache: Path) -> dict[str, bytes]:
    table = {"folder": fmus, "fmus": {"x": {"file": "x.fmu"}}, "stop_s": 0.2, "step_s": 0.01}
    write_run(table, out, cache=cache)
    return {name: (out / name).read_bytes() for name in SAME}


@pytest.mark.parametrize("name", ["ENOSPC", pytest.param("EIO", marks=pytest.mark.slow)])
def test_a_fault_at_every_operation_leaves_whole_files_or_none(
    name: str, fmus: Path, cache: Path, tmp_path: Path
) -> None:
    whole = written(fmus, tmp_path / "whole", cache)
    count, told = 0, 0
    for n in range(1, 500):
        out, fault = tmp_path / str(n), Fault(n, getattr(errno, name))
        try:
            with fault.injected():
                written(fmus, out, cache)
        except OSError as error:  # told by the command line with the file's name where there is one
            assert error.errno == getattr(errno, name)
            told += 1
        except DestinationError as error:
            assert str(out) in str(error) and os.strerror(getattr(errno, name)) in str(error)
            assert "\n" not in str(error)
            told += 1
        if fault.count < n:
            break
        count += 1
        left = {p.name: p.read_bytes() for p in out.iterdir()} if out.is_dir() else {}
        left.pop("run.json", None)
        assert left.items() <= whole.items(), n
        assert written(fmus, out, cache) == whole, n
    assert 20 <= count < 499 and told > count // 2
