"""Commutation failures in a run: the closed form of a voltage drop, runs with one and without."""

from __future__ import annotations

from dataclasses import replace
from math import acos, cos, degrees, radians

import numpy as np
import pandas as pd
import pytest

import interarea as ia
from interarea.cosim.designs.acceptance import judge_acceptance
from interarea.cosim.designs.certificate_words import in_words
from interarea.cosim.designs.design_tables import AcceptanceTable
from interarea.cosim.export.joint import run_joint
from interarea.cosim.results.accumulators import CRITICAL_DEG, Commutations
from interarea.cosim.sweep.front import run_sweep
from interarea.cosim.sweep.parts import read_rows
from interarea.cosim.trajectory import TIME, Trajectory
from interarea.design.controllers.bundled import shipped_controller
from interarea.models.case.case import load_case
from interarea.models.grid.dc_link import ends_of

LCC = {"rectifier_bus": 7, "inverter_bus": 9, "base_mva": 200.0, "vdc_kv": 250.0, "idc_ka": 0.4}
LCC |= {"gamma_deg": 20.0, "rectifier_kv": 112.0, "inverter_kv": 107.0, "r_ohm": 10.0, "l_mh": 800.0}
LCC |= {"rectifier_xc_ohm": 6.0, "inverter_xc_ohm": 5.0}
FAULT = {"kind": "bus_fault", "bus": 9, "start_s": 0.5, "end_s": 0.6, "x_pu": 0.02}


def with_link(**more):
    return load_case("two-area-thesis").with_changes({"hvdcs": {"hvdc1": LCC | more}})


def scenario(**event):
    return {"case": "two-area-thesis", "stop_s": 1.2, "event": [FAULT | event], "controller": "none"}


def points(case, gamma, volts, current):
    """Return a trajectory of an inverter with these extinction angles (rad), voltages and currents (pu)."""
    row, end = case.hvdcs[0], ends_of(case.hvdcs[0])[1]
    share = row.base_mva / case.base_mva
    size = end.no_load * volts * current
    phi = np.cos(gamma) - end.drop * current / (end.no_load * volts)
    columns = {
        TIME: 0.01 * np.arange(len(volts)),
        "plant.hvdc1.p_inverter": share * size * phi,
        "plant.hvdc1.q_inverter": -share * size * np.sqrt(1.0 - phi**2),
        "plant.bus9.v": volts,
    }
    return Trajectory(columns, dict.fromkeys(columns, "1"), dict.fromkeys(columns, ""), "by hand")


def lines_of(case, *parts):
    result = Commutations(case)
    for part in parts:
        result.add(part)
    return result.warnings


@pytest.mark.parametrize("gamma_deg", [16.0, 20.0, 30.0])
@pytest.mark.parametrize("rise", [1.0, 1.2])
def test_a_drop_fails_below_the_voltage_of_the_closed_form(gamma_deg, rise):
    """At the least u'/u = (I'/I) x/(x + cos(critical) - cos(gamma)) with x = 2 rho at u."""
    case = with_link()
    end, current = ends_of(case.hvdcs[0])[1], 0.5
    x = 2.0 * end.drop * current / end.no_load
    least = rise * x / (cos(radians(CRITICAL_DEG)) - cos(radians(gamma_deg)) + x)
    gamma = np.full(4, radians(gamma_deg))
    amps = current * np.array([1.0, 1.0, rise, rise])
    for factor, fails in ((0.999, 1), (1.001, 0)):
        volts = np.array([1.0, 1.0, factor * least, factor * least])
        whole = lines_of(case, points(case, gamma, volts, amps))
        assert len(whole) == fails
        if fails:
            assert "hvdc1" in whole[0] and "bus 9, at 1 points, first at t = 0.02 s" in whole[0]
            parts = [
                points(case, gamma[:2], volts[:2], amps[:2]),
                points(case, gamma[2:], volts[2:], amps[2:]),
            ]
            joined = lines_of(case, *parts)
            assert joined == [whole[0].replace("t = 0.02 s", "t = 0 s")]  # a part has its own time here


