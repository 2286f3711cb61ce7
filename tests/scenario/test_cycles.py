"""Times in periods of the case's frequency, and the share of lost packets as a number."""

from __future__ import annotations

from typing import Any

import pytest

from interarea.cosim.errors import ScenarioError
from interarea.cosim.scenario.scenario import load_scenario
from interarea.models.case.case import load_case

FAULT = {"kind": "bus_fault", "bus": 8, "start_s": "0.5 s"}


def scenario(**keys: Any) -> dict[str, Any]:
    return {"case": "two-area-thesis", "stop_s": 2.0, **keys}


@pytest.mark.parametrize(
    ("words", "after_s"),
    [("start + 8 cycles", 8 / 60), ("start + 100 ms", 0.1), ("start + 3 cycles + 0.05 s", 0.1)],
)
def test_an_event_lasts_cycles_from_its_start_on(words: str, after_s: float) -> None:
    event = load_scenario(scenario(event=[{**FAULT, "end_s": words}])).event[0]
    assert event.end_s == pytest.approx(0.5 + after_s, abs=1e-9)  # on a tick of the clock


def test_cycles_are_of_the_cases_frequency() -> None:
    timed = scenario(stop_s="60 cycles", channels={"r": {"signal": "G2_dw", "latency_s": "3 cycles"}})
    assert load_scenario(timed).stop_s == 1.0
    assert load_scenario(timed, frequency_hz=50.0).stop_s == 1.2
    assert load_scenario(timed, frequency_hz=50.0).channels["r"].latency_s == pytest.approx(0.06)


def test_outages_and_events_of_a_case_take_words_too() -> None:
    lost = scenario(channels={"r": {"signal": "G2_dw", "outages_s": [["6 cycles", "0.1 s + 6 cycles"]]}})
    assert load_scenario(lost).channels["r"].outages_s == ((0.1, 0.2),)
    changed = load_case("two-area-thesis").with_changes({"event": [{**FAULT, "end_s": "start + 6 cycles"}]})
    assert changed.events[0].end_s == pytest.approx(0.6)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"stop_s": "8 cyles"}, "stop_s = '8 cyles'"),
        ({"stop_s": "start"}, "stop_s = 'start'"),
        ({"stop_s": "1.0"}, "stop_s = '1.0'"),
        ({"event": [{**FAULT, "end_s": "8 cycles"}]}, "event 1"),  # before its start
        ({"case": "", "stop_s": "8 cycles"}, "name one"),
    ],
)
def test_words_that_are_no_time_are_refused(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(ScenarioError, match=said):
        load_scenario(scenario(**keys))


def test_a_loss_may_be_a_number() -> None:
    line = {"signal": "G2_dw", "reporting_interval_s": 0.02}
    scenarios = [
        load_scenario(scenario(channels={"r": {**line, "loss": loss}})).channels["r"]
        for loss in (0.1, {"kind": "bernoulli", "rate": 0.1})
    ]
    assert scenarios[0] == scenarios[1]
    for wrong in (1.5, True, "0.1"):
        with pytest.raises(ScenarioError, match="loss"):
            load_scenario(scenario(channels={"r": {**line, "loss": wrong}}))
