"""The file of the study of a grid: what `new` writes, what `study` takes from it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from interarea.cosim.errors import ScenarioError
from interarea.cosim.grid_study.choices import Choices, choices_text, load_choices
from interarea.cosim.grid_study.weak_modes import modes_of_grid, weak_modes
from interarea.models.case.case import load_case
from interarea.models.case.write_toml import export_toml


def test_new_writes_every_choice_and_what_was_found(interarea: Any, tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    code, out, _ = interarea("new", "study", "two-area-thesis", "--out", file)
    assert (code, out.strip()) == (0, str(file))
    text = file.read_text(encoding="utf-8")
    assert "# Weak: inter-area (0.62 Hz, damping 0.081)." in text
    assert "G4_vs" in text.partition("grid =")[0]
    choices = load_choices(file)
    assert choices == Choices(grid="two-area-thesis", inter_area=0.1)
    unsaid = {key for key, value in choices if value is None}
    assert {line.partition(" =")[0] for line in text.splitlines() if " = " in line and line[0] != "#"} == (
        set(Choices.model_fields) - unsaid
    )


def test_a_choice_is_taken(cache: Path) -> None:
    grid = modes_of_grid(load_case("two-area-thesis"), cache)
    weak = weak_modes(grid, Choices(grid="x", actuators=("G1_vs", "G2_vs"), inter_area=0.3))
    assert weak.required_damping == 0.3
    assert {a for one in weak.sets for a in one.actuators} == {"G1_vs", "G2_vs"}
    alone = replace(weak, choices=Choices(grid="x", most_actuators=1))
    assert {len(one.actuators) for one in alone.sets} == {1}


def test_more_can_be_asked_of_a_mode_that_is_not_weak(cache: Path) -> None:
    grid = modes_of_grid(load_case("kundur-pss"), cache)
    assert weak_modes(grid, Choices(grid="kundur-pss", inter_area=0.2)).required_damping == 0.2


@pytest.mark.slow
def test_a_study_file_names_its_grid_beside_it(interarea: Any, tmp_path: Path) -> None:
    export_toml(load_case("nets-nyps-no-pss"), tmp_path / "grid.toml")
    (tmp_path / "mine.toml").write_text('grid = "grid.toml"\nminutes = 2.0\n', encoding="utf-8")
    code, _, err = interarea("study", tmp_path / "mine.toml", "--out", tmp_path / "out")
    assert code == 1 and "unstable without control" in err
    study = json.loads((tmp_path / "out" / "study.json").read_text(encoding="utf-8"))
    assert study["choices"]["minutes"] == 2.0
    assert study["command"].startswith(f"interarea study {tmp_path / 'mine.toml'} --out")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("minutes = 2.0", "grid"),
        ('grid = "new-england"\nsingals = 2', "singals"),
        ('grid = "new-england"\nminutes = 0.0', "minutes"),
        ('grid = "new-england"\ninter_area = 1.5', "inter_area"),
        ('grid = "new-england"\nlatencies_ms = [99999]', "latencies_ms.* 99999, allowed: .* 10000"),
        ('grid = "new-england"\nclear_s = 100.0', "clear_s = 100.*, allowed: .* 5"),
    ],
)
def test_a_mistake_in_it_is_named(text: str, said: str, tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ScenarioError, match=said):
        load_choices(file)


def test_an_actuator_that_the_grid_has_not_is_a_mistake(interarea: Any, tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text('grid = "two-area-thesis"\nactuators = ["G9_vs"]\n', encoding="utf-8")
    code, _, err = interarea("study", tmp_path / "mine.toml", "--out", tmp_path / "out")
    assert code == 2 and "two-area-thesis: actuators has 'G9_vs', no input of the grid; did you mean" in err


def test_new_of_what_is_no_grid_is_a_mistake(interarea: Any, tmp_path: Path) -> None:
    code, _, err = interarea("new", "design", "new-england", "--out", tmp_path / "a.toml")
    assert code == 2 and "not a grid" in err
    code, _, err = interarea("new", "study", "nowhere", "--out", tmp_path / "a.toml")
    assert code == 2 and "not a grid" in err


def test_the_text_is_read_as_the_same_choices(tmp_path: Path) -> None:
    choices = Choices(grid="a.raw", dyr="a.dyr", actuators=("G1_vs",), latencies_ms=(50,), clear_s=0.08)
    file = tmp_path / "mine.toml"
    file.write_text(choices_text(choices, ["found"]), encoding="utf-8")
    assert load_choices(file) == choices
