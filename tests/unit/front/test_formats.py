"""The formats: pages and schemas are those of the models, every bundled file and template fits them."""

from __future__ import annotations

import json
import re
import tomllib
from functools import cache
from pathlib import Path

import pytest

import interarea as ia
from interarea import formats
from interarea.cli.listing import bundled_files
from interarea.cosim.designs.design_file import load_design
from interarea.cosim.grid_study.choices import Choices, load_choices
from interarea.cosim.scenario.scenario import load_scenario
from interarea.cosim.study.spec import design_specs, load_study, read_claims
from interarea.cosim.sweep.spec import load_sweep
from interarea.design.synthesis.study_designs import WdcSpec
from interarea.models.devices.library import own_model
from interarea.models.files import read_text

PAGES = Path(__file__).resolve().parents[3] / "docs" / "formats"
page = cache(formats.page)  # each is made once for all that is said of it


@pytest.mark.parametrize("kind", formats.kinds())
def test_page_and_schema_are_those_of_the_models(kind: str) -> None:
    again = "run: python docs/formats/make.py"
    assert (PAGES / f"{kind}.md").read_text(encoding="utf-8") == page(kind), again
    shipped = json.loads((formats.SCHEMAS / f"{kind}.json").read_text(encoding="utf-8"))
    assert shipped == json.loads(json.dumps(formats.schema(kind))), again


@pytest.mark.parametrize("kind", ["scenario", "case", "design", "study"])
def test_every_key_of_a_bundled_file_is_in_the_schema(kind: str) -> None:
    known = set(formats.schema(kind)["properties"])
    files = bundled_files()[{"study": "studies"}.get(kind, f"{kind}s")].values()
    assert files
    for file in files:
        assert set(tomllib.loads(read_text(file))) <= known, file


@pytest.mark.parametrize("kind", formats.kinds())
def test_every_key_says_what_it_is_with_an_example_or_a_default(kind: str) -> None:
    keys = page(kind).partition("\n## Elements")[0].splitlines()  # behind it: words of diagrams
    rows = [re.split(r"(?<!\\)\|", line)[1:-1] for line in keys if line[:3] == "| `"]
    assert len(rows) >= 10
    for key, holds, _, default, example, words in ([cell.strip() for cell in row] for row in rows):
        assert words, key
        assert example or default not in ("", "needed") or "table" in holds or "object" in holds, key


def test_the_template_of_a_grid_study_has_every_key() -> None:
    text = (formats.TEMPLATES / "grid_study.toml").read_text(encoding="utf-8").replace("# dyr", "dyr")
    assert set(tomllib.loads(text)) == set(Choices.model_fields)


def test_the_files_that_show_every_key_are_valid() -> None:
    load_scenario(formats.TEMPLATES / "all_scenario.toml")
    assert ia.load_case(formats.TEMPLATES / "all_case.toml").machine("south").slack
    assert load_design(formats.TEMPLATES / "all_design.toml").washout_s == 5.0
    assert load_sweep(formats.TEMPLATES / "all_sweep.toml").samples == 20
    assert design_specs(load_study(str(formats.TEMPLATES / "all_study.toml")))["ftc"].decay_rate == 0.1


@pytest.mark.parametrize("kind", [*(k for k in formats.kinds() if k != "events"), "test"])
def test_what_new_writes_runs(kind: str, interarea, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    file = tmp_path / f"mine.{ {'controller': 'json', 'test': 'py'}.get(kind, 'toml') }"
    code, out, _ = interarea("new", kind, "--out", file)
    assert code == 0 and out.strip() == str(file)
    first = file.read_text(encoding="utf-8").splitlines()[0]
    if file.suffix == ".toml":
        assert first.startswith("#:schema file://") and first.endswith(f"/schemas/{kind}.json")
    if kind == "scenario":
        assert ia.simulate(file).stable  # type: ignore[attr-defined]
    elif kind == "case":
        assert not ia.load_case(file).branch("8-9 a").in_service
    elif kind == "device":
        assert own_model(file.read_text(encoding="utf-8"), "mine.toml").device.key == "my_avr"
    elif kind == "controller":
        assert ia.load_controller(file).order == 2
    elif kind == "design":
        assert load_design(file).actuators == ("G4_vs",)
    elif kind == "sweep":
        assert load_sweep(file).size == 6
    elif kind == "study":
        assert design_specs(load_study(str(file)))["wdc"] == WdcSpec(low_pass=20.0)
    elif kind == "grid_study":
        assert load_choices(file).most_actuators == 2
    elif kind == "claims":
        assert read_claims(file)["statement"][0]["parts"] == ["inter < local"]
    else:
        compile(file.read_text(encoding="utf-8"), str(file), "exec")
    assert interarea("new", kind, "--out", file)[0] == 2  # it is there already


def test_new_names_the_kinds_and_the_suffix(interarea, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    assert "did you mean" in interarea("new", "scenari", "--out", tmp_path / "a.toml")[2]
    assert "a controller is a .json file" in interarea("new", "controller", "--out", tmp_path / "a.toml")[2]


def test_show_prints_the_file_and_names_it(interarea) -> None:  # type: ignore[no-untyped-def]
    code, out, err = interarea("show", "lost-signal")
    file = bundled_files()["scenarios"]["lost-signal"]
    assert code == 0 and out.rstrip() == file.read_text(encoding="utf-8").rstrip()
    assert err.strip() == f"scenarios: {file}"
    both = json.loads(interarea("show", "robust", "--json")[1])
    assert {row["kind"] for row in both} == {"controllers", "designs"}
    assert [r["kind"] for r in json.loads(interarea("show", "designs/robust", "--json")[1])] == ["designs"]
    assert "fault-tolerant" in interarea("show", "ftc")[1]
    assert interarea("show", "lost-signl") == (
        2, "", "interarea: show lost-signl: no bundled file has this name; did you mean lost-signal?\n"
    )  # fmt: skip
