"""Laws of a channel's packets: none appears or vanishes, none is younger than its way, steps change none."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmu_runner import Runner
from hypothesis import given, settings
from hypothesis import strategies as st

from interarea.cosim.run.artefacts import channel_fmu
from interarea.models.blocks.packet_schedule import packets_of

COUNTS = ("sent", "delivered", "dropped", "late")
SLACK_S = 1e-10
GRID_MS = 120  #: points at which differently stepped runs are compared, ms


@pytest.fixture(scope="module")
def channel(cache: Path) -> Path:
    return channel_fmu(cache)


@st.composite
def ways(draw: st.DrawFn) -> dict[str, Any]:
    """Parameters of a channel with packets: any latency, jitter, loss, with or without a concentrator."""
    way = {
        "reporting_interval": draw(st.sampled_from([0.01, 0.02, 0.035, 0.05])),
        "latency": draw(st.integers(0, 120)) * 1e-3,
        "jitter": draw(st.integers(0, 80)) * 1e-3,
        "seed": draw(st.integers(0, 2**31 - 1)),
        "on_loss": draw(st.integers(0, 2)),
    }
    if draw(st.booleans()):
        way |= {"loss_good": draw(st.floats(0.0, 1.0))}
    else:
        way |= {k: draw(st.floats(0.0, 1.0)) for k in ("loss_good", "loss_bad", "good_to_bad")}
        way["bad_to_good"] = draw(st.floats(0.01, 1.0))
    if draw(st.booleans()):
        way["pdc_wait"] = draw(st.integers(1, 150)) * 1e-3
    return way


def cubic(t: float) -> tuple[float, ...]:
    """What is sent, with its derivatives: a cubic, so that no choice of steps rounds it."""
    return 0.5 + t * (0.3 + t * (-0.2 + 0.1 * t)), 0.3 + t * (-0.4 + 0.3 * t), -0.4 + 0.6 * t, 0.6


def stepped(run: Runner, way: dict[str, Any], cuts: list[list[int]]) -> list[dict[str, float]]:
    """Step over the grid, each interval cut at some ms; outputs after each step."""
    run.fmu.reset()
    run.start(way)
    rows, now = [], 0
    for k, inside in enumerate(cuts):
        for end in [*(k * GRID_MS + c for c in sorted(set(inside))), (k + 1) * GRID_MS]:
            t, h = 1e-3 * now, 1e-3 * (end - now)
            run.set(u=cubic(t)[0])
            run.slopes("u", *cubic(t)[1:])
            run.step(t, h)
            now = end
            rows.append({"t": 1e-3 * now} | {n: run.get(n) for n in ("y", "age", "valid", *COUNTS)})
    return rows


cuts = st.lists(st.lists(st.integers(1, GRID_MS - 1), max_size=4), min_size=8, max_size=8)


@settings(max_examples=25)
@given(ways(), cuts, cuts)
def test_packets_are_conserved_and_the_same_however_it_is_stepped(
    channel: Path, way: dict[str, Any], one: list[list[int]], other: list[list[int]]
) -> None:
    with Runner(channel) as run:
        rows, again = stepped(run, way, one), stepped(run, way, other)
    packets = packets_of(way, 0.0, rows[-1]["t"])
    least = max(way["latency"], way.get("pdc_wait", 0.0))
    before = dict.fromkeys(COUNTS, 0.0)
    for row in rows:
        sent = packets.stamp_s <= row["t"] + SLACK_S
        on_their_way = int(np.sum(sent & (packets.due_s > row["t"] + SLACK_S)))
        assert row["sent"] == sent.sum()
        assert row["sent"] == row["delivered"] + row["dropped"] + row["late"] + on_their_way
        assert all(row[n] >= before[n] for n in COUNTS)
        # the age is that of what was received, which took its way; before that, the time since the start
        assert row["age"] >= (least if row["delivered"] else row["t"]) - 1e-9
        before = row
    ends = {round(1e3 * r["t"]): r for r in again}
    for row in rows:
        k = round(1e3 * row["t"])
        if k % GRID_MS == 0:
            assert {n: row[n] for n in ("age", "valid", *COUNTS)} == {
                n: pytest.approx(ends[k][n], abs=1e-12) for n in ("age", "valid", *COUNTS)
            }
            assert row["y"] == pytest.approx(ends[k]["y"], abs=1e-12)


@settings(max_examples=50)
@given(ways(), st.integers(0, 400), st.integers(1, 400))
def test_a_packets_fate_does_not_depend_on_when_one_begins_to_look(
    way: dict[str, Any], first: int, length: int
) -> None:
    interval = way["reporting_interval"]
    whole = packets_of(way, 0.0, 900 * interval)
    part = packets_of(way, first * interval, (first + length) * interval)
    if way.get("good_to_bad"):  # the chain begins anew there; what a packet takes does not
        np.testing.assert_array_equal(part.due_s, whole.due_s[first : first + length + 1])
    else:
        np.testing.assert_array_equal(part.due_s, whole.due_s[first : first + length + 1])
        np.testing.assert_array_equal(part.lost, whole.lost[first : first + length + 1])
    wait = way.get("pdc_wait", 0.0)
    spent = whole.due_s - whole.stamp_s
    assert np.all(spent >= (wait or way["latency"]) - 1e-12)
    assert np.all(spent <= (wait or way["latency"] + way["jitter"]) + 1e-12)
