"""Frequency relays and ramps against closed forms.

The electric power of a single constant EMF on constant impedances is constant, so 2 H d(slip)/dt is what its
mechanical power is stepped or ramped by, exactly.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from plant_shim import BlockFailure, BlockShim

from interarea.models.blocks.plant import event_parameters, plant_block
from interarea.models.case.case import Case, case_of
from interarea.models.case.events import events_of

H, HZ, LOOK_S = 4.0, 60.0, 0.005
FORMS = ("dense", "sparse")


def grid(more: int = 0, events: tuple[dict[str, Any], ...] = ()) -> Case:
    """One machine, two lines, one load; `more` machines beside the first, `events` of its own."""
    machine = {
        "bus": 1, "model": "classical", "base_mva": 100.0, "H": H, "Xd1": 0.2, "P_mw": 50.0 / (1 + more),
        "V_pu": 1.0,
    }  # fmt: skip
    names = [f"G{k}" for k in range(1, 2 + more)]
    return case_of(
        {
            "name": "one",
            "source": "of this test",
            "frequency_hz": HZ,
            "base_mva": 100.0,
            "buses": {"1": {}, "2": {}},
            "branches": {"1-2": {"from": 1, "to": 2, "x": 0.1}, "1-2 b": {"from": 1, "to": 2, "x": 0.3}},
            "loads": {"L2": {"bus": 2, "P_mw": 50.0, "Q_mvar": 10.0}},
            "machines": {name: machine | {"slack": name == "G1"} for name in names},
            "event": list(events),
        },
        where="one",
    )


def started(*events: dict[str, Any], form: str = "dense", more: int = 0) -> BlockShim:
    case = grid(more)
    return BlockShim(plant_block(case, network=form), event_parameters(case, events_of(events, where="test")))


def pushed(size: float, start: float = 0.1, **more: Any) -> dict[str, Any]:
    return {"kind": "pm_step", "machine": "G1", "size_pu": size, "start_s": start, **more}


def shed(threshold: float, **more: Any) -> dict[str, Any]:
    return {"kind": "frequency_shed", "bus": 2, "size_pu": 0.25, "threshold_hz": threshold, **more}


def opened_at(plant: BlockShim, stop_s: float) -> float:
    """When the electric power of G1 leaps, NaN where it does not."""
    times, _, outputs = plant.run(stop_s, 0.05)
    pe = outputs[:, plant.output_names.index("G1_pe")]
    leaps = np.flatnonzero(np.abs(np.diff(pe)) > 1e-6)
    return float(times[leaps[0] + 1]) if len(leaps) else math.nan


def picks_up(crossing_s: float, filter_s: float) -> float:
    """The first look at which a rate of change without end is seen beyond the threshold.

    What turned since the last look is the frequency half a look ago; the lag adds a / (1 - a) looks,
    a = exp(-look / filter).
    """
    decay = math.exp(-LOOK_S / filter_s) if filter_s else 0.0
    return LOOK_S * math.ceil((crossing_s + LOOK_S * (0.5 + decay / (1.0 - decay))) / LOOK_S)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(("filter_s", "sign"), [(0.05, -1.0), (0.0, -1.0), (0.02, 1.0)])
def test_a_relay_opens_at_the_time_that_a_constant_rate_of_change_tells(
    form: str, filter_s: float, sign: float
) -> None:
    push, delay_s, breaker_s = 0.2, 0.15, 0.0833
    rate = HZ * push / (2.0 * H)  # Hz/s
    crossing_s = 0.1 + 1.0333 / rate
    relay = shed(HZ + sign * 1.0333, delay_s=delay_s, breaker_s=breaker_s, filter_s=filter_s)
    expected = picks_up(crossing_s, filter_s) + delay_s + breaker_s
    assert opened_at(started(pushed(sign * push), relay, form=form), 1.5) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("form", FORMS)
def test_what_a_relay_sheds_is_a_load_step_of_minus_its_share(form: str) -> None:
    relay = started(pushed(-0.2), shed(59.0, breaker_s=0.0), form=form)
    _, states, _ = relay.run(1.5, 0.05)
    step = started(pushed(-0.2), {"kind": "load_step", "bus": 2, "size_pu": -0.25, "start_s": 0.0}, form=form)
    step.event(1.5, states[-1])
    for one, other in zip(relay.derivatives(states[-1]), step.derivatives(states[-1]), strict=True):
        assert np.array_equal(one, other)


@pytest.mark.parametrize("form", FORMS)
def test_relays_of_the_case_act_beside_what_happens_in_a_run(form: str) -> None:
    relay, push = shed(59.0, breaker_s=0.0), pushed(-0.2)
    case = grid(events=(relay,))
    own = plant_block(case, network=form)
    both = BlockShim(own, event_parameters(case, events_of([push], where="test")))
    assert opened_at(both, 1.5) == opened_at(started(relay, push, form=form), 1.5) > 0.5
    assert math.isnan(opened_at(BlockShim(own), 1.5))  # the relay alone, nothing that lowers the frequency
    free = [v for v in own.table.of_role("parameter", integers=True) if v.name.endswith(".kind")]
    assert [v.start for v in free] == [9, *[0] * 8]


def test_a_relay_drops_out_when_the_frequency_comes_back_in_time() -> None:
    """0.2 pu for .4 s is 0.6 Hz; as much upwards brings it back .5 s after it went below 59.5 Hz."""
    back = pushed(0.4, 0.5)
    low = [pushed(-0.2), back]
    assert math.isnan(opened_at(started(*low, shed(59.6, delay_s=0.45)), 1.2))
    assert opened_at(started(*low, shed(59.6, delay_s=0.1)), 1.2) < 0.7
    assert math.isnan(opened_at(started(*low, shed(59.6, delay_s=0.1, end_s=0.3)), 1.2))  # out of use
    assert opened_at(started(pushed(-0.2), shed(59.6, start_s=0.9, breaker_s=0.0)), 1.2) == pytest.approx(0.9)


def test_a_relay_at_a_bus_without_voltage_does_not_act() -> None:
    fault = {"kind": "bus_fault", "bus": 2, "start_s": 0.15, "end_s": 1.3, "x_pu": 1e-4}
    plant = started(pushed(-0.2), fault, shed(60.5, breaker_s=0.0))
    _, states, _ = plant.run(1.25, 0.05)
    alone = started(pushed(-0.2), fault)
    alone.event(1.25, states[-1])
    assert np.array_equal(plant.derivatives(states[-1])[0], alone.derivatives(states[-1])[0])
    assert states[-1][plant.state_names.index("G1.slip")] > 0.5 / HZ


def test_a_relay_trips_a_machine() -> None:
    relay = {
        "kind": "frequency_trip",
        "machine": "G2",
        "threshold_hz": 60.5,
        "delay_s": 0.1,
        "breaker_s": 0.05,
    }
    plant = started(pushed(0.2), relay, more=1)
    rate = HZ * 0.2 / (2.0 * 2.0 * H)  # both machines' inertia
    times, _, outputs = plant.run(1.2, 0.05)
    pe = outputs[:, plant.output_names.index("G2_pe")]
    off = times[np.flatnonzero(np.abs(pe) < 1e-12)[0]]
    assert off == pytest.approx(
        0.1 + 0.5 / rate + 0.05 + 0.15, abs=0.02
    )  # they also swing against each other
    assert np.all(pe[times >= off] == 0.0)


@pytest.mark.parametrize("form", FORMS)
def test_a_ramp_of_the_set_point_gives_the_speed_of_its_integral(form: str) -> None:
    """2 H slip = size t^2 / (2 rise) at the end of each stair, then a straight line."""
    rise, size = 0.33, 0.1
    plant = started(pushed(size, rise_s=rise), form=form)
    times, states, _ = plant.run(0.6, 0.002)
    slip = states[:, plant.state_names.index("G1.slip")]
    t = times - 0.1
    expected = np.where(t < rise, np.maximum(t, 0.0) ** 2 / (2.0 * rise), t - rise / 2.0) * size / (2.0 * H)
    off = np.abs(slip - expected)
    edge = np.isclose((t / (rise / 17)) % 1.0, 0.0, atol=1e-6) | np.isclose(
        (t / (rise / 17)) % 1.0, 1.0, atol=1e-6
    )
    assert off[(t < 0.0) | edge | (t > rise)].max() < 1e-15
    assert off.max() < 1.01 * size / rise * (rise / 17) ** 2 / 8.0 / (2.0 * H)  # half a stair above and below


@pytest.mark.parametrize("form", FORMS)
def test_a_ramp_of_a_load_goes_through_its_shares(form: str) -> None:
    step = {"kind": "load_step", "load": "L2", "start_s": 1.0}
    plant = started(step | {"size_pu": 0.4, "rise_s": 0.1}, form=form)
    edges = [plant.next_event(t) for t in (0.0, 1.0, 1.03, 1.09, 1.1)]
    assert edges == pytest.approx([1.0, 1.02, 1.04, 1.1, math.inf])
    for t, share in ((1.0, 0.1), (1.02, 0.3), (1.04, 0.5), (1.1, 1.0)):
        plant.event(t, plant.x)
        whole = started(step | {"size_pu": 0.4 * share, "start_s": 0.0}, form=form)
        expected = whole.derivatives(plant.x)[1]
        assert plant.derivatives(plant.x)[1] == pytest.approx(expected, rel=1e-14, abs=1e-15), t


def test_a_line_that_recloses_onto_its_fault_opens_again_and_may_come_back() -> None:
    trips = [
        {"kind": "branch_trip", "branch": "1-2 b", "start_s": a, "end_s": b}
        for a, b in ((0.1, 0.4), (0.5, 0.9))
    ]
    faults = [{"kind": "bus_fault", "bus": 2, "start_s": a, "end_s": b} for a, b in ((0.05, 0.1), (0.4, 0.5))]
    plant = started(*trips, *faults)
    _, _, outputs = plant.run(1.0, 0.005)
    pe = outputs[:, plant.output_names.index("G1_pe")]
    assert np.ptp(pe) > 0.1
    assert plant.derivatives(plant.x)[1] == pytest.approx(started().derivatives(plant.x)[1], abs=1e-14)


@pytest.mark.parametrize(
    ("event", "values", "says"),
    [
        (
            shed(59.0),
            {"event[1].threshold": 60.0},
            r"event\[1\] \(frequency_shed\): threshold = 60 Hz, allowed",
        ),
        (shed(59.0), {"event[1].delay": -1.0}, r"delay = -1 s"),
        (shed(59.0), {"event[1].rise": 1.0}, r"rise = 1 s, allowed: 0 to 0"),
        (pushed(0.1), {"event[1].rise": math.nan}, r"rise = nan|not a finite number"),
    ],
)
def test_numbers_that_no_relay_has_are_refused(event: Any, values: Any, says: str) -> None:
    case = grid()
    parameters = event_parameters(case, events_of([event], where="test"))
    with pytest.raises(BlockFailure, match=says):
        BlockShim(plant_block(case), parameters | values)
