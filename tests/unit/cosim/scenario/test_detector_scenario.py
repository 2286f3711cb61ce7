"""A detector in a scenario: whom it tells, what it changes, what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from interarea.cosim.errors import ScenarioError, ScenarioWarning
from interarea.cosim.run.run import system_of
from interarea.cosim.scenario.scenario import load_scenario
from interarea.design.controllers.detector_record import DetectorDesign
from interarea.models.blocks.detector import REASONS, Patterns, detector_block
from interarea.simulation import simulate

WRONG_S = 1.5
CHANNELS = {
    "remote": ("G2_dw", 0.1),
    "local": ("G4_dw", 0.0),
    "third": ("G1_dw", 0.1),
    "last": ("G3_dw", 0.1),
}


def scenario(
    controller: str = "robust",
    wrong: dict[str, Any] | None = None,
    detector: bool = True,
    stop_s: float = 4.0,
) -> dict[str, Any]:
    """A fault of 8 cycles at bus 8; the local signal is wrong from 1.5 s on."""
    channels: dict[str, Any] = {}
    for name, (signal, latency_s) in CHANNELS.items():
        if detector or name in ("remote", "local"):
            channels[name] = {"signal": signal, "latency_s": latency_s, "reporting_interval_s": 0.02}
    if wrong is not None:
        channels["local"]["signal_faults"] = [{**wrong, "start_s": WRONG_S}]
    table: dict[str, Any] = {
        "case": "two-area-thesis",
        "controller": controller,
        "stop_s": stop_s,
        "channels": channels,
        "event": [{"kind": "bus_fault", "bus": 8, "start_s": 1.0, "end_s": "start + 8 cycles"}],
    }
    return {**table, "detector": {}} if detector else table


@pytest.mark.parametrize("controller", ["robust", "active"])
def test_a_fault_of_the_grid_is_no_wrong_signal_and_changes_no_bit(controller: str) -> None:
    watched = simulate(scenario(controller))
    alone = simulate(scenario(controller, detector=False))
    assert watched.data["detector.isolations"].max() == 0
    np.testing.assert_array_equal(watched.data["plant.G4_dw"], alone.data["plant.G4_dw"])


def test_a_table_without_keys_and_an_fmu_without_parameters_have_the_same_limits() -> None:
    read = load_scenario(scenario())
    assert read.detector is not None
    block = detector_block([path.signal for path in read.signals])
    of_table = read.detector.parameters(read.signals)
    assert len(of_table) == 9 + 4 * len(CHANNELS)
    assert {name: block.table[name].start for name in of_table} == of_table


def test_polarity_in_a_swing_is_named_at_its_first_frame_and_taken_away() -> None:
    run = simulate(scenario(wrong={"kind": "polarity"}))
    reason = run.data["detector.G4_dw_reason"]
    first = reason[reason != 0].index[0]
    assert REASONS[int(reason[first])] == "jump"
    # the frame arrives at 1.5 s, the detector answers at the end of that step
    assert run.data.loc[first, "time_s"] == pytest.approx(WRONG_S + 0.01, abs=0.0051)
    assert all(run.data[f"detector.{s}_reason"].max() == 0 for s in ("G1_dw", "G2_dw", "G3_dw"))


def test_a_bank_switches_to_what_needs_no_wrong_signal() -> None:
    run = simulate(scenario("active", {"kind": "stuck"}))
    member = run.data["controller.active"]
    result = run.data["time_s"][run.data["detector.G4_dw_reason"] != 0].iloc[0]
    assert result == pytest.approx(WRONG_S + 10 * 0.02, abs=0.031)
    assert member.iloc[0] == 1
    assert member[run.data["time_s"] > result + 0.05].min() > 1


@pytest.mark.slow
def test_a_polarity_that_makes_the_loop_swing_no_longer_does() -> None:
    wrong = {"kind": "polarity"}
    without, with_it = (simulate(scenario("ftc", wrong, d, 12.0)) for d in (False, True))
    assert without.metrics.verdict is not None and with_it.metrics.verdict is not None
    assert not without.metrics.verdict.stable
    assert with_it.metrics.verdict.stable


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"channels": {"a": {"signal": "G2_dw"}}}, "detector: G2_dw is sent without packets, allowed: set"),
        (
            {
                "channels": {
                    "a": {"signal": "G2_dw", "reporting_interval_s": 0.02},
                    "b": {"signal": "G4_dw", "reporting_interval_s": 0.04},
                }
            },
            "packets come every 0.02 s and 0.04 s, allowed: one reporting interval",
        ),
        ({"channels": {}}, "detector: no signal has a channel"),
        (
            {"detector": {"average_s": 6.0}},
            "average_s = 6 with packets every 0.02 s, allowed: 1 to 256",
        ),
        (
            {"channels": {"detector": {"signal": "G2_dw", "reporting_interval_s": 0.02}}},
            "the name of its instance, 'detector', is taken",
        ),
        (
            {
                "channels": {
                    "a": {
                        "signal": "v",
                        "reporting_interval_s": 0.02,
                        "pmu": {"bus": 7, "quantity": "v"},
                    }
                }
            },
            "detector: v is not a frequency, allowed: speeds",
        ),
        ({"detector": {"repeat_frames": 0}}, "repeat_frames = 0"),
    ],
)
def test_refused(change: dict[str, Any], says: str) -> None:
    with pytest.raises(ScenarioError, match=says):
        load_scenario({**scenario(), **change})


def test_a_witness_that_the_plant_does_not_have_is_refused() -> None:
    table = scenario()
    table["channels"]["third"]["signal"] = "G9_dw"
    with pytest.raises(ScenarioError, match="'G9_dw' is not an output of the plant"):
        system_of(load_scenario(table))


def test_two_signals_are_a_warning() -> None:
    table = scenario()
    del table["channels"]["third"], table["channels"]["last"]
    with pytest.warns(ScenarioWarning, match="cannot identify the wrong one of two"):
        assert "detector" in system_of(load_scenario(table)).warned().parts


@pytest.mark.parametrize(
    ("of", "says"),
    [
        (
            {"signals": ("G2_dw", "G4_dw", "G1_dw")},
            "was designed for G2_dw, G4_dw, G1_dw, here the signals are",
        ),
        ({"interval_s": 0.04}, "was designed for packets every 0.04 s, here the interval is 0.02 s"),
        ({"case": "new-england"}, "was designed for the case 'new-england', here it is 'two-area-thesis'"),
    ],
)
def test_a_detector_of_something_else_is_refused(of: dict[str, Any], says: str, tmp_path: Path) -> None:
    signals = tuple(signal for signal, _ in CHANNELS.values())
    keys = {"case": "two-area-thesis", "signals": signals, "interval_s": 0.02, **of}
    basis = np.eye(12 * len(keys["signals"]))[:, :6].reshape(len(keys["signals"]), 12, 6)
    design = DetectorDesign(
        keys["case"],
        "robust",
        keys["signals"],
        keys["interval_s"],
        1e-5,
        Patterns(basis, 4, 3.0, 1.5, 1e-4, 4.0),
        2.0,
        1,
        1,
    )
    design.save(tmp_path / "detector.json")
    table = {**scenario(), "detector": {"file": str(tmp_path / "detector.json")}}
    with pytest.raises(ScenarioError, match=says):
        system_of(load_scenario(table))
