"""The page and the record of one run: complete, by themselves, and what the pointer shows is what was run."""

from __future__ import annotations

import json
import re
import tomllib
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from interarea.cosim.results.run import Run
from interarea.cosim.results.run_page import run_page
from interarea.cosim.run.run import run_scenario
from interarea.cosim.scenario.channels import derived_seed
from interarea.design.controllers.controller import Controller

VOID = {"meta", "br", "path", "rect", "use", "link", "circle"}
DOCUMENT: dict[str, Any] = {
    "title": "Angles < & > in a title",
    "case": "two-area-thesis",
    "stop_s": 4.0,
    "channels": {
        "remote": {"signal": "G2_dw", "latency_s": 0.1, "reporting_interval_s": 0.02, "loss": 0.1},
    },
    "event": [{"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 1.0, "end_s": 9.0}],
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, hand_controller: Controller) -> Path:
    folder = tmp_path_factory.mktemp("mine")
    hand_controller.save(folder / "mine.json")
    return folder


@pytest.fixture(scope="module")
def run(folder: Path) -> Run:
    with pytest.warns(UserWarning, match="end_s = 9"):
        return run_scenario(DOCUMENT | {"controller": "mine.json", "folder": folder})


class Balanced(HTMLParser):
    """Every element that is opened is closed, in order; what is loaded from elsewhere."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.loaded: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.loaded += [v or "" for k, v in attrs if k in ("src", "href") and "://" in (v or "")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Nothing is left open by `<path/>`."""

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID:
            assert self.open.pop() == tag


@pytest.mark.slow
def test_the_page_is_whole_and_says_what_ran(run: Run) -> None:
    text = run_page(run, run.plot(), explorer="explorer.html")
    parser = Balanced()
    parser.feed(text)
    assert not parser.open and not parser.loaded
    assert "<title>Angles &lt; &amp; &gt; in a title</title>" in text
    assert 'class="warned">event 1 (vref_pulse): end_s = 9 lies after the run' in text
    assert 'href="explorer.html"' in text
    assert f"{run.metrics.least_damping_ratio:.3g}" in text
    assert f"remote {derived_seed(0, 'remote')}" in text
    assert re.search(r"<text[^>]*>time \(s\)</text>", text)  # text as text
    assert "prefers-color-scheme: dark" in text


@pytest.mark.slow
def test_the_pointer_shows_what_was_run(run: Run) -> None:
    """The curves kept with the figure, at the places of the axes that the SVG draws."""
    text = run_page(run, run.plot())
    stored = json.loads(re.search(r'<script type="application/json">(.*?)</script>', text)[1])  # type: ignore[index]
    swing, speeds, control = stored["axes"]
    assert [c["name"] for c in speeds["curves"]] == ["G1", "G2", "G3", "G4"]
    time = np.array(speeds["curves"][1]["x"])
    expected = 1e3 * np.interp(time, run.trajectory.time_s, run["plant.G2_dw"])
    assert np.allclose(speeds["curves"][1]["y"], expected, rtol=1e-3, atol=1e-9)
    assert swing["x"] == [0.0, 4.0] and swing["name"] == "time (s)"
    ground = re.findall(
        r'id="[^"]*patch_\d+">\s*<path d="M ([\d.]+) ([\d.]+) L ([\d.]+) ([\d.]+) L [\d.]+ ([\d.]+)', text
    )
    boxes = [(float(x0), float(y0), float(x1), float(y1)) for x0, y1, x1, _, y0 in ground]
    for axis in (swing, speeds, control):
        assert any(np.allclose(axis["at"], box, atol=0.2) for box in boxes), (axis["at"], boxes)


@pytest.mark.slow
def test_what_is_kept_runs_the_same_again(run: Run, tmp_path: Path) -> None:
    run.save(tmp_path / "out")
    record = json.loads((tmp_path / "out" / "run.json").read_text(encoding="utf-8"))
    assert record["seeds"] == {"remote": derived_seed(0, "remote")}
    assert record["case"]["hash"] == run.case.hash and set(record["files_sha256"]) == {"controller"}
    assert {"interarea", "python", "numpy", "machine"} <= set(record["versions"])
    assert set(record["commit"]) == {"interarea", "scenario"}
    file = tmp_path / "out" / "scenario.toml"
    table = tomllib.loads(file.read_text(encoding="utf-8"))
    assert (
        Path(table["controller"]).is_absolute()
        and table["channels"]["remote"]["seed"] == record["seeds"]["remote"]
    )
    with pytest.warns(UserWarning, match="end_s = 9"):
        again = run_scenario(file)
    assert np.array_equal(again["plant.G2_dw"], run["plant.G2_dw"])
    assert np.array_equal(again["remote.dropped"], run["remote.dropped"])
