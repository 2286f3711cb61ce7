"""The guard of a controller's limit: closed forms of its filters, its limits and their derivatives."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from plant_shim import BlockShim

from interarea.fmu_build.write.sources import record_source
from interarea.models.blocks.controller import Guard, controller_block
from interarea.models.blocks.supervisor import supervisor_block

LIMIT, THRESHOLD, WASHOUT, LOWPASS = 0.05, 0.002, 3.0, 1.0


def _shim(side: float, gain: float = 100.0, watched: str | tuple[str, ...] = "G4_dw") -> BlockShim:
    guard = Guard({"G4_vs": watched}, {"G4_vs": side}, THRESHOLD, WASHOUT, LOWPASS)
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


def test_the_mean_of_several_signals_is_watched() -> None:
    """As one signal that has their mean; when one is lost the guard sees half of the other."""
    several, one = _shim(1.0, watched=("G2_dw", "G4_dw")), _shim(1.0)
    x = [0.0, 2e-4, -1e-4]
    for remote, local in ((1e-3, 6e-4), (0.0, 1e-3), (1e-3, 0.0), (-3e-4, 9e-4)):
        dx, y = several.derivatives(x, [remote, local])
        expected = one.derivatives(x, [remote, 0.5 * (remote + local)])
        assert y == pytest.approx(expected[1], abs=1e-15)
        assert dx[1:] == pytest.approx(expected[0][1:], abs=1e-15)
    rng = np.random.default_rng(5)
    for _ in range(5):
        state, u, vx, vu = (
            rng.normal(size=3) * 5e-4,
            rng.normal(size=2),
            rng.normal(size=3),
            rng.normal(size=2),
        )
        dx, dy = several.directional(vx, vu, state, u)
        ahead = several.derivatives(state + 1e-9 * vx, u + 1e-9 * vu)
        back = several.derivatives(state - 1e-9 * vx, u - 1e-9 * vu)
        assert dy == pytest.approx((ahead[1] - back[1]) / 2e-9, rel=1e-6, abs=1e-6)
        assert dx == pytest.approx((ahead[0] - back[0]) / 2e-9, rel=1e-6, abs=1e-6)
    with pytest.raises(ValueError, match="guard watches"):
        Guard({"G4_vs": ()}, {"G4_vs": 1.0}, 1e-3).check("K", ["G2_dw"], ["G4_vs"])
    with pytest.raises(ValueError, match="guard watches"):
        Guard({"G4_vs": ("G2_dw", "G9_dw")}, {"G4_vs": 1.0}, 1e-3).check("K", ["G2_dw"], ["G4_vs"])


def _bank(gain: float) -> BlockShim:
    """One member that passes G2_dw on; the guard watches the mean of both signals."""
    K = np.array([[-1.0]]), np.zeros((1, 2)), np.array([[0.0]]), np.array([[gain, 0.0]])
    guard = Guard({"G4_vs": ("G2_dw", "G4_dw")}, {"G4_vs": 1.0}, THRESHOLD, WASHOUT, LOWPASS)
    names = ["G2_dw", "G4_dw"]
    block = supervisor_block("B", {"one": K}, ["one"] * 4, names, ["G4_vs"], limit=LIMIT, guard=guard)
    return BlockShim(replace(block, sources=(*block.sources, record_source())))


@pytest.mark.slow
@pytest.mark.parametrize("trust", [(1.0, 1.0), (0.0, 1.0), (0.3, 0.9)])
def test_the_guard_of_a_supervisor_watches_what_is_trusted(trust: tuple[float, float]) -> None:
    """As the guard of one controller that gets the faded signals."""
    several, one = _bank(100.0), _shim(1.0, watched=("G2_dw", "G4_dw"))
    for filters in ([0.0, 0.0], [2e-4, -1e-3]):
        for u in ([1.0, 1e-3], [1e-3, -1e-3], [-1.0, 5e-4]):
            faded = [m * each for m, each in zip(trust, u, strict=True)]
            dx, y = several.derivatives([0.0, 1.0, *trust, *filters], u)
            expected = one.derivatives([0.0, *filters], faded)
            assert y == pytest.approx(expected[1], abs=1e-15)
            assert dx[-2:] == pytest.approx(expected[0][1:], abs=1e-15)


def test_derivatives_of_a_guarded_supervisor_are_those_of_differences() -> None:
    shim, rng = _bank(100.0), np.random.default_rng(7)
    for remote in (1.0, -1.0, 1e-5):
        x = np.array([*rng.normal(size=1), 1.0, 0.7, 0.9, *(rng.normal(size=2) * 5e-4)])
        u, vx, vu = np.array([remote, 4e-4]), rng.normal(size=6), rng.normal(size=2)
        dx, dy = shim.directional(vx, vu, x, u)
        ahead = shim.derivatives(x + 1e-9 * vx, u + 1e-9 * vu)
        back = shim.derivatives(x - 1e-9 * vx, u - 1e-9 * vu)
        assert dy == pytest.approx((ahead[1] - back[1]) / 2e-9, rel=1e-5, abs=1e-6)
        assert dx == pytest.approx((ahead[0] - back[0]) / 2e-9, rel=1e-5, abs=1e-6)


def test_what_a_supervisor_cannot_guard_is_refused() -> None:
    K = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.zeros((1, 1))
    for guard, says in (
        (Guard({"G4_vs": "G9_dw"}, {"G4_vs": 1.0}, 1e-3), "guard watches"),
        (Guard({"G4_vs": "G4_dw"}, {"G4_vs": 1.0}, 1e-3, follows="G4_dw"), "its guard follows 'G4_dw'"),
    ):
        with pytest.raises(ValueError, match=says):
            supervisor_block("B", {"one": K}, ["one"] * 2, ["G4_dw"], ["G4_vs"], guard=guard)


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
