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
#: how many parts each chapter or section has: the thesis's table of contents
CONTENTS: dict[str, int] = {
    "1": 4,
    "2": 5,
    "2.1": 3,
    "3": 5,
    "4": 5,
    "4.2": 1,
    "4.3": 1,
    "5": 2,
    "5.1": 6,
    "5.2": 3,
    "5.2.2": 2,
    "5.2.3": 1,
    "6": 2,
}
SECTIONS = {*"123456", *(f"{above}.{k}" for above, n in CONTENTS.items() for k in range(1, n + 1))}
CITED = re.compile(
    r"Sundaria2016\]?,\s+(?P<kind>sections?|chapters?|tables?|figs?\.|fig\.|eqs?\.|)\s*"
    r"(?P<numbers>\d[\d.]*(?:(?:-|, | and )\d[\d.]*)*)",
    re.IGNORECASE,
)


def items(kind: str) -> list[str]:
    """Return the numbers of a kind that the page has, ranges such as 5.1-5.17 spelt out."""
    numbers = []
    for row in ROWS:
        match = re.fullmatch(rf"{kind} (\d)\.(\d+)(?:-(\d)\.(\d+))?", row[0])
        if match:
            chapter, first, _, last = match.groups()
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


def there(kind: str, number: str) -> bool:
    """Say whether the thesis has a section, chapter, table, figure or equation of that number."""
    of = {"t": "Table", "f": "Fig.", "e": "Eq."}.get(kind[:1].lower())
    return number in (SECTIONS if of is None else items(of))


def test_what_is_cited_of_the_thesis_is_in_it() -> None:
    """Sources of scenarios, cases, devices and code: no section 5.4, for one."""
    cited = []
    for folder in ("cosim", "design", "models", "fmu_build", "interarea", "docs", "examples", "benchmarks"):
        for path in (ROOT / folder).rglob("*"):
            if path.suffix in (".py", ".toml", ".md", ".c", ".h"):
                for match in CITED.finditer(path.read_text(encoding="utf-8")):
                    for number in re.split(r"-|, | and ", match["numbers"].rstrip(".")):
                        cited.append((path.name, match["kind"], number))
    assert len(cited) > 20 and {name for name, *_ in cited} >= {"lost-signal.toml", "two-area-thesis.toml"}
    assert [row for row in cited if not there(row[1], row[2])] == []


def test_where_a_statement_or_correction_stands_is_in_the_thesis() -> None:
    claims = tomllib.loads((THESIS / "published.toml").read_text(encoding="utf-8"))
    for row in claims["statement"]:
        sections, _, figures = row["where"].partition(", fig. ")
        assert set(sections.split(" and ")) <= SECTIONS, row["where"]
        assert not figures or all(there("fig.", k) for k in figures.split(" and ")), row["where"]
    for row in claims["correction"]:
        kind, _, numbers = row["where"].rpartition("table ")
        for number in numbers.split(", "):
            assert there("table" if kind or "table" in row["where"] else "eq.", number) or number in SECTIONS
