"""A page of the explorer, and node that runs its scripts; skipped with the reason where there is none."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from interarea.cosim.explorer.page import write_explorer

DRIVER = Path(__file__).parent / "drive.js"


@pytest.fixture(scope="session")
def page(cache: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the page of the thesis' grid."""
    return write_explorer("two-area-thesis", tmp_path_factory.mktemp("explorer") / "page.html", cache=cache)


Node = Callable[[list[dict[str, Any]]], list[Any]]


@pytest.fixture(scope="session")
def node(page: Path, tmp_path_factory: pytest.TempPathFactory) -> Node:
    """Return a function that has node answer jobs (see drive.js) with the page's own scripts."""
    if shutil.which("node") is None:
        pytest.skip("node is not installed")
    folder = tmp_path_factory.mktemp("jobs")

    def answers(jobs: list[dict[str, Any]]) -> list[Any]:
        file = folder / "jobs.json"
        file.write_text(json.dumps(jobs), encoding="utf-8")
        done = subprocess.run(
            ["node", str(DRIVER), str(page), str(file)], capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return [json.loads(line) for line in done.stdout.splitlines()]

    return answers


@pytest.fixture(scope="session")
def data(node: Node) -> dict[str, Any]:
    """Return what the page knows."""
    known: dict[str, Any] = node([{"data": True}])[0]
    return known


@pytest.fixture(scope="session")
def runs_of_node(
    node: Node, data: dict[str, Any], tmp_path_factory: pytest.TempPathFactory
) -> list[tuple[dict[str, Any], list[str], bytes]]:
    """Return the state of each preset with the columns and rows that node gives, those of the FMU."""
    states = [preset["state"] for preset in data["presets"]]
    folder = tmp_path_factory.mktemp("runs")
    files = [folder / f"{k}.bin" for k in range(len(states))]
    reported = node([{"run": state, "file": str(file)} for state, file in zip(states, files, strict=True)])
    return [(s, t["columns"], f.read_bytes()) for s, t, f in zip(states, reported, files, strict=True)]
