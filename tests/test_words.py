"""Names and prose use the standard terms of the field, and files that they name exist."""

from __future__ import annotations

import ast
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
TRACKED = [
    ROOT / name
    for name in subprocess.run(
        ["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.splitlines()
    if (ROOT / name).is_file()
]
PYTHON = [p for p in TRACKED if p.suffix == ".py"]
PROSE = [
    p
    for p in TRACKED
    if p.suffix in {".py", ".c", ".h", ".js", ".md", ".j2", ".toml"}
    and p.relative_to(ROOT).parts[0] != "tests"
]
#: A name says what its value is: `rows`, `signal_paths`, `event_times`, not what was done with it.
NO_NAME = frozenset(
    {"alike", "bury", "company", "dismiss", "doubt", "doubtful", "found", "harm", "hire", "kink", "kinks"}
    | {"mine", "oddities", "oddity", "tally", "told", "way", "ways", "whims"}
    | {"asked", "given", "here", "kept", "made", "some", "wanted"}
)
#: Keys of files, parameters and fields of results, whose spelling others rely on; and of one file alone.
PUBLIC_NAMES = frozenset({"given_away", "kept_as_is", "made_from", "made_of", "wanted_s"})
PUBLIC_NAMES_OF = {"design/errors.py": {"asked"}, "design/reduction/gramians.py": {"kept"}}
NO_PHRASE = re.compile(
    r"\b(hardly meant|oddit\w*|whims|kinks?|bury|dismiss\w*|doubt\w*|alike|of one's own|comes along|is told"
    r"|are told|told in)\b",
    re.IGNORECASE,
)
#: A file that a comment or a page names.
NAMED_FILE = re.compile(
    r"(?<![\w/.-])((?:models|fmu_build|design|cosim|interarea|tests|benchmarks|docs|examples)/[\w/.-]*"
    r"\.(?:py|c|h|md|toml))\b"
)
#: A source file that a comment names by the end of its path.
NAMED_SOURCE = re.compile(r"(?<![\w/.*-])((?:[\w-]+/)*[a-z][\w-]{2,}\.(?:py|c|h))\b")
#: Sources that are generated, or of others.
NOT_TRACKED = frozenset({"devices.h", "mach-o/fat.h", "lag.h", "malloc.h"})


def _name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def _names_bound(tree: ast.AST) -> Iterator[tuple[int, str]]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.id if isinstance(node, ast.Name) else node.attr
        elif isinstance(node, ast.arg):
            yield node.lineno, node.arg
        elif isinstance(node, ast.ClassDef | ast.FunctionDef | ast.ExceptHandler):
            yield node.lineno, node.name or ""


def _is_private(name: str) -> bool:
    words = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower().split("_")
    return not name.startswith("test_") and not NO_NAME.isdisjoint(words)


def private_names(text: str, public: frozenset[str] = frozenset()) -> list[str]:
    """Return "line: name" of each name in a Python text that uses a word of `NO_NAME` and is not `public`."""
    if not any(map(_is_private, set(re.findall(r"\w+", text)) - public)):
        return []  # no such word anywhere, in two files of three: no need to parse it
    names = _names_bound(ast.parse(text))
    return [f"{line}: {name}" for line, name in names if name not in public and _is_private(name)]


def test_names_say_what_a_value_is() -> None:
    private = {
        _name(p): private_names(
            p.read_text(encoding="utf-8"), PUBLIC_NAMES.union(PUBLIC_NAMES_OF.get(_name(p), ()))
        )
        for p in PYTHON
    }
    assert not {name: names for name, names in private.items() if names}


def test_a_private_name_is_seen() -> None:
    seen = private_names("class ToldRows:\n    def f(self, way):\n        self.all_found = found = way\n")
    assert sorted(seen) == ["1: ToldRows", "2: way", "3: all_found", "3: found"]


def test_prose_uses_standard_terms() -> None:
    assert not [
        f"{_name(path)}:{n}: {line.strip()}"
        for path in PROSE
        for n, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if NO_PHRASE.search(line)
    ]


def test_files_that_are_named_exist() -> None:
    """A name is relative to the repository; NAME stands for any."""
    assert not [
        f"{_name(path)}: {name}"
        for path in PROSE
        for name in NAMED_FILE.findall(path.read_text(encoding="utf-8"))
        if "NAME" not in name and not (ROOT / name).is_file()
    ]


def _comments(path: Path) -> str:
    """Return the comments and docstrings of a source."""
    text = path.read_text(encoding="utf-8")
    if path.suffix != ".py":
        return "\n".join(re.findall(r"/\*.*?\*/|//[^\n]*", text, re.DOTALL))
    nodes = (ast.Module, ast.ClassDef, ast.FunctionDef)
    docstrings = [ast.get_docstring(n) or "" for n in ast.walk(ast.parse(text)) if isinstance(n, nodes)]
    return "\n".join([*docstrings, *re.findall(r"#.*", text)])


def test_sources_that_comments_name_exist() -> None:
    ends = {"/".join(p.parts[k:]) for p in TRACKED for k in range(len(p.parts))} | NOT_TRACKED
    assert not [
        f"{_name(path)}: {name}"
        for path in PROSE
        if path.suffix in {".py", ".c", ".h", ".js"}
        for name in NAMED_SOURCE.findall(_comments(path))
        if name not in ends and not name.startswith("fmi2")
    ]
