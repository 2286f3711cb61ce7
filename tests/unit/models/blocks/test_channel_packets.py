"""Packets of a channel: statistics, closed forms, the same packets whatever the step, sums that agree."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmu_runner import Runner
from scipy.stats import binom

from interarea.fmu_build.write.package import build_fmu
from interarea.models.blocks.channel import channel_block, gamma_quantiles, quantiles_of
from interarea.models.blocks.packet_schedule import packets_of
from interarea.models.blocks.sizes import QUANTILES

COUNTS = ("sent", "delivered", "dropped", "late")
ROUGH = {
    "latency": 0.03,
    "jitter": 0.05,
    "reporting_interval": 0.02,
    "loss_good": 0.1,
    "on_loss": 1,
    "seed": 7,
}


@pytest.fixture(scope="module")
def channel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_fmu(channel_block(capacity=512), tmp_path_factory.mktemp("channel"))


def sine(t: float) -> tuple[float, float]:
    return math.sin(3.0 * t), 3.0 * math.cos(3.0 * t)


def follow(run: Runner, first: int, last: int, h: float) -> list[tuple[float, ...]]:
    """Send a sine from step `first` to `last`; (y, age, valid, counts) after each."""
    rows = []
    for k in range(first, last):
        run.set(u=sine(k * h)[0])
        run.slopes("u", sine(k * h)[1])
        run.step(k * h, h)
        rows.append((run.get("y"), run.get("age"), run.get("valid"), *(run.get(n) for n in COUNTS)))
    return rows


def losses(run: Runner, packets: int) -> np.ndarray:
    """Whether each packet was dropped, one packet a step, no latency."""
    dropped = np.array([row[5] for row in follow(run, 0, packets, 0.02)])
    return np.diff(dropped) > 0


def test_bernoulli_loss_within_its_binomial_bounds(channel: Path) -> None:
    """4000 packets at rate 0.1: between the 0.00005 and 0.99995 quantiles (confidence 99.99 %)."""
    with Runner(channel) as run:
        lost = losses(run.start({"reporting_interval": 0.02, "loss_good": 0.1, "seed": 3}), 4000).sum()
    assert binom.ppf(5e-5, 3999, 0.1) <= lost <= binom.ppf(1 - 5e-5, 3999, 0.1)


@pytest.mark.slow
def test_gilbert_elliott_rate_and_mean_burst(channel: Path) -> None:
    """Stationary rate a/(a+z), mean burst 1/z; bounds of 4 standard deviations."""
    a, z, n = 0.05, 0.25, 8000
    values = {"reporting_interval": 0.02, "good_to_bad": a, "bad_to_good": z, "loss_bad": 1.0, "seed": 11}
    with Runner(channel) as run:
        lost = losses(run.start(values), n)
    rate, memory = a / (a + z), 1 - a - z
    deviation = math.sqrt(rate * (1 - rate) / n * (1 + memory) / (1 - memory))
    assert abs(lost.mean() - rate) < 4 * deviation
    bursts = np.sum(np.diff(lost.astype(int)) == 1) + lost[0]
    assert abs(lost.sum() / bursts - 1 / z) < 4 * math.sqrt((1 - z) / z**2 / bursts)


def test_same_packets_whatever_the_step(channel: Path) -> None:
    seen = []
    for divide in (1, 2, 4):
        with Runner(channel) as run:
            rows = follow(run.start(ROUGH), 0, 200 * divide, 0.02 / divide)
        seen.append(np.array(rows[divide - 1 :: divide]))
    for other in seen[1:]:
        assert np.array_equal(seen[0][:, 2:], other[:, 2:])
        assert np.allclose(seen[0][:, 1], other[:, 1], atol=1e-12)
        # stamps are communication points of every run: the values are the same too
        assert np.allclose(seen[0][:, 0], other[:, 0], atol=1e-14)


def test_same_packets_after_restore_and_reset(channel: Path) -> None:
    with Runner(channel) as run:
        follow(run.start(ROUGH), 0, 100, 0.01)
        state = run.fmu.getFMUState()
        first = follow(run, 100, 300, 0.01)
        run.fmu.setFMUState(state)
        assert follow(run, 100, 300, 0.01) == first
        run.fmu.freeFMUState(state)
        run.fmu.reset()
        assert follow(run.start(ROUGH), 0, 300, 0.01)[100:] == first
        run.fmu.reset()
        assert follow(run.start({**ROUGH, "seed": 8}), 0, 300, 0.01)[100:] != first


def test_ledger_adds_up_and_ages_grow_between_arrivals(channel: Path) -> None:
    """sent - delivered - dropped - late = packets on their way, of which latency bounds the number."""
    with Runner(channel) as run:
        rows = follow(run.start(ROUGH), 0, 1000, 0.01)
    for k, (_, age, _, sent, delivered, dropped, late) in enumerate(rows):
        assert sent == math.floor((k + 1) / 2 + 1e-9) + 1
        assert 0 <= sent - delivered - dropped - late <= 4  # 80 ms at most, one each 20 ms
        assert delivered == 0 or age >= 0.03 - 1e-9
    assert rows[-1][6] > 0  # 50 ms of jitter on a 20 ms interval: some come late
    assert rows[-1][5] > 0


def test_age_is_a_sawtooth_for_constant_latency(channel: Path) -> None:
    """Age = latency + (t - latency) mod T; the value is the one at its stamp."""
    latency, interval, h = 0.035, 0.02, 0.005
    with Runner(channel) as run:
        rows = follow(run.start({"latency": latency, "reporting_interval": interval}), 0, 200, h)
    for k, row in enumerate(rows, start=1):
        stamp = max(0, (k - 7) // 4) * 0.02
        assert abs(row[1] - (k * h - stamp)) < 1e-12
        assert abs(row[0] - sine(stamp)[0]) < 1e-12


def test_newest_stamp_wins(channel: Path) -> None:
    """Latency 0 or 50 ms at even odds, a packet each 20 ms: stamps never go back, overtaken ones are late."""
    table = {f"quantile[{k}]": 0.0 if k <= QUANTILES // 2 else 0.05 for k in range(1, QUANTILES + 1)}
    with Runner(channel) as run:
        rows = follow(run.start({"reporting_interval": 0.02, "seed": 1, **table}), 0, 400, 0.01)
    stamps = np.array([(k + 1) * 0.01 - row[1] for k, row in enumerate(rows)])
    assert np.all(np.diff(stamps) > -1e-12)
    assert rows[-1][6] > 50
    assert [row[0] for row in rows] == pytest.approx([sine(s)[0] for s in stamps], abs=5e-4)


def test_concentrator_releases_at_its_wait_and_drops_what_is_slower(channel: Path) -> None:
    """Latency uniform in 10 to 50 ms, wait 40 ms: 3/4 arrive (99.99 %), each exactly 40 ms old."""
    values = {"latency": 0.01, "jitter": 0.04, "reporting_interval": 0.02, "pdc_wait": 0.04, "on_loss": 1}
    with Runner(channel) as run:
        rows = follow(run.start(values), 0, 2000, 0.02)
    done = rows[-1][4] + rows[-1][6]
    assert binom.ppf(5e-5, done, 0.75) <= rows[-1][4] <= binom.ppf(1 - 5e-5, done, 0.75)
    assert all(abs(row[1] - 0.04) < 1e-9 for row in rows[3:] if row[2])


@pytest.mark.parametrize("interval", [0.0, 0.02])
def test_quantisation_error_is_at_most_half_a_step(channel: Path, interval: float) -> None:
    with Runner(channel) as run:
        run.start({"quantum": 0.1, "reporting_interval": interval})
        rows = follow(run, 0, 200, 0.02)
    for k, row in enumerate(rows[1:], start=2):
        assert abs(row[0] / 0.1 - round(row[0] / 0.1)) < 1e-9
        assert abs(row[0] - sine(k * 0.02)[0]) < 0.05 + 3e-3


def test_hold_then_zero_on_lost_packets(channel: Path) -> None:
    """Every packet lost: the start value for hold_time after the first miss at 0.1 s, then zero."""
    values = {"reporting_interval": 0.1, "loss_good": 1.0, "on_loss": 2, "hold_time": 0.25, "u": 0.5}
    with Runner(channel) as run:
        run.start(values)
        seen = []
        for k in range(6):
            run.step(0.1 * k, 0.1)
            seen.append((run.get("y"), run.get("valid")))
    assert seen == [*[(0.5, 0)] * 3, *[(0.0, 0)] * 3]


def test_gamma_table_has_the_mean_of_the_distribution() -> None:
    """A table that is linear between points has the mean of the trapezoid rule."""
    q = np.array(list(gamma_quantiles(2.0, 0.01).values()))
    assert abs(np.trapezoid(q, dx=1 / 32) - 0.02) < 1e-4
    assert list(quantiles_of([0.0, 0.32]).values()) == pytest.approx(np.arange(33) * 0.01)


def test_packet_settings_without_packets_are_refused(channel: Path) -> None:
    with Runner(channel) as run:
        with pytest.raises(FMICallException):
            run.start({"loss_good": 0.1})
        assert "set reporting_interval" in run.log[-1]


@pytest.mark.parametrize(
    "values",
    [
        {**ROUGH, "seed": 5},
        {
            "reporting_interval": 0.02,
            "latency": 0.033,
            "good_to_bad": 0.1,
            "bad_to_good": 0.3,
            "loss_bad": 0.9,
        },
        {"reporting_interval": 0.02, "latency": 0.01, "jitter": 0.05, "pdc_wait": 0.04, "loss_good": 0.1},
        {"reporting_interval": 0.01, "latency": 0.02, "seed": 9, **gamma_quantiles(2.0, 0.01)},
    ],
)
def test_python_knows_when_the_packets_of_the_fmu_come_out(channel: Path, values: dict[str, float]) -> None:
    """The channel stepped from each computed arrival to the next counts one packet at each, none between."""
    numbers = {k: float(v) for k, v in values.items()}
    packets = packets_of(numbers, 0.0, 6.0)
    order = np.argsort(packets.due_s, kind="stable")
    due = packets.due_s[order]
    points = [(k, t) for k, t in enumerate(due) if 0.0 < t < 5.5 and t - due[k - 1] > 1e-6 < due[k + 1] - t]
    assert len(points) > 150
    with Runner(channel) as run:
        run.start(values)
        now = 0.0
        for k, t in points:
            for to, count in ((t - 4e-7, k), (t, k + 1)):
                run.step(now, to - now)
                now = to
                assert sum(run.get(n) for n in ("delivered", "dropped", "late")) == count
            missed = bool(packets.lost[order[k]])
            assert run.get("valid") == (not missed) or run.get("late") > 0
        dropped = run.get("dropped") + (run.get("late") if "pdc_wait" in values else 0)
        assert dropped == packets.lost[order[: k + 1]].sum()
