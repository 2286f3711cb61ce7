"""The rules of the house that a machine can check: direction of imports, size of files, names."""

from __future__ import annotations

import ast
import re
import subprocess
import tomllib
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from importlib.util import resolve_name
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
FLOORS = ("models", "fmu_build", "design", "cosim", "interarea")
MAY_IMPORT = {
    "models": set(),
    "fmu_build": {"models"},
    "design": {"models"},
    "cosim": {"models", "fmu_build", "design"},
    "interarea": {"models", "fmu_build", "design", "cosim"},
}
#: Inside a floor the rooms have an order too: each imports from those before it and from the floor's files.
ORDER = {
    "models": ["devices", "case", "grid", "blocks", "importers", "exporters"],
    "fmu_build": ["write", "open", "check"],
    "design": [
        *("linear", "lmi", "reduction", "modes", "controllers", "delay"),
        *("synthesis", "certificates", "robust"),
    ],
    "cosim": [
        *("plots", "master", "scenario", "results", "run", "export", "designs", "records", "explorer"),
        *("sweep", "maps", "screen", "grid_study", "actuator_study", "inverter_study", "study"),
    ],
    "interarea": ["cli"],
}
PYTHON = [p for floor in FLOORS for p in sorted((ROOT / floor).rglob("*.py"))]
SOURCES = PYTHON + [p for floor in FLOORS for p in sorted((ROOT / floor).rglob("*.[ch]"))]
#: C has its order of folders too: each includes from those before it.
C_ORDER = [
    *(f"models/c/{k}" for k in ("block", "channel", "concentrator", "controller", "detector")),
    *(f"models/c/plant/{k}" for k in ("numbers", "machine", "network", "flow", "start", "events")),
    *(f"models/c/{k}" for k in ("plant", "plant/lanes", "pmu", "container")),
    *(
        "fmu_build/c",
        "fmu_build/c/group",
        "fmu_build/c/dll",
        "cosim/master/kernel",
        "cosim/explorer/web/libc",
        "cosim/explorer/web",
    ),
]
C_FILES = {p for p in SOURCES if p.suffix in {".c", ".h"}}
LONGEST_FILE = 450  # lines: what a person reads in one sitting
MOST_LINES_OF_DLLS = 1200  # what a second interface to the same blocks was allowed, before it was written
MOST_PATHS = 15  # through a function: what a person can test
LONGEST_FUNCTION = 80  # lines after its signature and docstring
MOST_MODULES = 16  # in a folder: what a person takes in at a glance


def _name(path: Path) -> str:
    return str(path.relative_to(ROOT))


