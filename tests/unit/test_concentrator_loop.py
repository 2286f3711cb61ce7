"""A concentrator in a system: the wide-area loop on aligned signals, its ledgers, its self-test."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from interarea.cosim.build import System
from interarea.cosim.errors import ScenarioError
from interarea.cosim.master import INPUTS
from interarea.design.controller import Controller

WAYS = [{"latency_s": 0.03}, {"latency_s": 0.08}]
PULSE = {"machine": "G1", "size_pu": 0.02, "start_s": 0.5, "end_s": 0.7}


def grid(controller: Controller, ways: list[dict[str, Any]], **keys: Any) -> System:
    system = System(stop_s=2.0, inputs=keys.pop("inputs", "hermite"), step_s=0.01)
    system.plant("two-area-thesis").controller(controller).concentrator("pdc", ways, **keys)
    for i, signal in enumerate(("G2_dw", "G4_dw"), start=1):
        system.connect(f"plant.{signal}", f"pdc.u{i}").connect(f"pdc.y{i}", f"controller.{signal}")
    return system.connect("controller.G4_vs", "plant.G4_vs").event("vref_pulse", **PULSE)


def test_signals_arrive_aligned_as_late_as_the_slowest(hand_controller: Controller) -> None:
    """80 and 20 ms make 100: y at 20 ms stamps is the plant's signal of 100 ms ago, for both."""
    run = grid(hand_controller, WAYS, latency_s=0.02).run()
    t = run["time_s"]
    stamps = np.flatnonzero(np.isclose(t * 50, np.round(t * 50), atol=1e-9) & (t > 0.2))
    at = np.searchsorted(t, t[stamps] - 0.1 - 1e-9)
    for i, signal in ((1, "G2_dw"), (2, "G4_dw")):
        sent = run[f"plant.{signal}"]
        np.testing.assert_allclose(run[f"pdc.y{i}"][stamps], sent[at], atol=1e-12 * np.max(np.abs(sent)))
    row = run.ledger["pdc.u1"]
    assert (row.network_s, row.reporting_s, row.jitter_mean_s) == (pytest.approx(0.1), 0.01, 0.0)
    counts = run.packets["pdc"]
    assert counts["sent"] == 2 * 101 and counts["late"] == counts["dropped"] == 0


@pytest.mark.parametrize("inputs", INPUTS)
def test_its_latency_is_the_stated_one(hand_controller: Controller, inputs: str) -> None:
    for keys in ({}, {"wait_s": 0.05}, {"relative": True, "wait_s": 0.02, "latency_s": 0.005}):
        test = grid(hand_controller, WAYS, inputs=inputs, **keys).self_test()
        late = [row for row in test.rows if not row.agrees]
        # behind the wait the slower signal never is in a set: nothing of it comes out
        assert all(str(r.connection.target) in ("pdc.u2", "controller.G4_dw") for r in late), str(test)
        assert bool(late) == bool(keys)


def test_a_lost_signal_is_missing_while_the_other_goes_on(hand_controller: Controller) -> None:
    ways = [{"latency_s": 0.03, "lost_s": (1.0, 1.5)}, {"latency_s": 0.05}]
    run = grid(hand_controller, ways, wait_s=0.1).run()
    t, first, second = run["time_s"], run["pdc.valid1"], run["pdc.valid2"]
    assert second.all()
    # complete sets come after 50 ms; the first without the signal waits 100 ms and holds up what follows
    np.testing.assert_array_equal(~first[t <= 1.99], ((t >= 1.1 - 1e-9) & (t < 1.58 - 1e-9))[t <= 1.99])
    assert np.all(run["pdc.y1"][~first] == 0.0)
    assert run.packets["pdc"]["dropped"] == 25


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"wait": 0.1}, r"concentrators\.pdc\.wait = 0\.1: no such key; did you mean 'wait_s'"),
        ({"on_loss": "keep"}, "allowed: 'zero' or 'hold'"),
        ({"reporting_interval_s": 0.0}, "reporting_interval_s"),
    ],
)
def test_mistakes_are_refused(keys: dict[str, Any], says: str) -> None:
    with pytest.raises(ScenarioError, match=says):
        System(stop_s=1.0).concentrator("pdc", WAYS, **keys)
    with pytest.raises(ScenarioError, match="did you mean 'latency_s'"):
        System(stop_s=1.0).concentrator("pdc", [{"latency": 0.1}])
