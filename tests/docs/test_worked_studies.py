"""The page of worked studies: what its rows and sentences take of a study, and that it holds each grid."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

SITE = Path(__file__).resolve().parents[2] / "docs" / "site"


@pytest.fixture(scope="module")
def script() -> ModuleType:
    sys.path.insert(0, str(SITE))
    try:
        import worked_studies
    finally:
        sys.path.remove(str(SITE))
    return worked_studies


def _study(**parts: Any) -> dict[str, Any]:
    modes = [
        {"name": "local area 1", "frequency_hz": 1.1, "damping_ratio": 0.01},
        {"name": "inter-area 1", "frequency_hz": 0.4, "damping_ratio": 0.06},
        {"name": "inter-area 2", "frequency_hz": 0.7, "damping_ratio": 0.05},
    ]
    counts = {"buses": 39, "machines": 10, "problem": None, "no_time_for": []}
    return {"case": "grid", "modes": {"modes": modes}, **counts, **parts}


def _cells(row: str) -> list[str]:
    return [cell.strip() for cell in row.strip().strip("|").split("|")]


def test_a_study_that_stops_has_its_reason_and_dashes(script: ModuleType) -> None:
    study = _study(problem="grid: the grid is unstable without control")
    assert _cells(script.row("grid", study)) == ["`grid`: 39, 10", "0.70 Hz, 0.050", *["–"] * 8]
    assert (
        script.words("grid", study) == "- `grid`: The study stopped: the grid is unstable without control.\n"
    )


def test_a_whole_study_has_each_number_in_its_column(script: ModuleType) -> None:
    late = [f"local area 1 at {p} from 0.07 to 0.06: allowed decrease 0.005" for p in ("base", "1-2 out")]
    faults = {
        "lost": ["a"],
        "standing": ["b", "c"],
        "cases": 42,
        "clearing_mean_change_cycles": 0.5,
        "clearing_worst_change_cycles": -0.25,
    }
    study = _study(
        asked={"inter_area": 0.1, "worst_swing": 0.02},
        parts=[{"actuator": "G9_vs"}],
        certificate={"inter_area": 0.12, "worst_swing": 0.03, "acceptance": faults, "violations": late},
        worth={"whole": {"inter_area": 0.3}, "rival": None},
        local={
            "sentence": "build both",
            "stabilizers": [{"machine": "G2"}, {"machine": "G3"}],
            "certificate": {"inter_area": 0.09, "worst_swing": 0.04},
            "installed": ["G3"],
        },
        no_time_for=["clearing times", "damping over latency"],
    )
    assert _cells(script.row("grid", study))[2:] == [
        "0.100",
        "G2, G3: 0.090, 0.040",
        "G9_vs; beside the stabilizers of G3",
        "0.120",
        "0.030",
        "1, 2, 42",
        "+0.5, -0.2",
        "0.300, –",
    ]
    assert script.words("grid", study) == (
        f"- `grid`: Build both. Violated by the loop: {late[0]} (and 1 similar). "
        "2 parts not computed within the time limit, first: clearing times.\n"
    )


def test_the_page_holds_each_grid_of_its_command(script: ModuleType) -> None:
    text = script.PAGE.read_text(encoding="utf-8")
    rows = [_cells(line) for line in text.splitlines() if line.startswith("| `")]
    assert [row[0].split("`")[1] for row in rows] == list(script.GRIDS)
    assert all(len(row) == 10 for row in rows)
    assert [line.split("`")[1] for line in text.splitlines() if line.startswith("- `")] == list(script.GRIDS)


def test_grids_that_are_not_run_keep_their_rows(script: ModuleType) -> None:
    before = script.tables({"a": _study(), "b": _study()}, "")
    again = _study(problem="grid: no weak mode")
    after = script.tables({"b": again, "c": _study()}, before)
    lines = [script.row(name, study) for name, study in (("a", _study()), ("b", again), ("c", _study()))]
    assert "".join(lines) in after
    assert script.words("a", _study()) + script.words("b", again) in after
    assert before.partition("| `a`")[0] == after.partition("| `a`")[0]
