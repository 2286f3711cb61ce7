"""The pages of the docs: for whom, what next, no dead link; nothing public is without a place."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from fmu_blocks import blocks

import interarea as ia
from interarea import formats
from interarea.cli.app import COMMANDS, load
from interarea.models.devices.library import library

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(p for p in DOCS.rglob("*.md") if "generated" not in p.parts and p.name != "index.md")
sys.path.insert(0, str(DOCS / "site"))
import written  # noqa: E402  of the site, no package

FLOORS = ("models", "fmu_build", "design", "cosim", "interarea")
QUICK = ("python", "commands", "devices", "variables")
GENERATED = (*QUICK, "written")  # that one runs commands for its examples


@pytest.fixture(scope="module")
def pages() -> dict[str, str]:
    """Return the generated pages that run nothing, by name."""
    sys.path.insert(0, str(DOCS / "site"))
    try:
        import catalogue
    finally:
        sys.path.remove(str(DOCS / "site"))
    return {name: "\n".join(getattr(catalogue, f"{name}_page")()) for name in QUICK}


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.stem)
def test_first_line_says_for_whom_and_the_last_what_is_next(page: Path) -> None:
    text = re.sub(r"\A---\n.*?\n---\n+", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    check_first_and_last(text)


def check_first_and_last(text: str) -> None:
    title, first = [part for part in text.split("\n\n") if part.strip()][:2]
    assert title.startswith("# ")
    assert re.match(r"For those who .*?\.\s+After th(is|ese)\s+pages?\s", first, re.DOTALL), first
    assert re.search(r"^Next: \[", text.rstrip().split("\n\n")[-1], re.MULTILINE), "no next step at the end"


@pytest.mark.parametrize("name", QUICK)
def test_generated_pages_say_so_too(name: str, pages: dict[str, str]) -> None:
    check_first_and_last(pages[name])


def test_the_front_page_says_so_too() -> None:
    text = (DOCS / "index.md").read_text(encoding="utf-8")
    check_first_and_last(text.partition("```{toctree}")[0])


def test_every_command_that_writes_has_its_files_told() -> None:
    """A command with `--out` writes what `written.toml` tells, or a file that has a page of its own."""
    reported = {command["name"] for command in written.WRITTEN["command"]}
    other = {
        "explore",
        "ssp",
        "container",
        "import",
        "export",
        "new",
    }  # a page, by standards, a case
    writing = {name for name in COMMANDS if any("--out" in p.opts for p in load(name).params)}
    assert writing - other <= reported and reported | other <= set(COMMANDS)


def test_every_kind_of_what_is_cached_is_told() -> None:
    code = "".join(p.read_text(encoding="utf-8") for f in FLOORS for p in (ROOT / f).rglob("*.py"))
    named = set(re.findall(r"(?:artefact|cached_json)\(\s*cache,\s*\"([\w-]+)\"", code))
    assert len(named) >= 12
    assert named | {block.kind for block in blocks().values()} - {"loop", "decay"} <= set(
        written.WRITTEN["cache"]
    )


def test_no_table_has_an_empty_heading(pages: dict[str, str]) -> None:
    texts = {p.name: p.read_text(encoding="utf-8") for p in PAGES} | pages
    for name, text in texts.items():
        for head in re.findall(r"^(\|.*\|)\n\|[-| :]+\|$", text, re.MULTILINE):
            assert all(cell.strip() for cell in head.strip("|").split("|")), f"{name}: {head}"


def test_every_page_can_be_reached_from_the_first() -> None:
    reached: set[str] = set()
    todo = ["index"]
    while todo:
        file = DOCS / f"{todo.pop()}.md"
        text = file.read_text(encoding="utf-8") if file.is_file() else ""
        trees = re.findall(r"```\{toctree\}(.*?)```", text, re.DOTALL)
        result = {line for tree in trees for line in tree.split() if not line.startswith(":")}
        todo += result - reached
        reached |= result
    assert {str(p.relative_to(DOCS).with_suffix("")) for p in PAGES} <= reached
    assert {f"generated/{name}" for name in GENERATED} <= reached


@pytest.mark.parametrize("page", [*PAGES, ROOT / "README.md", ROOT / "CONTRIBUTING.md"], ids=lambda p: p.stem)
def test_no_link_within_the_repository_is_dead(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", text):
        if not target.startswith(("http:", "https:")):
            generated = target.removeprefix("../").startswith("generated/")
            name = Path(target).stem
            assert (generated and name in GENERATED) or (page.parent / target).exists(), target


def test_every_public_name_command_and_device_has_its_place(pages: dict[str, str]) -> None:
    for name in set(ia.__all__) - {"__version__"}:
        assert f":: interarea.{name}\n" in pages["python"], name
    for name in COMMANDS:
        assert f"\n## {name}\n" in pages["commands"], name
        assert f"\n# interarea {name}" in pages["commands"], f"{name} has no example"
    for model in library().values():
        assert f"\n## {model.device.name}\n" in pages["devices"]
        for parameter in model.device.parameters:
            assert f"| `{parameter.name}` |" in pages["devices"]
    assert all((DOCS / "formats" / f"{kind}.md").is_file() for kind in formats.kinds())
    assert set(formats.kinds()) == set(
        re.findall(r"\(formats/(\w+)\.md\)", (DOCS / "reference.md").read_text())
    )


def test_every_option_of_a_command_has_its_place(pages: dict[str, str]) -> None:
    for name in COMMANDS:
        section = pages["commands"].split(f"\n## {name}\n")[1].split("\n## ")[0]
        for p in load(name).params:
            if not getattr(p, "hidden", False):
                shown = p.opts[0] if p.opts[0].startswith("-") else p.metavar or p.name.upper()
                assert f"| `{shown}" in section, f"{name} {shown}"
                assert getattr(p, "help", ""), f"{name} {shown} says nothing"


def test_every_variable_of_every_kind_of_fmu_has_its_place(pages: dict[str, str]) -> None:
    """Blocks that the page was not made of: names but for numbers."""
    shown = set(re.findall(r"^\| `([^`]+)` \|", pages["variables"], re.MULTILINE))
    plain = {re.sub(r"\d+", "#", name) for name in shown}
    for kind, block in blocks().items():
        for v in block.table if kind not in ("decay", "loop") else ():
            assert re.sub(r"\d+", "#", v.name) in plain, f"{kind}: {v.name}"


def test_every_variable_of_the_environment_has_its_place(pages: dict[str, str]) -> None:
    code = [p.read_text(encoding="utf-8") for f in FLOORS for p in (ROOT / f).rglob("*.py")]
    read = {name for text in code for name in re.findall(r"environ(?:\.get)?[\[(]\s*\"(\w+)\"", text)}
    read |= {name for text in code for name in re.findall(r"\"(INTERAREA_[A-Z_]+)\"", text)}
    for name in read - {"INTERAREA_GUARDED"}:  # set by one process of ours for another
        assert f"| `{name}` |" in pages["commands"], name


def test_spelling() -> None:
    pytest.importorskip("codespell_lib", reason="codespell is not installed (extra `docs`)")
    files = [str(p) for p in (*PAGES, DOCS / "index.md", *ROOT.glob("*.md"))]
    command = [sys.executable, "-m", "codespell_lib", "--ignore-words-list", "te", *files]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.stdout == "", done.stdout
