"""A concentrator in a system: the wide-area loop on aligned signals, its ledgers, its self-test."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from interarea.cosim.errors import ScenarioError
from interarea.cosim.export.container import write_container
from interarea.cosim.export.ssp import write_ssp
from interarea.cosim.run.artefacts import channel_fmu
from interarea.cosim.run.run import run_scenario, run_system
from interarea.cosim.run.system import System
from interarea.cosim.scenario.scenario import load_scenario
from interarea.cosim.stepping_words import INPUTS
from interarea.cosim.sweep.front import run_sweep
from interarea.cosim.sweep.parts import read_rows
from interarea.design.controllers.controller import Controller

SIGNALS = [{"latency_s": 0.03}, {"latency_s": 0.08}]
PULSE = {"machine": "G1", "size_pu": 0.02, "start_s": 0.5, "end_s": 0.7}


def grid(controller: Controller, paths: list[dict[str, Any]], **keys: Any) -> System:
    system = System(stop_s=2.0, inputs=keys.pop("inputs", "hermite"), step_s=0.01)
    system.plant("two-area-thesis").controller(controller).concentrator("pdc", paths, **keys)
    for i, signal in enumerate(("G2_dw", "G4_dw"), start=1):
        system.connect(f"plant.{signal}", f"pdc.u{i}").connect(f"pdc.y{i}", f"controller.{signal}")
    return system.connect("controller.G4_vs", "plant.G4_vs").event("vref_pulse", **PULSE)


def test_signals_arrive_aligned_as_late_as_the_slowest(hand_controller: Controller) -> None:
    """80 and 20 ms make 100: y at 20 ms stamps is the plant's signal of 100 ms ago, for both."""
    run = grid(hand_controller, SIGNALS, latency_s=0.02).run()
    t = run["time_s"]
    stamps = np.flatnonzero(np.isclose(t * 50, np.round(t * 50), atol=1e-9) & (t > 0.2))
    at = np.searchsorted(t, t[stamps] - 0.1 - 1e-9)
    for i, signal in ((1, "G2_dw"), (2, "G4_dw")):
        sent = run[f"plant.{signal}"]
        np.testing.assert_allclose(run[f"pdc.y{i}"][stamps], sent[at], atol=1e-12 * np.max(np.abs(sent)))
    row = run.ledger["pdc.u1"]
    assert (row.network_s, row.reporting_s, row.jitter_mean_s) == (pytest.approx(0.1), 0.01, 0.0)
    counts = run.packets["pdc"]
    assert counts["sent"] == 2 * 101 and counts["late"] == counts["dropped"] == 0


@pytest.mark.parametrize("inputs", INPUTS)
def test_its_latency_is_the_stated_one(hand_controller: Controller, inputs: str) -> None:
    for keys in ({}, {"wait_s": 0.05}, {"relative": True, "wait_s": 0.02, "latency_s": 0.005}):
        test = grid(hand_controller, SIGNALS, inputs=inputs, **keys).self_test()
        late = [row for row in test.rows if not row.agrees]
        # behind the wait the slower signal never is in a set: nothing of it comes out
        assert all(str(r.connection.target) in ("pdc.u2", "controller.G4_dw") for r in late), str(test)
        assert bool(late) == bool(keys)


def test_a_lost_signal_is_missing_while_the_other_goes_on(hand_controller: Controller) -> None:
    paths = [{"latency_s": 0.03, "lost_s": (1.0, 1.5)}, {"latency_s": 0.05}]
    run = grid(hand_controller, paths, wait_s=0.1).run()
    t, first, second = run["time_s"], run["pdc.valid1"], run["pdc.valid2"]
    assert second.all()
    # complete sets come after 50 ms; the first without the signal waits 100 ms and holds up what follows
    np.testing.assert_array_equal(~first[t <= 1.99], ((t >= 1.1 - 1e-9) & (t < 1.58 - 1e-9))[t <= 1.99])
    # what came last, for half a second: the outage takes 480 ms of sets
    assert np.all(run["pdc.y1"][~first] == run["pdc.y1"][np.flatnonzero(~first)[0] - 1])
    assert run.packets["pdc"]["dropped"] == 25


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"wait": 0.1}, r"concentrators\.pdc\.wait = 0\.1: no such key; did you mean 'wait_s'"),
        ({"on_loss": "keep"}, "allowed: 'zero', 'hold' or 'hold_then_zero'"),
        ({"reporting_interval_s": 0.0}, "reporting_interval_s"),
    ],
)
def test_mistakes_are_refused(keys: dict[str, Any], says: str) -> None:
    with pytest.raises(ScenarioError, match=says):
        System(stop_s=1.0).concentrator("pdc", SIGNALS, **keys)
    with pytest.raises(ScenarioError, match="did you mean 'latency_s'"):
        System(stop_s=1.0).concentrator("pdc", [{"latency": 0.1}])


SCENARIO = """
case = "two-area-thesis"
controller = "{controller}"
stop_s = 2.0
step_s = 0.01
[concentrators.pdc]
wait_s = 0.1
latency_s = 0.02
[[concentrators.pdc.signals]]
signal = "G2_dw"
latency_s = 0.03
[[concentrators.pdc.signals]]
signal = "G4_dw"
latency_s = 0.08
[[event]]
kind = "vref_pulse"
machine = "G1"
size_pu = 0.02
start_s = 0.5
end_s = 0.7
"""