def _module(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    full = ".".join(parts if parts[0] == "interarea" else ("interarea", *parts))
    return full.removesuffix(".__init__")


MODULES = {_module(path): path for path in PYTHON}


def _of_each(paths: Iterable[Path]) -> Callable[[Callable[[Path], None]], Callable[[], None]]:
    """Make one test of a rule for files, which names every file that breaks it.

    A test for each file would be 2700 of them: what pytest does around each takes longer than the rule.
    """

    def test_of(rule: Callable[[Path], None]) -> Callable[[], None]:
        def test() -> None:
            wrong, files = [], list(paths)
            for path in files:
                try:
                    rule(path)
                except AssertionError as error:
                    wrong.append(str(error))
            assert files
            assert not wrong, "\n".join(wrong)

        test.__name__, test.__doc__ = rule.__name__, rule.__doc__
        return test

    return test_of


@cache
def _tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def _imports(path: Path, *, late: bool = True, types: bool = True) -> set[str]:
    """Return the full names of our modules that a file imports; `late`: inside functions too.

    types : what only a type checker imports as well.
    """
    name = _module(path)
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    collected: set[str] = set()
    todo: list[ast.AST] = list(_tree(path).body)
    while todo:
        node = todo.pop()
        if not types and isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            todo += node.orelse
            continue
        if isinstance(node, ast.Import):
            collected |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = resolve_name("." * node.level + (node.module or ""), package)
            collected |= {n if (n := f"{base}.{alias.name}") in MODULES else base for alias in node.names}
        elif late or not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            todo += _statements_in(node)
    return collected


def _statements_in(node: ast.AST) -> Iterator[ast.AST]:
    """Return what is directly in a node but for expressions: most of a tree, and no statement is in them."""
    return (child for child in ast.iter_child_nodes(node) if not isinstance(child, ast.expr))


def _room(module: str) -> tuple[str, str]:
    """Return the floor of a module and its room there, "" for the floor's own files."""
    parts = module.split(".")[1:]
    if not parts or parts[0] not in FLOORS:
        parts = ["interarea", *parts]
    rooms = [
        r for r in ORDER[parts[0]] if ".".join(parts[1:]).startswith(f"{r}.") or ".".join(parts[1:]) == r
    ]
    return parts[0], max(rooms, key=len, default="")


@_of_each(PYTHON)
def test_imports_go_one_way(path: Path) -> None:
    floor, room = _room(_module(path))
    order = ("", *ORDER[floor])
    for name in _imports(path):
        # A bare `import cosim` works from the repository root and would make a second copy of every class.
        assert name.partition(".")[0] not in FLOORS[:-1], (
            f"{_name(path)} imports {name}: write interarea.{name}"
        )
        if not name.startswith("interarea.") or name not in MODULES:
            continue
        other, there = _room(name)
        if other != floor:
            assert other in MAY_IMPORT[floor], f"{_name(path)}: {floor} must not import {name}"
        elif there != room and not (floor == "interarea" and room == ""):
            assert there in order[: order.index(room)], (
                f"{_name(path)}: {room or floor} must not import {name}"
            )


def test_no_module_imports_itself_through_others() -> None:
    """Circles through types and inside functions count too: each hides a thing without a room of its own."""
    sorter = TopologicalSorter({m: _imports(p) & MODULES.keys() - {m} for m, p in MODULES.items()})
    circle: list[str] = []
    try:
        sorter.prepare()
    except CycleError as error:
        circle = error.args[1]
    assert not circle, " -> ".join(circle)


def _includes(path: Path) -> set[Path]:
    """Return our files that a C file includes, as the build finds them: beside it or among all headers."""
    names = re.findall(r'^\s*#\s*include\s+"([^"]+)"', path.read_text(encoding="utf-8"), re.MULTILINE)
    result = {(path.parent / name).resolve() for name in names} & C_FILES
    return result | {p for p in C_FILES for name in names if name == p.name}


def _unit(path: Path) -> str:
    """Return a C file without its ending: a header and the file that defines what it declares are one."""
    return _name(path.with_suffix(""))


def test_c_includes_go_one_way() -> None:
    """Between folders in the order above; between files without circles, a header with what it declares."""
    arrows: dict[str, set[str]] = {}
    for path in C_FILES:
        assert _name(path.parent) in C_ORDER, f"{_name(path)}: its folder has no place in C_ORDER"
        for other in _includes(path):
            own, there = (C_ORDER.index(_name(p.parent)) for p in (path, other))
            assert there <= own, f"{_name(path)} must not include {_name(other)}"
            arrows.setdefault(_unit(path), set()).add(_unit(other))
    circle: list[str] = []
    try:
        TopologicalSorter({unit: others - {unit} for unit, others in arrows.items()}).prepare()
    except CycleError as error:
        circle = error.args[1]
    assert not circle, " -> ".join(circle)


def test_no_two_c_files_of_an_fmu_have_one_name() -> None:
    """The sources of an FMU lie in one folder."""
    names = [p.name for p in C_FILES if _name(p).startswith(("models/c/", "fmu_build/c/"))]
    assert len(names) > 50
    assert not {n for n in names if names.count(n) > 1}


@_of_each(sorted(p for p in C_FILES if p.suffix == ".h"))
def test_a_header_declares_what_its_own_file_defines(path: Path) -> None:
    """A header that declares for many files is a hub: whoever needs one of them depends on all."""
    own = path.with_suffix(".c")
    if own not in C_FILES:
        return  # types, inline functions, or an interface that many kinds define
    text = re.sub(r"/\*.*?\*/", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)
    for name in re.findall(r"^(?!static|typedef)[A-Za-z_][\w *]*?\b(\w+)\([^;{]*\);", text, re.MULTILINE):
        defined = re.search(
            rf"^[\w *]*\b{name}\([^;]*?\)\s*\{{", own.read_text(encoding="utf-8"), re.MULTILINE
        )
        assert defined, f"{_name(path)} declares {name}, which {own.name} does not define"


@pytest.mark.parametrize("floor", [*FLOORS, "benchmarks"])
def test_a_folder_is_taken_in_at_a_glance(floor: str) -> None:
    """At most so many modules in a folder; a C file and its header count as one."""
    files = [p for p in (ROOT / floor).rglob("*") if p.suffix in (".py", ".c", ".h")]
    for folder in {p.parent for p in files}:
        names = {p.stem for p in files if p.parent == folder}
        assert len(names) <= MOST_MODULES, f"{_name(folder)}: {len(names)} modules; which belong together?"


def test_every_package_is_installed() -> None:
    """A folder that the list in pyproject.toml lacks is missing from every wheel."""
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"][
        "packages"
    ]
    assert set(listed) == {m for m, p in MODULES.items() if p.name == "__init__.py"}


