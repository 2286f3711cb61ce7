"""Honest mistakes, each with the line that is wanted: what, where, got, allowed, what to do.

`*.toml` beside this file hold them, one file a source: the command line, each file format, Python. Damaged
and hostile input lies in tests/corpus and tests/hostile.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest
from command_line import invoke

import interarea as ia

FOLDER = Path(__file__).parent
SOURCES = {p.stem: tomllib.loads(p.read_text(encoding="utf-8")) for p in sorted(FOLDER.glob("*.toml"))}
MISTAKES = [(source, row) for source, table in SOURCES.items() for row in table["mistake"]]
#: source -> the command that meets its file
COMMANDS = {
    "scenario": ("run", "mine.toml", "--out", "out"),
    "sweep": ("sweep", "mine.toml", "--out", "out"),
    "case": ("loops", "mine.toml"),
    "design": ("design", "mine.toml", "--out", "made.json"),
    "controller": ("certify", "mine.json"),
}


def printed(source: str, row: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> tuple[int, list[str]]:
    """Make a mistake in the present folder; return exit code and the lines on it."""
    if source == "python":
        with pytest.raises((ia.InterareaError, AttributeError)) as caught:
            eval(row["code"], {"ia": ia})
        return 2, str(caught.value).split("\n")
    for name, text in SOURCES["command_line"]["files"].items():
        Path(name).write_text(text, encoding="utf-8")
    words = row.get("command")
    if words is None:
        words = COMMANDS[source]
        text = SOURCES[source]["good"]
        for old, new in row["change"]:
            assert old in text, f"{old!r} is not in the good file"
            text = text.replace(old, new, 1)
        Path(words[1]).write_text(text, encoding="utf-8")
    code, _, complaint = invoke(words, monkeypatch)
    assert "Traceback" not in complaint
    return code, complaint.splitlines()


def test_size() -> None:
    assert len(MISTAKES) >= 200
    assert len({(source, row["name"]) for source, row in MISTAKES}) == len(MISTAKES)
    assert set(SOURCES) == {"command_line", "python", *COMMANDS}


@pytest.mark.parametrize(("source", "row"), MISTAKES, ids=[f"{s}: {r['name']}" for s, r in MISTAKES])
def test_the_wanted_line(
    source: str, row: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, lines = printed(source, row, monkeypatch)
    assert code == 2
    assert row["says"] in [line.removeprefix("interarea: ") for line in lines], lines
    assert not (tmp_path / "out").exists()
