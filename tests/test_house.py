"""The rules of the house that a machine can check: direction of imports, size of files, names."""

from __future__ import annotations

import ast
import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
ROOMS = ("models", "fmu_build", "design", "cosim")
MAY_IMPORT = {
    "models": set(),
    "fmu_build": {"models"},
    "design": {"models"},
    "cosim": {"models", "fmu_build", "design"},
}
PYTHON = [p for room in ROOMS for p in sorted((ROOT / room).rglob("*.py"))]
SOURCES = PYTHON + [p for room in ROOMS for p in sorted((ROOT / room).rglob("*.[ch]"))]
LONGEST_FILE = 450  # lines: what a person reads in one sitting


def _name(path: Path) -> str:
    return str(path.relative_to(ROOT))


def _imports(path: Path) -> list[tuple[int, str]]:
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found += [(0, alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            found.append((node.level, node.module or ""))
    return found


@pytest.mark.parametrize("path", PYTHON, ids=_name)
def test_imports_go_one_way(path: Path) -> None:
    room = path.relative_to(ROOT).parts[0]
    for level, module in _imports(path):
        first, _, rest = module.partition(".")
        # A bare `import cosim` works from the repository root and would make a second copy of every class.
        assert level > 0 or first not in ROOMS, f"{_name(path)} imports {module!r}; write interarea.{module}"
        if level == 0 and first == "interarea":
            other = rest.partition(".")[0]
            assert other in MAY_IMPORT[room] | {room}, f"{_name(path)}: {room} must not import {other}"


@pytest.mark.parametrize("path", PYTHON, ids=_name)
def test_modules_of_a_room_do_not_import_each_other_in_a_circle(path: Path) -> None:
    room = path.relative_to(ROOT).parts[0]
    seen: set[str] = set()
    todo = [path.stem]
    while todo:
        file = ROOT / room / f"{todo.pop()}.py"
        if not file.exists():
            continue
        for node in ast.parse(file.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ImportFrom) and node.level == 1:
                names = [node.module] if node.module else [alias.name for alias in node.names]
                for name in filter(None, names):
                    assert name != path.stem, f"{_name(path)} is imported by {file.name}, which it imports"
                    if name not in seen:
                        seen.add(name)
                        todo.append(name)


@pytest.mark.parametrize("path", SOURCES, ids=_name)
def test_a_file_is_read_in_one_sitting(path: Path) -> None:
    lines = path.read_text(encoding="utf-8").count("\n")
    assert lines <= LONGEST_FILE, f"{_name(path)} has {lines} lines; does it hold more than one thing?"


def test_no_drawers() -> None:
    vague = {"utils", "util", "common", "core", "base", "helpers", "misc", "tools"}
    assert not [_name(p) for p in SOURCES if p.stem in vague]


@pytest.mark.parametrize("path", SOURCES, ids=_name)
def test_nothing_is_left_for_later(path: Path) -> None:
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        assert not re.search(r"\b(TODO|FIXME|XXX|NotImplementedError)\b", line), (
            f"{_name(path)}:{number}: {line}"
        )


@pytest.mark.parametrize("path", sorted((ROOT / "tests").rglob("test_*.py")), ids=_name)
def test_every_test_asserts_something(path: Path) -> None:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
            text = ast.unparse(node)
            assert re.search(r"assert|raises|check_", text), f"{_name(path)}: {node.name} asserts nothing"


def test_names_of_test_files_differ() -> None:
    """pytest imports test files by their bare name: two of one name cannot be collected together."""
    names = [p.name for p in (ROOT / "tests").rglob("test_*.py")]
    assert sorted(names) == sorted(set(names))


def test_no_registry_host_and_no_path_of_one_machine_is_committed() -> None:
    tracked = subprocess.run(
        ["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False
    ).stdout.split()
    hosts = re.compile(r"(files\.pythonhosted|pypi\.org/simple|/root/|/home/\w+/|/work/)")
    for name in tracked:
        file = ROOT / name
        if file == Path(__file__) or not file.is_file() or file.suffix in {".png", ".parquet"}:
            continue
        hit = hosts.search(file.read_text(encoding="utf-8", errors="replace"))
        assert hit is None, f"{name} contains {hit and hit.group()!r}"
