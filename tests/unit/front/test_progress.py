"""Progress: lines where a stage ends and every ten seconds, bars in a notebook, else nothing."""

from __future__ import annotations

import re
import sys
import types
from typing import Any

import pytest

from interarea import progress
from interarea.cosim.sweep.front import Progress
from interarea.design.controllers.bundled import shipped_controller
from interarea.design.delay.signal_conditions import Condition
from interarea.design.robust.design import planned
from interarea.design.robust.spec import RobustSpec
from interarea.design.robust.stages import Stage


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Return the time that is told, which a test sets."""
    now = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    return now


def test_a_line_a_step_and_one_every_ten_seconds_with_what_is_left(clock: list[float]) -> None:
    said: list[str] = []
    report = progress.lines(("a", "b"), said.append)
    report("a", 0.0)
    clock[0] += 9.0
    report("a", 0.2)
    assert said == []
    clock[0] += 3.0
    report("a", 0.25, "half way")  # a quarter in 12 s: three more
    clock[0] += 1.0
    report("a", 0.5)
    report("a", 1.0)
    report("a", 1.0)
    assert said == ["a: 25 %, half way, 36 s left", "a: done, half way"]
    report("b", 1.0)
    assert said[-1] == "b: done"


def test_one_quick_stage_is_silent_unless_times_are_asked_for(clock: list[float]) -> None:
    said: list[str] = []
    for timed in (False, True):
        report = progress.lines(("a",), said.append, timed=timed)
        report("a", 0.0)
        clock[0] += 2.5
        report("a", 1.0)
    assert said == ["a: done in 2.5 s"]


def test_what_was_there_before_does_not_count_for_what_is_left(clock: list[float]) -> None:
    said: list[str] = []
    report = progress.lines(("runs",), said.append)
    progress.tell_runs(report, Progress(done=50, size=100, failed=0, rate=0.0))
    clock[0] += 20.0
    progress.tell_runs(report, Progress(done=60, size=100, failed=1, rate=0.5, forked=2))
    assert said == ["runs: 60 %, 60 of 100, 1 failed, 2 forked, 0.5 runs/s, 80 s left"]


class _Handle:
    def __init__(self, shown: list[str]) -> None:
        self.shown = shown

    def update(self, bars: Any) -> None:
        self.shown.append(bars._repr_html_())


def _notebook(monkeypatch: pytest.MonkeyPatch, kernel: object) -> list[str]:
    """Put an IPython there, with a kernel or without; return what it shows."""
    shown: list[str] = []
    shell = types.SimpleNamespace(kernel=kernel)
    top = types.SimpleNamespace(get_ipython=lambda: shell)
    display = types.SimpleNamespace(display=lambda bars, display_id: _Handle(shown))
    monkeypatch.setitem(sys.modules, "IPython", top)
    monkeypatch.setitem(sys.modules, "IPython.display", display)
    return shown


def test_a_notebook_shows_bars_once_work_takes_longer_than_a_moment(
    monkeypatch: pytest.MonkeyPatch, clock: list[float]
) -> None:
    shown = _notebook(monkeypatch, object())
    with progress.notebook_bars(("fast",)) as report:
        assert report is not None
        report("fast", 1.0)
    assert shown == []
    with progress.notebook_bars(("a<b", "next")) as report:
        assert report is not None
        report("a<b", 0.0)
        clock[0] += 1.0
        report("a<b", 0.25)
        clock[0] += 0.1
        report("a<b", 0.26)  # too soon for another picture
        clock[0] += 0.9
        report("a<b", 1.0)
    label = '<progress max="1" value="{}" aria-label="a&lt;b"></progress>'
    assert shown[0] == f"<div>{label.format('0.2500')} a&lt;b: 25 %, 3 s left, 1 s</div>"
    assert shown[-1] == f"<div>{label.format('1.0000')} a&lt;b: 100 %, 2 s</div>" and len(shown) == 3


def test_a_terminal_of_ipython_is_no_notebook(monkeypatch: pytest.MonkeyPatch) -> None:
    _notebook(monkeypatch, None)
    with progress.notebook_bars(("a",)) as report:
        assert report is None


def test_the_whole_of_a_design_is_known_before_it_begins() -> None:
    """Six starts of 600 evaluations on one point of two, then rounds of 900 on both."""
    conditions = (Condition("N"), Condition("L"))
    spec = RobustSpec(("y",), ("u",), conditions, starts=6, evaluations=600, polishes=6, starts_on=1)
    parts = planned(spec, 2.0, 2)
    assert [parts["start 1 of 6"], parts["polish 6 of 6"]] == [2 * 600.0, 4 * 900.0] and len(parts) == 8
    stages = (
        Stage(points=("a",), conditions=("N",), rho=(60.0,), steps=10),
        Stage(rho=(60.0, 120.0), steps=10),
    )
    parts = planned(RobustSpec(("y",), ("u",), conditions, starts=2, stages=stages), 2.0, 2)
    assert parts == {
        "stage 1 of 2, start 1 of 2": 3 * 110.0,
        "stage 1 of 2, start 2 of 2": 3 * 110.0,
        "stage 2 of 2": 4 * 2 * 3 * 110.0,
    }


def test_a_controller_shows_itself_in_a_notebook() -> None:
    shown = shipped_controller("robust")._repr_html_()
    rows = dict(re.findall(r'<th scope="row">(.*?)</th><td>(.*?)</td>', shown))
    assert rows["signals (rad/s)"] == "G2_dw, G4_dw" and rows["actuators (pu)"] == "G4_vs"
    assert rows["states"] == "6" and rows["certificate"] == "passed"
    low, _, high = rows["poles (rad/s)"].partition(" to ")
    assert 0.0 < float(low) < float(high) < 281.0  # what its design bounds them by
