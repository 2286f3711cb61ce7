"""A bank as a design: what its members are made from, and what of it is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from interarea.cli.app import app
from interarea.cosim.designs.bank_design import bank_worth, judge_bank, member_tables, run_bank_design
from interarea.cosim.designs.design_file import design_of, load_design, specification_of
from interarea.cosim.errors import ScenarioError
from interarea.design.controllers.bank import load_controller
from interarea.design.controllers.bundled import shipped_bank
from interarea.synthesis import design_controller


def test_members_share_points_and_limits_and_leave_the_guard_to_the_supervisor() -> None:
    table = load_design("active")
    members = member_tables(table)
    assert list(members) == ["all", "local", "remote"]
    assert [each.signals for each in members.values()] == [("G2_dw", "G4_dw"), ("G4_dw",), ("G2_dw",)]
    for each in members.values():
        assert (each.point, each.limit_pu, each.guard, each.bank) == (table.point, table.limit_pu, None, None)
    assert members["local"].first_swing is None and members["remote"].first_swing == table.first_swing
    assert members["local"].gain_of == {"G4_dw": 0.8}
    assert members["local"].effort_cap != members["remote"].effort_cap == table.effort_cap


QUICK: dict[str, Any] = {
    "name": "quick",
    "case": "two-area-thesis",
    "remote": "G2_dw",
    "local": "G4_dw",
    "actuator": "G4_vs",
    "order": 2,
    "conditions": ["N", "L"],
    "point": [{"name": "base"}],
    "starts": 1,
    "evaluations": 60,
    "polishes": 0,
    "effort_cap": [[0.05, 0.03], [300.0, 0.03]],
    "guard": {"watched": {"G4_vs": ["G2_dw", "G4_dw"]}, "sides": {"G4_vs": 1.0}, "threshold": 0.1},
    "bank": {"member": [{"name": "local", "signals": ["G4_dw"], "conditions": ["N"], "order": 2}]},
}


@pytest.mark.slow
def test_a_bank_is_designed_proven_and_judged(tmp_path: Path, cache: Path) -> None:
    table = design_of(QUICK)
    bank, missed = run_bank_design(table, cache)
    assert missed == () and bank.guard is not None
    assert [member.name for member in bank.members] == ["all", "local"]
    assert bank.certificate is not None and bank.certificate["slowest"] > 0.0
    own = specification_of(load_controller(bank.save(tmp_path / "bank.json")))
    assert own is not None and own.bank == table.bank
    rows = {row.condition: row for row in judge_bank(table, bank, cache)}
    assert list(rows) == ["N", "L", "L, unnoticed"] and all(row.stable for row in rows.values())
    worth = bank_worth(table, bank, cache)
    assert worth.afar == ("G2_dw",)
    assert worth.rival is not None and worth.rival.inter_area == pytest.approx(rows["L"].inter_area)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (
            {"member": [{"name": "x", "signals": ["G9_dw"], "conditions": ["N"]}]},
            "member x uses unknown signals \\['G9_dw'\\]",
        ),
        ({"member": []}, "bank.member"),
        ({"member": [{"name": "x", "signals": ["G4_dw"], "conditions": ["N"]}], "fade_s": -1.0}, "fade_s"),
    ],
)
def test_a_bank_that_cannot_be_is_refused(change: dict[str, Any], says: str) -> None:
    with pytest.raises(ScenarioError, match=says):
        design_of(QUICK | {"bank": change})


def test_conditions_of_signals_that_a_member_lacks_are_refused() -> None:
    wrong = {"member": [{"name": "x", "signals": ["G4_dw"], "conditions": ["L:G2_dw"]}]}
    with pytest.raises(ScenarioError, match="bank member x: condition 'L:G2_dw'"):
        member_tables(design_of(QUICK | {"bank": wrong}))
    with pytest.raises(ScenarioError, match="design quick: is a bank of controllers"):
        design_controller(QUICK)
    turning = {"sides": {"G4_vs": 1.0}, "watched": {"G4_vs": "G4_dw"}, "threshold": 0.1, "follows": "tie_p"}
    with pytest.raises(ScenarioError, match="not possible in a bank, its supervisor follows no flow"):
        design_of(QUICK | {"guard": turning})


@pytest.mark.slow
def test_the_bundled_bank_says_what_its_link_is_worth() -> None:
    """With both signals it damps more than the best of the local one alone; it keeps what the grid keeps."""
    said = CliRunner().invoke(app, ["certify", "active"])
    assert said.exit_code == 0, said.output
    assert "the link from G2 adds 0.0" in said.output
    assert "every sequence of losses and returns decays" in said.output
    record = (shipped_bank("active").certificate or {})["acceptance"]
    assert record["cases"] == 120 and not record["lost"] and not record["standing"] and not record["unstable"]
