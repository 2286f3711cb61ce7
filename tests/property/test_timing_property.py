"""Laws of time and of inputs over a step: whole ticks, every instant a communication point, exact cubics."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from interarea.cosim.clock import TICKS_PER_SECOND, Clock, seconds, to_ticks
from interarea.cosim.errors import GraphError
from interarea.cosim.master.step_choice import clock_of, step_and_reason
from interarea.cosim.polynomials import continued, hermite, mean_between, slope_at, through, value_at
from interarea.cosim.scenario.channels import ChannelLine
from interarea.fmu_build.open.ports import Description, Port

PLAIN = Description((), (Port("y"),), {})
RIGID = Description((), (Port("y"),), {}, variable_step=False)
ticks = st.one_of(st.integers(1, 3_000_000_000), st.integers(1, 3000).map(lambda ms: 1_000_000 * ms))
steps = st.one_of(
    st.sampled_from([1_000_000, 5_000_000, 10_000_000, 20_000_000]), st.integers(30_000_000, 10**9)
)


@settings(max_examples=60)
@given(
    st.integers(0, 10**9), ticks, steps, st.lists(ticks, max_size=4),
    st.lists(st.integers(0, 10**9), max_size=3), st.lists(ticks, max_size=4), st.booleans(),
    st.booleans(),
)  # fmt: skip
def test_every_instant_is_a_communication_point_and_time_only_grows(
    start: int,
    length: int,
    step: int,
    marks: list[int],
    latencies: list[int],
    points: list[int],
    edges: bool,
    at_rest: bool,
) -> None:
    stop = start + length
    clock = clock_of(
        {f"c{k}": PLAIN for k in range(3)},
        start_s=seconds(start),
        stop_s=seconds(stop),
        step_s=seconds(step),
        event_times_s=[seconds(start + m) for m in marks],
        latency_ticks={f"c{k}": d for k, d in enumerate(latencies)},
        edges=edges,
        points=[start + p for p in points],
        at_rest=at_rest,
    )
    result = clock.steps
    assert all(isinstance(t, int) for s in result for t in (s.start, s.end))
    assert [s.start for s in result] == [start, *(s.end for s in result[:-1])] and result[-1].end == stop
    assert all(0 < s.end - s.start <= step for s in result)
    assert sum(s.end - s.start for s in result) == length
    ends = {s.end for s in result}
    inside = [start + m for m in marks if m < length]
    late = [m + d for m in inside for d in latencies if m + d < stop]
    expected = {*inside, *late, *range(start + step, stop, step)}
    assert expected | {start + p for p in points if p < length} <= ends
    assert {s.end for s in result if s.recorded} == {*expected, stop}
    assert all(s.end - s.start == 1 for s in result if s.edge)
    if edges and not at_rest:  # what is moving at the start shows with a kink
        assert {start + d for d in latencies if 0 < d < length} <= ends
    if edges:  # what was just before an instant and what is just after are both known
        assert {t for m in inside for t in (m - 1, m + 1) if start < t < stop} <= ends
    for s in result[:50]:
        assert to_ticks(s.start_s, "start") == s.start and to_ticks(s.length_s, "length") == s.end - s.start


@settings(max_examples=60)
@given(ticks, steps, st.lists(ticks, max_size=3))
def test_steps_of_one_length_stay_so_or_the_run_is_refused(length: int, step: int, marks: list[int]) -> None:
    times = {"start_s": 0.0, "stop_s": seconds(length), "step_s": seconds(step)}
    off = [t for t in (*(m for m in marks if m < length), length) if t % step]
    try:
        event_times_s = [seconds(m) for m in marks]
        clock = clock_of(
            {"a": PLAIN, "r": RIGID}, **times, event_times_s=event_times_s, latency_ticks={}, edges=True
        )
    except GraphError as error:
        assert off and "r allows steps of one length only" in str(error)
    else:
        assert not off and {s.end - s.start for s in clock.steps} == {step}


@settings(max_examples=100)
@given(st.lists(st.integers(0, 2000), max_size=4), st.lists(st.integers(1, 50_000), max_size=4))
def test_the_chosen_step_keeps_what_it_says(latencies: list[int], instants: list[int]) -> None:
    late, known = [1e-3 * n for n in latencies], [1e-4 * n for n in instants]
    step_s, reason = step_and_reason(late, known)
    step = to_ticks(step_s, "step")
    shortest = min([10, *(n for n in latencies if n)])
    assert 500_000 < step <= 1_000_000 * shortest
    divided = [to_ticks(t, "t") for t in late if t]
    if "divides all latencies and instants" in reason:
        divided += [to_ticks(t, "t") for t in known]
    if "divides" in reason:
        assert all(t % step == 0 for t in divided)


small = st.integers(-1000, 1000)


def cubic(c: list[int], t: Fraction, order: int = 0) -> Fraction:
    """Derivative number `order` of sum c_k t^k, exactly."""
    return sum(
        (math.perm(k, order) * c[k] * t ** (k - order) for k in range(order, len(c))), start=Fraction(0)
    )


@settings(max_examples=100)
@given(
    st.lists(small, min_size=4, max_size=4), st.integers(-50, 50), st.integers(1, 10**6), st.floats(0.0, 1.0)
)
def test_a_cubic_comes_through_as_itself(c: list[int], begin: int, micros: int, share: float) -> None:
    t0, h = Fraction(begin), Fraction(micros, 10**6)
    v0, s0, v1, s1 = (float(cubic(c, t, k)) for t in (t0, t0 + h) for k in (0, 1))
    d = hermite(v0, s0, v1, s1, float(h))
    s = share * float(h)
    # rounding of the four values, and of their differences over h
    size = max(abs(v0), abs(v1), float(h) * abs(s0), float(h) * abs(s1), 1e-300)
    exact = float(cubic(c, t0 + Fraction(s)))
    assert value_at(d, s) == pytest.approx(exact, abs=32 * 2.0**-52 * size)
    assert slope_at(d, s) * float(h) == pytest.approx(
        float(h) * float(cubic(c, t0 + Fraction(s), 1)), abs=64 * 2.0**-52 * size
    )
    assert value_at(d, float(h)) == pytest.approx(v1, abs=8 * 2.0**-52 * size)
    integral = [0, *(Fraction(x, k + 1) for k, x in enumerate(c))]
    mean = (cubic(integral, t0 + h) - cubic(integral, t0)) / h  # type: ignore[arg-type]
    assert mean_between(d, 0.0, float(h)) == pytest.approx(float(mean), abs=32 * 2.0**-52 * size)
    onward = continued(d, float(h), v1, s1)
    assert value_at(onward, 0.5) == pytest.approx(
        float(cubic(c, t0 + h + Fraction(1, 2))), abs=1e4 * 2.0**-52 * size / float(h) ** 3
    )


@settings(max_examples=100)
@given(
    st.lists(small, min_size=1, max_size=4),
    st.lists(st.integers(0, 400), min_size=4, max_size=4, unique=True),
    st.integers(0, 3),
)
def test_as_many_points_as_coefficients_give_the_polynomial(c: list[int], times: list[int], at: int) -> None:
    n = len(c)
    assume(at < n)
    t = [Fraction(k, 100) for k in sorted(times)[:n]]
    d = through([float(x) for x in t], [float(cubic(c, x)) for x in t], at)
    for order in range(4):
        # differences over at least 10 ms, up to three of them
        assert d[order] == pytest.approx(float(cubic(c, t[at], order)), abs=1e-12 * 1e5 * 100.0**order)


@st.composite
def packets(draw: st.DrawFn) -> dict[str, Any]:
    interval = draw(st.sampled_from([10, 16, 20, 35, 40]))
    path = {"latency_s": 1e-3 * draw(st.integers(0, 90)), "reporting_interval_s": 1e-3 * interval}
    return path | ({"pdc_wait_s": 1e-3 * draw(st.integers(91, 150))} if draw(st.booleans()) else {})


@settings(max_examples=40)
@given(packets(), st.sampled_from([5, 10, 20, 30]), st.booleans())
def test_the_ledger_of_a_channel_is_the_mean_age_of_what_is_held(
    path: dict[str, Any], step_ms: int, exact: bool
) -> None:
    """Latency, half an interval, the wait for the next communication point: they add up to the age seen."""
    line = ChannelLine(**path)
    interval = round(1e3 * line.reporting_interval_s)
    pattern = math.lcm(interval, step_ms)  # ms after which everything repeats
    stop = pattern * (2 + 1000 // pattern)
    points = line.arrivals(0.0, 1e-3 * stop) if exact else []
    clock = Clock(0, 1_000_000 * stop, 1_000_000 * step_ms, points=tuple(points))
    delays = line.delays(clock)
    total = delays.network_s + delays.reporting_s + delays.jitter_mean_s + delays.waiting_s
    path_ms = round(1e3 * max(line.latency_s, line.pdc_wait_s))
    begin = 1_000_000 * (stop - pattern)  # the last pattern, long after the start
    area = 0.0
    for s in clock.steps:
        if s.start >= begin:
            held = (s.start - 1_000_000 * path_ms) // (1_000_000 * interval) * 1_000_000 * interval
            area += (s.end - s.start) * (0.5 * (s.start + s.end) - held)
    mean_s = area / (1_000_000 * pattern) / TICKS_PER_SECOND
    assert total == pytest.approx(mean_s, abs=1e-8)
    assert delays.requested_s == delays.network_s == pytest.approx(1e-3 * path_ms, abs=0.5e-9)
    assert np.isfinite(total) and (not exact or delays.waiting_s < 1e-9)
