"""The first scenario of one's own, as the tutorial has it: delay, loss, own controller, plot in one cell."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

import interarea as ia

TUTORIAL = Path(__file__).resolve().parents[2] / "docs" / "tutorial" / "tutorial.md"


@pytest.mark.slow
def test_the_first_scenario_runs_as_written() -> None:
    text = TUTORIAL.read_text(encoding="utf-8")
    section = text[text.index("## A scenario of your own") :]
    cell = re.search(r"```\{code-cell\}\n(.*?)```", section, re.DOTALL)
    assert cell is not None and cell[1].count("\n") < 40
    names: dict[str, Any] = {}
    exec(cell[1], names)
    run = names["run"]
    row = run.ledger["remote.u"]
    assert (row.network_s, row.reporting_s) == (0.1, 0.01) and "derived from its name" in row.note
    assert 10 < run.packets["remote"]["dropped"] < 100  # of some 500, one in ten
    assert len(run.plot().axes) == 3  # swing, speeds, the controller's output
    assert float(abs(run["controller.G4_vs"]).max()) > 1e-3
    alone = ia.simulate(names["scenario"], controller="none")
    assert alone.damping_ratio() == pytest.approx(0.0806, abs=0.002)
    assert run.stable and run.damping_ratio() > 1.2 * alone.damping_ratio()
