"""The channel: its latency is exact whatever the step; outages and rules on loss at exact times."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmu_runner import Runner

from interarea.fmu_build.write.package import build_fmu
from interarea.models.blocks.channel import channel_block


@pytest.fixture(scope="module")
def channel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_fmu(channel_block(capacity=128), tmp_path_factory.mktemp("channel"))


def cubic(t: float) -> np.ndarray:
    """Value and three derivatives of a cubic; Hermite interpolation reproduces it."""
    return np.array([0.2 + t - 2 * t**2 + 0.5 * t**3, 1 - 4 * t + 1.5 * t**2, -4 + 3 * t, 3.0])


def drive(run: Runner, times: np.ndarray, slopes: int) -> tuple[np.ndarray, np.ndarray]:
    """Send the cubic with that many derivatives; outputs and their slopes after each step."""
    y, dy = [], []
    for a, b in itertools.pairwise(times):
        u = cubic(a)
        run.set(u=u[0])
        if slopes:
            run.slopes("u", *u[1 : slopes + 1])
        run.step(a, b - a)
        y.append(run.get("y"))
        dy.append(run.slope("y"))
    return np.array(y), np.array(dy)


@pytest.mark.parametrize("latency", [0.1, 0.123, 0.0317, 0.35])
@pytest.mark.parametrize("seed", [1, 2])
def test_output_is_the_input_of_latency_ago(channel: Path, latency: float, seed: int) -> None:
    """Steps of any length up to the latency: only values and slopes at past points are needed."""
    gaps = np.random.default_rng(seed).uniform(0.2, 1.0, 60) * min(latency, 0.05)
    times = np.concatenate([[0.0], np.cumsum(gaps)])
    with Runner(channel) as run:
        y, dy = drive(run.start({"latency": latency, "u": cubic(0.0)[0]}), times, slopes=1)
    past = times[1:] - latency
    exact = np.array([cubic(max(s, 0.0)) for s in past]).T
    assert np.allclose(y, exact[0], atol=1e-13)
    # Within the last interval the slope at its end is not known when y is asked for.
    known = past > 0
    assert np.allclose(dy[known], exact[1][known], atol=1e-2)


@pytest.mark.parametrize("latency", [0.0, 0.01, 0.05, 0.099])
def test_latency_shorter_than_the_step(channel: Path, latency: float) -> None:
    """With all derivatives the input is known within the step: exact for a cubic."""
    times = np.linspace(0.0, 1.0, 11)
    with Runner(channel) as run:
        y, dy = drive(run.start({"latency": latency, "u": cubic(0.0)[0]}), times, slopes=3)
    exact = np.array([cubic(s) for s in times[1:] - latency]).T
    assert np.allclose(y, exact[0], atol=1e-13)
    assert np.allclose(dy, exact[1], atol=1e-12)


def test_without_slopes_straight_lines(channel: Path) -> None:
    times = np.linspace(0.0, 1.0, 21)
    with Runner(channel) as run:
        y, _ = drive(run.start({"latency": 0.125, "u": cubic(0.0)[0]}), times, slopes=0)
    line = np.interp(times[1:] - 0.125, times, [cubic(t)[0] for t in times])
    assert np.allclose(y, line, atol=1e-14)


def test_zero_latency_passes_on_what_is_set(channel: Path) -> None:
    with Runner(channel) as run:
        run.start()
        for u in (0.5, -0.25):
            run.set(u=u)
            assert run.get("y") == u


@pytest.mark.parametrize(("on_loss", "inside"), [(0, 0.0), (1, "held"), (2, "held 0.15 s")])
def test_outages(channel: Path, on_loss: int, inside: object) -> None:
    """Windows [0.3, 0.5) and [0.5, 0.7) are one outage; [0.9, 0.9) is none."""
    h = 0.05
    times = h * np.arange(25)
    values = {
        "latency": 0.1,
        "on_loss": on_loss,
        "hold_time": 0.15,
        "outage[2].start": 0.3,
        "outage[2].end": 0.5,
        "outage[1].start": 0.5,
        "outage[1].end": 0.7,
        "outage[3].start": 0.9,
        "outage[3].end": 0.9,
        "u": cubic(0.0)[0],
    }
    with Runner(channel) as run:
        run.start(values)
        held = cubic(0.2)[0]
        for k, t in enumerate(times):
            run.set(u=cubic(t)[0])
            run.slopes("u", cubic(t)[1])
            run.step(t, h)
            at = (k + 1) * h
            lost = 5 < k + 1 < 14
            assert run.get("valid") == (not lost)
            expected = cubic(max(at - 0.1, 0.0))[0]
            if lost:
                held_now = on_loss == 1 or (on_loss == 2 and k + 1 < 9)
                expected = held if held_now else 0.0
                assert run.slope("y") == 0.0
            assert abs(run.get("y") - expected) < 1e-13, (on_loss, inside, at)


def test_a_channel_that_is_not_asked_holds_for_half_a_second_then_gives_zero(channel: Path) -> None:
    with Runner(channel) as run:
        run.start({"outage[1].start": 0.3, "outage[1].end": 1.2, "u": 0.3})
        for k in range(12):
            run.step(0.1 * k, 0.1)
            assert run.get("y") == (0.0 if 8 <= k + 1 < 12 else 0.3), k


def test_history_that_is_too_short_is_an_error(channel: Path) -> None:
    with Runner(channel) as run:
        run.start({"latency": 1.0})
        with pytest.raises(FMICallException):
            for k in range(200):
                run.step(0.001 * k, 0.001)
            for k in range(200, 2000):
                run.step(0.001 * k, 0.001)
        assert "larger capacity" in run.log[-1]


def test_windows_that_end_before_they_start(channel: Path) -> None:
    with Runner(channel) as run:
        with pytest.raises(FMICallException):
            run.start({"outage[2].start": 2.0, "outage[2].end": 1.0})
        assert "outage[2] ends at 1 s" in run.log[-1]


def test_capacity_out_of_range() -> None:
    with pytest.raises(ValueError, match="capacity is 1, allowed"):
        channel_block(capacity=1)