def test_the_angle_that_is_said_is_that_of_the_firing_before():
    case = with_link()
    end = ends_of(case.hvdcs[0])[1]
    x = 2.0 * end.drop * 0.5 / end.no_load
    after = radians(5.0)
    volts = np.array([1.0, x / (x + cos(after) - cos(radians(20.0)))])
    (line,) = lines_of(case, points(case, np.full(2, radians(20.0)), volts, np.full(2, 0.5)))
    assert "an extinction angle of 5 deg" in line and degrees(acos(cos(after))) == pytest.approx(5.0)
    volts[1] *= 0.5
    (line,) = lines_of(case, points(case, np.full(2, radians(20.0)), volts, np.full(2, 0.5)))
    assert "no extinction" in line


def test_a_link_that_carries_nothing_does_not_fail():
    """Nor does it at the first point after: nothing was fired."""
    case = with_link()
    volts, amps = np.array([1.0, 0.1, 0.1, 0.2, 1.0]), np.array([0.5, 0.0, 0.0, 0.5, 0.5])
    assert lines_of(case, points(case, np.full(5, radians(20.0)), volts, amps)) == []


def test_a_run_says_by_name_that_an_inverter_fails_to_commutate():
    run = ia.simulate(scenario(), case=with_link())
    (line,) = [text for text in run.warnings if "commutation" in text]
    assert line.startswith("commutation failure of hvdc1 at its inverter's bus 9, at ")
    assert "first at t = 0.5" in line and "hvdc_block" in line and "\n" not in line


def test_the_run_as_one_block_says_the_same(cache):
    document = scenario(bus=13) | {"case": "two-area-hvdc"}
    (line,) = ia.simulate(document).warnings
    assert line.startswith("commutation failure of hvdc1 at its inverter's bus 115")
    assert run_joint(document, cache=cache).warnings == (line,)


@pytest.mark.slow
def test_rows_of_a_sweep_name_links_that_fail_to_commutate(tmp_path, cache):
    case = scenario(bus=13) | {"case": "two-area-hvdc"}
    depths = {"depth": {"path": "event.1.x_pu", "values": [0.02, 5.0]}}
    run_sweep({"name": "s", "scenario": case, "parameters": depths}, tmp_path / "s", workers=1, cache=cache)
    rows = read_rows(tmp_path / "s")
    assert [None if pd.isna(value) else value for value in rows["commutation_failure"]] == ["hvdc1", None]


@pytest.mark.slow
def test_the_acceptance_names_faults_after_which_a_link_fails_to_commutate(cache):
    """A fault at the inverter's bus, not one at the far end of the grid."""
    places = AcceptanceTable(fault=({"bus": 9}, {"bus": 5}), latency_s=(0.1,), never_lost=("G2_dw", "G4_dw"))
    cases, K = {"base": with_link()}, shipped_controller("robust")
    acceptance = judge_acceptance(K, cases, places, cache, clearing=False)
    assert acceptance.as_dict()["commutation"] == ("base, fault at bus 9, 100 ms: hvdc1",)
    assert "commutation" not in replace(acceptance, commutation=()).as_dict()
    line = (
        "1 with a dc link that fails to commutate, which the model does not have (first: base, fault at bus 9"
    )
    assert line in in_words(acceptance.as_dict())


@pytest.mark.parametrize("event", [{"x_pu": 5.0}, {"bus": 5, "x_pu": 1.0}])
def test_a_shallow_dip_gives_no_line(event):
    assert not [t for t in ia.simulate(scenario(**event), case=with_link()).warnings if "commutation" in t]


def test_a_link_that_is_blocked_over_the_fault_gives_no_line():
    block = {"kind": "hvdc_block", "device": "hvdc1", "start_s": 0.5, "end_s": 0.7}
    document = scenario() | {"event": [FAULT, block]}
    assert not [t for t in ia.simulate(document, case=with_link()).warnings if "commutation" in t]
