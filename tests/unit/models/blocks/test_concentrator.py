"""The concentrator against a simulation of its events, message by message, and against closed forms."""

from __future__ import annotations

import heapq
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmu_runner import Runner
from scipy.stats import binom

from interarea.fmu_build.write.package import build_fmu
from interarea.models.blocks.concentrator import concentrator_block, frame_sets
from interarea.models.blocks.packet_schedule import packet_random

N, STOP_S = 3, 4.0
COUNTS = ("sent", "delivered", "dropped", "late")
BASE: dict[str, float] = {"reporting_interval": 0.02, "wait": 0.06, "seed": 3.0}
PATHS: dict[str, dict[str, float]] = {
    "steady": {"latency[1]": 0.01, "latency[2]": 0.03, "latency[3]": 0.05, "latency": 0.015},
    "jitter": {"latency[1]": 0.01, "jitter[1]": 0.08, "jitter[2]": 0.05, "latency[3]": 0.04, "on_loss": 1.0},
    "loss": {"latency[1]": 0.01, "loss[1]": 0.2, "loss[2]": 0.1, "lost[3].start": 1.0, "lost[3].end": 2.0},
    "held for a while": {"latency[1]": 0.01, "loss[1]": 0.7, "loss[2]": 0.5, "lost[3].start": 1.0}
    | {"lost[3].end": 2.0, "on_loss": 2.0, "hold_time": 0.05, "latency": 0.015},
    "relative": {"relative": 1.0, "wait": 0.03, "jitter[1]": 0.08, "jitter[2]": 0.05, "latency[3]": 0.04}
    | {"loss[1]": 0.5, "loss[2]": 0.5, "loss[3]": 0.5, "latency": 0.005, "on_loss": 1.0},
}


