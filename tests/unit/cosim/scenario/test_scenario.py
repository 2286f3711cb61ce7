"""Scenario files: the documented form loads, every mistake is one line with key, value and allowed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from interarea.cosim.errors import ScenarioError
from interarea.cosim.scenario.scenario import load_scenario

FILE = """
case = "two-area-thesis"
controller = "ftc"
stop_s = 20.0
step_s = 0.01
[channels.remote]
signal = "G2_dw"
latency_s = 0.1
on_loss = "zero"
outages_s = [[10.0, 20.0]]
[channels.local]
signal = "G4_dw"
[[event]]
kind = "bus_fault"
bus = 8
start_s = 1.0
end_s = 1.1333333
x_pu = 1e-4
[[event]]
kind = "branch_trip"
branch = "8-9 a"
start_s = 1.1333333
[[event]]
kind = "vref_pulse"
machine = "G1"
size_pu = 0.05
start_s = 1.0
end_s = 1.2
"""
GOOD: dict[str, Any] = {
    "case": "two-area-thesis",
    "controller": "ftc",
    "stop_s": 20.0,
    "channels": {"remote": {"signal": "G2_dw", "latency_s": 0.1}},
    "event": [{"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 1.0, "end_s": 1.2}],
}


def test_the_documented_file_loads(tmp_path: Path) -> None:
    path = tmp_path / "lost.toml"
    path.write_text(FILE, encoding="utf-8")
    scenario = load_scenario(path)
    assert scenario.name == "lost"
    assert scenario.event_times_s == (1.0, 1.1333333, 1.2, 10.0)
    assert scenario.channels["local"].latency_s == 0.0
    assert [e.kind for e in scenario.event] == ["bus_fault", "branch_trip", "vref_pulse"]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"stopp_s": 3}, r"stopp_s = 3: no such key; did you mean 'stop_s'"),
        ({"stop_s": -1.0}, r"stop_s = -1.0, allowed: greater than 0"),
        ({"step_s": 30.0}, r"step_s = 30, allowed: at most stop_s"),
        ({"step_s": 1e-12}, r"shorter than a tick"),
        ({"channels": {"a": {"signal": "G2_dw", "latency_s": -1.0}}}, r"channels.a.latency_s = -1"),
        ({"channels": {"a": {"signal": "G2_dw", "latncy_s": 1.0}}}, r"did you mean 'latency_s'"),
        (
            {"channels": {"a": {"signal": "G2_dw", "on_loss": "keep"}}},
            r"allowed: 'zero', 'hold' or 'hold_then_zero'",
        ),
        ({"channels": {"a": {"signal": "G2_dw", "outages_s": [[3.0, 2.0]]}}}, r"allowed: end > start"),
        ({"channels": {"a": {"signal": "G2_dw", "outages_s": [[30.0, 40.0]]}}}, r"outside the run"),
        ({"channels": {"plant": {"signal": "G2_dw"}}}, r"an identifier other than plant"),
        ({"channels": {"a": {"signal": "G2_dw"}, "b": {"signal": "G2_dw"}}}, r"one channel for each signal"),
        ({"event": [{"kind": "busfault"}]}, r"did you mean bus_fault"),
        ({"event": [{**GOOD["event"][0], "end_s": 1.0000000003}]}, r"on one tick of the clock"),
        ({"event": [{**GOOD["event"][0], "start_s": 25.0, "end_s": 26.0}]}, r"outside the run"),
        ({"event": 3}, r"allowed: \[\[event\]\] tables"),
        ({"master": {"inputs": "cubic"}}, r"master.inputs = 'cubic', allowed"),
    ],
)
def test_a_mistake_is_one_line(change: dict[str, Any], says: str) -> None:
    with pytest.raises(ScenarioError, match=says) as caught:
        load_scenario({**GOOD, **change})
    assert "\n" not in str(caught.value)


def test_missing_keys_files_and_names() -> None:
    with pytest.raises(ScenarioError, match="case is missing"):
        load_scenario({"stop_s": 1.0})
    with pytest.raises(ScenarioError, match="no such scenario file"):
        load_scenario("nowhere.toml")
    with pytest.raises(ScenarioError, match="did you mean 'ring-down'"):
        load_scenario("ringdown")


def test_what_is_no_toml_names_the_place(tmp_path: Path) -> None:
    path = tmp_path / "bad.toml"
    path.write_text("case = x", encoding="utf-8")
    with pytest.raises(ScenarioError, match=r"bad\.toml: not valid TOML.*line 1"):
        load_scenario(path)


def test_file_names_start_at_the_scenario(tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    path.write_text('case = "mine.toml"\ncontroller = "k.json"\nstop_s = 1.0', encoding="utf-8")
    scenario = load_scenario(path)
    assert scenario.controller_path == tmp_path / "k.json"
    assert scenario.case_path == tmp_path / "mine.toml"
