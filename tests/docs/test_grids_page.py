"""The page of published grids prints what `interarea modes` finds."""

from __future__ import annotations

import importlib.util
import json
import re
import subprocess
from pathlib import Path

import pytest
from command_line import invoke

PAGE = Path(__file__).resolve().parents[2] / "docs" / "grids.md"


@pytest.mark.slow
@pytest.mark.parametrize(("grid", "modes"), [("wecc-240", 7), ("mini-wecc", 8)])
def test_the_modes_of_a_bundled_grid_are_those_of_the_page(
    grid: str, modes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = PAGE.read_text(encoding="utf-8").partition(f"## {grid}\n")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| (\S.* \d.*?) \| (\S+) \| (\S+) \| (\S+) \|$", text, re.MULTILINE)
    words = ["modes", grid, "--band", "0.1:0.9", "--below", "0.2", "--json"]
    code, out, _ = invoke(words, monkeypatch)
    document = json.loads(out)
    assert code == 0 and document["counted"] == len(rows) == len(document["modes"]) == modes
    for (name, hertz, ratio, machine), mode in zip(rows, document["modes"], strict=True):
        assert (name, hertz) == (mode["name"], f"{mode['frequency_hz']:.4f}")
        assert ratio == f"{mode['damping_ratio']:.4f}"
        assert machine == next(iter(mode["participation"])).partition(".")[0]
    assert f"{document['states']} states" in text


@pytest.mark.slow
def test_the_modes_of_the_fetched_grids_are_those_of_the_page(tmp_path: Path) -> None:
    spec = importlib.util.spec_from_file_location("fetched_grids", PAGE.parent / "site" / "fetched_grids.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    try:
        rows, least = module.tables(tmp_path)
    except subprocess.CalledProcessError as error:
        if b"pip does not" in error.stderr:
            pytest.skip("the wheel with the grids cannot be fetched")
        raise
    text = PAGE.read_text(encoding="utf-8")
    assert rows in text and least in text
    assert rows.count("\n") + 1 == 21