@_of_each(SOURCES)
def test_a_file_is_read_in_one_sitting(path: Path) -> None:
    lines = path.read_text(encoding="utf-8").count("\n")
    assert lines <= LONGEST_FILE, f"{_name(path)} has {lines} lines; does it hold more than one thing?"


def test_dlls_are_a_front_of_what_fmus_have() -> None:
    """Export, check and import of IEEE/CIGRE DLLs: more lines would be a second layer beside that of FMUs."""
    files = [p for p in SOURCES if p.stem == "real_code" or _name(p) == "models/c/container/chain.h"]
    lines = {_name(p): p.read_text(encoding="utf-8").count("\n") for p in files}
    assert len(files) == 7 and sum(lines.values()) <= MOST_LINES_OF_DLLS, lines


def test_no_drawers() -> None:
    vague = {"utils", "util", "common", "core", "base", "helpers", "misc", "tools"}
    assert not [_name(p) for p in SOURCES if p.stem in vague]


@_of_each(SOURCES)
def test_nothing_is_left_for_later(path: Path) -> None:
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        assert not re.search(r"\b(TODO|FIXME|XXX|NotImplementedError)\b", line), (
            f"{_name(path)}:{number}: {line}"
        )


def _paths_in_python(tree: ast.AST) -> dict[str, int]:
    """Return the cyclomatic numbers of functions [McCabe]: one, and one for each place that branches.

    Functions and classes inside a function count by themselves.
    """
    counted: dict[tuple[str, int], int] = {}
    todo: list[tuple[ast.AST, str, tuple[str, int] | None]] = [(tree, "", None)]
    while todo:
        parent, inside, function = todo.pop()
        for node in ast.iter_child_nodes(parent):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                counted[own := (f"{inside}{node.name}", node.lineno)] = 1
                todo.append((node, f"{own[0]}.", own))
            elif isinstance(node, ast.ClassDef):
                todo.append((node, f"{inside}{node.name}.", None))
            else:
                if function is not None:
                    counted[function] += _branches(node)
                todo.append((node, inside, function))
    return {f"{name}, line {line}": number for (name, line), number in counted.items()}


_BRANCHING = (ast.If, ast.IfExp, ast.For, ast.AsyncFor, ast.While, ast.ExceptHandler, ast.match_case)


