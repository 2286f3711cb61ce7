"""Memory that runs out at one allocation of many: told as that, never as anything of a file; no harm done.

A run makes some 35 000 allocations, one with a case 1.4 million, a sweep's folder some 8000; tried are 1, 2
.. and on, each 1.6 or 1.25 times the one before; in `make fuzz` all of them (1000 of a run with a case).
Each is tried in a process of its own: here and there it is the interpreter that crashes (expat in CPython
3.11), and then the files are as after any kill.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable
from itertools import count, islice
from pathlib import Path

import pytest
from file_faults import EVERY, LONG, SHARED, SHARES, grid, no_memory
from fmu_runner import decay_block
from stored_runs import finished, session
from test_run_faults import OF_A_CASE, WITH_A_CASE, plain, written

from interarea.cli.terminal import complain
from interarea.cosim.errors import machine_error
from interarea.cosim.master import records
from interarea.fmu_build.write.package import build_fmu
from interarea.models.errors import InterareaError

pytestmark = [
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
    pytest.mark.filterwarnings("ignore:This process:DeprecationWarning"),
    pytest.mark.skipif(not hasattr(os, "fork"), reason="forks"),
]
CLEAN = 2000 // SHARES if EVERY else 5  # in a row without an error: they lie beyond the last allocation
#: what the interpreter says in place of MemoryError
_SWALLOWED = ("not PosixPath", "can't allocate")


@pytest.fixture(autouse=True)
def _small_parts_and_no_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(records, "PART", 5)
    monkeypatch.setattr(os, "fsync", lambda handle: None)


def outcome_without_memory(n: int, act: Callable[[], object]) -> str:
    """Return what became of `act` in a process of its own, without allocation n: clean, told or crashed."""
    pid = os.fork()
    if pid == 0:
        code = 3  # whatever else ends it is no end without an error
        try:
            with no_memory(n):
                act()
            code = 0
        except Exception as error:
            of_a_file = isinstance(error, InterareaError) and machine_error(error) is None
            code = 1
            if of_a_file and not any(text in str(error) for text in _SWALLOWED):
                print(f"allocation {n}: {error!r}", flush=True)
                code = 2
        finally:
            os._exit(code)
    status = os.waitpid(pid, 0)[1]
    if os.WIFSIGNALED(status):
        return "crashed"
    code = os.WEXITSTATUS(status)
    assert code in (0, 1, 3), f"allocation {n} is told as an error of a file"
    return {0: "clean", 1: "reported", 3: "crashed"}[code]


@pytest.mark.slow
@LONG
@SHARED
def test_a_run(share: int, tmp_path: Path, cache: Path) -> None:
    """One line or none; whole files or none; with memory the same bits; no hidden half stays."""
    build_fmu(decay_block(), tmp_path / "x.fmu", cache=cache)
    table = plain(tmp_path)
    whole = written(table, tmp_path / "whole", cache)
    seen, clean = Counter[str](), 0
    for n in islice(grid(ratio=1.6), share, None, SHARES):
        out = tmp_path / str(n)
        outcome = outcome_without_memory(n, lambda out=out: written(table, out, cache))  # type: ignore[misc]
        seen[outcome], clean = seen[outcome] + 1, clean + 1 if outcome == "clean" else 0
        there = [p for p in out.iterdir() if p.suffix != ".partial"] if out.is_dir() else []
        left = {p.name: p.read_bytes() for p in there if p.name != "run.json"}
        assert left.items() <= whole.items(), (n, outcome, sorted(left))
        assert written(table, out, cache) == whole, n
        assert {p.name for p in out.iterdir()} == {*whole, "run.json"}, n
        if clean == CLEAN:
            break
    assert n > 10_000 and seen["reported"] > (20_000 // SHARES if EVERY else 12)
    assert seen["crashed"] < seen["reported"] // 4


@LONG
@SHARED
@pytest.mark.slow
def test_a_run_with_a_case(share: int, tmp_path: Path, cache: Path) -> None:
    """Where no error comes out every file is the same: none is swallowed and taken for a fact of the loop."""
    whole = written(WITH_A_CASE, tmp_path / "whole", cache, OF_A_CASE)
    seen, clean = Counter[str](), 0
    ratio = 1.01 if EVERY else 1.6
    for n in islice((k + int(ratio**k) for k in count()), share, None, SHARES):
        out = tmp_path / str(n)
        outcome = outcome_without_memory(n, lambda out=out: written(WITH_A_CASE, out, cache))  # type: ignore[misc]
        seen[outcome], clean = seen[outcome] + 1, clean + 1 if outcome == "clean" else 0
        there = [p for p in out.iterdir() if p.suffix != ".partial"] if out.is_dir() else []
        left = {p.name: p.read_bytes() for p in there}
        assert left.items() <= whole.items(), (n, outcome, sorted(left))
        assert outcome != "clean" or left.keys() == whole.keys(), n
        if left and outcome != "clean":
            assert written(WITH_A_CASE, out, cache, OF_A_CASE) == whole, n
        if clean == 3:
            break
    assert n > 1_000_000 and seen["reported"] > 20 and seen["crashed"] < seen["reported"] // 4


@pytest.mark.slow
@LONG
@SHARED
def test_the_folder_of_a_sweep(share: int, tmp_path: Path) -> None:
    work = [[0, 1, 2, 3], [4, 5, 6, 7, 8]]
    session(tmp_path / "whole", work)  # imports
    seen, clean = Counter[str](), 0
    for n in islice(grid(ratio=1.25), share, None, SHARES):
        folder = tmp_path / str(n)
        outcome = outcome_without_memory(n, lambda folder=folder: session(folder, work))  # type: ignore[misc]
        seen[outcome], clean = seen[outcome] + 1, clean + 1 if outcome == "clean" else 0
        finished(folder)
        if clean == CLEAN:
            break
    assert n > 2000 and seen["reported"] > (2000 // SHARES if EVERY else 12)
    assert seen["crashed"] < seen["reported"] // 4


def test_the_command_line_tells_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert complain(MemoryError("Unable to allocate 3. GiB")) == complain(MemoryError()) == 2
    lines = ["interarea: not enough memory: Unable to allocate 3. GiB", "interarea: not enough memory"]
    assert capsys.readouterr().err.splitlines() == lines