@pytest.fixture
def file(hand_controller: Controller, tmp_path: Path) -> Path:
    saved = hand_controller.save(tmp_path / "by_hand.json")
    path = tmp_path / "aligned.toml"
    path.write_text(SCENARIO.format(controller=saved), encoding="utf-8")
    return path


def test_a_scenario_file_names_it(hand_controller: Controller, file: Path, cache: Path) -> None:
    result = run_scenario(file, cache=cache)
    there = grid(hand_controller, SIGNALS, wait_s=0.1, latency_s=0.02).run()
    for column in ("plant.G2_dw", "controller.G4_vs", "pdc.y1", "pdc.y2", "pdc.age"):
        np.testing.assert_array_equal(result[column], there[column])
    text = result.explain()
    assert "plant.G2_dw -> pdc.u1" in text and "pdc.y2 -> controller.G4_dw" in text
    assert result.ledger["pdc.u1"].total_s == pytest.approx(0.11)
    assert result.packets["pdc"]["sent"] == 2 * 101
    assert result.packets["pdc"] == there.packets["pdc"]


@pytest.mark.slow
def test_a_sweep_varies_what_is_around_it(file: Path, cache: Path, tmp_path: Path) -> None:
    size = {"path": "event.1.size_pu", "values": [0.02, 0.03]}
    run_sweep({"scenario": str(file), "parameters": {"size": size}}, tmp_path / "s", workers=1, cache=cache)
    rows = read_rows(tmp_path / "s")
    single = run_scenario(file, cache=cache)
    assert rows.peak_pu[0] == single.metrics.peak_pu and rows.peak_pu[1] > 1.4 * rows.peak_pu[0]
    assert list(rows.packets_sent) == [202, 202]


def test_it_goes_into_an_ssp_and_not_into_one_fmu(file: Path, cache: Path, tmp_path: Path) -> None:
    scenario = load_scenario(file)
    ssp = write_ssp(scenario, tmp_path / "loop.ssp", cache=cache)
    with zipfile.ZipFile(ssp) as archive:
        assert "resources/pdc.fmu" in archive.namelist()
        structure = archive.read("SystemStructure.ssd").decode()
    assert 'startElement="plant" startConnector="G2_dw" endElement="pdc" endConnector="u1"' in structure
    with pytest.raises(ScenarioError, match="member pdc is a concentrator"):
        write_container(scenario, tmp_path / "loop.fmu", cache=cache)


def test_a_scenario_without_a_case_connects_its_ends(cache: Path) -> None:
    table: dict[str, Any] = {
        "stop_s": 1.0,
        "fmus": {"one": {"file": str(channel_fmu(cache)), "start": {"latency": 0.1}}},
        "concentrators": {"pdc": {"wait_s": 0.05, "signals": [{"latency_s": 0.02}]}},
        "connections": [["one.y", "pdc.u1"]],
    }
    run = run_system(table, cache=cache)
    assert run.packets["pdc"]["sent"] == 51
    assert run.ledger["pdc.u1"].network_s == pytest.approx(0.02)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"wait": 0.1}, r"concentrators\.pdc\.wait = 0\.1: no such key; did you mean 'wait_s'"),
        ({"signals": [{"signl": "G2_dw"}]}, r"no such key; did you mean 'signal'"),
        ({"signals": [{"latency_s": 0.1}]}, r"pdc\.signals 1: signal is missing \(or name pdc\.u1"),
        (
            {"signals": [{"signal": "G2_dw"}, {"signal": "G2_dw"}]},
            "is already sent through concentrators.pdc",
        ),
        ({"signals": []}, "signals = .*at least 1"),
        (
            {"signals": [{"signal": "G9_dw"}]},
            r"concentrators\.pdc: signal = 'G9_dw' is not an output of the plant",
        ),
    ],
)
def test_a_mistake_in_its_table_is_one_line(cache: Path, change: dict[str, Any], says: str) -> None:
    table = {"wait_s": 0.1, "signals": [{"signal": "G2_dw"}], **change}
    document = {"case": "two-area-thesis", "stop_s": 1.0, "concentrators": {"pdc": table}}
    with pytest.raises(ScenarioError, match=says) as caught:
        run_scenario(document, cache=cache)
    assert "\n" not in str(caught.value)


def test_a_signal_travels_one_way_and_a_name_is_used_once() -> None:
    pdc = {"signals": [{"signal": "G2_dw"}]}
    document = {"case": "two-area-thesis", "stop_s": 1.0, "concentrators": {"pdc": pdc}}
    with pytest.raises(ScenarioError, match=r"is already sent through channels\.remote"):
        load_scenario(document | {"channels": {"remote": {"signal": "G2_dw"}}})
    with pytest.raises(ScenarioError, match=r"concentrators\.pdc: its name must be .* used once"):
        load_scenario(document | {"channels": {"pdc": {"signal": "G4_dw"}}})
