"""The modulated intertie of the mini-WECC: the table of the page, and what is asked of the loop."""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

from interarea.cosim.run.run import run_scenario

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "actuators.md").read_text(encoding="utf-8")
SLOW, FAST = "inter-area 1", "inter-area 2"  #: both of north against south


@pytest.fixture(scope="module")
def intertie() -> Any:
    sys.path.insert(0, str(ROOT / "benchmarks" / "control"))
    try:
        import intertie
    finally:
        sys.path.pop(0)
    return intertie


@pytest.fixture(scope="module")
def reached(intertie: Any) -> Any:
    return intertie.rows(intertie.GAIN)


@pytest.mark.slow
def test_the_loop_has_the_damping_that_the_page_states(intertie: Any) -> None:
    assert intertie.table(intertie.GAIN) in PAGE


@pytest.mark.slow
def test_100_ms_late_with_any_signal_lost_both_modes_gain_four_points(intertie: Any, reached: Any) -> None:
    """And no other mode loses half a point, whichever signal is lost."""
    without, rows = reached
    judged = [name for name in rows if "200" not in name and "alone" not in name]
    assert len(judged) == 8
    for name in judged:
        row = rows[name]
        assert set(row.damping) == set(without)
        assert min(row.damping[mode] - without[mode] for mode in (SLOW, FAST)) > 0.04
        assert intertie.most_lost(without, row)[1] > -0.005
        assert row.least > min(without.values()) - 0.005  # of every root, also those that the loop brought
    south, north = (
        [100.0 * (rows[f"{end} alone"].damping[mode] - without[mode]) for mode in (SLOW, FAST)]
        for end in ("south", "north")
    )
    assert south == pytest.approx([4.25, 7.03], abs=0.05)
    assert north == pytest.approx([1.83, 14.88], abs=0.05)


def test_the_bank_keeps_both_ends_while_one_signal_of_each_arrives(intertie: Any) -> None:
    bank = intertie.bank(0.4)
    for lost in bank.inputs:
        signs = bank.acting([lost]).matrices.B[1] / bank.acting([]).matrices.B[1][0]
        read = dict(zip(bank.acting([lost]).inputs, signs, strict=True))
        assert lost not in read and sorted(read.values()) == pytest.approx([-1.0, 1.0])
        assert len({name[:5] for name in read}) == 2
    assert bank.active(["north_dw", "north2_dw"]) == bank.active(["south_dw", "south2_dw"]) == "off"


@pytest.mark.slow
def test_after_the_loss_of_a_unit_the_difference_leaves_the_link_alone(intertie: Any) -> None:
    said = list(intertie.common_rise(intertie.GAIN))
    assert all(line in PAGE for line in said), said


@pytest.mark.slow
def test_without_its_sign_the_modulation_takes_damping(intertie: Any) -> None:
    without, rows = intertie.rows(-0.05)
    assert rows["all arrive"].damping[FAST] < without[FAST] - 0.01


@pytest.mark.slow
def test_the_run_of_the_page_rings_down_as_the_roots_say(intertie: Any, tmp_path: Path) -> None:
    text = PAGE.partition("## The Pacific intertie")[2].partition("```toml\n")[2].partition("```")[0]
    (scenario := tmp_path / "run.toml").write_text(text, encoding="utf-8")
    intertie.bank(intertie.GAIN).save(tmp_path / "intertie.json")
    assert tomllib.loads(text)["controller"] == "intertie.json"
    for controller, lost, hertz, ratio in (
        ("intertie.json", False, 0.414, 0.201),
        ("intertie.json", True, 0.417, 0.188),
        ("none", False, 0.377, 0.094),
    ):
        table = tomllib.loads(scenario.read_text(encoding="utf-8"))
        if lost:
            table["channels"]["north"]["outages_s"] = [[2.0, 60.0]]
        if controller == "none":
            del table["channels"]
        table["controller"] = str(tmp_path / controller) if controller != "none" else "none"
        metrics = run_scenario(table).metrics
        assert metrics.frequency_hz["inter-area"] == pytest.approx(hertz, abs=2e-3)
        assert metrics.damping_ratio["inter-area"] == pytest.approx(ratio, abs=2e-3)
