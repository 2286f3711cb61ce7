"""A loop is a value: two ways to say the same loop are equal, and what contradicts itself is refused."""

from __future__ import annotations

import dataclasses
import inspect
import pickle
from typing import Any

import pytest

from interarea.cosim.errors import GraphError
from interarea.cosim.master.master import Master
from interarea.cosim.master.plan import LoopPlan
from interarea.cosim.run.run import system_of
from interarea.cosim.scenario.scenario import load_scenario

WIRES = [("b.y", "a.u"), ("a.y", "b.u")]


def test_order_and_kind_of_what_is_given_do_not_matter() -> None:
    plan = LoopPlan(WIRES, stop_s=1.0, event_times_s=[0.5], latency_s={"a": 0.1})
    assert plan == LoopPlan(reversed(WIRES), stop_s=1.0, event_times_s=(0.5,), latency_s={"a": 0.1})
    assert plan == pickle.loads(pickle.dumps(plan))
    assert plan != dataclasses.replace(plan, latency_s={"a": 0.2})


def test_a_plan_does_not_change_with_what_it_was_made_of() -> None:
    wires, latency = list(WIRES), {"a": 0.1}
    plan = LoopPlan(wires, stop_s=1.0, latency_s=latency)
    wires.clear()
    latency["a"] = 0.3
    assert plan.connections == (("a.y", "b.u"), ("b.y", "a.u")) and plan.latency_s == {"a": 0.1}
    with pytest.raises(dataclasses.FrozenInstanceError):
        plan.stop_s = 2.0  # type: ignore[misc]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"inputs": "cubic"}, "inputs = 'cubic': allowed are hermite"),
        ({"loops": "once"}, "loops = 'once': allowed are auto"),
        ({"engine": "fast"}, "engine = 'fast': allowed are auto"),
        ({"early": "stop"}, "early = 'stop': allowed are continue"),
        ({"engine": "kernel", "early": "roll back"}, "cannot roll back"),
    ],
)
def test_options_are_checked_before_there_are_participants(options: dict[str, Any], message: str) -> None:
    with pytest.raises(GraphError, match=message):
        LoopPlan((), stop_s=1.0, **options)


@pytest.mark.slow
def test_the_plan_of_a_scenario_says_what_its_master_steps() -> None:
    scenario = load_scenario("lost-signal")
    system = system_of(scenario)
    plan = system.plan
    assert (plan.stop_s, plan.step_s, plan.event_times_s) == (20.0, 0.01, system.event_times_s)
    with system.master() as master:
        assert master.plan == plan == system_of(scenario).plan
        assert {(str(c.source), str(c.target)) for c in master.graph.connections} == set(plan.connections)
    assert len(inspect.signature(Master).parameters) <= 5
