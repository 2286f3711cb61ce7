"""The self-test: measured latencies are the stated ones in every mode, and a wrong statement is found."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from participants import Delay, Linear

from interarea.cosim.master.master import Master
from interarea.cosim.master.plan import LoopPlan
from interarea.cosim.results.delay_ledger import Delays
from interarea.cosim.results.latency_test import self_test
from interarea.cosim.run.system import System
from interarea.cosim.stepping_words import INPUTS
from interarea.fmu_build.open.units import UnitOf

RAD = UnitOf("rad", (0, 0, 0, 0, 0, 0, 0, 1))
DEG = UnitOf("deg", (0, 0, 0, 0, 0, 0, 0, 1), factor=0.017453292519943295)
KELVIN = UnitOf("K", (0, 0, 0, 0, 1, 0, 0, 0))
CELSIUS = UnitOf("degC", (0, 0, 0, 0, 1, 0, 0, 0), offset=273.15)
NOTHING: dict[str, Any] = {"channels": {}, "delays": lambda clock: {}}


def lag(name: str, *, direct: bool = False, **abilities: Any) -> Linear:
    one = np.array([[1.0]])
    return Linear(name, -one, one, one, one if direct else 0 * one, ["u"], ["y"], **abilities)


def with_port(p: Linear, end: str, **changes: Any) -> Linear:
    ports = tuple(replace(port, **changes) for port in getattr(p.description, end))
    p.description = replace(p.description, **{end: ports})
    return p


@pytest.mark.parametrize("inputs", INPUTS)
@pytest.mark.parametrize(
    "abilities",
    [{}, {"input_order": 0}, {"output_order": 0}, {"saves_state": False}],
    ids=["able", "no input derivatives", "no slopes", "no saved states"],
)
def test_every_kind_of_connection_has_the_latency_that_the_ledger_states(
    inputs: Any, abilities: dict[str, Any]
) -> None:
    """A loop of three, direct and not, and one FMU whose steps have one length."""
    parts = [lag("a", **abilities), lag("b", direct=True, **abilities), lag("c", **abilities)]
    parts.append(lag("rigid", input_order=0))
    parts[-1].description = replace(parts[-1].description, variable_step=False)
    wires = [("a.y", "b.u"), ("b.y", "c.u"), ("c.y", "a.u"), ("c.y", "rigid.u")]
    with Master(LoopPlan(wires, stop_s=1.0, step_s=0.02, inputs=inputs), parts) as master:
        test = self_test(master, **NOTHING)
    assert test.passed, str(test)
    assert test.worst_s <= 1e-6
    held = {"hold-jacobi": (0.02, 0.01), "hold-gauss-seidel": None}.get(inputs, (0.0, 0.0))
    if held is not None:
        assert test["b.u"].measured_s == pytest.approx(held[0], abs=1e-6)
        assert test["c.u"].measured_s == pytest.approx(held[1], abs=1e-6)


@pytest.mark.parametrize("inputs", INPUTS)
@pytest.mark.parametrize(
    "line",
    [
        {"latency_s": 0.1},
        {"latency_s": 0.0371},
        {"latency_s": 0.004},
        {"latency_s": 0.0},
        {"latency_s": 0.1, "outages_s": [(0.1, 0.5)], "quantum": 0.3},
        {"latency_s": 0.1, "reporting_interval_s": 0.02, "jitter_s": 0.01},
        {"latency_s": 0.0333, "reporting_interval_s": 0.025, "loss": {"kind": "bernoulli", "rate": 0.2}},
        {"latency_s": 0.01, "reporting_interval_s": 0.02, "jitter_s": 0.05, "pdc_wait_s": 0.04},
    ],
)
def test_channels_have_the_latency_that_the_ledger_states(inputs: Any, line: dict[str, Any]) -> None:
    system = System(stop_s=1.0, step_s=0.01, inputs=inputs)
    system.add(lag("a")).add(lag("b", direct=True)).channel("remote", **line)
    test = system.connect("a.y", "remote", "b.u").self_test()
    assert test.passed, str(test)
    mean = line.get("reporting_interval_s", 0.0) / 2
    latency_s = max(line["latency_s"], line.get("pdc_wait_s", 0.0))
    if latency_s >= 0.01 and inputs in ("hermite", "linear"):
        assert test["remote.u"].measured_s == pytest.approx(latency_s + mean, abs=1e-6)


def test_arrivals_on_the_grid_wait_as_stated() -> None:
    """Latency 33 ms, packets each 20 ms, H = 10 ms: every packet waits 7 ms."""
    system = System(stop_s=1.0, step_s=0.01, arrivals="grid").add(lag("a")).add(lag("b"))
    system.channel("remote", latency_s=0.033, reporting_interval_s=0.02).connect("a.y", "remote", "b.u")
    test = system.self_test()
    assert test.passed, str(test)
    assert test["remote.u"].measured_s == pytest.approx(0.033 + 0.01 + 0.007, abs=1e-6)
    assert system.run().ledger["remote.u"].master_s == pytest.approx(0.007, abs=1e-9)


def test_units_are_taken_out_of_the_measurement() -> None:
    for unit_out, unit_in in ((DEG, RAD), (CELSIUS, KELVIN)):
        for direct in (False, True):
            a = with_port(lag("a"), "outputs", unit=unit_out)
            b = with_port(lag("b", direct=direct), "inputs", unit=unit_in)
            with Master(
                LoopPlan([("a.y", "b.u")], stop_s=1.0, step_s=0.02, inputs="hold-jacobi"), [a, b]
            ) as master:
                test = self_test(master, **NOTHING)
            assert test.passed, str(test)
            assert test["b.u"].measured_s == pytest.approx(0.02 if direct else 0.01, abs=1e-6)


@pytest.mark.parametrize("kind", ["Real", "Integer", "Boolean"])
def test_discrete_outputs_change_at_communication_points(kind: Any) -> None:
    a = with_port(lag("a"), "outputs", type=kind, discrete=True)
    b = with_port(lag("b"), "inputs", type=kind)
    with Master(LoopPlan([("a.y", "b.u")], stop_s=1.0, step_s=0.02), [a, b]) as master:
        test = self_test(master, **NOTHING)
    assert test.passed, str(test)
    assert test["b.u"].measured_s == pytest.approx(0.0, abs=1e-6)


def test_a_channel_that_is_later_than_stated_is_found() -> None:
    parts: list[Any] = [lag("a"), Delay("late", 0.11), lag("b")]
    wires = [("a.y", "late.u"), ("late.y", "b.u")]
    with Master(LoopPlan(wires, stop_s=1.0, step_s=0.01, latency_s={"late": 0.1}), parts) as master:
        stated = {"late": Delays(0.1, 0.1)}
        test = self_test(master, {"late": Delay("late", 0.11)}, delays=lambda clock: stated)
        right = self_test(master, {"late": Delay("late", 0.1)}, delays=lambda clock: stated)
    assert right.passed and not test.passed
    assert test["late.u"].difference_s == pytest.approx(0.01, abs=1e-9)
    assert "DIFFERS" in str(test) and "the ledger is wrong" in str(test)


def test_a_channel_that_scales_is_found_by_the_height_of_its_impulse() -> None:
    half = Delay("half", 0.1)
    receive = half.receive

    def halved(slopes: bool) -> None:
        receive(slopes)
        half.y[0] *= 0.5
        if slopes and half.dy:
            half.dy[0] *= 0.5

    half.receive = halved  # type: ignore[method-assign]
    parts: list[Any] = [lag("a"), Delay("half", 0.1), lag("b")]
    wires = [("a.y", "half.u"), ("half.y", "b.u")]
    with Master(LoopPlan(wires, stop_s=1.0, step_s=0.01, latency_s={"half": 0.1}), parts) as master:
        test = self_test(master, {"half": half}, delays=lambda clock: {"half": Delays(0.1, 0.1)})
    assert not test.passed and test["half.u"].height == pytest.approx(0.5, rel=1e-9)
    assert "0.5 times as high" in str(test)


def test_the_master_under_test_is_not_touched() -> None:
    a, b = lag("a"), lag("b")
    with Master(LoopPlan([("a.y", "b.u")], stop_s=1.0, step_s=0.02), [a, b]) as master:
        self_test(master, **NOTHING)
        assert (a.started, b.started) == (0, 0)
