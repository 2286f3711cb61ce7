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
def test_100_ms_late_and_with_any_signal_lost_the_mode_gains_four_points(intertie: Any, reached: Any) -> None:
    """And no other mode loses half a point, whichever signal is lost."""
    without, rows = reached
    judged = [name for name in rows if "200" not in name]
    assert len(judged) == 6
    for name in judged:
        row = rows[name]
        assert set(row.damping) == set(without)
        assert row.damping[FAST] - without[FAST] > 0.04
        assert intertie.most_lost(without, row)[1] > -0.005
        assert row.least > min(without.values()) - 0.005  # of every root, also those that the loop brought
    assert rows["100 ms late"].damping[SLOW] - without[SLOW] > 0.04
    gained = {
        name: [100.0 * (row.damping[mode] - without[mode]) for mode in (SLOW, FAST)]
        for name, row in rows.items()
    }
    assert gained["100 ms late"] == pytest.approx([4.1, 8.9], abs=0.05)
    assert min(gained[name][1] for name in judged if "lost" in name) == pytest.approx(4.7, abs=0.05)
    assert min(gained[name][0] for name in judged if "south lost" in name) == pytest.approx(1.1, abs=0.05)
    assert min(gained[name][0] for name in judged if "north lost" in name) == pytest.approx(2.9, abs=0.05)


@pytest.mark.slow
def test_without_its_sign_the_modulation_takes_damping(intertie: Any) -> None:
    without, rows = intertie.rows(-0.05)
    assert rows["at once"].damping[FAST] < without[FAST] - 0.01


@pytest.mark.slow
def test_the_run_of_the_page_rings_down_as_the_roots_say(intertie: Any, tmp_path: Path) -> None:
    text = PAGE.partition("## The Pacific intertie")[2].partition("```toml\n")[2].partition("```")[0]
    (scenario := tmp_path / "run.toml").write_text(text, encoding="utf-8")
    intertie.Controller("intertie", intertie.modulation(intertie.GAIN), limit_pu=0.1).save(
        tmp_path / "intertie.json"
    )
    assert tomllib.loads(text)["controller"] == "intertie.json"
    for controller, hertz, ratio in (("intertie.json", 0.414, 0.201), ("none", 0.377, 0.094)):
        table = tomllib.loads(scenario.read_text(encoding="utf-8"))
        if controller == "none":
            del table["channels"]
        table["controller"] = str(tmp_path / controller) if controller != "none" else "none"
        metrics = run_scenario(table).metrics
        assert metrics.frequency_hz["inter-area"] == pytest.approx(hertz, abs=2e-3)
        assert metrics.damping_ratio["inter-area"] == pytest.approx(ratio, abs=2e-3)
