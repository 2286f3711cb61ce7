"""Packets in a loop: what arrives is integrated exactly, whatever the step."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from participants import Linear

from interarea.cosim.run.system import System
from interarea.cosim.scenario.channels import ChannelLine
from interarea.design.controllers.controller import Controller
from interarea.models.blocks.packet_schedule import packets_of

RATE = 2.0


def system(step_s: float, line: dict[str, Any], **options: Any) -> System:
    """dx/dt = -2 x, sent in packets to an integrator and to a follower y = (what arrives) + 0.3 z."""
    one = np.array([[1.0]])
    source = Linear("source", -RATE * one, 0 * one, one, 0 * one, ["u"], ["y"], x0=np.ones(1))
    total = Linear("total", 0 * one, one, one, 0 * one, ["u"], ["y"])
    direct = Linear("direct", -one, one, 0.3 * one, one, ["u"], ["y"])
    last = Linear("last", 0 * one, one, one, 0 * one, ["u"], ["y"])
    system = System(stop_s=2.0, step_s=step_s, **options)
    for p in (source, total, direct, last):
        system.add(p)
    system.channel("line", **line)
    return (
        system.connect("source.y", "line", "total.u")
        .connect("line.y", "direct.u")
        .connect("direct.y", "last.u")
    )


def received(line: dict[str, Any], stop_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Instants from which a new value holds and the values, by closed form: newest stamp wins."""
    p = packets_of(
        {k: float(v) for k, v in ChannelLine(**line).parameters("x").items() if k != "on_loss"}, 0.0, stop_s
    )
    times, values, newest = [0.0], [1.0], -1.0
    for k in np.argsort(p.due_s, kind="stable"):
        if not p.lost[k] and p.stamp_s[k] > newest and p.due_s[k] < stop_s:
            newest = p.stamp_s[k]
            times.append(p.due_s[k])
            values.append(np.exp(-RATE * newest))
    return np.array(times), np.array(values)


@pytest.mark.parametrize(
    "line",
    [
        {"latency_s": 0.1, "reporting_interval_s": 0.02},
        {"latency_s": 0.0437, "reporting_interval_s": 0.02},
        {"latency_s": 0.03, "reporting_interval_s": 0.02, "jitter_s": 0.05, "seed": 3},
        {
            "latency_s": 0.03,
            "reporting_interval_s": 0.025,
            "jitter_s": 0.01,
            "on_loss": "hold",
            "loss": {"kind": "bernoulli", "rate": 0.2},
            "seed": 0,
        },
    ],
)
def test_what_arrives_is_integrated_exactly(line: dict[str, Any]) -> None:
    """Integral of a staircase: values times the time each holds; through a direct dependence too."""
    times, values = received(line, 2.0)
    lengths = np.diff([*times, 2.0])
    exact = values @ lengths
    z = held = 0.0  # dz/dt = -z + u behind the direct dependence, its integral in closed form piece by piece
    for u, h in zip(values, lengths, strict=True):
        held += u * h + 0.3 * (u * h + (z - u) * (1 - np.exp(-h)))
        z = u + (z - u) * np.exp(-h)
    for step_s in (0.01, 0.005):
        run = system(step_s, line).run()
        assert run["total.y"][-1] == pytest.approx(exact, abs=3e-9)  # an arrival is met to a tick of 1 ns
        assert run["last.y"][-1] == pytest.approx(held, abs=2e-7)


def test_on_the_grid_it_is_not(  # the reason for all of this
) -> None:
    line = {"latency_s": 0.0437, "reporting_interval_s": 0.02}
    times, values = received(line, 2.0)
    run = system(0.01, line, arrivals="grid").run()
    error = run["total.y"][-1] - values @ np.diff([*times, 2.0])
    # 6.3 ms late of what decays with the rate 2/s from 1
    assert error == pytest.approx(0.0063 * (1 - np.exp(-RATE * 2.0)), rel=0.1)


def test_arrivals_are_not_recorded_and_a_channel_without_packets_has_none() -> None:
    master = system(0.01, {"latency_s": 0.0437, "reporting_interval_s": 0.02}).master()
    with master:
        run = master.run()
    np.testing.assert_allclose(run.time_s, np.arange(201) / 100, atol=1e-12)
    assert len(master.clock.steps) == 200 + 2 * len(master.clock.points)
    plain = system(0.01, {"latency_s": 0.0437}).master()
    assert plain.clock.slope_events == (43_700_000,)  # the source starts with a slope, which shows there
    assert len(plain.clock.steps) == 200 + 3


def test_both_engines_give_the_same_bits_where_packets_come_out(hand_controller: Controller) -> None:
    """Channel and concentrator, random latency, loss, late frames: kernel and Python reference."""
    runs = []
    for engine in ("kernel", "python"):
        system = System(stop_s=1.5, engine=engine).plant("two-area-thesis").controller(hand_controller)
        system.channel(
            "line",
            latency_s=0.0437,
            reporting_interval_s=0.02,
            jitter_s=0.01,
            loss={"kind": "bernoulli", "rate": 0.1},
        )
        system.concentrator("pdc", [{"latency_s": 0.02, "jitter_s": 0.05}, {"latency_s": 0.03}], wait_s=0.06)
        system.connect("plant.G2_dw", "line", "controller.G2_dw").connect("plant.G1_dw", "pdc.u2")
        system.connect("plant.G4_dw", "pdc.u1").connect("pdc.y1", "controller.G4_dw")
        system.connect("controller.G4_vs", "plant.G4_vs")
        system.event("vref_pulse", machine="G1", size_pu=0.02, start_s=0.5, end_s=0.7)
        runs.append(system.run())
    assert runs[0].data.equals(runs[1].data)
    assert "packets are released at" in runs[0].explain()
    assert runs[0].packets["line"]["dropped"] > 0 and runs[0].packets["pdc"]["late"] > 0


def test_the_end_of_holding_is_a_communication_point() -> None:
    line = ChannelLine(on_loss="hold_then_zero", hold_s=0.25, outages_s=((0.5, 1.0), (1.2, 1.3)))
    assert line.event_times_s == (0.5, 0.75, 1.0, 1.2, 1.3)
    packets = ChannelLine(
        latency_s=0.05,
        reporting_interval_s=0.1,
        on_loss="hold_then_zero",
        hold_s=0.033,
        loss={"kind": "bernoulli", "rate": 1.0},  # type: ignore[arg-type]
    )
    assert packets.arrivals(0.0, 0.3) == [
        50_000_000,
        83_000_000,
        150_000_000,
        183_000_000,
        250_000_000,
        283_000_000,
    ]
