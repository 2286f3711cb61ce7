"""Words that a command does not take: one line on stderr for each kind of mistake, at every command."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from command_line import invoke

from interarea.cli.app import COMMANDS, load

LOADED = {name: load(name) for name in COMMANDS}


def _parameters(name: str, kind: str) -> list[Any]:
    return [p for p in LOADED[name].params if p.param_type_name == kind]


def _line(words: list[str], monkeypatch: pytest.MonkeyPatch) -> str:
    """Return the one line on a mistake in `words`."""
    code, out, said = invoke(words, monkeypatch)
    assert (code, out) == (2, "")
    line = said.removesuffix("\n")
    assert "\n" not in line and line.startswith(f"interarea: {words[0]}: "), said
    return line.removeprefix(f"interarea: {words[0]}: ")


OPTIONS = [
    (name, p) for name in COMMANDS for p in _parameters(name, "option") if not p.is_flag and p.opts[0] != "-h"
]
each_option = pytest.mark.parametrize(
    ("name", "option"), OPTIONS, ids=[f"{n} {p.opts[0]}" for n, p in OPTIONS]
)


@pytest.fixture(autouse=True)
def _empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("name", COMMANDS)
def test_words_too_many_and_too_few(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    arguments = _parameters(name, "argument")
    required = [p for p in LOADED[name].params if p.required]
    for parameter in required[:1]:
        line = _line([name], monkeypatch)
        assert " is missing, wanted: " in line and f"as in `interarea {name}" in line
        assert parameter.help in line
    if not any(p.nargs != 1 for p in arguments):
        missing = [w for p in required if p.param_type_name == "option" for w in (p.opts[0], "there")]
        line = _line([name, *["a"] * len(arguments), "surplus", *missing], monkeypatch)
        assert line.startswith("surplus: too many arguments, allowed: ")


@each_option
def test_an_option_misspelt(name: str, option: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its last letter twice: it is the nearest of all that the command has."""
    right = option.opts[0]
    wrong = right + right[-1]
    assert _line([name, wrong, "1"], monkeypatch) == (
        f"{wrong}: no such option; did you mean {right}? (`interarea {name} --help` lists them)"
    )


@each_option
def test_an_option_without_its_value(name: str, option: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    word = option.opts[0]
    arguments = ["a"] * len(_parameters(name, "argument"))
    for rest in ([], ["--quiet"], ["--json"]):
        line = _line([name, *arguments, word, *rest], monkeypatch)
        assert line.startswith(f"{word} has no value, ") and option.help in line
    assert _line([name, *arguments, f"{word}="], monkeypatch).startswith(f"{word} is empty, allowed: ")


NUMBERS = [(name, p) for name, p in OPTIONS if "float" in str(p.type_descriptor.annotation)]


@pytest.mark.parametrize("value", ["nan", "inf", "-inf", "1e300", "lots", "1,5", "3s"])
@pytest.mark.parametrize(("name", "option"), NUMBERS, ids=[f"{n} {p.opts[0]}" for n, p in NUMBERS])
def test_a_number_that_is_none(name: str, option: Any, value: str, monkeypatch: pytest.MonkeyPatch) -> None:
    words = ["a"] * max(1, len(_parameters(name, "argument")))
    needed = [w for p in LOADED[name].params if p.required and p.opts[0][0] == "-" for w in (p.opts[0], "x")]
    if not _parameters(name, "argument"):
        words = []
    line = _line([name, *words, *needed, f"{option.opts[0]}={value}"], monkeypatch)
    got = value.replace("1e300", "1e+300")
    assert f"{option.opts[0]} {option.metavar or ''}".strip() in line and f"got {got}, allowed: a" in line


def test_a_flag_with_a_value(monkeypatch: pytest.MonkeyPatch) -> None:
    assert _line(["run", "a", "--json=3"], monkeypatch) == "--json takes no value, wanted: --json alone"


def test_options_before_the_command_and_no_command(monkeypatch: pytest.MonkeyPatch) -> None:
    for words, says in {
        ("--quiet", "run"): "--quiet: no such option before the name of a command; ",
        ("quarrel",): "quarrel: no such command; wanted: the name of one ",
        ("modess", "--json"): "modess: no such command; did you mean modes? ",
    }.items():
        code, out, said = invoke(words, monkeypatch)
        assert (code, out, said.count("\n")) == (2, "", 1)
        assert said.startswith(f"interarea: {says}")
