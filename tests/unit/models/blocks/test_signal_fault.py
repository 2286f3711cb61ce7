"""Faults of a signal in the channel: closed forms at exact times, the flag up, the same random packets."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmu_runner import Runner

from interarea.fmu_build.write.package import build_fmu
from interarea.models.blocks.channel import SIGNAL_FAULT, channel_block

KIND = {name: number for name, number, _ in SIGNAL_FAULT.items}
START, END, SIZE, DETAIL = 0.4, 0.9, 0.3, 0.2
LATENCY, STEP, PACKET = 0.05, 0.01, 0.02
CLOSED_FORM = {  # what is sent at s, and its slope
    "stuck": lambda s: (cubic(START)[0], 0.0),
    "bias": lambda s: (cubic(s)[0] + SIZE, cubic(s)[1]),
    "ramp": lambda s: (cubic(s)[0] + SIZE * (s - START), cubic(s)[1] + SIZE),
    "drift": lambda s: (
        cubic(s)[0] + SIZE * -math.expm1(-(s - START) / DETAIL),
        cubic(s)[1] + SIZE / DETAIL * math.exp(-(s - START) / DETAIL),
    ),
    "scale": lambda s: (SIZE * cubic(s)[0], SIZE * cubic(s)[1]),
    "polarity": lambda s: (-cubic(s)[0], -cubic(s)[1]),
    "time_error": lambda s: _mistimed(s),
    "oscillating": lambda s: (
        cubic(s)[0] + SIZE * math.sin(2 * math.pi * DETAIL * (s - START)),
        cubic(s)[1] + SIZE * 2 * math.pi * DETAIL * math.cos(2 * math.pi * DETAIL * (s - START)),
    ),
}


def cubic(t: float) -> tuple[float, float]:
    """Value and slope; Hermite interpolation reproduces it."""
    return 0.2 + t - 2 * t**2 + 0.5 * t**3, 1 - 4 * t + 1.5 * t**2


def _mistimed(s: float) -> tuple[float, float]:
    value, slope = cubic(s - SIZE - DETAIL * (s - START))
    return value, slope * (1.0 - DETAIL)


def fault(kind: str, start: float = START, end: float = END, k: int = 1) -> dict[str, float]:
    numbers = {"kind": KIND[kind], "start": start, "end": end, "size": SIZE, "detail": DETAIL}
    return {f"fault[{k}].{key}": value for key, value in numbers.items()}


@pytest.fixture(scope="module")
def channel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_fmu(channel_block(capacity=64), tmp_path_factory.mktemp("channel"))


def follow(run: Runner, steps: int, step: float = STEP) -> np.ndarray:
    """Send the cubic; y, its slope, valid and age after each step."""
    rows = []
    for k in range(steps):
        run.set(u=cubic(k * step)[0])
        run.slopes("u", cubic(k * step)[1])
        run.step(k * step, step)
        rows.append((run.get("y"), run.slope("y"), run.get("valid"), run.get("age")))
    return np.array(rows)


@pytest.mark.parametrize("kind", sorted(CLOSED_FORM))
def test_continuous_signal_follows_its_closed_form(channel: Path, kind: str) -> None:
    """In [start, end) of measurement, so a latency later of arrival; valid and age as without a fault."""
    with Runner(channel) as run:
        rows = follow(run.start({"latency": LATENCY, "u": cubic(0.0)[0], **fault(kind)}), 120)
    times = STEP * np.arange(1, 121) - LATENCY
    wrong = [START - 1e-9 <= s < END - 1e-9 for s in times]
    exact = [CLOSED_FORM[kind](s) if w else cubic(max(s, 0.0)) for s, w in zip(times, wrong, strict=True)]
    assert sum(wrong) == 50
    assert np.allclose(rows[:, 0], [value for value, _ in exact], rtol=0, atol=1e-12)
    moving = times > 0
    assert np.allclose(rows[moving, 1], np.array([slope for _, slope in exact])[moving], atol=2e-2)
    assert np.all(rows[:, 2] == 1.0)
    assert np.all(rows[:, 3] == LATENCY)


def test_a_signal_stays_stuck_longer_than_the_history(channel: Path) -> None:
    """64 communication points are remembered, 400 pass: the value at the start stays to the bit."""
    with Runner(channel) as run:
        rows = follow(run.start({"u": cubic(0.0)[0], **fault("stuck", START, 9.0)}), 400)
    assert set(rows[int(START / STEP) :, 0]) == {rows[int(START / STEP), 0]}
    assert abs(rows[-1, 0] - cubic(START)[0]) < 1e-12


def packets(channel: Path, values: dict[str, float], steps: int = 200) -> np.ndarray:
    start = {"reporting_interval": PACKET, "latency": LATENCY, "seed": 5, "u": cubic(0.0)[0], **values}
    with Runner(channel) as run:
        return follow(run.start(start), steps)


def test_a_replay_repeats_the_packets_before_its_start(channel: Path) -> None:
    """Again and again, far beyond the history; the stamps go on."""
    wrong = packets(channel, fault("replay", START, 3.0), 320)
    right = packets(channel, {}, 320)
    first = round((START + LATENCY) / STEP) - 1  # row in which the packet stamped START comes
    length = round(SIZE / STEP)
    last = round((3.0 + LATENCY) / STEP) - 1
    for row in range(first, last):
        back = length * ((row - first) // length + 1)
        assert wrong[row, 0] == right[row - back, 0]
    assert np.array_equal(wrong[:first, 0], right[:first, 0])
    assert np.array_equal(wrong[:, 2:], right[:, 2:])
    assert np.array_equal(wrong[last:, 0], right[last:, 0])


@pytest.mark.slow
def test_noise_and_spikes_by_their_law(channel: Path) -> None:
    """4000 packets: mean and standard deviation of noise, share and size of spikes, within 4 sigma."""
    right = packets(channel, {}, 8000)[::2, 0]
    noise = packets(channel, fault("noise", 0.0, 1e9), 8000)[::2, 0] - right
    spikes = packets(channel, fault("spike", 0.0, 1e9), 8000)[::2, 0] - right
    n = len(noise)
    assert abs(noise.mean()) < 4 * SIZE / math.sqrt(n)
    assert abs(noise.std() / SIZE - 1) < 4 / math.sqrt(2 * n)
    off = np.abs(spikes) > SIZE / 2
    assert np.allclose(np.abs(spikes[off]), SIZE)
    assert abs(off.mean() - DETAIL) < 4 * math.sqrt(DETAIL * (1 - DETAIL) / n)
    assert abs(np.sign(spikes[off]).mean()) < 4 / math.sqrt(off.sum())
    assert abs(np.corrcoef(noise[1:], noise[:-1])[0, 1]) < 4 / math.sqrt(n)


@pytest.mark.parametrize("kind", ["noise", "spike", "replay", "stuck"])
def test_packets_do_not_depend_on_the_step(channel: Path, kind: str) -> None:
    values = {"reporting_interval": PACKET, "latency": LATENCY, "seed": 5, "u": cubic(0.0)[0], **fault(kind)}
    with Runner(channel) as run:
        fine = follow(run.start(values), 100)
    with Runner(channel) as run:
        coarse = follow(run.start(values), 50, 2 * STEP)
    assert np.allclose(fine[1::2, 0], coarse[:, 0], rtol=0, atol=1e-13)


def test_without_a_fault_the_bits_are_the_same(channel: Path) -> None:
    """A window that never comes changes nothing; several faults act one after the other."""
    for more in ({}, {"reporting_interval": PACKET, "loss_good": 0.2, "seed": 4}):
        start = {"latency": LATENCY, "u": cubic(0.0)[0], **more}
        with Runner(channel) as run:
            right = follow(run.start(start), 120)
        with Runner(channel) as run:
            off = follow(run.start({**start, **fault("scale", 5.0, 6.0)}), 120)
        assert np.array_equal(right, off)
    both = {**fault("bias", 0.2, 0.4), **fault("polarity", 0.4, 0.6, k=2)}
    with Runner(channel) as run:
        rows = follow(run.start({"latency": STEP, "u": cubic(0.0)[0], **both}), 80)
    assert abs(rows[30, 0] - cubic(0.3)[0] - SIZE) < 1e-12
    assert abs(rows[50, 0] + cubic(0.5)[0]) < 1e-12
    assert abs(rows[70, 0] - cubic(0.7)[0]) < 1e-12


@pytest.mark.parametrize(
    ("values", "says"),
    [
        (fault("noise"), "act on packets"),
        (fault("bias", 2.0, 1.0), "fault.end lies before fault.start"),
        ({**fault("time_error"), "fault[1].size": -0.1}, "must not be negative"),
        ({**fault("replay"), "reporting_interval": PACKET, "fault[1].size": 30.0}, "1 to 1024 packets"),
    ],
)
def test_refused(channel: Path, values: dict[str, float], says: str) -> None:
    with Runner(channel) as run:
        with pytest.raises(FMICallException):
            run.start(values)
        assert says in run.log[-1]
