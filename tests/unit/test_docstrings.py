"""The examples in docstrings print what they say; what the pages show of commands and of Python is there."""

from __future__ import annotations

import doctest
import importlib
import pkgutil
import re
import shlex
import shutil
from pathlib import Path

import pytest

import interarea as ia
from interarea.cli.app import COMMANDS, load

ROOMS = ("models", "design", "fmu_build", "cosim")
ROOT = Path(__file__).resolve().parents[2]
PAGES = ["README.md", *sorted(f"docs/{p.name}" for p in (ROOT / "docs").glob("*.md"))]


@pytest.mark.parametrize("room", ROOMS)
def test_examples_in_docstrings_print_what_they_say(room: str) -> None:
    package = importlib.import_module(f"interarea.{room}")
    tried = 0
    for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        result = doctest.testmod(importlib.import_module(module.name))
        tried += result.attempted
        assert result.failed == 0, module.name
    assert tried > 0


@pytest.mark.slow
@pytest.mark.parametrize("module", ["grids", "synthesis", "simulation", "exchange"])
def test_examples_of_public_functions(module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each has one, and they run in the order in which they stand, in the folder of the tutorial's grid."""
    for file in (ROOT / "docs" / "tutorial").glob("grid.*"):
        shutil.copy(file, tmp_path)
    monkeypatch.chdir(tmp_path)
    loaded = importlib.import_module(f"interarea.{module}")
    result = [t for t in doctest.DocTestFinder().find(loaded) if t.examples]
    public = {n for n, place in ia._PLACE.items() if place == module} - {
        "load_case"
    }  # shown where it is defined
    assert public <= {t.name.rpartition(".")[2] for t in result}
    for example in sorted(result, key=lambda t: t.lineno or 0):
        assert doctest.DocTestRunner().run(example).failed == 0, example.name


def commands(page: str) -> list[list[str]]:
    """Return the lines of a page's code blocks that call `interarea`, without their comments."""
    text = (ROOT / page).read_text(encoding="utf-8")
    blocks = re.findall(r"```[a-z]*\n(.*?)```", text, re.DOTALL)
    lines = [line.split("$ ")[-1] for block in blocks for line in block.splitlines()]
    return [shlex.split(line, comments=True)[1:] for line in lines if line.startswith("interarea ")]


@pytest.mark.parametrize("page", PAGES)
def test_every_command_of_a_page_is_one_of_ours(page: str) -> None:
    for name, *arguments in commands(page):
        command = load(name)
        known = {option for p in command.params for option in (*p.opts, *p.secondary_opts)}
        assert {a for a in arguments if a.startswith("--")} <= known, (name, arguments)


def test_the_reference_shows_each_command_once() -> None:
    shown = {name for name, *_ in commands("docs/reference.md")}
    assert shown == set(COMMANDS) - {"cases"}


@pytest.mark.parametrize("page", PAGES)
def test_python_on_a_page_imports_what_there_is(page: str) -> None:
    text = (ROOT / page).read_text(encoding="utf-8")
    for block in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
        compile(block, page, "exec")
        for module, names in re.findall(r"^ *from (interarea\S*) import (.+)$", block, re.MULTILINE):
            for name in names.split(","):
                assert hasattr(importlib.import_module(module), name.strip()), (module, name)


@pytest.mark.slow
def test_the_system_of_readme_runs() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (block,) = [b for b in re.findall(r"```python\n(.*?)```", text, re.DOTALL) if "System(" in b]
    names: dict[str, object] = {}
    exec(compile(block, "README.md", "exec"), names)
    assert names["result"].data["time_s"].iloc[-1] == 10.0  # type: ignore[attr-defined]
    assert re.search(r"remote\.u +100\.000", names["result"].explain())  # type: ignore[attr-defined]
