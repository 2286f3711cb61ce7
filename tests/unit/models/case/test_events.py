"""Events: kinds, times and targets."""

from __future__ import annotations

import pytest

from interarea.models.case.case import CaseError, load_case
from interarea.models.case.checks import check_events, target_index
from interarea.models.case.events import EVENT_KINDS, event_of, events_of

GOOD = [
    {"kind": "bus_fault", "bus": 8, "start_s": 1.0, "end_s": 1.1333333, "x_pu": 1e-4},
    {"kind": "branch_trip", "branch": "8-9 a", "start_s": 1.0},
    {"kind": "branch_reclose", "branch": "8-9 a", "start_s": 2.0},
    {"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 1.0, "end_s": 1.2},
    {"kind": "vref_step", "machine": "G2", "size_pu": -0.01, "start_s": 1.0},
    {"kind": "pm_pulse", "machine": "G3", "size_pu": 0.05, "start_s": 1.0, "end_s": 1.2},
    {"kind": "pm_step", "machine": "G4", "size_pu": 0.05, "start_s": 0},
    {"kind": "load_step", "bus": 9, "size_pu": 0.1, "start_s": 1.0},
    {"kind": "machine_trip", "machine": "G2", "start_s": 1.0},
    {"kind": "shunt_switch", "shunt": "C9", "start_s": 1.0, "end_s": 3.0},
    {"kind": "frequency_shed", "load": "L9", "size_pu": 0.1, "threshold_hz": 59.3},
    {"kind": "frequency_trip", "machine": "G3", "threshold_hz": 61.5, "delay_s": 0.2},
    {"kind": "device_trip", "device": "svc1", "start_s": 1.0},
    {"kind": "hvdc_block", "device": "hvdc1", "start_s": 1.0, "end_s": 1.2},
    {"kind": "oscillation", "on": "voltage_reference", "machine": "G2", "size_pu": 0.01, "frequency_hz": 0.5,
     "start_s": 1.0, "harmonics": [0.1]},
    {"kind": "oscillation", "on": "load", "bus": 9, "p_pu": 0.2, "frequency_hz": 0.5, "start_s": 1.0},
    {"kind": "load_noise", "load": "L9", "size_pu": 0.01, "start_s": 1.0},
    {"kind": "load_noise", "size_pu": 0.01, "start_s": 1.0},
]  # fmt: skip


def test_every_kind_has_its_target() -> None:
    svc = {"bus": 8, "base_mva": 100.0, "control": {"kind": "svc"}}
    link = {"rectifier_bus": 7, "inverter_bus": 9, "base_mva": 200.0, "vdc_kv": 250.0, "idc_ka": 0.4}
    link |= {"gamma_deg": 20.0, "rectifier_kv": 112.0, "inverter_kv": 107.0, "r_ohm": 10.0, "l_mh": 800.0}
    link |= {"rectifier_xc_ohm": 6.0, "inverter_xc_ohm": 5.0}
    change = {"svcs": {"svc1": svc}, "hvdcs": {"hvdc1": link}}
    case = load_case("two-area-thesis").with_changes(change)
    events = events_of(GOOD, where="here")
    assert {e.kind for e in events} == set(EVENT_KINDS)
    assert [target_index(case, e) for e in events] == [7, 8, 8, 0, 1, 2, 3, 1, 1, 1, 1, 2, 0, 1, 1, 1, 1, -1]
    check_events(case, events)


SWING = {"kind": "oscillation", "on": "voltage_reference", "start_s": 1.0}
BAD = [
    ({"kind": "bus_foult"}, r"here: kind = 'bus_foult'; did you mean bus_fault\?"),
    ({"kind": "bus_fault", "bus": 8, "start_s": 1.0}, "end_s is missing"),
    ({"kind": "bus_fault", "bus": 8, "start_s": 1.0, "end_s": 1.0}, "allowed: end_s > start_s"),
    ({"kind": "bus_fault", "bus": 8, "start_s": 1.0, "end_s": 2.0, "x_pu": 0.0}, "a fault impedance above 0"),
    (
        {"kind": "branch_trip", "branch": "8-9 a", "start_s": -1.0},
        "start_s = -1.0, allowed: greater than or equal",
    ),
    ({"kind": "branch_trip", "branch": "8-9 a", "start_s": float("nan")}, "start_s = nan"),
    ({"kind": "branch_trip", "line": "8-9 a", "start_s": 1.0}, "branch is missing|no such key"),
    ({"kind": "vref_step", "machine": "G1", "size_pu": "0.1", "start_s": 1.0}, "size_pu = '0.1'"),
    ({"kind": "load_step", "bus": 7, "start_s": 1.0}, "exactly one of these forms"),
    (
        {"kind": "load_step", "bus": 7, "size_pu": 0.1, "start_s": 1.0, "end_s": 2.0, "rise_s": 3.0},
        "rise_s = 3 from 1 to 2 s",
    ),
    ({"kind": "frequency_shed", "bus": 7, "size_pu": 1.5, "threshold_hz": 59.0}, "size_pu = 1.5"),
    ({"kind": "load_step", "bus": 7, "load": "L7", "size_pu": 0.1, "start_s": 1.0}, "by load or by bus"),
    (SWING | {"machine": "G1", "frequency_hz": 11.0, "size_pu": 0.1}, "frequency_hz = 11.0"),
    (
        SWING | {"bus": 7, "frequency_hz": 1.0, "size_pu": 0.1},
        "on voltage_reference names its target by machine",
    ),
    (SWING | {"machine": "G1", "frequency_hz": 1.0}, "on voltage_reference has size_pu, no load"),
    (
        SWING | {"machine": "G1", "frequency_hz": 4.0, "size_pu": 0.1, "harmonics": [0.1] * 2},
        "harmonic 3 of 4 Hz",
    ),
    (
        SWING | {"machine": "G1", "frequency_hz": 1.0, "size_pu": 0.1, "shape": "square", "harmonics": [0.1]},
        "a square wave has harmonics of its own",
    ),
    (SWING | {"on": "load", "frequency_hz": 1.0, "size_pu": 0.1}, "names its target by load or by bus"),
    (SWING | {"on": "load", "bus": 7, "frequency_hz": 1.0}, "the oscillation has size_pu, or p_pu and q_pu"),
    ({"kind": "load_noise", "bus": 7, "load": "L7", "size_pu": 0.1, "start_s": 1.0}, "by load or by bus"),
    ({"kind": "load_noise", "size_pu": 0.1, "start_s": 1.0, "corner_hz": 0.0}, "corner_hz = 0.0"),
]


@pytest.mark.parametrize(("table", "message"), BAD)
def test_a_wrong_event_is_refused_in_one_line(table: dict, message: str) -> None:
    with pytest.raises(CaseError, match=message) as caught:
        event_of(table, where="here")
    assert all(line.startswith("here") for line in str(caught.value).split("\n"))


TARGETS = [
    ({"kind": "bus_fault", "bus": 88, "start_s": 1.0, "end_s": 1.1}, "bus 88 does not exist; did you mean 8"),
    ({"kind": "branch_trip", "branch": "8-9a", "start_s": 1.0}, "did you mean 8-9 a or 8-9 b"),
    ({"kind": "machine_trip", "machine": "G9", "start_s": 1.0}, "machine 'G9' does not exist"),
    (
        {"kind": "load_step", "bus": 5, "size_pu": 0.1, "start_s": 1.0},
        r"bus 5 has 0 loads, allowed: one load",
    ),
    (
        {"kind": "frequency_shed", "bus": 9, "size_pu": 0.1, "threshold_hz": 60.0},
        r"threshold_hz = 60, allowed: below the rated 60 Hz",
    ),
]


@pytest.mark.parametrize(("table", "message"), TARGETS)
def test_an_unknown_target_names_the_nearest(table: dict, message: str) -> None:
    with pytest.raises(CaseError, match=message):
        target_index(load_case("two-area-thesis"), event_of(table, where="here"))


def test_constant_excitation_has_no_set_point() -> None:
    event = event_of(GOOD[4], where="here")
    with pytest.raises(CaseError, match="constant excitation"):
        target_index(load_case("kundur-manual"), event)