@pytest.fixture(scope="module")
def concentrator(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_fmu(concentrator_block(N, capacity=256), tmp_path_factory.mktemp("pdc") / "pdc.fmu")


def signal(i: int, t: float) -> tuple[float, float]:
    return math.sin((1 + i) * t), (1 + i) * math.cos((1 + i) * t)


def start_of(p: dict[str, float]) -> dict[str, Any]:
    whole = ("seed", "on_loss", "relative")
    start: dict[str, Any] = {k: int(v) if k in whole else v for k, v in p.items()}
    return start | {f"u{i + 1}": signal(i, 0.0)[0] for i in range(N)}


def follow(path: Path, p: dict[str, float], h: float) -> np.ndarray:
    """Send sines; rows of (y1.., valid1.., age, counts) after each step."""
    rows = []
    with Runner(path) as run:
        run.start(start_of(p))
        for k in range(round(STOP_S / h)):
            for i in range(N):
                run.set(**{f"u{i + 1}": signal(i, k * h)[0]})
                run.slopes(f"u{i + 1}", signal(i, k * h)[1])
            run.step(k * h, h)
            names = [f"y{i + 1}" for i in range(N)] + [f"valid{i + 1}" for i in range(N)]
            rows.append([float(run.get(n)) for n in (*names, "age", *COUNTS)])
    return np.array(rows)


def simulate(p: dict[str, float], h: float) -> np.ndarray:
    """The same rows from a queue of arrivals and ends of waits: a concentrator that knows no formula."""
    T, frames = p["reporting_interval"], int(STOP_S / p["reporting_interval"]) + 1
    number = np.arange(frames)
    events: list[tuple[float, int, int, int]] = []  # time, 0 arrival | 1 end of a wait, stamp number, signal
    came: dict[int, set[int]] = {k: set() for k in range(frames)}
    for i in range(N):
        u, v = (packet_random(int(p["seed"]), number, 16 + 2 * i + s) for s in (0, 1))
        for k in range(frames):
            out = p.get(f"lost[{i + 1}].start", 9e9) - 1e-9 < k * T < p.get(f"lost[{i + 1}].end", 9e9) - 1e-9
            if v[k] >= p.get(f"loss[{i + 1}]", 0.0) and not out:
                at = k * T + p.get(f"latency[{i + 1}]", 0.0) + p.get(f"jitter[{i + 1}]", 0.0) * u[k]
                heapq.heappush(events, (round(at, 12), 0, k, i))
    expected = {k: sum(1 for e in events if e[2] == k) for k in range(frames)}
    if not p.get("relative"):
        for k in range(frames):
            heapq.heappush(events, (round(k * T + p["wait"], 12), 1, k, -1))
    waiting = [k for k in range(frames) if expected[k] or not p.get("relative")]
    over: set[int] = set()
    out: list[tuple[float, int, set[int]]] = []  # instant, stamp number, signals
    while events:
        now, kind, k, i = heapq.heappop(events)
        if kind == 0 and k in waiting:
            came[k].add(i)
            if p.get("relative") and len(came[k]) == 1:
                heapq.heappush(events, (round(now + p["wait"], 12), 1, k, -1))
            if len(came[k]) == N:
                over.add(k)
        elif kind == 1:
            over.add(k)
        # frames of one instant belong together: release after the last of them
        if events and events[0][0] == now and events[0][1] == 0:
            continue
        while waiting and waiting[0] in over:
            out.append((now + p.get("latency", 0.0), waiting[0], set(came[waiting[0]])))
            waiting.pop(0)
    rows = []
    held_s = {0.0: 0.0, 1.0: 9e9, 2.0: p.get("hold_time", 0.5)}[p.get("on_loss", 2.0)]
    for step in range(1, round(STOP_S / h) + 1):
        t = step * h
        y, valid, newest = [signal(i, 0.0)[0] for i in range(N)], [1.0] * N, 0
        since = [0.0] * N
        for at, k, signals in out:
            if at <= t + 1e-9:
                newest = k
                for i in range(N):
                    since[i] = at if valid[i] and i not in signals else since[i]
                    valid[i] = float(i in signals)
                    y[i] = signal(i, k * T)[0] if i in signals else y[i]
        y = [y[i] if valid[i] or t < since[i] + held_s - 1e-9 else 0.0 for i in range(N)]
        rows.append([*y, *valid, t - newest * T])
    return np.array(rows)


@pytest.mark.slow
@pytest.mark.parametrize("path", PATHS)
def test_it_does_what_a_simulation_of_its_messages_does(concentrator: Path, path: str) -> None:
    p = BASE | PATHS[path]
    for h in (0.02, 0.005):
        own, theirs = follow(concentrator, p, h), simulate(p, h)
        np.testing.assert_array_equal(own[:, N : 2 * N], theirs[:, N : 2 * N])
        np.testing.assert_allclose(own[:, 2 * N], theirs[:, 2 * N], atol=1e-9)
        # stamps are communication points: values to rounding
        np.testing.assert_allclose(own[:, :N], theirs[:, :N], atol=1e-12)


def test_steady_ways_come_out_together_as_late_as_the_slowest(concentrator: Path) -> None:
    """50 ms for the slowest and 15 more: age is a sawtooth from 65 to 85 ms, the same for each signal."""
    rows = follow(concentrator, BASE | PATHS["steady"], 0.005)
    ages = rows[30:, 2 * N]
    assert ages.min() == pytest.approx(0.065, abs=1e-9) and ages.max() == pytest.approx(0.080, abs=1e-9)
    assert np.all(rows[:, N : 2 * N] == 1.0)


def test_frames_add_up_and_losses_keep_their_rate(concentrator: Path) -> None:
    p = BASE | {"loss[1]": 0.2, "latency[1]": 0.01, "jitter[2]": 0.08, "seed": 8.0}
    rows = follow(concentrator, p, 0.02)
    sent, delivered, dropped, late = rows[-1, 2 * N + 1 :]
    assert sent == N * (STOP_S / 0.02 + 1)
    assert 0 <= sent - delivered - dropped - late <= N * 4  # a wait of 60 ms, a set each 20
    assert binom.ppf(5e-5, 200, 0.2) <= dropped <= binom.ppf(1 - 5e-5, 200, 0.2)
    assert binom.ppf(5e-5, 198, 0.25) <= late <= binom.ppf(1 - 5e-5, 198, 0.25)  # 60 to 80 of 0 to 80 ms


def test_the_same_after_restoring_and_in_every_step(concentrator: Path) -> None:
    p = BASE | PATHS["jitter"]
    coarse, fine = follow(concentrator, p, 0.02), follow(concentrator, p, 0.005)
    np.testing.assert_array_equal(coarse[:, N : 2 * N], fine[3::4, N : 2 * N])
    with Runner(concentrator) as run:
        run.start(start_of(p))
        for k in range(40):
            run.step(0.02 * k, 0.02)
        state = run.fmu.getFMUState()
        seen = []
        for _ in range(2):
            run.fmu.setFMUState(state)
            rows = []
            for k in range(40, 80):
                run.step(0.02 * k, 0.02)
                rows.append([run.get(n) for n in ("y1", "valid1", "valid2", "age", *COUNTS)])
            seen.append(rows)
        run.fmu.freeFMUState(state)
    assert seen[0] == seen[1]


@pytest.mark.parametrize("path", PATHS)
def test_python_knows_when_sets_come_out(concentrator: Path, path: str) -> None:
    p = BASE | PATHS[path]
    sets = frame_sets(p, N, 0.0, STOP_S)
    rows = simulate(p, 0.005)
    for t, row in zip(np.arange(1, len(rows) + 1) * 0.005, rows, strict=True):
        out = np.flatnonzero(sets.due_s <= t + 1e-9)
        if out.size:
            assert row[2 * N] == pytest.approx(t - sets.stamp_s[out[-1]], abs=1e-9)
            np.testing.assert_array_equal(row[N : 2 * N], sets.valid[out[-1]])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"reporting_interval": 1e-5}, "reporting_interval was set to 1e-05; allowed are 0.0001"),
        ({"loss[2]": 1.5}, r"loss[2] was set to 1.5; allowed are 0 to 1"),
        ({"lost[1].start": 2.0, "lost[1].end": 1.0}, "lies before lost.start"),
    ],
)
def test_settings_that_make_no_sense_are_refused(
    concentrator: Path, change: dict[str, float], says: str
) -> None:
    with Runner(concentrator) as run:
        with pytest.raises(FMICallException):
            run.start(start_of(BASE | change))
        assert says in run.log[-1]
    with pytest.raises(ValueError, match="33 signals, allowed are 1 to 32"):
        concentrator_block(33)


