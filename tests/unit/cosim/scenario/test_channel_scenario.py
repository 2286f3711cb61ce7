"""Channel keys of a scenario: what is accepted, what is refused and why."""

from __future__ import annotations

from typing import Any

import pytest

from interarea.cosim.errors import ScenarioError
from interarea.cosim.scenario.channels import GammaLatency, GilbertElliottLoss
from interarea.cosim.scenario.scenario import load_scenario


def scenario(**keys: Any) -> dict[str, Any]:
    return {"case": "two-area-thesis", "stop_s": 1.0, "channels": {"remote": {"signal": "G2_dw", **keys}}}


def test_packet_keys() -> None:
    keys = {
        "reporting_interval_s": 0.02,
        "latency": {"kind": "gamma", "shape": 2.0, "scale_s": 0.01},
        "loss": {"kind": "gilbert_elliott", "good_to_bad": 0.1, "bad_to_good": 0.5},
        "on_loss": "hold_then_zero",
        "hold_s": 0.2,
    }
    channel = load_scenario(scenario(**keys)).channels["remote"]
    assert channel.latency == GammaLatency(kind="gamma", shape=2.0, scale_s=0.01)
    assert channel.loss == GilbertElliottLoss(kind="gilbert_elliott", good_to_bad=0.1, bad_to_good=0.5)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"jitter_s": 0.01}, "jitter_s acts on packets: set reporting_interval_s"),
        ({"reporting_interval_s": 1e-5}, "at least 1e-4"),
        ({"reporting_interval_s": 0.02, "loss": {"kind": "bernoulli", "rate": 1.5}}, "rate"),
        (
            {
                "reporting_interval_s": 0.02,
                "latency": {"kind": "empirical", "quantiles_s": [0.02, 0.01]},
            },
            "not descending",
        ),
    ],
)
def test_refused(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(ScenarioError, match=said):
        load_scenario(scenario(**keys))
