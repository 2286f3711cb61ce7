"""The controller on the page about one's own: it runs as written and helps."""

from __future__ import annotations

import re
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
