"""docs/thesis.md names every item of the thesis once, and what it names is there."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ROWS = [
    [cell.strip() for cell in line.strip("|\n ").split(" | ")]
    for line in (ROOT / "docs" / "thesis.md").read_text(encoding="utf-8").splitlines()
    if line.startswith("| ") and not line.startswith("| item")
]
THESIS = ROOT / "cosim" / "study" / "thesis"


def items(kind: str) -> list[str]:
    """Return the numbers of a kind that the page has, ranges such as 5.1-5.17 spelt out."""
    numbers = []
    for row in ROWS:
        found = re.fullmatch(rf"{kind} (\d)\.(\d+)(?:-(\d)\.(\d+))?", row[0])
        if found:
            chapter, first, _, last = found.groups()
            numbers += [f"{chapter}.{k}" for k in range(int(first), int(last or first) + 1)]
    return numbers


@pytest.mark.parametrize(
    ("kind", "last"),
    [
        ("Table", {5: 2}),
        ("Fig.", {2: 2, 3: 7, 4: 2, 5: 26}),
        ("Eq.", {2: 13, 3: 6, 4: 29, 5: 7}),
    ],
)
def test_no_table_figure_or_equation_is_missing_or_twice(kind: str, last: dict[int, int]) -> None:
    """How many there are is read from the thesis: its lists of figures and the numbers of its equations."""
    assert items(kind) == [f"{chapter}.{k}" for chapter, n in last.items() for k in range(1, n + 1)]


def test_every_statement_that_is_judged_stands_there() -> None:
    claims = tomllib.loads((THESIS / "published.toml").read_text(encoding="utf-8"))["statement"]
    listed = {row[0].strip("`"): row for row in ROWS if row[0].startswith("`")}
    assert list(listed) == [row["check"] for row in claims]
    for claim in claims:
        assert listed[claim["check"]][1] == f"{claim['where']}: {claim['says']}"
        assert listed[claim["check"]][-1] in ("agrees", "partly", "differs")


def test_every_figure_of_chapter_5_is_in_the_specification() -> None:
    study = tomllib.loads((THESIS / "study_thesis.toml").read_text(encoding="utf-8"))
    keys = {row["key"] for row in study["figure"]}
    assert {f"5.{k}" for k in range(1, 27) if k != 18} <= keys


def test_the_future_scope_is_complete() -> None:
    """Section 6.2: networked control, the non-linear model, another fault-tolerant design, an active one."""
    assert [row[0] for row in ROWS if row[0].startswith("Scope")] == [f"Scope {k}" for k in range(1, 5)]


def test_every_row_leads_to_a_file_that_is_there() -> None:
    assert all(len(row) == 5 and all(row) for row in ROWS)
    for row in ROWS:
        (path,) = re.findall(r"`([^`]+)`", row[2])
        assert (ROOT / path).exists(), row
