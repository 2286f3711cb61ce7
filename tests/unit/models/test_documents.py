"""Documents of the user's: a number is a number of sensible size, in TOML, JSON and every model."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from interarea.cosim.errors import ScenarioError
from interarea.cosim.scenario.scenario import load_scenario
from interarea.cosim.sweep.spec import load_sweep
from interarea.design.controllers.bundled import shipped_controller
from interarea.design.controllers.controller import Controller, ControllerError
from interarea.models.case.case import case_of, load_case
from interarea.models.documents import DocumentError, parse_json, parse_toml
from interarea.models.errors import CaseError, UserError

MARK = "\ufeff".encode()
SCENARIO = 'case = "two-area-thesis"\nstop_s = 1.0\n'
#: lines of a scenario that nobody means, with a part of what is said
SCENARIOS = {
    "stop_s = true": "stop_s = True",
    'stop_s = "20"': "stop_s = '20'",
    "stop_s = 1e308": "stop_s = 1e+308",
    f"stop_s = {'9' * 400}": "400 digits",
    f"stop_s = {'9' * 5000}": "digits",
    "stop_s = 9223372036854775808": "integers of 64 bits",
    "stop_s = nan": "stop_s = nan",
    "stop_s = 1.0\ncontroller_gain = false": "controller_gain = False",
    "stop_s = 1.0\ncontroller_gain = -1e31": "controller_gain = -1e+31",
    "stop_s = 1.0\n[master]\njoint = 1e99": "master.joint",
    "stop_s = 1.0\n[channels.remote]\nsignal = 'G2_dw'\nlatency_s = true": "latency_s = True",
    f"stop_s = 1.0\nname = '{'n' * 65}'": "at most 64 characters",
    f"stop_s = 1.0\ntitle = '{'t' * 201}'": "at most 200 characters",
    f"stop_s = 1.0\n[channels.{'c' * 65}]\nsignal = 'G2_dw'": "at most 64 characters",
}


@pytest.mark.parametrize("line", SCENARIOS, ids=range(len(SCENARIOS)))
def test_a_scenario_with_a_number_that_is_none(line: str, tmp_path: Path) -> None:
    file = tmp_path / "s.toml"
    file.write_text(f'case = "two-area-thesis"\n{line}\n')
    with pytest.raises(ScenarioError) as error:
        load_scenario(file)
    assert "s.toml: " in str(error.value) and SCENARIOS[line] in str(error.value), error.value
    assert len(str(error.value)) < 400


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (SCENARIO.encode("utf-16"), "not valid TOML: is UTF-16, wanted: UTF-8"),
        ("title = 'Sj\u00f6'".encode("latin-1"), "byte 0xf6 in line 1 is not UTF-8"),
        (b"PK\x03\x04\x14\x00", "is a zip archive"),
        (b"MATLAB 5.0\xff\x00", "is binary"),
        (SCENARIO.replace("\n", "\r").encode(), "line ends of Unix or Windows are wanted"),
        (b"x = [" + b"9 " * 100_000, "got: x = [9 9"),
        (b"x = '\x1b[31m'", r"got: x = '\x1b[31m"),
    ],
)
def test_text_that_is_no_toml_is_said_to_be_what_it_is(content: bytes, says: str) -> None:
    with pytest.raises(DocumentError) as error:
        parse_toml(content)
    assert says in str(error.value) and len(str(error.value)) < 300 and str(error.value).isprintable()


def test_names_and_titles_up_to_their_length(tmp_path: Path) -> None:
    file = tmp_path / f"{'x' * 200}.toml"
    file.write_text(f"{SCENARIO}title = '{'t' * 200}'\n")
    assert len(load_scenario(file).name) == 64
    assert load_scenario({"case": "two-area-thesis", "stop_s": 1.0, "name": "n" * 64}).name == "n" * 64


@pytest.mark.parametrize("value", [True, "6.5", 10**400])
def test_the_numbers_of_a_case(value: Any) -> None:
    document = load_case("two-area-thesis").document()
    document["machines"]["G1"]["H"] = value
    with pytest.raises(CaseError, match="H"):
        case_of(document, where="it")


def test_a_sweep_with_a_switch_for_a_number(tmp_path: Path) -> None:
    file = tmp_path / "s.toml"
    text = 'scenario = "lost-signal"\n[parameters.x]\npath = "controller_gain"\nvalues = [1.0]\n'
    file.write_text(f"{text}[trajectories]\nevery = 2.0\n")
    with pytest.raises(UserError, match="every"):
        load_sweep(file)
    file.write_text(f"samples = true\n{text}")
    with pytest.raises(UserError, match="samples = True"):
        load_sweep(file)


def test_byte_order_marks_are_read_over(tmp_path: Path) -> None:
    file = tmp_path / "s.toml"
    file.write_bytes(MARK + SCENARIO.encode())
    assert load_scenario(file).stop_s == 1.0
    case = tmp_path / "c.toml"
    case.write_bytes(MARK + b'base = "two-area-thesis"\nname = "mine"\n')
    assert load_case(case).name == "mine"
    controller = shipped_controller("robust").save(tmp_path / "k.json")
    controller.write_bytes(MARK + controller.read_bytes())
    assert Controller.load(controller).name == shipped_controller("robust").name


@pytest.mark.parametrize(
    ("value", "says"),
    [
        ("NaN", "NaN is no number"),
        ("-Infinity", "-Infinity is no number"),
        ("1e300", r"limit_pu = 1e\+300"),
        ("9" * 400, "400 digits"),
        ('0.1, "limit_pu": 0.2', "'limit_pu' is given twice"),
    ],
    ids=["NaN", "Infinity", "1e300", "400 digits", "twice"],
)
def test_the_json_of_a_controller(value: str, says: str, tmp_path: Path) -> None:
    file = shipped_controller("robust").save(tmp_path / "k.json")
    text, count = re.subn(r'"limit_pu": [0-9.]+', f'"limit_pu": {value}', file.read_text(), count=1)
    assert count == 1
    file.write_text(text)
    with pytest.raises(ControllerError, match=says) as error:
        Controller.load(file)
    assert "k.json" in str(error.value)


def test_where_a_number_stands_is_said() -> None:
    with pytest.raises(DocumentError, match=r"^a.b 2.c = 1e\+200, allowed"):
        parse_toml("[[a.b]]\n[[a.b]]\nc = 1e200")
    with pytest.raises(DocumentError, match="nested too deeply"):
        parse_json("[" * 100_000)
    assert parse_toml("a = inf")["a"] == float("inf")  # what may be unlimited is said by the models


def test_an_empty_word_of_a_command_is_refused(
    interarea: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for words in (("--out", ""), ("--out=",)):
        code, _, said = interarea("run", "lost-signal", *words)
        assert code == 2 and "run: --out is empty, allowed: DIR" in said
        assert len(said.strip().splitlines()) == 1
    assert interarea("run", "", "--out", "x")[0] == 2
    assert list(tmp_path.iterdir()) == []
