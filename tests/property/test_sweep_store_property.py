"""Laws of the store: whatever is killed, cut off or spoilt, in the end every row is there once."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from stored_runs import PLAN, RUNS, finished, plan_for, session

from interarea.cosim.errors import SweepError
from interarea.cosim.sweep.parts import read_rows
from interarea.cosim.sweep.store import SweepStore


@pytest.fixture(autouse=True)
def _no_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing here outlives the test: the disk need not be waited for."""
    monkeypatch.setattr(os, "fsync", lambda handle: None)


class Killed(BaseException):
    """The process ends here."""


@contextlib.contextmanager
def killed_after(operations: int, torn: float) -> Iterator[None]:
    """End the process at file operation number `operations`; a file being written then is `torn` off."""
    left = [operations]

    def dying(real: Callable[..., Any], path_of: Callable[..., Any] | None = None) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            left[0] -= 1
            if left[0] == 0:
                if path_of is not None:
                    real(*arguments, **options)
                    path = Path(path_of(*arguments))
                    os.truncate(path, int(torn * path.stat().st_size))
                raise Killed
            return real(*arguments, **options)

        return call

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pq, "write_table", dying(pq.write_table, lambda table, where: where))
        patch.setattr(Path, "write_text", dying(Path.write_text, lambda path, text: path))
        for name in ("replace", "unlink", "mkdir"):
            patch.setattr(Path, name, dying(getattr(Path, name)))
        patch.setattr(os, "fsync", dying(lambda handle: None))
        yield


batches = st.lists(st.lists(st.integers(0, RUNS - 1), min_size=1, max_size=5), max_size=4)
sessions = st.lists(st.tuples(batches, st.integers(1, 60), st.floats(0.0, 1.0)), max_size=4)


@pytest.mark.slow
@settings(max_examples=25)
@given(sessions)
def test_killed_between_any_two_file_operations_nothing_is_lost_and_nothing_twice(
    plan: list[tuple[list[list[int]], int, float]],
) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "s"
        safe: set[int] = set()
        for work, operations, torn in plan:
            with contextlib.suppress(Killed), killed_after(operations, torn):
                session(folder, work)
            with contextlib.suppress(SweepError):  # killed before there was any part
                now = set(read_rows(folder).run)
                assert now >= safe  # a row that was there stays there
                safe = now
        finished(folder)


@pytest.mark.slow
@settings(max_examples=30)
@given(st.lists(st.permutations(range(RUNS)).map(lambda p: p[:5]), min_size=2, max_size=4), st.data())
def test_a_spoilt_part_is_found_and_its_runs_are_done_again(
    work: list[list[int]], data: st.DataObject
) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "s"
        session(folder, work)
        kind = data.draw(st.sampled_from(["runs", "trajectories"]))
        part = data.draw(st.sampled_from(sorted((folder / kind).glob("part-*"))))
        content = bytearray(part.read_bytes())
        at = data.draw(st.integers(0, len(content) - 1))
        how = data.draw(st.sampled_from(["cut", "flip", "zeros", "garbage"]))
        if how == "cut":
            content = content[:at]
        elif how == "flip":
            content[at] ^= 1 << data.draw(st.integers(0, 7))
        elif how == "zeros":
            content[at : at + 64] = bytes(len(content[at : at + 64]))
        else:
            content = bytearray(data.draw(st.binary(max_size=64)))
        changed = bytes(content) != part.read_bytes()
        part.write_bytes(bytes(content))
        if changed and kind == "runs":
            with pytest.raises(SweepError, match="is damaged; repeat the command of the sweep"):
                read_rows(folder)
        with SweepStore(folder, PLAN) as store:
            assert len(store.dropped) == changed
        finished(folder)


@settings(max_examples=12)
@given(
    st.sampled_from(
        [
            ({"seed": 5}, "sweep.seed: stored 0, now 5"),
            ({"name": "other"}, 'sweep.name: stored "sweep", now "other"'),
            ({"time_limit_s": 2.0}, "sweep.time_limit_s: stored 60.0, now 2.0"),
            ({"metrics": ["stable"]}, "sweep.metrics: stored"),
            ({"trajectories": {"keep": "none"}}, "sweep.trajectories.keep"),
            ({"parameters": {"stop": {"path": "stop_s", "values": [1.0]}}}, "sweep.parameters.size"),
        ]
    ),
    batches,
)
def test_another_specification_is_refused_and_changes_nothing(
    change: tuple[dict[str, Any], str], work: list[list[int]]
) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "s"
        session(folder, work)
        before = {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()}
        with pytest.raises(SweepError, match="holds results of another specification") as caught:
            SweepStore(folder, plan_for(**change[0]))
        assert change[1] in str(caught.value) and "\n" not in str(caught.value)
        assert {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()} == before
        shutil.rmtree(folder)
