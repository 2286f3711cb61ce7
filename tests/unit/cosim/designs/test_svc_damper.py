"""A damper at an SVC, `svc_damper.toml` beside this file, against the same design for an exciter."""

from __future__ import annotations

from pathlib import Path

import pytest

from interarea.cosim.designs.design_file import judge, load_design
from interarea.cosim.designs.short_designs import short_designs
from interarea.cosim.designs.worth import rival_table
from interarea.cosim.errors import ScenarioError
from interarea.cosim.run.run import run_scenario
from interarea.design.controllers.controller import Controller
from interarea.design.modes.loop_points import LoopSet
from interarea.models.case.case import load_case

FOLDER = Path(__file__).parent
DESIGN = FOLDER / "svc_damper.toml"
FAULT = [{"kind": "bus_fault", "bus": 3, "start_s": 1.0, "end_s": 1.05, "x_pu": 1e-4}]


def scenario(controller, **more):
    named = controller if controller == "none" else str(FOLDER / f"{controller}.json")
    return {"case": "two-area-svc", "controller": named, "stop_s": 20.0, "event": FAULT} | more


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "least"), [("none", -0.0601), ("svc_damper", 0.056), ("exciter_damper", 0.0337)]
)
def test_the_least_inter_area_damping_of_all_conditions(name, least, cache):
    """With a circuit out the grid is unstable without control; the SVC gives more than the exciter."""
    table = load_design(DESIGN)
    system = Controller.load(FOLDER / f"{'svc_damper' if name == 'none' else name}.json").system
    part = table.part[0].model_copy(update={"actuator": system.output_labels[0]})
    K = 0.0 * system if name == "none" else system
    K.update_names(inputs=system.input_labels, outputs=system.output_labels)
    assert judge(table.model_copy(update={"part": (part,)}), K, cache).inter_area == pytest.approx(
        least, abs=5e-4
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("controller", "within_s"), [("none", None), ("svc_damper", 9.0), ("exciter_damper", 18.0)]
)
def test_after_a_fault_the_svc_settles_first(controller, within_s):
    result = run_scenario(scenario(controller)).metrics.settling_time_s
    if within_s is None:
        assert result is None
    else:
        assert within_s - 0.4 < result <= within_s


@pytest.mark.slow
def test_a_set_of_loops_with_an_svc_is_designed_shortly(cache):
    """It has no speed of its own: the rival without links is the grid without control."""
    one = LoopSet(("svc1_v_mod",), 1.0, 1.0, "inter-area", {"svc1_v_mod": "dw13"})
    (row,) = short_designs(load_case("two-area-svc"), [one], cache)
    assert row.damping > 0.05
    assert row.own == pytest.approx(0.0011, abs=1e-3)


def test_a_rival_of_its_own_signals_is_refused_with_the_remedy():
    with pytest.raises(ScenarioError, match=r"svc1_v_mod has no signal of its own machine .*--no-worth"):
        rival_table(load_design(DESIGN))


def test_a_modulation_of_a_device_that_the_grid_does_not_have_names_those_it_has():
    keys = scenario("svc_damper", case="two-area-thesis")
    with pytest.raises(ScenarioError, match=r"none of its outputs is an input of the plant .* G1_vs, G2_vs"):
        run_scenario(keys)
