"""A loop fed by PMUs: measured as the windows say, late as the ledger says, damped as the roots say."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from interarea.cosim.errors import ScenarioError
from interarea.cosim.explorer.subject import subject_of
from interarea.cosim.export.container import write_container
from interarea.cosim.results.run import Run
from interarea.cosim.run.run import run_scenario, system_of
from interarea.cosim.scenario.scenario import load_scenario
from interarea.cosim.sweep.front import run_sweep
from interarea.cosim.sweep.parts import read_rows
from interarea.design.controllers.controller import Controller
from interarea.models.blocks.pmu import pmu_filter
from interarea.models.case.case import load_case

CASE = "two-area-thesis"


def scenario(pmu: dict[str, Any], **keys: Any) -> dict[str, Any]:
    pulse = {"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 0.5, "end_s": 0.7}
    channels = {"remote": {"signal": "G2_dw", "latency_s": 0.1, "pmu": pmu}}
    return {"name": "pmu", "case": CASE, "stop_s": 6.0, "channels": channels, "event": [pulse], **keys}


@pytest.fixture(scope="module")
def run(hand_controller: Controller, cache: Path) -> Run:
    table = scenario({"bus": 2, "performance": "M"}, show=["bus2.angle", "branch[7-8 a].i"])
    return run_scenario(table, controller=hand_controller, cache=cache)


def test_the_frequency_is_that_of_the_window(run: Run) -> None:
    """From the recorded voltages by numpy: angles, weights, the difference around the middle."""
    filter_ = pmu_filter("M", 60.0, 60.0)
    t, volts = run["time_s"], run["plant.bus2.re"] + 1j * run["plant.bus2.im"]
    fine = np.arange(0.0, t[-1], filter_.sample_s / 4)
    angle = np.interp(fine, t, np.unwrap(np.angle(volts)))
    at = np.arange(1.0, 5.5, 0.05)
    k = filter_.sample_s * np.arange(-filter_.half, filter_.half + 1)

    def seen(middle: np.ndarray) -> np.ndarray:
        return np.array([np.interp(m + k, fine, angle) @ filter_.weights for m in middle])

    middle, h = at - filter_.delay_s, filter_.sample_s
    expected = (seen(middle + h) - seen(middle - h)) / (2 * h) / load_case(CASE).omega_b
    got = np.interp(at, t, run["remote_pmu.deviation"])
    np.testing.assert_allclose(got, expected, atol=2e-3 * np.abs(expected).max())
    np.testing.assert_allclose(run["remote_pmu.frequency"], 60.0 * (1.0 + run["remote_pmu.deviation"]))


def test_its_group_delay_is_in_the_ledger(run: Run, hand_controller: Controller, cache: Path) -> None:
    delay = pmu_filter("M", 60.0, 60.0).delay_s
    row = run.ledger["remote_pmu.re"]
    assert row.measuring_s == row.total_s == pytest.approx(delay) and "measuring" in str(run.ledger)
    assert run.ledger["remote.u"].total_s == pytest.approx(0.1)
    system = system_of(load_scenario(scenario({"bus": 2})), controller=hand_controller, cache=cache)
    assert system.self_test().passed


def test_damping_is_that_of_the_roots_with_the_window(hand_controller: Controller, cache: Path) -> None:
    """The mode that the loop acts on: simulated and fitted, and a root of the loop with H(s) of the PMU."""
    result = {}
    for performance in ("P", "M"):
        table = scenario({"bus": 2, "performance": performance}, stop_s=15.0)
        metrics = run_scenario(table, controller=hand_controller, cache=cache).metrics
        assert metrics.methods["damping_ratio"].startswith("roots of the linear loop")
        result[performance] = metrics.damping_ratio["inter-area"]
        assert metrics.ring_down["inter-area"] == pytest.approx(result[performance], abs=1e-3)
    assert abs(result["P"] - result["M"]) > 4e-3  # the window is not nothing


def test_shown_outputs_come_by_name(run: Run) -> None:
    assert {"plant.bus2.angle", "plant.branch[7-8 a].i", "plant.G1_dw"} <= set(run.data)
    angle, volts = run["plant.bus2.angle"], run["plant.bus2.re"] + 1j * run["plant.bus2.im"]
    assert np.ptp(angle) > 1e-3 and np.ptp(np.abs(volts)) > 1e-4


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"channels": {"remote": {"pmu": {"bus": 2}}}}, "pmu needs signal = the controller's input"),
        (
            {"channels": {"remote": {"signal": "G2_dw", "pmu": {"bus": 99}}}},
            r"remote: pmu\.bus = 99 does not",
        ),
        (
            {"channels": {"remote": {"signal": "G2_dw", "pmu": {"bus": 2, "class": "P"}}}},
            "class.*no such key",
        ),
        ({"show": ["bus99.v"]}, "nothing to show matches 'bus99.v'"),
        (
            {
                "channels": {
                    "remote": {"signal": "G2_dw", "pmu": {"bus": 2}},
                    "remote_pmu": {"signal": "G4_dw"},
                }
            },
            "remote_pmu: the name of the PMU before remote.u is taken",
        ),
    ],
)
def test_mistakes_are_refused(keys: dict[str, Any], says: str, cache: Path) -> None:
    with pytest.raises(Exception, match=says):
        system_of(load_scenario(scenario({"bus": 2}) | keys), cache=cache)


def test_an_m_class_needs_a_rate_that_the_standard_knows(hand_controller: Controller, cache: Path) -> None:
    table = scenario({"bus": 2, "performance": "M", "reporting_rate_hz": 50.0})
    with pytest.raises(
        ScenarioError, match=r"50 reports a second, allowed: 10, 12, .*; set reporting_rate_hz"
    ):
        system_of(load_scenario(table), controller=hand_controller, cache=cache)


def test_what_holds_no_pmu_says_so(hand_controller: Controller, cache: Path, tmp_path: Path) -> None:
    loaded = load_scenario(scenario({"bus": 2}))
    with pytest.raises(ScenarioError, match="pmu"):
        write_container(loaded, tmp_path / "loop.fmu", cache=cache, controller=hand_controller)
    with pytest.raises(ScenarioError, match="a page contains no PMU"):
        subject_of(loaded, cache=cache)


@pytest.mark.slow
def test_a_sweep_runs_with_pmus(hand_controller: Controller, cache: Path, tmp_path: Path) -> None:
    """Each point is its run alone: the plant of the sweep shows what the PMU measures."""
    hand_controller.save(tmp_path / "hand.json")
    table = scenario({"bus": 2}, stop_s=2.0, controller=str(tmp_path / "hand.json"))
    latencies = {"path": "channels.remote.latency_s", "values": [0.0, 0.1]}
    run_sweep({"scenario": table, "parameters": {"late": latencies}}, tmp_path / "s", workers=1, cache=cache)
    rows = read_rows(tmp_path / "s")
    for latency_s, peak in zip((0.0, 0.1), rows.peak_pu, strict=True):
        table["channels"]["remote"]["latency_s"] = latency_s
        assert run_scenario(table, cache=cache).metrics.peak_pu == peak
