"""Faults that controllers do not survive: the search, the loops side by side, the operating points."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from interarea.cosim.designs.fault_runs import longest_stable
from interarea.cosim.run.controllers import design_controller
from interarea.cosim.run.run import run_scenario
from interarea.cosim.study.spec import load_study
from interarea.cosim.study.survival import NONE, Faults, Setting, case_at, local_stabilizer, settings_of
from interarea.design.controllers.bundled import shipped_bank
from interarea.design.controllers.controller import Controller
from interarea.models.case.case import Case

SETTINGS = [Setting("a"), Setting("a", "remote"), Setting("b"), Setting("c")]


def test_the_search_ends_within_its_tolerance_below_the_limit() -> None:
    limit = dict(zip(SETTINGS, (8.123, 0.5, 29.99, 40.0), strict=True))
    calls: list[int] = []

    def survives(tried: Any) -> Any:
        calls.append(len(tried))
        return {s: value <= limit[s] for s, value in tried.items()}

    result = longest_stable(SETTINGS, survives, 1.0, 30.0, 0.15)
    for setting in (SETTINGS[0], SETTINGS[2]):
        assert limit[setting] - 0.15 <= result[setting] <= limit[setting]
    assert result[SETTINGS[1]] == 0.0 and result[SETTINGS[3]] == 30.0
    assert calls[0] == calls[1] == 4 and calls[2] == 2  # settings that are decided are not run again
    assert len(calls) == 2 + 8  # 29 cycles halved to below 0.15


def test_points_and_ceilings_are_cases_of_their_own(two_area: Case) -> None:
    table = load_study("thesis")["survival"]
    points = {p["name"]: p for p in table["point"]}
    free, ceiled = table["ceiling"]
    assert case_at(two_area, points["base"], free) == two_area
    out = case_at(two_area, points["circuit out"], ceiled)
    assert not out.branch("8-9 a").in_service and {m.exciter.Efd_max for m in out.machines} == {5.0}
    more = case_at(two_area, points["tie +100 MW"], free)
    loads = [{q.name: q.P_mw for q in c.loads} for c in (two_area, more)]
    assert loads[1]["L7"] == loads[0]["L7"] - 100.0 and loads[1]["L9"] == loads[0]["L9"] + 100.0
    assert abs(sum(loads[1].values()) - sum(loads[0].values())) < 1e-9


def test_side_by_side_every_fault_is_the_run_made_alone(
    two_area: Case, hand_controller: Controller, by_hand: Controller, cache: Path
) -> None:
    """The angles of lanes that are reset and run again are those of `run_scenario`, to the bit."""
    spec = dict(load_study("thesis"))
    spec["survival"] = spec["survival"] | {"watch_s": 2.0}
    settings = [Setting(NONE), Setting("wdc"), Setting("wdc", "remote")]
    clearing = dict(zip(settings, (0.1, 0.1333333, 0.2), strict=True))
    with Faults(spec, {"wdc": hand_controller}, two_area, cache) as faults:
        first = faults.largest_angles(dict.fromkeys(settings, 0.3))
        result = faults.largest_angles(clearing)
        assert faults.clearing_s == pytest.approx(8.0 / 60.0, abs=1e-6)
        documents = {s: faults.document(s, at) for s, at in clearing.items()}
    for setting, document in documents.items():
        own = None if setting.controller == NONE else by_hand
        data = run_scenario(document, cache=cache, controller=own).trajectory.data
        angles = np.array([data[f"plant.{m.name}_delta"] for m in two_area.machines])
        assert result[setting] == float(np.ptp(angles, axis=0).max()) < first[setting]
    assert [e["kind"] for e in documents[settings[0]]["event"]] == ["bus_fault", "branch_trip"]
    assert {e.get("end_s", e["start_s"]) for e in documents[settings[0]]["event"]} == {1.1}


def test_a_branch_that_is_out_is_not_tripped(two_area: Case, cache: Path) -> None:
    spec = load_study("thesis")
    case = case_at(two_area, {"out": ["8-9 a"]}, {})
    with Faults(spec, {}, case, cache) as faults:
        events = faults.document(Setting(NONE), 0.1)["event"]
    assert [e["kind"] for e in events] == ["bus_fault"]


def test_each_signal_is_lost_in_turn_but_the_only_one(two_area: Case) -> None:
    """A controller whose only signal is lost is no control: that row is there already."""
    spec = load_study("thesis")
    (row,) = spec["survival"]["stabilizer"]
    alone = local_stabilizer(row, two_area)
    settings = settings_of(spec, {"active": shipped_bank("active"), row["name"]: alone})
    assert [(s.controller, s.signals) for s in settings] == [
        ("none", "nothing lost"),
        ("active", "nothing lost"),
        ("active", "remote lost"),
        ("active", "local lost"),
        ("local_stabilizer", "nothing lost"),
    ]


@pytest.mark.slow
def test_a_local_stabilizer_loses_what_the_bank_keeps(two_area: Case, cache: Path) -> None:
    """Tie +100 MW, as good a root as any (.245): eigenvalues would call it the equal of the bank."""
    spec = load_study("thesis")
    (row,) = spec["survival"]["stabilizer"]
    controllers = {"active": shipped_bank("active"), row["name"]: local_stabilizer(row, two_area)}
    case = case_at(two_area, {"tie_flow_mw": 100.0}, {})
    with Faults(spec, controllers, case, cache) as faults:
        result = faults.outcomes(settings_of(spec, controllers))
    assert not result[Setting("local_stabilizer")].synchronous
    for setting, run in result.items():
        assert run.stable == (setting.controller != "local_stabilizer"), setting


@pytest.mark.slow
def test_what_decays_in_a_minute_is_not_called_growing_after_ten_seconds(two_area: Case, cache: Path) -> None:
    """WDC with its local signal lost, tie reversed, ceilings: the control still grows from 5 to 10 s."""
    spec = load_study("thesis")
    case = case_at(two_area, {"tie_flow_mw": -500.0}, spec["survival"]["ceiling"][1])
    controllers = {"wdc": design_controller(two_area, "wdc", cache)}
    setting = Setting("wdc", "local")
    with Faults(spec, controllers, case, cache) as faults:
        run = faults.outcomes([setting])[setting]
    assert run.verdict is not None and run.verdict.name == "settled" and run.verdict.window_s[1] == 60.0
