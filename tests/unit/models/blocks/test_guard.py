"""The guard of a controller's limit: closed forms of its filters, its limits and their derivatives."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from plant_shim import BlockShim

from interarea.fmu_build.write.sources import record_source
from interarea.models.blocks.controller import Guard, controller_block

LIMIT, THRESHOLD, WASHOUT, LOWPASS = 0.05, 0.002, 3.0, 1.0


def _shim(side: float, gain: float = 100.0) -> BlockShim:
    guard = Guard({"G4_vs": "G4_dw"}, {"G4_vs": side}, THRESHOLD, WASHOUT, LOWPASS)
    block = controller_block(
        "K",
        [[-1.0]],
        [[0.0, 0.0]],
        [[0.0]],
        [[gain, 0.0]],
        ["G2_dw", "G4_dw"],
        ["G4_vs"],
        limit=LIMIT,
        guard=guard,
    )
    return BlockShim(replace(block, sources=(*block.sources, record_source())))


@pytest.mark.parametrize("side", [1.0, -1.0, 0.5])
@pytest.mark.parametrize("speed", [0.0, 0.0005, -0.001, 0.003])
def test_one_side_of_the_limit_falls_with_the_swing(side: float, speed: float) -> None:
    shim = _shim(side)
    share = min(1.0, abs(speed) / THRESHOLD)
    high = LIMIT * (1.0 - share * max(side, 0.0))
    low = LIMIT * (1.0 + share * min(side, 0.0))
    assert shim.derivatives([0.0, 0.0, 0.0], [1.0, speed])[1][0] == pytest.approx(high, abs=1e-15)
    assert shim.derivatives([0.0, 0.0, 0.0], [-1.0, speed])[1][0] == pytest.approx(-low, abs=1e-15)


def test_a_lasting_deviation_does_not_hold_the_limit_shut() -> None:
    """s = s0 from t = 0: s - w = s0 exp(-t/washout); the low pass of that in closed form."""
    shim = _shim(1.0)
    speed, t = 0.004, 6.0
    x = shim.run(t, 1e-2, np.array([1.0, speed]))[1][-1]
    fast = speed * math.exp(-t / WASHOUT)
    slow = speed * WASHOUT / (WASHOUT - LOWPASS) * (math.exp(-t / WASHOUT) - math.exp(-t / LOWPASS))
    assert speed - x[1] == pytest.approx(fast, rel=1e-9)
    assert x[2] == pytest.approx(slow, rel=1e-9)
    expected = LIMIT * (1.0 - max(fast, slow) / THRESHOLD)
    assert shim.derivatives(x, [1.0, speed])[1][0] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("side", [1.0, -0.7])
@pytest.mark.parametrize("remote", [1.0, -1.0, 1e-5])
def test_derivatives_are_those_of_differences(side: float, remote: float) -> None:
    shim = _shim(side)
    rng = np.random.default_rng(3)
    for _ in range(10):
        x, u = rng.normal(size=3) * 5e-4, np.array([remote, rng.normal() * 5e-4])
        vx, vu, eps = rng.normal(size=3), rng.normal(size=2), 1e-9
        dx, dy = shim.directional(vx, vu, x, u)
        ahead = shim.derivatives(x + eps * vx, u + eps * vu)
        back = shim.derivatives(x - eps * vx, u - eps * vu)
        assert dy == pytest.approx((ahead[1] - back[1]) / (2 * eps), rel=1e-6, abs=1e-6)
        assert dx == pytest.approx((ahead[0] - back[0]) / (2 * eps), rel=1e-6, abs=1e-6)


FLOW = 0.4


def _turned(flow: float) -> BlockShim:
    """Two guarded outputs whose sides follow the third input; at rest that is `flow`."""
    guard = Guard(
        {"G2_vs": "G2_dw", "G4_vs": "G4_dw"},
        {"G2_vs": -1.0, "G4_vs": 0.5},
        THRESHOLD,
        WASHOUT,
        LOWPASS,
        follows="tie_p",
        flow_pu=FLOW,
    )
    block = controller_block(
        "K",
        [[-1.0]],
        [[0.0, 0.0, 0.0]],
        [[0.0], [0.0]],
        [[100.0, 0.0, 0.0], [0.0, 100.0, 0.0]],
        ["G2_dw", "G4_dw", "tie_p"],
        ["G2_vs", "G4_vs"],
        limit=LIMIT,
        guard=guard,
    )
    shim = BlockShim(replace(block, sources=(*block.sources, record_source())), {"tie_p": flow})
    assert shim.state_names[-1] == "flow_course"
    return shim


@pytest.mark.parametrize("flow", [0.0, 0.1, -0.3, 2.0, -2.0])
def test_sides_turn_with_the_slow_course_of_a_flow(flow: float) -> None:
    shim = _turned(flow)
    x0, turn = shim.x.copy(), max(-1.0, min(1.0, flow / FLOW))
    assert x0[-1] == flow  # the course starts at rest, whatever its start value
    assert shim.derivatives(x0)[0][-1] == 0.0
    for speed in (0.4 * THRESHOLD, -2.0 * THRESHOLD):
        share = min(1.0, abs(speed) / THRESHOLD)
        y = shim.derivatives(x0, [speed, speed, flow])[1]
        for out, side in zip(y, (-1.0 * turn, 0.5 * turn), strict=True):
            high, low = LIMIT * (1.0 - share * max(side, 0.0)), LIMIT * (1.0 + share * min(side, 0.0))
            assert out == pytest.approx(min(max(100.0 * speed, -low), high), abs=1e-15)


def test_the_course_of_a_flow_goes_from_rest_to_where_the_flow_stays() -> None:
    shim = _turned(1.0)
    x = shim.run(6.0, 1e-2, np.array([0.0, 0.0, -0.5]))[1][-1]
    assert x[-1] == pytest.approx(-0.5 + 1.5 * math.exp(-6.0 / WASHOUT), rel=1e-9)


@pytest.mark.parametrize("course", [0.2, -0.3, 0.9])
def test_derivatives_of_turned_sides_are_those_of_differences(course: float) -> None:
    shim, rng = _turned(course), np.random.default_rng(4)
    for _ in range(20):
        x = np.array([*(rng.normal(size=5) * 5e-4), course + 0.05 * rng.normal()])
        u = np.array([rng.choice([-1.0, 1.0]), rng.choice([-1.0, 1.0]), rng.normal()]) * [5e-4, 5e-4, 1.0]
        u[:2] *= rng.uniform(0.5, 2.5, 2)
        vx, vu, eps = rng.normal(size=6), rng.normal(size=3), 1e-9
        dx, dy = shim.directional(vx, vu, x, u)
        ahead = shim.derivatives(x + eps * vx, u + eps * vu)
        back = shim.derivatives(x - eps * vx, u - eps * vu)
        assert dy == pytest.approx((ahead[1] - back[1]) / (2 * eps), rel=1e-5, abs=1e-5)
        assert dx == pytest.approx((ahead[0] - back[0]) / (2 * eps), rel=1e-5, abs=1e-5)


@pytest.mark.parametrize(
    ("guard", "said"),
    [
        (Guard({"G3_vs": "G4_dw"}, {"G3_vs": 1.0}, 0.1), "G3_vs"),
        (Guard({"G4_vs": "G9_dw"}, {"G4_vs": 1.0}, 0.1), "G9_dw"),
        (Guard({"G4_vs": "G4_dw"}, {}, 0.1), "the same outputs"),
        (Guard({"G4_vs": "G4_dw"}, {"G4_vs": 2.0}, 0.1), "-1 to 1"),
        (Guard({"G4_vs": "G4_dw"}, {"G4_vs": 1.0}, math.nan), "threshold"),
        (Guard({"G4_vs": "G4_dw"}, {"G4_vs": 1.0}, 0.1, follows="tie_p"), "follows 'tie_p'"),
        (Guard({"G4_vs": "G4_dw"}, {"G4_vs": 1.0}, 0.1, follows="G4_dw", flow_pu=0.0), "flow_pu"),
    ],
)
def test_a_guard_that_does_not_fit_is_refused(guard: Guard, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        controller_block("K", [[-1.0]], [[0.0]], [[0.0]], [[1.0]], ["G4_dw"], ["G4_vs"], guard=guard)