def _branches(node: ast.AST) -> int:
    if isinstance(node, ast.BoolOp):
        return len(node.values) - 1
    if isinstance(node, ast.comprehension):
        return 1 + len(node.ifs)
    return int(isinstance(node, _BRANCHING))


@_of_each(PYTHON)
def test_functions_are_simple(path: Path) -> None:
    above = {name: k for name, k in _paths_in_python(_tree(path)).items() if k > MOST_PATHS}
    assert not above, f"{_name(path)}: {above}, allowed are {MOST_PATHS} ways through a function; divide it"


def _statement_lines(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Return how many lines follow a function's signature and docstring."""
    first = function.body[int(ast.get_docstring(function) is not None) :]
    return (first[-1].end_lineno or 0) - first[0].lineno + 1 if first else 0


@_of_each(PYTHON)
def test_functions_are_short(path: Path) -> None:
    functions = [n for n in ast.walk(_tree(path)) if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef)]
    above = {n.name: k for n in functions if (k := _statement_lines(n)) > LONGEST_FUNCTION}
    assert not above, f"{_name(path)}: {above}, allowed are {LONGEST_FUNCTION} lines; divide it"


def _paths_in_c(text: str) -> dict[str, int]:
    """Return the cyclomatic numbers of the functions of a C file."""
    text = re.sub(r"/\*.*?\*/|//[^\n]*", " ", text, flags=re.DOTALL)
    text = re.sub(r'"(?:\\.|[^"\\])*"|\'(?:\\.|[^\'\\])\'', "0", text)
    text = re.sub(r"^[ \t]*#(?:[^\n]*\\\n)*[^\n]*", " ", text, flags=re.MULTILINE)
    result, depth, start, name = {}, 0, 0, None
    for brace in re.finditer(r"[{}]", text):
        if brace[0] == "{" and depth == 0:
            name = re.search(r"(\w+)\s*\((?:[^()]|\([^()]*\))*\)\s*$", text[start : brace.start()])
            start = brace.end()
        depth += 1 if brace[0] == "{" else -1
        if depth == 0:
            body = text[start : brace.start()]
            if name is not None:
                result[name[1]] = 1 + len(re.findall(r"\b(?:if|for|while|case)\b|&&|\|\||\?", body))
            start = brace.end()
    return result


@_of_each(sorted(C_FILES))
def test_functions_in_c_are_simple(path: Path) -> None:
    above = {n: k for n, k in _paths_in_c(path.read_text(encoding="utf-8")).items() if k > MOST_PATHS}
    assert not above, f"{_name(path)}: {above}, allowed are {MOST_PATHS} ways through a function; divide it"


def test_paths_in_c_are_counted() -> None:
    text = """
    static const char *const names[] = { "if (", "b" };
    #define LOOP(k) for (k = 0; k < 3 && k; ++k) \\
        if (k)
    static int f(int (*g)(int), int a) /* if */
    {
        for (int k = 0; k < a && g(k); ++k) { if (k) return 1; }
        switch (a) { case 1: return a ? 2 : 3; default: return 0; }
    }
    static void h(void) { f(0, 1); }
    """
    assert _paths_in_c(text) == {"f": 6, "h": 1}


@_of_each(sorted((ROOT / "tests").rglob("test_*.py")))
def test_every_test_asserts_something(path: Path) -> None:
    source = path.read_text(encoding="utf-8")
    # a comment asserts nothing; where a string with # hides what does, the code is written anew
    lines = [line.partition("#")[0] for line in source.splitlines()]
    asserting = re.compile(r"assert|raises|check_")
    todo: list[ast.AST] = [ast.parse(source)]
    while todo:
        node = todo.pop()
        todo += _statements_in(node)
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
            text = "\n".join(lines[node.lineno - 1 : node.end_lineno])
            assert asserting.search(text) or asserting.search(ast.unparse(node)), (
                f"{_name(path)}: {node.name} asserts nothing"
            )


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