def test_faults_of_one_signal_leave_the_others_alone(concentrator: Path) -> None:
    """Signal 1 inverted, signal 2 replaced by signal 3 from 1 to 2 s of measurement; all flags stay up."""
    kinds = {"fault[1,1].kind": 6, "fault[2,1].kind": 12, "fault[2,1].size": 3.0}
    window = {f"fault[{i},1].{end}": at for i in (1, 2) for end, at in (("start", 1.0), ("end", 2.0))}
    p = {**BASE, "latency[1]": 0.02, "latency[2]": 0.02, "latency[3]": 0.02}
    right = follow(concentrator, p, 0.01)
    with Runner(concentrator) as run:
        run.start({**start_of(p), **kinds, **window})
        for k in range(round(STOP_S / 0.01)):
            for i in range(N):
                run.set(**{f"u{i + 1}": signal(i, k * 0.01)[0]})
                run.slopes(f"u{i + 1}", signal(i, k * 0.01)[1])
            run.step(k * 0.01, 0.01)
            wrong = 101 <= k <= 200  # rows whose newest set is stamped 1.00 to 1.98 s
            y = right[k, :N]
            expected = (-y[0], y[2], y[2]) if wrong else tuple(y)
            assert tuple(run.get(f"y{i + 1}") for i in range(N)) == expected, k
            assert all(run.get(f"valid{i + 1}") for i in range(N))


def test_a_swap_with_a_signal_that_is_not_there_is_refused(concentrator: Path) -> None:
    swap = {"fault[1,1].kind": 12, "fault[1,1].size": 4.0, "fault[1,1].start": 0.0, "fault[1,1].end": 1.0}
    with Runner(concentrator) as run:
        with pytest.raises(FMICallException):
            run.start({**start_of(BASE), **swap})
        assert "another signal of the same concentrator" in run.log[-1]
