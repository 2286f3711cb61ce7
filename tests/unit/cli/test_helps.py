"""What `--help` prints: it fits 80 columns, cuts nothing, and ends with an example, which runs."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from interarea.cli import app
from interarea.cli.app import COMMANDS, load
from interarea.command_help import EXAMPLES, READS, SUMMARIES

#: examples of a second or two; all others run in the slow half
QUICK = ("list", "cases", "show", "new", "device", "export", "cache")
RUNNING = [pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in COMMANDS]


def _help(*words: str) -> str:
    done = CliRunner().invoke(app.app, [*words, "--help"], terminal_width=80)
    assert done.exit_code == 0
    return done.stdout


def _squeezed(text: str) -> str:
    return "".join(text.split())  # a line may break at a hyphen too


def test_the_help_fits_80_columns_and_cuts_no_summary() -> None:
    assert list(SUMMARIES) == list(COMMANDS)
    printed = _help()
    assert max(map(len, printed.splitlines())) <= 80
    assert all(
        re.search(rf"^  {name} +{re.escape(line)}$", printed, re.M) for name, line in SUMMARIES.items()
    )


@pytest.mark.parametrize("name", COMMANDS)
def test_a_commands_help_fits_80_columns_and_cuts_no_sentence(name: str) -> None:
    printed, command = _help(name), load(name)
    assert max(map(len, printed.splitlines())) <= 80
    texts = [command.help, *(getattr(p, "help", None) for p in command.params if not p.hidden)]
    assert len(texts) > 3
    for text in filter(None, texts):
        assert _squeezed(text) in _squeezed(printed), text


@pytest.mark.parametrize("name", COMMANDS)
def test_a_commands_help_ends_with_its_example(name: str) -> None:
    """On a line of its own, so that it can be copied."""
    before = f", after `{READS[name]}`" if name in READS else ""
    assert shlex.split(EXAMPLES[name])[:2] == ["interarea", name]
    assert _help(name).splitlines()[-2:] == [f"  Example{before}:", f"    {EXAMPLES[name]}"]


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory, cache: Path) -> tuple[Path, set[str]]:
    """A folder, and the examples that have run there."""
    return tmp_path_factory.mktemp("examples"), set()


@pytest.mark.parametrize("name", RUNNING)
@pytest.mark.timeout(1800)  # a study takes minutes
def test_an_example_runs(name: str, ran: tuple[Path, set[str]], monkeypatch: pytest.MonkeyPatch) -> None:
    """In an empty folder, with nothing but what the line named above it has written."""
    folder, done = ran
    monkeypatch.chdir(folder)
    _run(EXAMPLES[name], done)
    assert EXAMPLES[name] in done


def _run(example: str, done: set[str]) -> None:
    if example in done:
        return
    words = shlex.split(example)[1:]
    if words[0] in READS and example == EXAMPLES[words[0]]:
        _run(READS[words[0]], done)
    before = set(Path().rglob("*"))
    ended = CliRunner().invoke(app.app, words)
    assert ended.exit_code == 0, ended.output
    if "--out" in words:
        written = Path(words[words.index("--out") + 1])
        assert written in set(Path().rglob("*")) - before and (written.is_file() or any(written.iterdir()))
    else:
        assert ended.stdout.strip()
    done.add(example)
