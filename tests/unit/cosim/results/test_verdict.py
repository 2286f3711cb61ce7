"""The one rule of verdicts against motions whose answer is known, good ones and bad ones."""

from __future__ import annotations

import numpy as np
import pytest
from judged import judged

from interarea.cosim.results import verdict as v

T = 0.02 * np.arange(1001)  # 20 s


def ring(zeta: float, hertz: float = 0.6, time: np.ndarray = T) -> np.ndarray:
    w = 2.0 * np.pi * hertz
    return 1e-3 * np.exp(-zeta * w * time) * np.cos(w * time + 0.3)


@pytest.mark.parametrize(
    ("zeta", "name"),
    [(0.3, v.SETTLED), (0.05, v.SETTLED), (0.01, v.SLOW), (0.0, v.STANDING), (-0.01, v.GROWING)],
)
def test_one_mode_by_its_damping(zeta: float, name: str) -> None:
    result = judged(T, ring(zeta))
    assert result.name == name and result.stable is (zeta > 0.0)
    # exp(-zeta w 5 s) from one window to the next
    assert result.last / result.before == pytest.approx(np.exp(-zeta * 2 * np.pi * 0.6 * 5.0), rel=0.02)


@pytest.mark.parametrize("start", [0.3, 1.0, 3.0])
@pytest.mark.parametrize("approach", [1.0, 2.0])
def test_a_limit_cycle_is_no_success_from_wherever_it_is_reached(start: float, approach: float) -> None:
    envelope = 1.0 + (start - 1.0) * np.exp(-approach * T)
    result = judged(T, 1e-3 * envelope * np.sin(2 * np.pi * 0.6 * T))
    assert result.name == v.STANDING and not result.stable


def test_a_limit_cycle_far_below_the_first_swing_is_none_either() -> None:
    """A tenth of the first swing at 0.1 Hz: a run of 60 s sees it, whatever its first seconds did."""
    time = 0.02 * np.arange(3001)
    swing = ring(0.3, time=time) + 1e-4 * np.sin(2 * np.pi * 0.1 * time) * (1 - np.exp(-time))
    assert judged(time, swing).name == v.STANDING


def test_a_residue_within_the_band_of_the_settling_time_has_settled() -> None:
    ripple = 1e-3 * np.sin(2 * np.pi * 3.0 * T)
    assert judged(T, ring(0.3) + 0.005 * ripple).name == v.SETTLED
    assert judged(T, ring(0.3) + 0.1 * ripple).name == v.STANDING


def test_a_control_at_its_limit_in_the_end_is_no_success() -> None:
    stuck = np.full(len(T), 0.05)
    assert judged(T, ring(0.3), controls={"vs": stuck}, limit_pu=0.05).name == v.STANDING
    assert judged(T, ring(0.3), controls={"vs": stuck * (T < 5.0)}, limit_pu=0.05).name == v.SETTLED
    assert judged(T, ring(0.3), controls={"vs": stuck}).name == v.SETTLED  # no limit: an offset


def test_a_control_that_goes_on_is_no_success_though_the_speeds_settle() -> None:
    """+-0.03 pu at 0.1 Hz below the limit, which the speeds hardly show."""
    control = 0.03 * np.sin(2 * np.pi * 0.2 * T)
    result = judged(T, ring(0.3), controls={"vs": control}, limit_pu=0.05)
    assert result.name == v.STANDING and "vs" in result.why


def test_a_standing_swing_of_all_machines_together_is_seen() -> None:
    """The difference of two speeds is blind to it."""
    common = 1e-3 * np.sin(2 * np.pi * 0.2 * T)
    assert judged(T, ring(0.3), common=common).name == v.STANDING
    assert judged(T, ring(0.3), common=1e-3 * T / T[-1]).name == v.SETTLED  # a frequency that drifts


def test_a_slip_is_told_with_the_angle_and_when() -> None:
    turned = np.radians(90.0 + 1000.0 * np.clip(T - 5.0, 0.0, 1.0))
    angles = np.array([turned, np.zeros(len(T))])
    result = judged(T, ring(0.3), angles=angles)
    assert result.name == v.LOST and not result.stable and not result.synchronous
    assert result.lost_s == pytest.approx(5.1, abs=0.02)  # 90 degrees more at 1000 a second
    assert result.angle_deg == pytest.approx(1090.0) and result.slips == 3 and result.pair == ("A", "B")


