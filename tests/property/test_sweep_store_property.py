"""Laws of the store: whatever is killed, cut off or spoilt, in the end every row is there once."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from interarea.cosim.errors import SweepError
from interarea.cosim.sweep.plan import SweepPlan
from interarea.cosim.sweep.rows import Outcome, failed_row, start_row
from interarea.cosim.sweep.spec import load_sweep
from interarea.cosim.sweep.store import SweepStore, read_rows, read_trajectory, summary_of

RUNS = 12


def plan_for(**change: Any) -> SweepPlan:
    """A plan of 12 runs that keep their trajectories; nothing of it is ever simulated."""
    event = {"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 0.5, "end_s": 0.7}
    document = {
        "scenario": {"case": "two-area-thesis", "stop_s": 4.0, "event": [event]},
        "parameters": {
            "size": {"path": "event.1.size_pu", "values": [0.1, 0.2, 0.3]},
            "stop": {"path": "stop_s", "values": [1.0, 2.0, 3.0, 4.0]},
        },
        "trajectories": {"keep": "all"},
    }
    return SweepPlan(load_sweep(document | change), {}, {}, ("inter-area",), "1")


PLAN = plan_for()


def outcome(run: int) -> Outcome:
    """What run `run` leaves: a function of its number, every fourth a failure."""
    if run % 4 == 3:
        return Outcome(failed_row(PLAN.sweep, run, "fmu", f"run {run} failed"))
    row = start_row(run, PLAN.sweep.values(run)) | {"stable": run % 2 == 0, "peak_pu": run / 7.0}
    curve = pa.table(
        {"run": pa.array([run] * 3, pa.int64()), "time_s": [0.0, 1.0, 2.0], "x": [run / 3.0] * 3}
    )
    return Outcome(row, curve)


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


def session(folder: Path, work: list[list[int]]) -> None:
    """Open the folder, append outcomes batch by batch."""
    with SweepStore(folder, PLAN) as store:
        for runs in work:
            store.append([outcome(run) for run in runs])


def finished(folder: Path) -> None:
    """Go on undisturbed, and check that everything is there once and as it was made."""
    with SweepStore(folder, PLAN) as store:
        todo = list(store.todo())
        store.append([outcome(run) for run in todo])
        assert list(store.todo()) == [] and store.count == RUNS
        store.finish()
    rows = read_rows(folder)
    assert list(rows.run) == list(range(RUNS))
    for run in range(RUNS):
        wanted = outcome(run)
        for key, value in wanted.row.items():
            assert rows[key][run] == value or (value is None and rows[key].isna()[run])
        curve = read_trajectory(folder, run)
        assert (curve is None) == (wanted.trajectory is None)
        assert curve is None or list(curve.x) == [run / 3.0] * 3
    assert summary_of(folder)["failed"] == RUNS // 4
    assert (
        not [p for p in folder.rglob("*") if p.name.endswith(".partial")] and not (folder / ".work").exists()
    )


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
            with pytest.raises(SweepError, match="is damaged; give the command of the sweep again"):
                read_rows(folder)
        with SweepStore(folder, PLAN) as store:
            assert len(store.dropped) == changed
        finished(folder)


@settings(max_examples=12)
@given(
    st.sampled_from(
        [
            ({"seed": 5}, "sweep.seed: there 0, here 5"),
            ({"name": "other"}, 'sweep.name: there "sweep", here "other"'),
            ({"time_limit_s": 2.0}, "sweep.time_limit_s: there 60.0, here 2.0"),
            ({"metrics": ["stable"]}, "sweep.metrics: there"),
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
