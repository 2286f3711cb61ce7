"""Laws of a channel's packets: none appears or vanishes, none is younger than its path, steps change none."""

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
def channels(draw: st.DrawFn) -> dict[str, Any]:
    """Parameters of a channel with packets: any latency, jitter, loss, with or without a concentrator."""
    path = {
        "reporting_interval": draw(st.sampled_from([0.01, 0.02, 0.035, 0.05])),
        "latency": draw(st.integers(0, 120)) * 1e-3,
        "jitter": draw(st.integers(0, 80)) * 1e-3,
        "seed": draw(st.integers(0, 2**31 - 1)),
        "on_loss": draw(st.integers(0, 2)),
    }
    if draw(st.booleans()):
        path |= {"loss_good": draw(st.floats(0.0, 1.0))}
    else:
        path |= {k: draw(st.floats(0.0, 1.0)) for k in ("loss_good", "loss_bad", "good_to_bad")}
        path["bad_to_good"] = draw(st.floats(0.01, 1.0))
    if draw(st.booleans()):
        path["pdc_wait"] = draw(st.integers(1, 150)) * 1e-3
    return path


def cubic(t: float) -> tuple[float, ...]:
    """What is sent, with its derivatives: a cubic, so that no choice of steps rounds it."""
    return 0.5 + t * (0.3 + t * (-0.2 + 0.1 * t)), 0.3 + t * (-0.4 + 0.3 * t), -0.4 + 0.6 * t, 0.6


def stepped(run: Runner, path: dict[str, Any], cuts: list[list[int]]) -> list[dict[str, float]]:
    """Step over the grid, each interval cut at some ms; outputs after each step."""
    run.fmu.reset()
    run.start(path)
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


@pytest.mark.slow
@settings(max_examples=25)
@given(channels(), cuts, cuts)
def test_packets_are_conserved_and_the_same_however_it_is_stepped(
    channel: Path, path: dict[str, Any], one: list[list[int]], other: list[list[int]]
) -> None:
    with Runner(channel) as run:
        rows, again = stepped(run, path, one), stepped(run, path, other)
    packets = packets_of(path, 0.0, rows[-1]["t"])
    least = max(path["latency"], path.get("pdc_wait", 0.0))
    before = dict.fromkeys(COUNTS, 0.0)
    for row in rows:
        sent = packets.stamp_s <= row["t"] + SLACK_S
        in_flight = int(np.sum(sent & (packets.due_s > row["t"] + SLACK_S)))
        assert row["sent"] == sent.sum()
        assert row["sent"] == row["delivered"] + row["dropped"] + row["late"] + in_flight
        assert all(row[n] >= before[n] for n in COUNTS)
        # the age is that of what was received, which took its path; before that, the time since the start
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
@given(channels(), st.integers(0, 400), st.integers(1, 400))
def test_a_packets_fate_does_not_depend_on_when_one_begins_to_look(
    path: dict[str, Any], first: int, length: int
) -> None:
    interval = path["reporting_interval"]
    whole = packets_of(path, 0.0, 900 * interval)
    part = packets_of(path, first * interval, (first + length) * interval)
    if path.get("good_to_bad"):  # the chain begins anew there; what a packet takes does not
        np.testing.assert_array_equal(part.due_s, whole.due_s[first : first + length + 1])
    else:
        np.testing.assert_array_equal(part.due_s, whole.due_s[first : first + length + 1])
        np.testing.assert_array_equal(part.lost, whole.lost[first : first + length + 1])
    wait = path.get("pdc_wait", 0.0)
    spent = whole.due_s - whole.stamp_s
    assert np.all(spent >= (wait or path["latency"]) - 1e-12)
    assert np.all(spent <= (wait or path["latency"] + path["jitter"]) + 1e-12)
