"""Own-signal rivals: what their design keeps, what it refuses, and where it is shown."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import control
import pytest
from typer.testing import CliRunner

import interarea
from interarea.cli.app import app
from interarea.cosim.designs.design_file import load_design, specification_of
from interarea.cosim.designs.worth import rival_on_record, rival_table, worth, worth_at
from interarea.cosim.errors import ScenarioError
from interarea.design.controllers.bundled import shipped_controller
from interarea.fmu_build.write.cache import default_cache
from interarea.models.case.case import load_case
from interarea.models.errors import UserError


@pytest.mark.parametrize(
    ("name", "sees", "conditions"),
    [
        ("robust", {"G4_vs": ("G4_dw",)}, ("N", "s100")),
        ("robust_latency", {"G4_vs": ("G4_dw",)}, ("N", "s100", "s150", "s200")),
        ("two_actuators", {"G2_vs": ("G2_dw",), "G4_vs": ("G4_dw",)}, ("N", "s100")),
        ("wecc_240", {"G2030_G_vs": ("G2030_G_dw",)}, ("N", "s50", "s150")),
    ],
)
def test_a_rival_has_equal_order_effort_and_points(
    name: str, sees: dict[str, Any], conditions: tuple[str, ...]
) -> None:
    table = load_design(name)
    rival = rival_table(table)
    assert {part.actuator: part.signals for part in rival.part}.items() >= sees.items()
    assert rival.conditions == conditions
    assert (rival.point, rival.effort_cap, rival.fastest_pole) == (
        table.point,
        table.effort_cap,
        table.fastest_pole,
    )
    orders = sum(part.order for part in table.part) or table.order
    assert sum(part.order for part in rival.part) == orders
    assert rival.starts >= 1


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            {"local": "G3_dw", "guard": None},
            "G4_vs has no signal of its own machine among G2_dw, G3_dw; add one of its own, such as G4_dw",
        ),
        (
            {
                "remote": None,
                "local": None,
                "actuator": None,
                "part": [{"actuator": "G4_vs", "signals": ["G4_dw"]}],
                "conditions": ["N"],
            },
            "uses no signal of another machine",
        ),
    ],
)
def test_a_design_without_a_rival_is_refused_in_a_line(change: dict[str, Any], said: str) -> None:
    keys = load_design("robust").model_dump(exclude_defaults=True) | change
    table = type(load_design("robust")).model_validate({k: v for k, v in keys.items() if v is not None})
    with pytest.raises(ScenarioError, match=said) as caught:
        rival_table(table)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.slow
def test_the_rival_on_record_is_recomputed_not_believed() -> None:
    """The record's figures are those of its system: with a fifth of its gain the rival reaches less."""
    controller = shipped_controller("robust")
    rival = rival_on_record(controller)
    assert rival is not None
    assert rival.inputs == ("G4_dw",)
    whole, cache = load_design("robust"), default_cache()
    hardest = next(p for p in whole.point if p.name == "circuit out, tie +50")
    table = whole.model_copy(update={"point": (hardest,), "fault": None, "acceptance": None})
    result = worth(table, controller, cache)
    weaker = worth(table, controller, cache, rival=rival.scaled(0.2))
    # the hardest point for the inter-area mode is the worst of the whole family
    assert controller.certificate is not None
    assert result.adds == pytest.approx(controller.certificate["worth"]["adds"], abs=1e-9)
    assert weaker.rival is not None
    assert result.rival is not None
    assert weaker.rival.inter_area < result.rival.inter_area - 0.05
    assert result.pays is False
    assert result.sentence.startswith("a local stabilizer performs as well: do not build the link from G2")


@pytest.mark.slow
def test_certify_says_what_the_link_is_worth() -> None:
    assert "do not build the link from G2" in interarea.certify("robust").worth
    bare = replace(shipped_controller("robust"), design={}, certificate=None)
    assert "--worth designs it" in interarea.certify(bare).worth


def test_worth_asks_for_the_design_that_fits() -> None:
    said = CliRunner().invoke(app, ["certify", "two_actuators", "--worth", "--spec", "robust"])
    assert said.exit_code != 0
    assert "give the design of the controller with --spec" in str(said.exception or said.output)


@pytest.mark.slow
def test_compare_says_it_for_each_controller() -> None:
    said = CliRunner().invoke(app, ["compare", "robust", "none", "--json"])
    assert said.exit_code == 0, said.output
    worths = json.loads(said.stdout)["worth"]
    assert list(worths) == ["robust"]
    assert "local stabilizer performs as well" in worths["robust"]


@pytest.mark.slow
def test_clearing_times_on_record_count_where_the_same_design_found_them() -> None:
    controller = shipped_controller("robust_latency")
    own = specification_of(controller)
    assert own is not None and controller.certificate is not None
    table = own.model_copy(update={"fault": None})  # another design: what it found is not known
    point = own.point[:1]
    assert worth(table.model_copy(update={"point": point}), controller, default_cache()).adds_cycles is None
    local = worth_at(own.grid, controller, default_cache())
    stored = controller.certificate["worth"]
    expected = stored["whole"]["clearing_cycles"] - stored["rival"]["clearing_cycles"]
    assert local.adds_cycles == pytest.approx(expected)
    assert f"{expected:.1f} cycles of clearing time: inter-area" in local.sentence
    assert worth_at(load_case("kundur-pss"), controller, default_cache()).adds_cycles is None


def test_worth_of_signals_that_the_plant_lacks_is_a_line() -> None:
    lacking = replace(shipped_controller("robust"), design={}, certificate=None)
    K = lacking.system
    renamed = control.ss(K.A, K.B, K.C, K.D, inputs=["G9_dw", "G4_dw"], outputs=K.output_labels)
    with pytest.raises(UserError, match="unknown output 'G9_dw' of the plant") as caught:
        worth_at(load_case("two-area-thesis"), replace(lacking, system=renamed), default_cache())
    assert len(str(caught.value).splitlines()) == 1


def test_one_signal_is_worth_what_the_controller_is() -> None:
    rival = rival_on_record(shipped_controller("robust"))
    assert rival is not None
    said = worth_at(load_case("two-area-thesis"), rival, default_cache()).sentence
    assert said.startswith("no signal of another machine: the controller changes inter-area damping by +0.")
