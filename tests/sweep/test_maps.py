"""The page of a sweep: it draws what the rows say, its margins are the exact ones, it loads nothing."""

from __future__ import annotations

import html
import html.parser
import json
import math
import re
import shutil
import subprocess
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from interarea.cosim.explorer.address import address_of
from interarea.cosim.explorer.subject import subject_of
from interarea.cosim.maps.margins import certified_margin, margins_of
from interarea.cosim.maps.page import write_maps
from interarea.cosim.maps.page_data import is_grid, map_of, pairs_of, worst_runs
from interarea.cosim.scenario.scenario import load_scenario
from interarea.cosim.sweep.front import run_sweep
from interarea.cosim.sweep.parts import read_plan
from interarea.cosim.sweep.plan import plan_sweep
from interarea.cosim.sweep.point import point_of
from interarea.cosim.sweep.runner import Runner
from interarea.cosim.sweep.spec import load_sweep
from interarea.cosim.sweep.values import Search


def _rows() -> pd.DataFrame:
    grid = [(a, b, c) for a in (0.1, 0.2) for b in (0.0, 0.5) for c in (1, 2)]
    rows = pd.DataFrame(grid, columns=["latency", "loss", "seed"])
    rows["run"] = range(8)
    rows["status"] = "ok"
    rows["stable"] = [True, True, True, False, True, False, False, False]
    rows["peak_pu"] = [1.0, 1.0, 1.0, 5.0, 1.0, 7.0, 2.0, 3.0]
    rows["damping_least"] = [0.30, 0.20, 0.10, -0.1, 0.25, -0.2, np.nan, -0.3]
    return rows


def test_a_cell_pools_the_runs_with_its_two_values() -> None:
    result = map_of(_rows(), "latency", "loss")
    assert result.stable.tolist() == [[1.0, 0.5], [0.5, 0.0]]  # rows: loss, columns: latency
    assert result.damping[0].tolist() == [0.20, 0.25]  # the least among the stable runs
    assert result.damping[1, 0] == 0.10
    assert math.isnan(result.damping[1, 1])
    assert result.runs.tolist() == [[2.0, 2.0], [2.0, 2.0]]
    assert is_grid(_rows(), "latency", "loss")


def test_worst_are_unstable_runs_by_peak_then_the_least_damped() -> None:
    assert worst_runs(_rows(), 6) == [5, 3, 7, 6, 2, 1]


