"""What is gathered part by part is what the whole gives, wherever the parts are cut."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from interarea.cosim.results.accumulators import DRAWN, Curves, Samples, Settling, Squares
from interarea.cosim.results.metrics import settling_time_s
from interarea.cosim.trajectory import TIME, Trajectory

Array = npt.NDArray[np.float64]
T: Array = np.concatenate([np.arange(0.0, 2.0, 0.01), np.arange(2.0, 10.0, 0.013)])


@st.composite
def signals(draw: st.DrawFn) -> Array:
    """Swings that grow, decay, stay, or are nothing but noise."""
    zeta, hertz = draw(st.floats(-0.05, 0.3)), draw(st.floats(0.1, 3.0))
    noise = draw(st.sampled_from([0.0, 1e-3, 1.0]))
    chance = np.random.default_rng(draw(st.integers(0, 2**32)))
    swing = np.exp(-zeta * 2.0 * np.pi * hertz * T) * np.sin(2.0 * np.pi * hertz * T)
    return np.asarray(swing + noise * chance.standard_normal(len(T)))


cuts = st.lists(st.integers(1, len(T) - 1), max_size=8, unique=True).map(sorted)


def parts(at: list[int], *whole: Array) -> list[list[Array]]:
    """Cut arrays; each part begins with the last point of the one before."""
    edges = [0, *at, len(T)]
    return [[w[max(a - 1, 0) : b] for w in whole] for a, b in pairwise(edges)]


def settled_at_once(signal: Array, start_s: float, band: float) -> float | None:
    """The last crossing as it is defined, on the whole signal."""
    x = np.abs(signal)
    limit = band * np.max(x)
    outside = np.flatnonzero((x > limit) & (start_s <= T))
    if not outside.size:
        return 0.0
    k = int(outside[-1])
    if k + 1 == len(T):
        return None
    return float(T[k] + (T[k + 1] - T[k]) * (x[k] - limit) / (x[k] - x[k + 1]) - start_s)


@pytest.mark.slow
@given(signals(), cuts, st.floats(0.0, 9.0), st.sampled_from([0.02, 0.3, 0.9]))
def test_settling(signal: Array, at: list[int], start_s: float, band: float) -> None:
    settling = Settling(start_s, band)
    for t, x in parts(at, T, signal):
        settling.add(t, x)
    assert (
        settling.time_s
        == settled_at_once(signal, start_s, band)
        == settling_time_s(T, signal, start_s, band=band)
    )
    assert settling.peak == np.max(np.abs(signal))


@pytest.mark.slow
@given(signals(), cuts, st.floats(0.0, 9.0))
def test_squares(signal: Array, at: list[int], start_s: float) -> None:
    squares = Squares(start_s)
    for t, x in parts(at, T, signal):
        squares.add(t, x)
    after = start_s <= T
    assert squares.total == pytest.approx(np.trapezoid(signal[after] ** 2, T[after]), rel=1e-12)


@pytest.mark.slow
@given(signals(), signals(), cuts, st.floats(0.0, 5.0), st.floats(5.0, 12.0), st.floats(0.003, 1.0))
def test_samples(one: Array, two: Array, at: list[int], start_s: float, stop_s: float, step_s: float) -> None:
    samples = Samples(2, start_s, stop_s, step_s)
    for t, x, y in parts(at, T, one, two):
        samples.add(t, [x, y])
    assert samples.time_s[0] == start_s and stop_s - step_s < samples.time_s[-1] <= stop_s + 1e-6
    assert np.array_equal(samples.values[:, 0], np.interp(samples.time_s, T, one))
    assert np.array_equal(samples.values[:, 1], np.interp(samples.time_s, T, two))


@pytest.mark.slow
@given(st.integers(1, 40), st.integers(0, 2**32))
def test_curves_of_a_long_run_keep_what_can_be_seen(count: int, seed: int) -> None:
    """Ends, largest and least of every stretch, whatever the parts; integers stay integers."""
    chance = np.random.default_rng(seed)
    n = 3 * DRAWN + 7
    x, k = np.cumsum(chance.standard_normal(n)), np.arange(n) // 1000
    curves = Curves(n)
    for part in np.array_split(np.arange(n), count):
        columns = {TIME: 0.5 * part, "a.x": x[part], "a.k": k[part], "a.other": x[part]}
        curves.add(Trajectory(columns, dict.fromkeys(columns, "1")), ["a.x", "a.k"])
    drawn = curves.trajectory
    assert list(drawn.units) == [TIME, "a.x", "a.k"] and drawn["a.k"].dtype.kind == "i"
    assert n // 14 < len(drawn.time_s) <= DRAWN
    assert np.all(np.diff(drawn.time_s) >= 0.0) and len(drawn["a.x"]) == len(drawn.time_s)
    assert (drawn["a.x"][0], drawn["a.x"][-1], drawn.time_s[-1]) == (x[0], x[-1], 0.5 * (n - 1))
    for begin in range(0, n - 1000, 1000):
        seen = (2 * drawn.time_s >= begin) & (2 * drawn.time_s < begin + 1000)
        inner = x[begin + 20 : begin + 980]
        assert np.min(drawn["a.x"][seen]) <= np.min(inner) and np.max(drawn["a.x"][seen]) >= np.max(inner)


def test_curves_of_a_short_run_are_its_points() -> None:
    x = np.sin(T)
    curves = Curves(len(T))
    for t, part in ((T[:50], x[:50]), (T[50:], x[50:])):
        curves.add(Trajectory({TIME: t, "a.x": part}, {TIME: "s", "a.x": "pu"}), ["a.x"])
    assert np.array_equal(curves.trajectory["a.x"], x) and curves.trajectory.units["a.x"] == "pu"
