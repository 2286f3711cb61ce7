"""The step of the plant in a large screening: unstable and inexact ones are not chosen."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from interarea.cosim.screen import solver_step as module
from interarea.cosim.screen.page import write_screening
from interarea.cosim.screen.screening import Screened, Screening, run_screening
from interarea.cosim.screen.solver_step import LARGEST, StepChoice, changes_of, choose_step


def rows(**change: object) -> pd.DataFrame:
    """Two runs as a sweep stores them, the second with `change`."""
    plain = {"status": "ok", "synchronous": True, "verdict": "settled"} | dict.fromkeys(LARGEST, 1.0)
    return pd.DataFrame([plain, plain | change], index=pd.Index([8, 5], name="bus"))


def test_changes_are_the_largest_of_runs_that_keep_synchronism() -> None:
    exact = rows()
    assert changes_of(exact, exact) == dict.fromkeys(LARGEST, 0.0)
    largest = changes_of(exact, rows(angle_deg=1.09).iloc[::-1])
    assert largest == pytest.approx({"angle_deg": 0.09, "voltage_pu": 0.0, "nadir_hz": 0.0, "zenith_hz": 0.0})
    lost = rows(synchronous=False, angle_deg=400.0)
    assert changes_of(lost, rows(synchronous=False, angle_deg=500.0)) == dict.fromkeys(LARGEST, 0.0)


@pytest.mark.parametrize(
    "change",
    [
        {"angle_deg": 1.11},
        {"voltage_pu": 1.0011},
        {"nadir_hz": 0.9989},
        {"zenith_hz": float("nan")},
        {"status": "failed"},
        {"synchronous": False},
        {"verdict": "standing"},
    ],
)
def test_a_step_that_changes_results_is_not_exact_enough(change: dict[str, object]) -> None:
    assert changes_of(rows(), rows(**change)) is None


@pytest.mark.slow
def test_an_unstable_step_is_not_chosen(tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A mode at 1001 1/s: 10 and 5 ms are beyond the stability of RK4, 2.5 ms is not."""
    monkeypatch.setattr(module, "FROM", 1)
    choice = choose_step(Screening("two-area-thesis", stop_s=3.0), tmp_path, workers=1, cache=cache)
    assert isinstance(choice, StepChoice)
    assert (choice.step_s, choice.own_s, len(choice.places)) == (0.0025, 0.001, 3)
    assert all(0.0 <= choice.changes[key] <= LARGEST[key] for key in LARGEST)
    assert str(choice).startswith("solver step: 2.5 ms; at bus ")


@pytest.mark.slow
def test_results_elsewhere_are_those_of_the_own_step(tmp_path: Path, cache: Path) -> None:
    """New England with three outages has 156 places; the step is compared at three and holds at others."""
    outages = ("3-4", "16-19", "21-22")
    screening = Screening("new-england", outages=outages, stop_s=4.0)
    choice = choose_step(screening, tmp_path / "step", workers=1, cache=cache)
    assert choice is not None and choice.step_s == 0.01
    few = {"buses": (4, 16, 29), "stop_s": 4.0}
    longer, own = (
        {(one.place, one.outage): one for one in run_screening(s, tmp_path / name, workers=1, cache=cache)}
        for name, s in (
            ("longer", Screening("new-england", solver_step_s=choice.step_s, **few)),
            ("own", Screening("new-england", **few)),
        )
    )
    for place, one in own.items():
        assert longer[place].came_to == one.came_to
        assert longer[place].angle_deg == pytest.approx(one.angle_deg, abs=LARGEST["angle_deg"])
        assert longer[place].voltage_pu == pytest.approx(one.voltage_pu, abs=LARGEST["voltage_pu"])
        assert longer[place].nadir_hz == pytest.approx(one.nadir_hz, abs=LARGEST["nadir_hz"])


def test_a_prescribed_step_and_few_runs_are_left_alone(tmp_path: Path, cache: Path) -> None:
    for screening in (Screening("new-england"), Screening("new-england", solver_step_s=0.002)):
        assert choose_step(screening, tmp_path, cache=cache) is None
    assert not any(tmp_path.iterdir())


@pytest.mark.slow
def test_runs_that_fail_with_the_chosen_step_are_repeated(tmp_path: Path, cache: Path) -> None:
    """With 10 ms a fault makes the thesis's grid grow without bound; with its own step it has a verdict."""
    long = Screening("two-area-thesis", buses=(8, 5), stop_s=3.0, solver_step_s=0.01)
    options: dict[str, Any] = {"workers": 1, "cache": cache}
    assert {one.verdict for one in run_screening(long, tmp_path / "long", **options)} == {"failed"}
    own = run_screening(replace(long, solver_step_s=0.001), tmp_path / "own", **options)
    repeated = replace(long, repeat_step_s=0.001)
    assert run_screening(repeated, tmp_path / "repeated", **options) == own


def test_the_page_says_which_step_and_shows_angles_without_exponents(tmp_path: Path) -> None:
    screening = Screening("grids/own.toml", solver_step_s=0.01, step_reason="solver step: 10 ms; at bus 8")
    lost = Screened("8", "", "none", "lost", 366512.4, 0.8, "bus8", 57.0, 63.0, "", None, "synchronism lost")
    page = write_screening(screening, [lost], tmp_path).read_text(encoding="utf-8")
    assert "<h1>Screening of own.toml</h1>" in page and "Solver step: 10 ms; at bus 8." in page
    assert ">366512<" in page and "e+05" not in page
