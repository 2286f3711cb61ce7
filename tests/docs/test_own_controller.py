"""The controller on the page about one's own: it runs as written and helps."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

PAGE = Path(__file__).resolve().parents[2] / "docs" / "own_controller.md"


@pytest.mark.slow
def test_the_example_runs_as_written() -> None:
    cell = re.search(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert cell is not None
    names: dict[str, Any] = {}
    exec(cell[1], names)
    assert names["run"].stable
    assert names["run"].damping_ratio("inter-area") == pytest.approx(0.16, abs=0.005)  # the page's number


def test_the_extra_that_the_page_names_is_there() -> None:
    extras = tomllib.loads((PAGE.parents[1] / "pyproject.toml").read_text(encoding="utf-8"))
    name = re.search(r"interarea\[(\w+)\]", PAGE.read_text(encoding="utf-8"))
    assert name is not None
    assert extras["project"]["optional-dependencies"][name[1]][0].startswith("slycot")
