"""What the documentation shows is what the program takes."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pandas as pd
import pytest

from interarea.cosim.sweep.plan import plan_sweep
from interarea.cosim.sweep.point import check_paths
from interarea.cosim.sweep.spec import METRICS, load_sweep, sweep_of
from interarea.models.case.case import Case

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "docs" / "sweeps.md").read_text(encoding="utf-8")


def test_the_sweep_of_the_documentation_is_one(two_area: Case) -> None:
    block = re.search(r"```toml\n(.*?)```", TEXT, re.DOTALL)
    assert block is not None
    sweep = sweep_of(tomllib.loads(block.group(1)), "sweeps.md", Path())
    check_paths(sweep, two_area, {"limit"})
    assert sweep.size == 5 * 2 * 200
    assert set(sweep.metrics) <= set(METRICS)


@pytest.mark.slow
def test_the_example_can_be_planned(cache: Path) -> None:
    plan = plan_sweep(load_sweep(ROOT / "examples" / "latency_loss.toml"), cache)
    assert plan.sweep.size == 13 * 4 * 3 * 2
    assert set(plan.controllers) == {"two-area-thesis/wdc", "two-area-thesis/ftc"}


def test_rows_open_in_pandas_and_duckdb_as_shown(finished: tuple[Path, pd.DataFrame]) -> None:
    folder, rows = finished
    opened = pd.read_parquet(folder / "runs").sort_values("run")
    assert list(opened.run) == list(rows.run)
    query = re.search(r'duckdb\.sql\("(.*?)"\)', TEXT)
    assert query is not None
    duckdb = pytest.importorskip("duckdb")
    shares = duckdb.sql(query.group(1).replace("out/latency_loss", str(folder))).fetchall()
    assert dict(shares) == pytest.approx(rows.groupby("loss").stable.mean().to_dict())
