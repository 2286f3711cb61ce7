"""Scenarios on the real FMUs: wiring, what is refused, linear against nonlinear, events at their instants."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from participants import delayed_reference
from scenario_loop import Loop

from interarea.cosim.errors import ScenarioError
from interarea.cosim.results.run import Run
from interarea.cosim.run.artefacts import linear_plant
from interarea.cosim.run.run import run_scenario
from interarea.cosim.scenario.scenario import load_scenario
from interarea.design.controllers.controller import Controller
from interarea.models.case.case import Case, CaseError

PULSE = {"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 1.0, "end_s": 1.2}
SMALL = PULSE | {"size_pu": 1e-4}


def document(**changes: Any) -> dict[str, Any]:
    channels = {
        "remote": {"signal": "G2_dw", "latency_s": 0.1},
        "local": {"signal": "G4_dw", "latency_s": 0.1},
    }
    return {
        "case": "two-area-thesis",
        "controller": "wdc",
        "stop_s": 10.0,
        "channels": channels,
        "event": [PULSE],
    } | changes


@pytest.fixture(scope="module")
def ring_down() -> Run:
    return run_scenario(document(controller="none", channels={}, stop_s=20.0))


def test_open_loop_ring_down_shows_the_modes_of_the_thesis(ring_down: Run) -> None:
    """Matched plant: 0.6227 Hz / .0806, 1.1393 Hz / .2466; the pulse is not infinitesimal: 1 %."""
    assert ring_down.metrics.frequency_hz["inter-area"] == pytest.approx(0.6227, rel=0.005)
    assert ring_down.damping_ratio("inter-area") == pytest.approx(0.0806, abs=0.002)
    assert ring_down.metrics.frequency_hz["local area 1"] == pytest.approx(1.1393, rel=0.01)
    assert ring_down.damping_ratio("local area 1") == pytest.approx(0.2466, abs=0.01)
    assert ring_down.stable


def test_windows_can_be_chosen_and_unknown_modes_are_refused(ring_down: Run) -> None:
    assert ring_down.damping_ratio(start_s=3.0, stop_s=15.0) == pytest.approx(0.0806, abs=0.002)
    with pytest.raises(ValueError, match="did you mean 'inter-area'"):
        ring_down.damping_ratio("interarea")


@pytest.mark.slow
def test_a_limit_cycle_at_the_output_limit_is_not_stable() -> None:
    """Latency beyond the margin: the swing grows until the limit holds it, and then even shrinks a little."""
    late = {s: {"signal": f"{s}_dw", "latency_s": 0.5} for s in ("G2", "G4")}
    run = run_scenario(document(channels=late, stop_s=30.0))
    swing, time = np.abs(run["plant.G2_dw"] - run["plant.G4_dw"]), run.trajectory.time_s
    quarters = [float(np.max(swing[(time >= t) & (time < t + 7.2)])) for t in (8.4, 15.6, 22.8)]
    assert quarters == sorted(quarters, reverse=True) and quarters[2] > 0.9 * quarters[0]
    assert not run.stable
    assert run_scenario(document(channels={}, stop_s=30.0)).stable


def test_nothing_moves_before_the_event(ring_down: Run) -> None:
    before = ring_down.trajectory.time_s < 1.0
    for machine in "G1", "G2", "G3", "G4":
        assert np.max(np.abs(ring_down.trajectory[f"plant.{machine}_dw"][before])) < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("latency", [{"local": 0.1, "remote": 0.1}, {"local": 0.0, "remote": 0.1}])
def test_a_small_pulse_through_the_loop_is_the_linear_delay_equation(
    latency: dict[str, float],
    two_area: Case,
    cache: Path,
    by_hand: Controller,
    hand_controller: Controller,
) -> None:
    """Nonlinear FMUs through channels against the linearised plant by the method of steps: 1 % of peak."""
    signals = {"remote": "G2_dw", "local": "G4_dw"}
    channels = {n: {"signal": s, "latency_s": latency[n]} for n, s in signals.items()}
    run = run_scenario(document(channels=channels, event=[SMALL]), cache=cache, controller=by_hand)
    G, K = linear_plant(two_area, cache), hand_controller.system
    n = G.nstates
    rows = [G.output_labels.index(s) for s in ("G2_dw", "G4_dw")]
    Cp = G.C[rows]
    BK = K.B * two_area.omega_b
    vref, vs = G.B[:, G.input_labels.index("G1_vs")], G.B[:, G.input_labels.index("G4_vs")]
    delayed = np.array([latency["remote"] > 0, latency["local"] > 0])

    def rate(t: float, x: np.ndarray, past: Any) -> np.ndarray:
        y = np.where(delayed, Cp @ past(t - 0.1)[:n], Cp @ x[:n])
        push = SMALL["size_pu"] * vref if 1.0 <= t < 1.2 else 0.0
        return np.concatenate([G.A @ x[:n] + vs * (K.C[0] @ x[n:]) + push, K.A @ x[n:] + BK @ y])

    exact = _stiff_reference(rate, np.zeros(n + K.nstates), run.trajectory.time_s, delayed_reference)
    dw24 = run.trajectory["plant.G2_dw"] - run.trajectory["plant.G4_dw"]
    linear = exact[:, :n] @ (Cp[0] - Cp[1])
    assert np.max(np.abs(dw24 - linear)) <= 0.01 * np.max(np.abs(linear))


def _stiff_reference(rate: Any, x0: np.ndarray, times: np.ndarray, solve: Any) -> np.ndarray:
    return solve(rate, x0, 0.1, (1.0, 1.2), float(times[-1]), method="Radau", rtol=1e-7, atol=1e-13)(times)


@pytest.mark.slow
def test_synchronous_feedback_has_no_loop_and_no_delay_of_the_master(by_hand: Controller) -> None:
    loaded = load_scenario(document(stop_s=1.5))
    with Loop(loaded, controller=by_hand) as loop:
        assert loop.master.graph.order == ("local", "remote", "controller", "plant")
        loop.master.run()
        run = loop.result()
    assert run.ledger["remote.u"].total_s == 0.1
    assert all(row.master_s == 0.0 for row in run.ledger.rows)
    assert "plant.G2_dw -> remote.u" in run.explain()


def test_channels_deliver_what_was_sent_their_latency_ago(by_hand: Controller) -> None:
    run = run_scenario(document(), controller=by_hand)
    time, sent, got = run.trajectory.time_s, run.trajectory["plant.G2_dw"], run.trajectory["remote.y"]
    grid = np.isclose(time, np.round(time, 2), atol=1e-12)
    assert np.max(np.abs(got[grid][10:] - sent[grid][:-10])) <= 1e-12 * np.max(np.abs(sent)) + 1e-18


def test_an_outage_is_exact_and_shows_in_valid(by_hand: Controller) -> None:
    lost = {"signal": "G2_dw", "on_loss": "zero", "outages_s": [[2.0033333, 3.0]]}
    run = run_scenario(document(channels={"remote": lost}), controller=by_hand)
    time, valid, got = run.trajectory.time_s, run.trajectory["remote.valid"], run.trajectory["remote.y"]
    np.testing.assert_array_equal(valid, ~((time >= 2.0033333) & (time < 3.0)))
    assert 2.0033333 in time
    assert np.all(got[~valid] == 0.0) and np.any(got[valid] != 0.0)


def test_two_runs_and_any_order_of_declaration_give_the_same_bits(by_hand: Controller) -> None:
    first = run_scenario(document(stop_s=3.0), controller=by_hand)
    turned = dict(reversed(document()["channels"].items()))
    again = run_scenario(document(stop_s=3.0, channels=turned), controller=by_hand)
    assert first.trajectory.data.equals(again.trajectory.data)


def test_a_run_can_be_forked_from_its_fault(by_hand: Controller) -> None:
    with Loop(load_scenario(document(stop_s=3.0)), controller=by_hand) as loop:
        whole = loop.master.run().data
        loop.master.start()
        loop.master.run(until_s=1.2)
        saved = loop.master.save()
        first = loop.master.run().data
        loop.master.restore(saved)
        assert loop.master.run().data.equals(first)
        assert first.equals(whole)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (
            {"channels": {"a": {"signal": "G9_dw"}}},
            r"channels\.a\.signal = 'G9_dw' is not an output of the plant",
        ),
        ({"channels": {"a": {"signal": "G1_pe"}}}, r"is not an input of controller by_hand"),
        ({"controller": "best"}, r"controller = 'best' is neither a name nor a file; "),
    ],
)
def test_wiring_mistakes_are_refused(change: dict[str, Any], says: str, by_hand: Controller) -> None:
    provider = None if "controller" in change else by_hand
    with pytest.raises(ScenarioError, match=says):
        run_scenario(document(**change), controller=provider)


def test_mistakes_of_the_case_are_refused() -> None:
    with pytest.raises(CaseError):
        run_scenario(document(case="three-area"))
    with pytest.raises(ScenarioError, match="event 1: bus_fault: bus 99"):
        run_scenario(document(event=[{"kind": "bus_fault", "bus": 99, "start_s": 1.0, "end_s": 1.1}]))
