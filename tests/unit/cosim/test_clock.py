"""Time is a whole number of ticks; events are communication points; what lies between ticks is rounded."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from interarea.cosim.clock import TICKS_PER_SECOND, Clock, seconds, to_ticks
from interarea.cosim.errors import ScenarioError


def test_a_step_of_ten_milliseconds_gives_the_doubles_one_would_write() -> None:
    ends = [seconds(s.end) for s in Clock.of_seconds(1.0, 0.01).steps]
    assert ends == [float(f"{k / 100:.2f}") for k in range(1, 101)]


@given(st.integers(-(10**15), 10**15))
def test_every_tick_survives_the_way_to_seconds_and_back(tick: int) -> None:
    assert to_ticks(seconds(tick), "t") == tick


def test_a_computed_sum_is_the_tick_it_means() -> None:
    assert to_ticks(0.1 + 0.2, "t") == 300_000_000


def test_the_thesis_clearing_time_is_representable() -> None:
    assert to_ticks(1.1333333, "end_s") == 1_133_333_300


@given(st.floats(1e-9, 9e6))
def test_a_time_between_two_ticks_is_the_nearer_one(value: float) -> None:
    off = abs(Fraction(to_ticks(value, "t")) - Fraction(value) * TICKS_PER_SECOND)
    assert off <= Fraction(1, 2) + Fraction(float(np.spacing(value * TICKS_PER_SECOND)))


def test_eight_cycles_at_60_hz_are_a_third_of_a_nanosecond_off() -> None:
    assert to_ticks(1.0 + 8.0 / 60.0, "end_s") == 1_133_333_333


@pytest.mark.parametrize("value", [4e-10, float("nan"), float("inf"), 1e10])
def test_times_that_the_clock_cannot_hold_are_refused(value: float) -> None:
    with pytest.raises(ScenarioError, match="end_s"):
        to_ticks(value, "end_s")


def test_steps_end_at_marks_and_on_the_grid_and_nowhere_else() -> None:
    clock = Clock.of_seconds(0.05, 0.01, event_times_s=[0.0133333, 0.02])
    recorded = [s.end for s in clock.steps if s.recorded]
    assert recorded == [10_000_000, 13_333_300, 20_000_000, 30_000_000, 40_000_000, 50_000_000]
    assert sum(s.edge for s in clock.steps) == 4  # one tick before and one after each mark
    assert [s.start for s in clock.steps[1:]] == [s.end for s in clock.steps[:-1]]


def test_the_end_need_not_lie_on_the_grid() -> None:
    assert seconds(Clock.of_seconds(0.025, 0.01).steps[-1].end) == 0.025


@pytest.mark.parametrize(("stop", "step"), [(1.0, 0.0), (1.0, -0.01), (0.0, 0.01)])
def test_nonsense_is_refused(stop: float, step: float) -> None:
    with pytest.raises(ScenarioError):
        Clock.of_seconds(stop, step)
