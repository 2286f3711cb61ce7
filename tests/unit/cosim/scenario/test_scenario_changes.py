"""Keys of a scenario that change what its case and controller name, against the changed thing itself."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest
from scenario_loop import Loop

from interarea.cosim.errors import ScenarioError
from interarea.cosim.export.container import container_block
from interarea.cosim.run.run import run_scenario
from interarea.cosim.scenario.scenario import load_scenario
from interarea.design.controllers.bank import ControllerBank
from interarea.design.controllers.controller import Controller
from interarea.models.case.case import Case
from interarea.models.case.variants import operating_variant

PULSE = {"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 0.2, "end_s": 0.4}


def scenario(**changes: Any) -> dict[str, Any]:
    return {
        "name": "changed",
        "case": "two-area-thesis",
        "controller": "wdc",
        "stop_s": 2.0,
        "step_s": 0.01,
        "event": [PULSE],
        **changes,
    }


def test_gain_is_the_controller_with_its_output_multiplied(hand_controller: Controller) -> None:
    K = hand_controller.system
    by_hand = Controller(
        "by_hand", control.ss(K.A, K.B, 2.5 * K.C, 2.5 * K.D, inputs=K.input_labels, outputs=K.output_labels)
    )
    changed = run_scenario(scenario(controller_gain=2.5), controller=hand_controller)
    expected = run_scenario(scenario(), controller=by_hand)
    assert np.array_equal(changed["controller.G4_vs"], expected["controller.G4_vs"])
    assert np.max(np.abs(expected["controller.G4_vs"])) > 1e-4


def test_limit_bounds_the_control_signal(hand_controller: Controller) -> None:
    run = run_scenario(scenario(controller_limit_pu=1e-4, controller_gain=2.0), controller=hand_controller)
    assert np.max(np.abs(run["controller.G4_vs"])) == 1e-4


def test_operating_point_moves_the_loads_and_no_design(
    hand_controller: Controller, two_area: Case, monkeypatch: pytest.MonkeyPatch
) -> None:
    designed_for = []

    def design(case: Case, name: str, cache: Path) -> Controller:
        designed_for.append(case.hash)
        return hand_controller

    monkeypatch.setattr("interarea.cosim.run.controllers.design_controller", design)
    table = scenario(operating_point={"tie_flow_mw": 100.0, "load_scale": 0.95})
    with Loop(load_scenario(table)) as loop:
        assert loop.system.case.hash == operating_variant(two_area, tie_flow_mw=100.0, load_scale=0.95).hash
    assert designed_for == [two_area.hash]


def test_plant_gives_start_values_of_the_plants_parameters(hand_controller: Controller, cache: Path) -> None:
    table = scenario(plant={"G1.exciter.Efd_max": 5.0, "G1.exciter.Efd_min": -4.5})
    block = container_block(load_scenario(table), cache=cache, controller=hand_controller)
    assert block.table["plant.G1.exciter.Efd_max"].start == 5.0
    assert block.table["plant.G1.exciter.Efd_min"].start == -4.5
    assert block.table["plant.G2.exciter.Efd_max"].start == 1e30


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"plant": {"G1.exciter.Efd_mux": 5.0}}, r"plant.G1.exciter.Efd_mux is not a parameter.*Efd_max"),
        ({"plant": {"G1_vs": 0.1}}, "G1_vs is not a parameter"),
        ({"controller": "none", "controller_gain": 2.0}, "controller = 'none'"),
        ({"controller": "x.fmu", "controller_limit_pu": 0.1}, "controller = 'x.fmu'"),
        ({"controller_limit_pu": 0.0}, "controller_limit_pu"),
        ({"controller_gain": float("nan")}, "controller_gain"),
        ({"operating_point": {"load_scale": 0.0}}, "load_scale"),
        ({"operating_point": {"tie_flow": 0.0}}, "tie_flow"),
        ({"operating_point": {"out": ["7-9"]}}, "7-9"),
    ],
)
def test_mistakes_are_named(changes: dict[str, Any], said: str, hand_controller: Controller) -> None:
    with pytest.raises(ValueError, match=said) as caught:
        run_scenario(scenario(**changes), controller=hand_controller)
    assert isinstance(caught.value, ScenarioError) or "branch" in str(caught.value)


def test_a_bank_has_no_one_gain(hand_controller: Controller) -> None:
    bank = ControllerBank("bank", (hand_controller,))
    with pytest.raises(ScenarioError, match="is a bank"):
        run_scenario(scenario(controller_gain=2.0), controller=bank)  # type: ignore[arg-type, return-value]


def test_changes_without_a_case_are_refused() -> None:
    with pytest.raises(ScenarioError, match="plant, show and operating_point need a case"):
        load_scenario({"stop_s": 1.0, "fmus": {"a": {"file": "a.fmu"}}, "plant": {"x": 1.0}})
