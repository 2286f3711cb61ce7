"""Long work speaks: a line a step on stderr, nothing with `--quiet`; what is found as JSON on stdout."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from interarea.cli.app import COMMANDS, load

Command = Callable[..., tuple[int, str, str]]
SWEEP = 'scenario = "ring-down"\n[parameters.size]\npath = "event.1.size_pu"\nvalues = [0.02, 0.04]\n'
DESIGN = """name = "tiny"
case = "two-area-thesis"
remote = "G2_dw"
local = "G4_dw"
actuator = "G4_vs"
order = 2
conditions = ["N"]
starts = 1
evaluations = 20
polishes = 0
point = [{ name = "base" }]
ask = { worst_swing = 0.0 }
"""


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_reports_as_json_and_can_be_quiet_or_verbose(name: str) -> None:
    options = {word for p in load(name).params for word in p.opts}
    assert {"--json", "--quiet", "--verbose"} <= options


def test_files_that_are_written_are_told_as_json(interarea: Command, tmp_path: Path) -> None:
    raw, back = tmp_path / "grid.raw", tmp_path / "back.toml"
    code, out, err = interarea("export", "two-area-thesis", "--out", raw, "--json")
    files = json.loads(out)["files"]
    assert (code, err) == (0, "") and [f["file"] for f in files] == [str(raw), str(raw.with_suffix(".dyr"))]
    assert all(Path(f["file"]).is_file() for f in files) and files[1]["not_in_it"]
    code, out, err = interarea("import", raw, "--dyr", raw.with_suffix(".dyr"), "--out", back, "--json")
    document = json.loads(out)
    assert (code, err) == (0, "") and document["file"] == str(back) and back.is_file()
    assert (document["read"]["buses"], document["read"]["units"]) == (11, 4)
    assert all(remark["count"] >= 1 and remark["first"] for remark in document["assumed"])
    code, out, _ = interarea("new", "scenario", "--out", tmp_path / "mine.toml", "--json")
    assert code == 0 and Path(json.loads(out)["file"]).is_file()


@pytest.mark.slow
def test_verbose_tells_what_the_cache_had_and_how_long_steps_took(interarea: Command) -> None:
    _, _, err = interarea("certify", "robust_linear", "--verbose")
    assert re.search(r"^linear family: done in \d+\.\d s$", err, re.MULTILINE)
    assert re.search(r"^(cache|made in \d+\.\d s): .*linear.*\.npz$", err, re.MULTILINE), err
    assert "cache" not in interarea("certify", "robust_linear")[2]


def test_build_tells_each_fmu_and_prints_them_as_json(interarea: Command, tmp_path: Path) -> None:
    words = ("build", "two-area-thesis", "--controller", "robust", "--out", tmp_path)
    code, out, err = interarea(*words, "--json")
    document = json.loads(out)
    names = ["two-area-thesis", "channel", "robust"]
    assert code == 0 and document["case"] == "two-area-thesis" and list(document["fmus"]) == names
    assert all(Path(file).is_file() for file in document["fmus"].values())
    assert err.splitlines() == [f"{name}.fmu: done" for name in names]
    code, out, err = interarea(*words, "--quiet")
    assert (code, err) == (0, "") and out.split() == list(document["fmus"].values())


@pytest.mark.slow
def test_certify_tells_its_steps(interarea: Command) -> None:
    code, out, err = interarea("certify", "robust_linear", "--json")
    assert code == 0 and json.loads(out)["passed"] is True
    assert "linear family: done" in err.splitlines()
    assert "linear family" not in interarea("certify", "robust_linear", "--json", "--quiet")[2]


@pytest.mark.slow
def test_sweep_and_its_maps_print_json(interarea: Command, tmp_path: Path) -> None:
    (tmp_path / "two.toml").write_text(SWEEP, encoding="utf-8")
    folder = tmp_path / "out"
    code, out, _ = interarea("sweep", tmp_path / "two.toml", "--out", folder, "--workers", 1, "--json")
    document = json.loads(out)
    assert code == 0 and (document["runs"], document["ok"], document["failed"]) == (2, 2, 0)
    assert document["folder"] == str(folder)
    code, out, err = interarea("maps", folder, "--worst", 1, "--json")
    page = json.loads(out)
    assert code == 0 and page["runs"]["stable"] == document["stable"] == 2 and Path(page["page"]).is_file()
    assert "figures: done" in err.splitlines()
    assert interarea("maps", folder, "--worst", 1, "--quiet")[2] == ""


@pytest.mark.slow
def test_design_prints_what_it_found_as_json(interarea: Command, tmp_path: Path) -> None:
    (tmp_path / "tiny.toml").write_text(DESIGN, encoding="utf-8")
    words = ("design", tmp_path / "tiny.toml", "--out", tmp_path / "tiny.json")
    code, out, err = interarea(*words, "--json")
    document = json.loads(out)
    assert code == 0 and document["controller"] == "tiny" and document["certificate"]["passed"]
    saved = json.loads((tmp_path / "tiny.json").read_text(encoding="utf-8"))
    assert document["certificate"] == saved["certificate"]
    assert document["alternatives"][0]["alternative"] == "tiny" and document["files"] == [
        str(tmp_path / "tiny.json")
    ]
    assert "start 1 of 1: " in err
    assert interarea(*words, "--quiet")[2] == ""
