"""Faults of a signal in a scenario: keys, what is refused, the same run in a container and from a master."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from interarea.cosim.errors import ScenarioError
from interarea.cosim.export.joint import run_joint
from interarea.cosim.run.run import system_of
from interarea.cosim.scenario.scenario import load_scenario
from interarea.simulation import simulate

EVENT = {"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 0.5, "end_s": 0.7}
PACKETS = {"reporting_interval_s": 0.02}


def scenario(*faults: dict[str, Any], stop_s: float = 3.0, **keys: Any) -> dict[str, Any]:
    channel = {"signal": "G2_dw", "latency_s": 0.05, "signal_faults": list(faults), **keys}
    local = {"signal": "G4_dw"}
    return {
        "case": "two-area-thesis",
        "controller": "active",
        "stop_s": stop_s,
        "event": [EVENT],
        "channels": {"remote": channel, "local": local},
    }


@pytest.mark.parametrize(
    ("keys", "faults", "says"),
    [
        (
            {},
            [{"kind": "bias", "size": 1e-3, "start_s": 1.0, "end_s": 2.0}, {"kind": "stuck", "start_s": 1.5}],
            "stuck starts at 1.5 s, before 2 s, allowed: in order, no overlap",
        ),
        (
            {},
            [{"kind": "stuck", "start_s": 1.0}, {"kind": "polarity", "start_s": 2.0}],
            "before the end of the previous one, which has none, allowed: in order, no overlap",
        ),
        (
            PACKETS,
            [{"kind": "replay", "length_s": 1.5, "start_s": 1.0}],
            r"length_s = 1.5, allowed: at most start_s = 1 \(the signal before it\)",
        ),
        ({}, [{"kind": "noise", "rms": 1e-3, "start_s": 1.0}], "noise acts on packets"),
        (PACKETS, [{"kind": "replay", "length_s": 0.03, "start_s": 1.0}], "a whole number of packets"),
        ({}, [{"kind": "stuck", "start_s": 1.0, "end_s": 1.0}], "end_s = 1, allowed: above start_s = 1"),
        (
            {},
            [{"kind": "stuck", "start_s": 5.0}],
            "channels.remote: stuck fault starts at 5 s, outside the run",
        ),
        ({}, [{"kind": "sticky", "start_s": 1.0}], "kind = 'sticky'"),
        ({}, [{"kind": "time_error", "offset_s": -0.1, "start_s": 1.0}], "offset_s = -0.1"),
        (
            PACKETS,
            [{"kind": "swap", "other": 2, "start_s": 1.0}],
            "swap with signal 2 of 1, allowed: one of",
        ),
        ({}, 5 * [{"kind": "stuck", "start_s": 1.0}], "5 tables, allowed: at most 4"),
    ],
)
def test_refused(keys: dict[str, Any], faults: list[dict[str, Any]], says: str) -> None:
    with pytest.raises(ScenarioError, match=says):
        load_scenario(scenario(*faults, **keys))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "keys"),
    [
        ({"kind": "polarity", "start_s": 1.0, "end_s": 2.0}, {}),
        ({"kind": "oscillating", "amplitude": 1e-3, "frequency_hz": 0.6, "start_s": 0.9}, {}),
        ({"kind": "noise", "rms": 1e-4, "start_s": 1.0}, PACKETS),
        ({"kind": "replay", "length_s": 0.5, "start_s": 0.8}, PACKETS),
    ],
)
def test_the_container_gives_what_the_master_gives(fault: dict[str, Any], keys: dict[str, Any]) -> None:
    """One block without a master, and FMUs under one: the same run within the master's own error."""
    table = scenario(fault, **keys)
    apart = simulate(table).trajectory
    joint = run_joint(load_scenario({**table, "master": {"joint": True}})).trajectory
    right = simulate(scenario(**keys)).trajectory
    for name in ("remote.y", "plant.G4_dw"):
        a, b = (np.interp(right.time_s, x.time_s, x[name]) for x in (apart, joint))
        swing = np.ptp(right[name])
        off = np.abs(a - b)
        assert np.quantile(off, 0.98) < 2e-3 * swing, (name, off.max(), swing)
        assert np.max(np.abs(a - right[name])) > 2e-2 * swing
    assert np.all(apart["remote.valid"] == 1)


def test_a_wrong_polarity_is_the_mirrored_signal_from_its_start_on() -> None:
    run = simulate(scenario({"kind": "polarity", "start_s": 1.0, "end_s": 2.0})).trajectory
    sent = np.interp(run.time_s - 0.05, run.time_s, run["plant.G2_dw"])
    wrong = (run.time_s > 1.05) & (run.time_s < 2.05)
    right = (run.time_s < 1.05) | (run.time_s > 2.05)
    assert np.allclose(run["remote.y"][wrong], -sent[wrong], atol=1e-6)
    assert np.allclose(
        run["remote.y"][right & (run.time_s > 0.05)], sent[right & (run.time_s > 0.05)], atol=1e-6
    )


def test_no_linear_roots_are_given_while_a_signal_is_wrong() -> None:
    table = scenario({"kind": "scale", "factor": 3.0, "start_s": 1.0}, stop_s=6.0)
    assert system_of(load_scenario(table)).linear_swings() == "channels.remote: the signal is wrong (scale)"
