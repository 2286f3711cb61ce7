"""The study `wrong-signals`: what it counts, and that it goes on where it was stopped."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from command_line import invoke

from interarea.cosim.designs.design_file import load_design
from interarea.cosim.results.verdict import GROWING, LOST, STANDING
from interarea.cosim.screen import detector_design, detector_size, wrong_study
from interarea.cosim.screen.wrong_runs import fault_place
from interarea.cosim.screen.wrong_signals import RIGHT, WrongRow
from interarea.cosim.screen.wrong_study import FILES, Subject, study_wrong_signals, summary_of
from interarea.design.controllers.detector_record import DetectorDesignError
from interarea.fmu_build.write.cache import default_cache
from interarea.synthesis import load_controller

ROW = WrongRow("stuck", "G2_dw", "rest", "base", True, "settled", "", 0.0, 0.2, (), "settled")
LEFT = {"point": "base", "signal": "G2_dw", "stable": True, "worst_swing": 0.2, "inter_area": 0.25}


def certificate(*rows: WrongRow, left: tuple[dict[str, Any], ...] = (LEFT,)) -> dict[str, Any]:
    document = {
        "rows": [asdict(row) for row in rows],
        "out": list(left),
        "isolated": 3,
        "rightly": 2,
        "stops": 1,
    }
    return json.loads(json.dumps(document))  # type: ignore[no-any-return]


def test_runs_are_counted_by_what_they_end_in_and_by_the_grid_without_control() -> None:
    counts = summary_of(
        certificate(
            ROW,
            replace(ROW, verdict=LOST),
            replace(ROW, verdict=LOST, without=LOST),  # no control loses it too
            replace(ROW, verdict=STANDING, without=STANDING),
            replace(ROW, verdict=GROWING, detector=False),
            replace(ROW, kind=RIGHT, signal="", others=("G4_dw",)),
            replace(ROW, kind=RIGHT, signal="", detector=False),
        )
    )
    assert counts["watched"] == {"lost": 2, "swinging": 1, "worse": 1}
    assert counts["alone"] == {"lost": 0, "swinging": 1, "worse": 1}
    assert (counts["false_alarms"], counts["clean_runs"], counts["runs_of_each"]) == (1, 1, 1)
    assert counts["least_left"] == 0.25
    assert (
        "2 and 1 with a detector, in 1 of these runs all signals were isolated; of 3 isolated"
        in counts["conclusion"]
    )


def test_a_loop_that_is_unstable_without_a_signal_has_no_damping_left() -> None:
    counts = summary_of(certificate(ROW, left=(LEFT, {**LEFT, "stable": False})))
    assert counts["least_left"] is None
    assert counts["conclusion"].endswith("with one of its signals isolated the linear loop is unstable")


@pytest.mark.slow
def test_the_study_goes_on_where_it_was_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def none_of_it(*_: Any, **__: Any) -> None:
        raise DetectorDesignError("no run keeps synchronism")

    monkeypatch.setattr(wrong_study, "design_detector", none_of_it)
    table = load_design("robust")
    subject = Subject("robust", load_controller("robust"), table.grid, fault_place(table))
    options = {"kinds": ("polarity",), "disturbances": ("pulse",)}
    first = study_wrong_signals([subject], tmp_path, default_cache(), **options)
    one = first["controllers"][0]
    # docs/wrong_signals.md: with G4 isolated nothing of the damping of `robust` is left but the grid's own
    assert one["least_left"] == pytest.approx(0.077, abs=0.005)
    assert one["runs_of_each"] == 4 and one["watched"]["lost"] == 0
    page = (tmp_path / FILES[1]).read_text(encoding="utf-8")
    assert one["conclusion"] in page and "No designed detector (no run keeps synchronism)" in page
    for table_of in (pd.read_parquet(tmp_path / FILES[2]), pd.read_csv(tmp_path / FILES[3])):
        assert len(table_of) == len(one["rows"]) and set(table_of["controller"]) == {"robust"}

    def refused(*_: Any, **__: Any) -> None:
        raise AssertionError("made again")

    monkeypatch.setattr(wrong_study, "certify_wrong_signals", refused)
    assert study_wrong_signals([subject], tmp_path, default_cache(), **options)["controllers"] == [one]
    with pytest.raises(AssertionError, match="made again"):  # another question is not answered by the file
        study_wrong_signals([subject], tmp_path, default_cache(), kinds=("stuck",))


@pytest.mark.slow
def test_a_grid_of_five_areas_has_its_own_detector(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`nets_nyps`: a control stays at its limit while G14 is times 10; with a detector none."""
    monkeypatch.setattr(detector_size, "PER_SIGNAL", (5,))  # what the whole choice comes to
    monkeypatch.setattr(detector_design, "MOST_BUSES", 2)
    monkeypatch.setattr(detector_design, "MOST_MACHINES", 6)
    monkeypatch.setattr(detector_design, "_near", lambda *_: ())
    monkeypatch.setattr(detector_design, "_SEEN", (0.95,))
    monkeypatch.setattr(detector_design, "_BETWEEN", (1.025,))
    table = load_design("nets_nyps")
    subject = Subject("nets_nyps", load_controller("nets_nyps"), table.grid, fault_place(table))
    options = {"kinds": ("times 10",), "disturbances": ("bus fault",), "points": 1}
    one = study_wrong_signals([subject], tmp_path, default_cache(), **options)["controllers"][0]
    assert one["no_detector"] == ""
    assert (one["runs_of_each"], one["points"], one["disturbances"]) == (6, ["base"], ["bus fault"])
    ends = {(row["signal"], row["detector"]): row for row in one["rows"]}
    alone = ends["G14_dw", False]
    assert alone["verdict"] == STANDING and "at its limit" in alone["why"]
    assert one["watched"] == {"lost": 0, "swinging": 0, "worse": 0}
    # the fault changes G13, G5, G14 and G15 so fast that ten times as much is beyond what a machine can do
    for signal in ("G13_dw", "G5_dw", "G14_dw", "G15_dw"):
        assert ends[signal, True]["detected_s"] < 0.15
    assert one["isolated"] == one["rightly"] >= 4
    assert one["false_alarms"] == 0


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (
            ["wrong-signals", "--grid", "new-england"],
            "belongs to the study worth, inverters or actuators, not to wrong-signals",
        ),
        (["wrong-signals", "--minutes", "3"], "--minutes: not with the study wrong-signals; leave it out"),
        (["worth", "--controller", "robust"], "--controller robust: belongs to the study wrong-signals, not"),
        (["wrong-signals", "--controller", "robost"], "robost"),
        (["worth", "--disturbance", "rest"], '--disturbance "rest": belongs to the study wrong-signals, not'),
        (["thesis", "--points", "3"], "--points 3: belongs to the study wrong-signals, not to thesis"),
        (
            ["wrong-signals", "--disturbance", "storm"],
            "--disturbance storm: no such one; allowed: rest, pulse, bus fault, tie trip",
        ),
        (["wrong-signals", "--kind", "polarit"], "--kind polarit: no such one; did you mean polarity?"),
    ],
)
def test_options_that_a_study_does_not_take(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], line: str
) -> None:
    code, _, err = invoke(["study", *words, "--out", str(tmp_path / "out")], monkeypatch)
    assert code == 2
    assert line in err
    assert not (tmp_path / "out").exists() or not list((tmp_path / "out").iterdir())