class _Loads(html.parser.HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.loaded: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for key, value in attrs:
            if tag == "a":  # loads nothing before it is clicked
                continue
            if key in ("src", "href", "xlink:href") and value and not value.startswith("#"):
                self.loaded.append(f"{tag} {key}={value[:60]}")


@pytest.mark.slow
def test_the_page_is_whole_and_loads_nothing(finished: Any, cache: Path, tmp_path: Path) -> None:
    page = write_maps(finished[0], tmp_path / "maps.html", cache=cache, worst=2)
    text = page.read_text(encoding="utf-8")
    reader = _Loads()
    reader.feed(text)
    assert [x for x in reader.loaded if not x.startswith("image xlink:href=data:")] == []
    assert "12 of 12 runs" in text
    for section in (
        "What was varied",
        "Maps",
        "Margins, certified and simulated",
        "Worst runs",
        "Distributions",
    ):
        assert f"<h2>{section}</h2>" in text
    assert len(re.findall("<svg", text)) >= 4
    assert sorted(p.name for p in tmp_path.iterdir()) == ["maps-explorer.html", "maps.html"]


@pytest.mark.slow
def test_a_click_on_a_cell_opens_its_run(finished: Any, cache: Path, tmp_path: Path) -> None:
    """What the explorer makes of a cell's address is the scenario of the run that the cell names."""
    if shutil.which("node") is None:
        pytest.skip("node is not installed")
    text = write_maps(finished[0], tmp_path / "maps.html", cache=cache, worst=0).read_text(encoding="utf-8")
    named = re.findall(r'<a href="maps-explorer\.html(#[^"]+)" aria-label="open run (\d+):', text)
    sweep, rows = read_plan(finished[0]).sweep, finished[1]
    assert len(named) == 2 * rows.groupby(["latency", "loss"]).ngroups  # share and damping
    addresses = {html.unescape(address): int(run) for address, run in named}
    opened = _by_node([{"link": a} for a in addresses], tmp_path)
    assert [x["why"] for x in opened] == [""] * len(addresses)
    saved = _by_node([{"toml": x["state"]} for x in opened], tmp_path)
    for run, words in zip(addresses.values(), saved, strict=True):
        there, expected = load_scenario(tomllib.loads(words)), point_of(sweep, sweep.values(run)).scenario
        assert (there.controller, there.stop_s, there.event) == (
            expected.controller,
            expected.stop_s,
            expected.event,
        )
        for name, channel in expected.channels.items():
            nothing = {"loss_good": 0.0}  # what a loss of rate 0 says, and no loss leaves out
            opened_as = nothing | there.channels[name].parameters(name)
            assert opened_as == nothing | channel.parameters(name), run


def _by_node(jobs: list[dict[str, Any]], folder: Path) -> list[Any]:
    file = folder / "jobs.json"
    file.write_text(json.dumps(jobs), encoding="utf-8")
    driver = Path(__file__).parents[1] / "explorer" / "drive.js"
    command = ["node", str(driver), str(folder / "maps-explorer.html"), str(file)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return [json.loads(line) for line in done.stdout.splitlines()]


def test_a_run_that_no_state_of_the_page_is_has_no_link(finished: Any, cache: Path) -> None:
    sweep = read_plan(finished[0]).sweep
    subject = subject_of(sweep.base, cache)
    run = point_of(sweep, sweep.values(0)).scenario
    address = address_of(subject, run)
    assert address is not None and address.startswith("#v=1")
    remote = run.channels["remote"]
    for change in (
        {"stop_s": run.stop_s + 1.0},
        {"controller": "mine.json"},
        {"operating_point": run.operating_point.model_copy(update={"tie_flow_mw": 12.5})},
        {"channels": {**run.channels, "remote": remote.model_copy(update={"latency_s": 2.0})}},
        {"channels": {**run.channels, "remote": remote.model_copy(update={"quantum": 1e-6})}},
        {"event": (*run.event, *run.event)},
    ):
        assert address_of(subject, run.model_copy(update=change)) is None, change


def test_pairs_begin_with_latency_and_loss(finished: Any, document: Any) -> None:
    assert pairs_of(load_sweep(document()), finished[1]) == [("latency", "loss")]


@pytest.mark.slow
def test_simulated_margins_agree_with_the_exact_ones_of_the_linear_loop(
    document: Any, cache: Path, tmp_path: Path
) -> None:
    # Continuous channels and a pulse so small that the plant is linear: nothing lies between the two.
    channels = {"remote": {"signal": "G2_dw"}, "local": {"signal": "G4_dw"}}
    pulse = {"kind": "vref_pulse", "machine": "G1", "size_pu": 1e-4, "start_s": 0.5, "end_s": 0.7}
    base = {"controller": "wdc", "stop_s": 40.0, "step_s": 0.01, "channels": channels, "event": [pulse]}
    latency = {"path": "channels.*.latency_s", "values": [0.0, 0.1]}
    plan = plan_sweep(load_sweep(document(base, parameters={"latency": latency})), cache)
    with Runner(plan, cache, tmp_path) as runner:
        exact = certified_margin(plan.sweep, runner, "latency", {}, 2.0)
        search = Search(low=0.0, high=1.0, tolerance=1e-3, scan=21)
        good, bad, _ = runner.edge({}, "latency", search)
    assert good is not None and bad is not None
    assert good == pytest.approx(exact, abs=4e-3)  # growth below 1/e in 40 s does not show
    assert 0.3 < exact < 0.6


@pytest.mark.slow
def test_margins_follow_case_and_controller(document: Any, cache: Path, tmp_path: Path) -> None:
    parameters = {
        "latency": {"path": "channels.*.latency_s", "values": [0.0, 0.1]},
        "tie": {"path": "case.tie_flow_mw", "values": [0.0, 100.0]},
        "controller": {"values": ["ftc", "wdc"]},
    }
    run_sweep(document({"stop_s": 8.0}, parameters=parameters), tmp_path / "s", workers=1, cache=cache)
    from interarea.cosim.sweep.parts import read_plan, read_rows

    plan, rows = read_plan(tmp_path / "s"), read_rows(tmp_path / "s")
    reported: list[float] = []
    with Runner(plan, cache, tmp_path) as runner:
        result = margins_of(plan, rows, runner, workers=2, progress=reported.append)
        search = Search(low=0.0, high=2.0, tolerance=1e-3, scan=21)
        alone = [runner.edge(m.values, "latency", search)[:2] for m in result]
    assert [(m.stable, m.unstable) for m in result] == alone  # the bits of one process
    assert reported[-1] == 1.0 and reported == sorted(reported)
    assert [(m.values["tie"], m.values["controller"]) for m in result] == [
        (0.0, "ftc"), (0.0, "wdc"), (100.0, "ftc"), (100.0, "wdc"),
    ]  # fmt: skip
    assert all(m.certified is not None and m.stable is not None for m in result)
    assert result[1].certified > result[0].certified  # type: ignore[operator]
