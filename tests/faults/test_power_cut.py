"""Power that is lost before any fsync: what was told to be safe is there, and the same command goes on."""

from __future__ import annotations

import contextlib
import os
import random
from pathlib import Path

import pytest
from power_cut import Disk, cut
from stored_runs import PLAN, finished, outcome

from interarea.cosim.errors import SweepError
from interarea.cosim.sweep.parts import read_rows
from interarea.cosim.sweep.store import SweepStore
from interarea.models.files import write_whole

pytestmark = pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="looks for files in /proc")
WORK = [[0, 1, 2, 3], [4, 5, 6], [7, 8]]


class Lost(BaseException):
    """The power."""


class Power:
    """Lost before fsync number `at`; `count` of them all."""

    def __init__(self, at: int, disk: Disk) -> None:
        self.at, self.disk, self.count = at, disk, 0

    def fsync(self, handle: int) -> None:
        self.count += 1
        if self.count == self.at:
            raise Lost
        self.disk.forced(handle)


def safe_rows(folder: Path) -> set[int]:
    with contextlib.suppress(SweepError):
        return set(read_rows(folder).run)
    return set()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_before_every_fsync_of_a_sweep(seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows that `append` has taken are there afterwards, those under way whole or not; then all are, once."""
    chance, lost = random.Random(seed), 0
    for n in range(1, 100):
        folder, place = tmp_path / f"{n}", tmp_path / f"{n}-disk"
        power, reported = Power(n, Disk(place)), set[int]()
        with monkeypatch.context() as patch, contextlib.suppress(Lost):
            patch.setattr(os, "fsync", power.fsync)
            with SweepStore(folder, PLAN) as store:
                for runs in WORK:
                    store.append([outcome(run) for run in runs])
                    reported.update(runs)
        if power.count < n:
            break
        lost += cut(folder, place, chance)
        with SweepStore(folder, PLAN):  # sweeps away what is half there
            pass
        assert reported <= safe_rows(folder), n
        finished(folder)
    assert 12 <= n < 99 and lost >= n // 2


@pytest.mark.parametrize("seed", range(4))
def test_a_file_is_the_old_or_the_new_one(seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    chance, path = random.Random(seed), tmp_path / "there" / "a.txt"
    write_whole(path, "old")
    for n in (1, 2, 3):
        place = tmp_path / f"{n}"
        power = Power(n, Disk(place))
        power.disk.begin(path.parent)
        with monkeypatch.context() as patch, contextlib.suppress(Lost):
            patch.setattr(os, "fsync", power.fsync)
            write_whole(path, "new")
        cut(path.parent, place, chance)
        assert path.read_text() == "new" if n == 3 else path.read_text() in ("old", "new")
        write_whole(path, "old")
