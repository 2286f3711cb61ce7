"""What can be run as written but is probably unintended is reported; what can only be wrong is refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import control
import numpy as np
import pytest

from interarea.cosim.errors import ScenarioError, ScenarioWarning
from interarea.cosim.run.run import run_scenario, system_of
from interarea.cosim.run.scenario_warnings import outputs_used
from interarea.cosim.scenario.channels import derived_seed
from interarea.cosim.scenario.scenario import load_scenario
from interarea.design.controllers.controller import Controller

PULSE = {"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 1.0, "end_s": 1.2}
PACKETS = {"reporting_interval_s": 0.02, "loss": 0.2, "on_loss": "hold"}


def document(**changes: Any) -> dict[str, Any]:
    return {"case": "two-area-thesis", "controller": "robust", "stop_s": 3.0, "event": [PULSE]} | changes


def warned(controller: Controller | None = None, **changes: Any) -> list[str]:
    return system_of(load_scenario(document(**changes)), controller=controller).warnings


def test_nothing_odd_nothing_said() -> None:
    assert warned(channels={"remote": {"signal": "G2_dw", "latency_s": 0.1}}) == []


def test_a_latency_not_below_the_time_left() -> None:
    late = {"remote": {"signal": "G2_dw", "latency_s": 2.0}}
    (line,) = warned(channels=late)
    assert line.startswith(
        "remote: a latency of 2 s is not below the 2 s left after the first event (at 1 s)"
    )
    assert warned(channels={"remote": {"signal": "G2_dw", "latency_s": 1.999}}) == []
    with pytest.raises(
        ScenarioError, match=r"channels.remote: a latency of 100 s with stop_s = 3: no packet"
    ):
        warned(channels={"remote": {"signal": "G2_dw", "latency_s": 100.0}})  # milliseconds were meant


def test_an_event_that_ends_after_the_run() -> None:
    (line,) = warned(event=[PULSE, PULSE | {"end_s": 12.0}])
    assert line.startswith("event 2 (vref_pulse): end_s = 12 lies after the run (stop_s = 3)")


def test_a_controller_made_for_another_case() -> None:
    pulse = PULSE | {"kind": "pm_pulse"}
    (line,) = warned(case="kundur-thyristor-z", event=[pulse])
    assert "robust: designed for the case 'two-area-thesis', runs with 'kundur-thyristor-z'" in line


def test_an_output_connected_to_nothing(hand_controller: Controller) -> None:
    driving, lines = outputs_used("mine", ["G4_vs", "alarm"], ["G2_vs", "G4_vs"], [])
    assert driving == ["G4_vs"]
    assert lines == ["controller mine: output 'alarm' is not connected; there are: G2_vs, G4_vs"]
    assert outputs_used("mine", ["G4_vs", "alarm"], ["G4_vs"], [("controller.alarm", "mine.u")])[1] == []
    K = hand_controller.system
    D = np.zeros((2, 2))
    two = control.ss(
        K.A, K.B, np.vstack([K.C, K.C]), D, inputs=["G2_dw", "G4_dw"], outputs=["G4_vs", "G9_vs"]
    )
    (line,) = warned(replace(hand_controller, system=two))
    assert "output 'G9_vs' is not connected; did you mean" in line
    none = control.ss(K.A, K.B, K.C, K.D, inputs=["G2_dw", "G4_dw"], outputs=["G9_vs"])
    with pytest.raises(ScenarioError, match=r"none of its outputs .* 'G9_vs': did you mean"):
        warned(replace(hand_controller, system=none))


@pytest.mark.slow
def test_a_run_warns_and_keeps_the_lines(hand_controller: Controller, tmp_path: Any) -> None:
    odd = document(event=[PULSE | {"end_s": 12.0}])
    with pytest.warns(ScenarioWarning, match="end_s = 12 lies after the run"):
        run = run_scenario(odd, controller=hand_controller)
    assert len(run.warnings) == 1 and run.explain().endswith(run.warnings[0])
    run.save(tmp_path)
    assert '"warnings": [\n  "event 1' in (tmp_path / "ledger.json").read_text(encoding="utf-8")


def test_no_two_channels_lose_the_same_packets(hand_controller: Controller) -> None:
    """Without a seed each channel draws from one made of its name, which the ledger says."""
    paths = {n: {"signal": s, **PACKETS} for n, s in (("remote", "G2_dw"), ("local", "G4_dw"))}
    run = run_scenario(document(channels=paths), controller=hand_controller)
    lost = [run[f"{name}.dropped"] for name in paths]
    assert lost[0][-1] > 5 < lost[1][-1] and not np.array_equal(lost[0], lost[1])
    seed = derived_seed(0, "remote")
    assert run.ledger["remote.u"].note.endswith(f"seed {seed}, derived from its name")
    channels = {n: path | {"seed": 7} for n, path in paths.items()}
    same = run_scenario(document(channels=channels), controller=hand_controller)
    assert np.array_equal(same["remote.dropped"], same["local.dropped"])
    assert same.ledger["remote.u"].note.endswith("seed 7")


def test_seeds_stand_in_the_resolved_scenario_where_anything_is_random() -> None:
    channels = {
        "a": {"signal": "G2_dw", **PACKETS},
        "b": {"signal": "G4_dw", "reporting_interval_s": 0.02},
    }
    pdc = {"signals": [{"signal": "G1_dw", "jitter_s": 0.01}]}
    loaded = load_scenario(document(channels=channels, concentrators={"c": pdc}))
    assert loaded.channels["a"].seed == derived_seed(0, "a")
    assert loaded.channels["b"].seed is None
    assert loaded.concentrators["c"].seed == derived_seed(0, "c")
