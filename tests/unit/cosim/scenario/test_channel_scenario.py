"""Channel keys of a scenario: what is accepted, what is refused and why."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from interarea.cosim import explorer
from interarea.cosim.designs.fault_runs import FaultRun
from interarea.cosim.errors import ScenarioError
from interarea.cosim.scenario.channels import ChannelLine, GammaLatency, GilbertElliottLoss
from interarea.cosim.scenario.concentrators import ConcentratorLine, PathTable
from interarea.cosim.scenario.scenario import load_scenario
from interarea.design.controllers.bundled import shipped_controller
from interarea.models.blocks.channel import ON_LOSS, channel_block
from interarea.models.blocks.concentrator import ON_MISSING, concentrator_block


def scenario(**keys: Any) -> dict[str, Any]:
    return {"case": "two-area-thesis", "stop_s": 1.0, "channels": {"remote": {"signal": "G2_dw", **keys}}}


def test_a_channel_that_says_nothing_is_what_its_fmu_and_the_page_start_with() -> None:
    block = channel_block()
    said: dict[str, Any] = {**ChannelLine().parameters("x")}
    said["on_loss"] = {key: code for key, code, _ in ON_LOSS.items}[said["on_loss"]]
    assert said == {v.name: v.start for v in (*block.table.reals, *block.table.integers) if v.name in said}
    page = (Path(explorer.__file__).parent / "web" / "settings.js").read_text(encoding="utf-8")
    assert f"on_loss: '{ChannelLine().on_loss}', hold: {1000 * ChannelLine().hold_s:g}," in page


def test_a_concentrator_that_says_nothing_is_what_its_fmu_starts_with() -> None:
    block = concentrator_block(1)
    said = {**ConcentratorLine(signals=(PathTable(),)).parameters("x")}
    said["on_loss"] = {key: code for key, code, _ in ON_MISSING.items}[str(said["on_loss"])]
    assert said == {v.name: v.start for v in (*block.table.reals, *block.table.integers) if v.name in said}


def test_the_end_of_what_a_concentrator_holds_is_a_communication_point() -> None:
    path = PathTable(latency_s=0.01, lost_s=(0.1, 0.5))
    line = ConcentratorLine(signals=(path,), reporting_interval_s=0.1, wait_s=0.03, hold_s=0.217)
    # sets of the stamps 0 to .6 s, without the signal at .13 s first; what is held ends at .347 s
    came = [10, 130, 230, 330, 347, 430, 510]
    assert line.arrivals(0.0, 0.6) == [ms * 1_000_000 for ms in came]


def test_a_signal_lost_in_an_acceptance_is_zero_at_once() -> None:
    controller = shipped_controller("robust")
    run = FaultRun((), 10.0, controller, lost_s={"G2_dw": 1.5})
    channels = load_scenario(run.document()).channels
    assert {c.signal: (c.on_loss, c.outages_s) for c in channels.values()} == {
        "G2_dw": ("zero", ((1.5, 10.0),)),
        "G4_dw": ("zero", ()),
    }


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
            "not decreasing",
        ),
    ],
)
def test_refused(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(ScenarioError, match=said):
        load_scenario(scenario(**keys))
