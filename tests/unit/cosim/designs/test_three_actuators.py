"""An exciter, a dc link and an SVC damp a swing, `three_actuators.toml`; any one, any signal may be lost."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from interarea.cosim.designs.design_file import judge, load_design
from interarea.cosim.run.run import run_scenario
from interarea.design.controllers.controller import Controller

FOLDER = Path(__file__).parent
TABLE = load_design(FOLDER / "three_actuators.toml")
LOOPS = {part.actuator: part.signals for part in TABLE.part}


def test_every_signal_and_every_actuator_is_lost_in_some_condition() -> None:
    signals = [signal for sees in LOOPS.values() for signal in sees]
    assert len(signals) == len(set(signals))  # else a signal lost would not be an actuator lost
    lost = {frozenset(condition.lost) for condition in TABLE.family()}
    assert {frozenset({signal}) for signal in signals} | {frozenset(s) for s in LOOPS.values()} <= lost


@pytest.mark.slow
def test_the_damping_that_is_left_with_any_signal_or_actuator_lost(cache: Path) -> None:
    system = Controller.load(FOLDER / "three_actuators.json").system
    judged = judge(TABLE, system, cache)
    assert all(row.stable for row in judged.rows)
    assert len(judged.rows) == 3 * 16
    assert judged.inter_area == pytest.approx(0.1843, abs=5e-4)


#: actuator lost -> (its device trips, settling time without control, with it, s)
SETTLING: dict[str, tuple[str | None, float, float]] = {
    "": (None, 10.8, 3.7),
    "G4_vs": (None, 10.8, 6.1),
    "hvdc1_p_mod": ("hvdc1", 6.5, 3.0),
    "svc1_v_mod": ("svc1", 10.6, 4.2),
}


@pytest.mark.slow
@pytest.mark.parametrize("lost", SETTLING)
def test_a_fault_settles_sooner_whichever_actuator_is_lost_in_the_swing(lost: str) -> None:
    device, *settling = SETTLING[lost]
    times = []
    for controller in ("none", str(FOLDER / "three_actuators.json")):
        result = run_scenario(_scenario(controller, device, LOOPS.get(lost, ())))
        assert result.stable
        times.append(result.metrics.settling_time_s)
    assert times == pytest.approx(settling, abs=0.06)


def _scenario(controller: str, device: str | None, lost: tuple[str, ...]) -> dict[str, Any]:
    """Return a fault beside the loads of the receiving area; what is lost goes half a second later."""
    events = [{"kind": "bus_fault", "bus": 8, "start_s": 1.0, "end_s": 1.1, "x_pu": 1e-4}]
    if device is not None:
        events.append({"kind": "device_trip", "device": device, "start_s": 1.5})
    scenario = {"case": TABLE.case, "controller": controller, "stop_s": 30.0, "event": events}
    if controller != "none":
        scenario["channels"] = {
            f"c_{signal}": {
                "signal": signal,
                "latency_s": 0.1,
                "on_loss": "zero",
                "outages_s": [[1.5, 30.0]] if signal in lost else [],
            }
            for signals in LOOPS.values()
            for signal in signals
        }
    return scenario
