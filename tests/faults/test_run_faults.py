"""A run whose files the machine refuses: at every file operation whole files or none, then the same bits."""

from __future__ import annotations

import errno
import io
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from file_faults import LONG, Fault, grid
from fmu_runner import decay_block
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

from interarea.cosim.master import records
from interarea.cosim.run.run import write_run
from interarea.fmu_build.write.package import build_fmu
from interarea.models.errors import InterareaError

SAME = ("trajectory.csv", "trajectory.parquet", "ledger.json", "scenario.toml")  # run.json: commits
OF_A_CASE = (*SAME, "metrics.json", "run.svg", "report.html", "run.json")  # in one test the commit is one
WITH_A_CASE = {
    "name": "small",
    "case": "two-area-thesis",
    "controller": "wdc",
    "stop_s": 1.0,
    "step_s": 0.02,
    "event": [{"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 0.1, "end_s": 0.2}],
}


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory, cache: Path) -> Path:
    folder = tmp_path_factory.mktemp("fmus")
    build_fmu(decay_block(), folder / "x.fmu", cache=cache)
    return folder


@pytest.fixture(autouse=True)
def _small_parts_and_no_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    """Parts of 5 points; nothing here outlives the test, so the disk need not be waited for."""
    monkeypatch.setattr(records, "PART", 5)
    monkeypatch.setattr(os, "fsync", lambda handle: None)


def plain(fmus: Path) -> dict[str, object]:
    """A run without a case."""
    return {"folder": fmus, "fmus": {"x": {"file": "x.fmu"}}, "stop_s": 0.2, "step_s": 0.01}


def written(
    table: Mapping[str, object], out: Path, cache: Path, names: tuple[str, ...] = SAME
) -> dict[str, bytes]:
    write_run(table, out, cache=cache)
    return {name: (out / name).read_bytes() for name in names}


@pytest.fixture
def drawn_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw the figure of run.svg and that of the page once; some 280 runs draw the same."""
    drawn: dict[bool, tuple[bytes, list[Bbox]]] = {}
    real = Figure.savefig

    def savefig(figure: Figure, file: io.BytesIO, *, transparent: bool, **options: Any) -> None:
        if transparent not in drawn:
            real(figure, file, transparent=transparent, **options)
            drawn[transparent] = (file.getvalue(), [axes.get_position() for axes in figure.axes])
            return
        content, places = drawn[transparent]
        file.write(content)
        for axes, place in zip(figure.axes, places, strict=True):  # the page reads where they came to lie
            axes.set_position(place)

    monkeypatch.setattr(Figure, "savefig", savefig)


@pytest.mark.parametrize("name", ["ENOSPC", pytest.param("EIO", marks=pytest.mark.slow)])
def test_a_fault_at_every_operation_leaves_whole_files_or_none(
    name: str, fmus: Path, cache: Path, tmp_path: Path
) -> None:
    assert faults_at_operations(plain(fmus), getattr(errno, name), cache, tmp_path) >= 20


@LONG
@pytest.mark.slow
def test_of_a_run_with_a_case_as_well(cache: Path, tmp_path: Path, drawn_once: None) -> None:
    """Every fourth; all of them in `make fuzz`."""
    assert faults_at_operations(WITH_A_CASE, errno.ENOSPC, cache, tmp_path, OF_A_CASE, step=4) >= 100


def faults_at_operations(
    table: Mapping[str, object],
    number: int,
    cache: Path,
    folder: Path,
    names: tuple[str, ...] = SAME,
    step: int = 1,
) -> int:
    """Let every `step`-th file operation of a run fail in turn; return how many operations there are."""
    whole = written(table, folder / "whole", cache, names)
    last, tried, reported = 0, 0, 0
    for n in grid(step=step):
        out, fault = folder / str(n), Fault(n, number)
        try:
            with fault.injected():
                written(table, out, cache)
        except OSError as error:  # told by the command line with the file's name where there is one
            assert error.errno == number
            reported += 1
        except InterareaError as error:  # of the result or, in the cache, of an artefact
            assert os.strerror(number) in str(error) and "\n" not in str(error)
            reported += 1
        if fault.count < n:
            break
        last, tried = n, tried + 1
        left = {p.name: p.read_bytes() for p in out.iterdir()} if out.is_dir() else {}
        if "run.json" not in names:
            left.pop("run.json", None)
        assert left.items() <= whole.items(), n
        assert written(table, out, cache, names) == whole, n
    assert reported > tried // 2
    return last
