"""The page of a grid's study: what it says first, and what stands where a part is missing."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from interarea.cosim.designs.design_file import load_design, specification_of
from interarea.cosim.grid_study import faults, local_stabilizers
from interarea.cosim.grid_study import study as grid_study
from interarea.cosim.grid_study.choices import Choices
from interarea.cosim.grid_study.page import damping_rows, headline, write_page
from interarea.cosim.grid_study.study import STAGES, study_grid
from interarea.design.controllers.controller import Controller
from interarea.design.errors import InfeasibleDesign
from interarea.fmu_build.write.cache import default_cache
from interarea.models.case.case import load_case


def _certificate(**changed: Any) -> dict[str, Any]:
    faults = {
        "cases": 10,
        "lost": [],
        "gained": [],
        "standing": [],
        "unstable": [],
        "loops": 5,
        "clearing": [],
        "clearing_mean_change_cycles": None,
    }
    return {"inter_area": 0.2, "passed": True, "violations": [], "rows": [], "acceptance": faults} | changed


def _study(**parts: Any) -> dict[str, Any]:
    mode = {"name": "inter-area", "frequency_hz": 0.6, "damping_ratio": 0.05}
    return {"modes": {"modes": [mode], "growing": []}, "problem": None} | parts


def test_what_is_missed_is_said_at_the_top() -> None:
    bad = _certificate(passed=False, violations=["base, fault at bus 7: synchronism lost", "another"])
    bad["acceptance"]["lost"] = ["base, fault at bus 7"]
    lines = headline(_study(certificate=bad))
    assert lines[2] == "It violates 2 of the requirements, first: base, fault at bus 7: synchronism lost."
    assert lines[3].startswith("Non-linear faults: 1 of 10 lose synchronism only with the controller")
    assert not any("violates" in line for line in headline(_study(certificate=_certificate())))


def test_a_point_outside_the_design_that_falls_short_is_said_at_the_top() -> None:
    row = {"point": "1-2 out", "stable": True, "inter_area": 0.09, "worst_swing": 0.05}
    targets = {"inter_area": 0.1, "worst_swing": 0.05}
    study = _study(certificate=_certificate(), asked=targets, left_out=[row])
    assert any("outside the design it does not meet the requirements: 1-2 out." in t for t in headline(study))
    row["inter_area"] = 0.1
    assert not any("outside the design" in line for line in headline(study))
    row["stable"] = False  # a loop may be unstable and have no root in the band
    assert any("outside the design" in line for line in headline(study))


def test_a_grid_that_grows_is_said_first() -> None:
    study = _study()
    study["modes"]["growing"] = ["local 1 1.20 Hz -0.010, with G1.delta"]
    assert (
        headline(study)[0] == "The grid is unstable without control: local 1 1.20 Hz -0.010, with G1.delta."
    )


def test_damping_is_the_least_of_each_kind_of_condition() -> None:
    row = {"point": "base", "stable": True, "worst_swing": 0.1}
    rows = [
        row | {"condition": "N", "inter_area": 0.3},
        row | {"condition": "s100", "inter_area": 0.25},
        row | {"condition": "s200", "inter_area": 0.2},
        row | {"condition": "s100+L:G2_dw", "inter_area": 0.15, "stable": False},
    ]
    (base,) = damping_rows(rows)
    assert (base["inter_area_all"], base["inter_area_late"], base["inter_area_lost"]) == (0.3, 0.2, 0.15)
    assert base["stable"] is False


@pytest.mark.slow
def test_a_study_that_cannot_go_on_has_the_reason_in_its_place(interarea: Any, tmp_path: Path) -> None:
    code, out, err = interarea("study", "nets-nyps-no-pss", "--out", tmp_path / "out")
    assert code == 1
    assert "unstable without control" in err
    folder = tmp_path / "out"
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert page.count("Not computed: nets-nyps-no-pss: the grid is unstable without control") == 7
    assert "unstable" in json.loads((folder / "study.json").read_text(encoding="utf-8"))["problem"]
    assert not (folder / "controller.json").exists()
    assert out.splitlines() == [str(tmp_path / "out" / n) for n in ("study.json", "report.html")]


@pytest.mark.slow
def test_loops_stand_on_the_page_before_the_first_design(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    seen: list[str] = []

    def stopped(*_: Any, **__: Any) -> None:
        seen.append((tmp_path / "report.html").read_text(encoding="utf-8"))
        raise InfeasibleDesign("no controller", constraint="stability")

    monkeypatch.setattr(grid_study, "findings_of", stopped)
    study = study_grid(load_case("two-area-thesis"), tmp_path, default_cache())
    assert "The best sets of loops by their residues" in seen[0]
    assert '<td class="t">G4_vs</td><td class="n">–</td>' in seen[0]
    assert "not computed yet" in seen[0] and "Not computed" not in seen[0]
    assert study["problem"] == "no controller"
    assert study["loops"][0]["actuators"] == ["G4_vs"]
    ended = write_page(study | {"problem": None, "versions": {}}, (), (), tmp_path / "ended.html")
    text = ended.read_text(encoding="utf-8")
    assert (
        "Latency: not computed within 10 minutes of processor time; run the command again with more --minutes"
        in text
    )
    assert "not computed yet; the command" not in text


def test_dynamic_data_beside_a_case_is_a_mistake(interarea: Any, tmp_path: Path) -> None:
    dyr = tmp_path / "a.dyr"
    dyr.touch()
    code, _, err = interarea("study", "new-england", "--dyr", dyr, "--out", tmp_path / "out")
    assert code == 2
    assert f"--dyr {dyr}: needs a RAW file, not the case new-england" in err
    code, _, err = interarea("design", "robust", "--dyr", dyr, "--out", tmp_path / "out.json")
    assert code == 2
    assert f"--dyr {dyr}: needs a RAW file, not robust" in err


@pytest.mark.slow
@pytest.mark.timeout(1200)  # half a minute with a warm cache, beyond five from an empty one beside others
def test_a_study_of_a_grid_from_its_name_alone(
    few_points: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """One actuator, two signals, one fault, two local stabilizers and four points; more take minutes."""
    monkeypatch.setattr(faults, "LIMITS_PU", (0.05,))
    monkeypatch.setattr(local_stabilizers, "MOST", 2)
    done: dict[str, float] = {}

    def report(stage: str, share: float) -> None:
        done[stage] = share

    case = load_case("two-area-thesis")
    study = study_grid(
        case,
        tmp_path,
        default_cache(),
        choices=Choices(
            grid="two-area-thesis",
            minutes=60.0,
            most_actuators=1,
            signals=2,
            latencies_ms=(150,),
            faults=1,
        ),
        report=report,
    )
    assert set(done) == set(STAGES)
    assert all(share == 1.0 for share in done.values())
    assert study["problem"] is None
    certificate = study["certificate"]
    assert certificate["inter_area"] >= 0.1 and all(row["stable"] for row in certificate["rows"])
    points = 1 + sum(point["taken"] for point in study["points"])  # and the grid as it is
    assert points == 4 and certificate["acceptance"]["cases"] == 3 * points
    assert certificate["passed"] == (not certificate["violations"])
    assert any(line.startswith("It violates") for line in headline(study)) != certificate["passed"]
    table = load_design(tmp_path / "design.toml")  # test_beside_local certifies one again by its record
    assert table.grid.hash == case.hash
    assert specification_of(Controller.load(tmp_path / "controller.json")) == table
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "not computed yet" not in page
    assert study["worth"]["sentence"][1:40] in page
    assert study["local"]["sentence"][1:30] in page
    local = json.loads((tmp_path / "local.json").read_text(encoding="utf-8"))
    assert local["certificate"]["acceptance"]["cases"] == 3 * points
    assert (tmp_path / "fmus" / "controller.fmu").is_file()


@pytest.mark.parametrize(
    ("loop", "local", "code"), [(True, None, 0), (False, None, 1), (False, False, 1), (False, True, 0)]
)
def test_a_study_passes_where_a_loop_or_local_stabilizers_hold_what_is_asked(
    interarea: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, loop: bool, local: bool | None, code: int
) -> None:
    beside = None if local is None else _certificate(passed=local)
    study = _study(
        certificate=_certificate(passed=loop), local={"sentence": "build it", "certificate": beside}
    )
    monkeypatch.setattr(grid_study, "study_grid", lambda *_, **__: study)
    ended, out, err = interarea("study", "two-area-thesis", "--out", tmp_path / "out", "--json")
    assert ended == code, err
    assert json.loads(out)["passed"] == (code == 0)