def test_angles_that_are_not_shown_come_from_the_speeds() -> None:
    speed = np.full(len(T), 1e-3)  # of one against the other: 360 * 60 * 1e-3 = 21.6 degrees a second
    motion = v.Motion(["A", "B"], [[0, 1]], (), (), 20.0, 2 * np.pi * 60.0)
    motion.add(T, np.array([speed, 0 * speed]), None, {})
    result = motion.verdict(None)
    assert result.angle_deg == pytest.approx(432.0) and result.lost_s == pytest.approx(180 / 21.6, abs=0.02)


def test_machines_of_different_islands_do_not_slip_against_each_other() -> None:
    motion = v.Motion(["A", "B"], [[0], [1]], (), (), 20.0, 2 * np.pi * 60.0)
    angles = np.array([10.0 * T, 0.0 * T])
    motion.add(T, np.array([ring(0.3), ring(0.3)]), angles, {})
    assert motion.verdict(None).name == v.SETTLED


def test_a_voltage_source_that_slips_is_lost_though_the_machines_settle() -> None:
    swing = np.array([ring(0.3), -ring(0.3)])
    turned = np.radians(400.0 * np.clip(T - 5.0, 0.0, 1.0))  # once round, then in step again
    for islands, name in (([[0, 1, 2]], v.LOST), ([[0, 1], [2]], v.SETTLED)):
        motion = v.Motion(["A", "B"], islands, (), (), 20.0, 2 * np.pi * 60.0, ["C"])
        motion.add(T, swing, np.array([0.0 * T, 0.0 * T, turned]), {})
        result = motion.verdict(None)
        assert result.name == name and motion.rule == v.RULE
    motion = v.Motion(["A", "B"], [[0, 1, 2]], (), (), 20.0, 2 * np.pi * 60.0, ["C"])
    motion.add(T, swing, None, {})  # a plant that does not show it
    assert motion.verdict(None).name == v.SETTLED and "not judged: the angle of C" in motion.rule


def test_a_machine_alone_settles_at_another_frequency_or_does_not() -> None:
    """After a load step its speed goes to an offset; without a governor it runs away."""
    offset = -2e-3 * (1.0 - np.exp(-T / 2.0))
    assert judged(T, offset, alone=True).name == v.SETTLED
    assert not judged(T, -1e-3 * T, alone=True).stable
    assert judged(T, offset + ring(-0.01), alone=True).name == v.GROWING


def test_no_window_holds_the_end_of_an_outage() -> None:
    """The kick of a signal that returns is no growth, whether the run ends with it or a second later."""
    swing = ring(0.08) + 1e-4 * np.where(T >= 19.0, np.sin(2 * np.pi * 0.6 * (T - 19.0)), 0.0)
    result = judged(T, swing, events_s=[0.0], outages_s=[1.5, 19.0])
    assert result.stable and result.window_s == (1.5, 19.0) and "up to 19 s" in result.why
    jump = np.where(T >= 20.0, 0.05, 0.0)
    kicked = judged(T, ring(0.08), outages_s=[1.5, 20.0], controls={"vs": jump}, limit_pu=0.05)
    assert kicked.name == v.SETTLED
    # the same growth while nothing changes is seen
    assert not judged(T, ring(-0.02), events_s=[0.0], outages_s=[1.5, 19.0]).stable


def test_what_follows_the_last_event_too_shortly_is_not_judged() -> None:
    result = judged(T, ring(0.3), events_s=[1.0, 19.0])
    assert result.name == v.NOT_JUDGED and not result.stable


def test_a_grid_at_rest_is_what_its_linear_loop_is() -> None:
    still = np.zeros(len(T))
    assert judged(T, still).name == v.SETTLED
    assert judged(T, still, root=-0.1 + 4j).name == v.SETTLED
    result = judged(T, still, root=0.03 + 4j)
    assert result.name == v.GROWING and "+0.03" in result.why
    # growth with a time constant of 33 s does not show in 20 s
    assert judged(T, ring(0.1), root=0.03 + 0.67j).name == v.GROWING


def test_parts_give_what_the_whole_gives() -> None:
    control = {"vs": 0.05 * ring(0.1) / 1e-3}
    angles = np.array([np.radians(50.0) * np.sin(T), np.zeros(len(T))])
    whole = judged(T, ring(0.05), controls=control, limit_pu=0.05, angles=angles, events_s=[1.0])
    for parts in ([500], [100, 250, 800], [999]):
        assert (
            judged(T, ring(0.05), controls=control, limit_pu=0.05, angles=angles, events_s=[1.0], parts=parts)
            == whole
        )
