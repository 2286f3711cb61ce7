"""The master against the delay differential equation; what it promises and what it refuses."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from participants import Delay, Linear, delayed_reference

from interarea.cosim.errors import GraphError, StepError
from interarea.cosim.master.master import Master
from interarea.cosim.master.plan import LoopPlan
from interarea.cosim.results.delay_ledger import delay_ledger, explain
from interarea.cosim.trajectory import Trajectory

TAU, STOP = 0.1, 10.0
PULSE = (1.0, 1.2)


def _plant_matrices() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Exciter 20 ms, field 0.5 s, an inter-area swing at 0.62 Hz and a local one at 1.2 Hz."""
    w, z, v, y = 2 * np.pi * 0.62, 0.08, 2 * np.pi * 1.2, 0.2
    A = np.zeros((6, 6))
    A[0, 0], A[1, 0], A[1, 1] = -50.0, 2.0, -2.0
    A[2, 3], A[3, 2], A[3, 3], A[3, 1] = 1.0, -w * w, -2 * z * w, -3.0
    A[4, 5], A[5, 4], A[5, 5], A[5, 1] = 1.0, -v * v, -2 * y * v, -2.0
    B = np.zeros((6, 1))
    B[0, 0] = 50.0
    C = np.zeros((2, 6))
    C[0, 3], C[0, 5], C[1, 3], C[1, 5] = 1.0, -0.1, -1.0, 1.0
    return A, B, C


A, B, C = _plant_matrices()
AK = np.array([[-6.0, 0.0], [6.0, -20.0]])
BK = np.array([[6.0, -6.0], [0.0, 0.0]])
CK = np.array([[0.0, 1.5]])
PUSH = 0.05 * B[:, 0]


def loop(
    step_s: float, *, synchronous: bool, abilities: dict[str, Any] | None = None, **options: Any
) -> Master:
    able = abilities or {}
    plant = Linear("plant", A, B, C, np.zeros((2, 1)), ["vs"], ["r", "l"], push=[(*PULSE, PUSH)], **able)
    controller = Linear("controller", AK, BK, CK, np.zeros((1, 2)), ["r", "l"], ["vs"], **able)
    parts: list[Any] = [plant, controller, Delay("remote", TAU)]
    wires = [("plant.r", "remote.u"), ("remote.y", "controller.r"), ("controller.vs", "plant.vs")]
    latency = {"remote": TAU}
    if synchronous:
        parts.append(Delay("local", TAU))
        wires += [("plant.l", "local.u"), ("local.y", "controller.l")]
        latency["local"] = TAU
    else:
        wires.append(("plant.l", "controller.l"))
    turn = options.pop("turn", 0)
    parts, wires = parts[turn:] + parts[:turn], wires[turn:] + wires[:turn]
    return Master(
        LoopPlan(wires, stop_s=STOP, step_s=step_s, event_times_s=PULSE, latency_s=latency, **options), parts
    )


@cache
def reference(synchronous: bool, tau: float = TAU) -> Callable[[np.ndarray], np.ndarray]:
    """Difference of the speeds from the delay differential equation, by the method of steps at 1e-12."""

    def rate(t: float, x: np.ndarray, past: Callable[[float], np.ndarray]) -> np.ndarray:
        old = past(t - tau)[:6]
        signals = np.array([C[0] @ old, C[1] @ (old if synchronous else x[:6])])
        push = PUSH if PULSE[0] <= t < PULSE[1] else np.zeros(6)
        return np.concatenate([A @ x[:6] + B[:, 0] * (CK[0] @ x[6:]) + push, AK @ x[6:] + BK @ signals])

    at = delayed_reference(rate, np.zeros(8), tau, PULSE, STOP)
    return lambda times: at(times)[:, :6] @ (C[0] - C[1])


def error_of(master: Master, synchronous: bool) -> float:
    """Largest error of the difference of the speeds over its peak."""
    run = master.run()
    exact = reference(synchronous)(run.time_s)
    return float(np.max(np.abs(run["plant.r"] - run["plant.l"] - exact)) / np.max(np.abs(exact)))


@pytest.mark.slow
@pytest.mark.parametrize("synchronous", [True, False])
def test_the_loop_is_the_delay_equation_to_2e_7_at_10_ms_and_of_third_order(synchronous: bool) -> None:
    coarse, middle, fine = (
        error_of(loop(h, synchronous=synchronous), synchronous) for h in (0.02, 0.01, 0.005)
    )
    assert middle <= 2e-7
    # below the tolerance of the loop iteration (1e-7 a step) there is nothing left to gain
    assert np.log2(coarse / middle) >= 3.0
    assert np.log2(coarse / fine) >= 2 * 3.0 or fine <= 2e-8


@pytest.mark.slow
def test_a_tighter_tolerance_keeps_fourth_order_without_a_channel() -> None:
    middle, fine = (error_of(loop(h, synchronous=False, tolerance=1e-10), False) for h in (0.01, 0.005))
    assert np.log2(middle / fine) >= 3.5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("abilities", "bound"),
    [
        ({"output_order": 0}, 1e-4),  # slopes from differences: second order where an event cuts the past
        ({"input_order": 0}, 1e-4),  # means over parts of the step: second order
        ({"saves_state": False}, 2e-6),  # the loop is extrapolated: third order
    ],
)
def test_fmus_that_can_do_less_still_converge(abilities: dict[str, Any], bound: float) -> None:
    middle, fine = (error_of(loop(h, synchronous=False, abilities=abilities), False) for h in (0.01, 0.005))
    assert middle <= bound
    assert middle / fine >= 3.0


@pytest.mark.slow
def test_straight_lines_are_second_order_and_held_inputs_first() -> None:
    for inputs, order in (("linear", 2.0), ("hold-jacobi", 1.0), ("hold-gauss-seidel", 1.0)):
        middle, fine = (error_of(loop(h, synchronous=True, inputs=inputs), True) for h in (0.01, 0.005))
        assert np.log2(middle / fine) == pytest.approx(order, abs=0.15)


@pytest.mark.slow
@pytest.mark.parametrize("inputs", ["hold-jacobi", "hold-gauss-seidel"])
def test_held_inputs_add_the_latency_that_the_ledger_states(inputs: Any) -> None:
    """The run is the delay equation with the loop's stated latency added, up to an error of O(H^2)."""
    rows = []
    for h in (0.01, 0.005):
        master = loop(h, synchronous=True, inputs=inputs)
        ledger = delay_ledger(master)
        added = ledger["controller.r"].master_s + ledger["plant.vs"].master_s
        run = master.run()
        exact = reference(True, TAU + added)(run.time_s)
        rows.append(np.max(np.abs(run["plant.r"] - run["plant.l"] - exact)) / np.max(np.abs(exact)))
    assert rows[0] <= 1e-2
    assert rows[0] / rows[1] >= 3.0


@pytest.mark.slow
def test_any_declaration_order_gives_the_same_bits() -> None:
    runs = [loop(0.01, synchronous=False, turn=k).run().data for k in range(3)]
    assert runs[0].equals(runs[1]) and runs[0].equals(runs[2])


@pytest.mark.slow
def test_saving_restoring_and_going_on_is_not_stopping() -> None:
    whole = loop(0.01, synchronous=False).run().data
    master = loop(0.01, synchronous=False)
    master.run(until_s=2.0)
    saved = master.save()
    first = master.run().data
    master.restore(saved)
    again = master.run().data
    master.release(saved)
    assert first.equals(whole) and again.equals(whole)


@pytest.mark.slow
def test_a_second_run_on_live_participants_gives_the_same_bits() -> None:
    master = loop(0.01, synchronous=True)
    first = master.run().data
    master.start()
    assert master.run().data.equals(first)


def gain(name: str, k: float, constant: float = 0.0) -> Linear:
    """y = k u + constant, with a direct dependence (the constant is the state)."""
    one = np.array([[0.0]])
    return Linear(name, one, one, np.array([[1.0]]), np.array([[k]]), ["u"], ["y"], x0=np.array([constant]))


@pytest.mark.parametrize("k", [0.5, -3.0, 0.999])
def test_an_algebraic_loop_is_solved_to_its_closed_form(k: float) -> None:
    """y = k y + 1 through two instances: y = 1 / (1 - k), also where plain sweeps would diverge."""
    parts = [gain("a", k, 1.0), gain("b", 1.0)]
    with Master(LoopPlan([("a.y", "b.u"), ("b.y", "a.u")], stop_s=0.1, step_s=0.01), parts) as master:
        run = master.run()
    assert master.residual <= 1e-12
    np.testing.assert_allclose(run["a.y"], 1.0 / (1.0 - k), rtol=1e-6)


class Limited(Linear):
    """Its output is at most `limit`, and has no slope there."""

    limit = np.inf

    def receive(self, slopes: bool) -> None:
        super().receive(slopes)
        if self.y[0] >= self.limit:
            self.y[0], self.dy[:] = self.limit, [0.0] * len(self.dy)


def test_a_limit_reached_just_at_the_end_of_a_step_is_stepped_over() -> None:
    """x' = u, u = t - 2 x up to a limit: with its slope at the end u is at the limit, without it below it.

    u(t) = (1 - exp(-2 t)) / 2 until the limit, then x grows along a line.
    """
    zero, one = np.zeros((1, 1)), np.ones((1, 1))

    def run(limit: float) -> Trajectory:
        plant = Linear("plant", zero, one, one, zero, ["u"], ["x"])
        ramp = [(0.0, 10.0, np.ones(1))]
        control = Limited("control", zero, zero, one, -2.0 * one, ["x"], ["u"], push=ramp)
        control.limit = limit
        wires = [("plant.x", "control.x"), ("control.u", "plant.u")]
        with Master(LoopPlan(wires, stop_s=1.0, step_s=0.1), [plant, control]) as master:
            return master.run()

    u_end = run(np.inf)["control.u"]
    for k in (3, 5):
        limit = float(u_end[k]) - 2e-4
        data = run(limit)
        reached = -0.5 * np.log(1.0 - 2.0 * limit)
        x_there = 0.5 * (reached - limit)
        exact = x_there + limit * (data.time_s[-1] - reached)
        assert data["plant.x"][-1] == pytest.approx(exact, rel=1e-3)
        assert np.max(data["control.u"]) == limit


def test_a_loop_without_a_solution_says_so() -> None:
    parts = [gain("a", 1.0, 1.0), gain("b", 1.0)]
    with pytest.raises(StepError, match="solving the initial values"):
        Master(LoopPlan([("a.y", "b.u"), ("b.y", "a.u")], stop_s=0.1, step_s=0.01), parts).run()


class Spoiled(Linear):
    """Gives NaN from 0.5 s on."""

    def receive(self, slopes: bool) -> None:
        super().receive(slopes)
        if self.time >= 0.5:
            self.y[0] = float("nan")


def test_nan_stops_the_run_at_that_step_with_the_results_so_far() -> None:
    one = np.array([[-1.0]])
    bad = Spoiled("bad", one, one, one, np.zeros((1, 1)), ["u"], ["y"])
    sink = Linear("sink", one, one, one, np.zeros((1, 1)), ["u"], ["y"])
    with pytest.raises(StepError, match=r"bad: reading outputs at t = 0.5 s: output y is nan") as caught:
        Master(LoopPlan([("bad.y", "sink.u")], stop_s=1.0, step_s=0.01), [bad, sink]).run()
    assert caught.value.trajectory is not None
    assert caught.value.trajectory.time_s[-1] == 0.49


def test_iterating_asks_for_saved_states() -> None:
    with pytest.raises(GraphError, match="cannot save its state"):
        loop(0.01, synchronous=False, abilities={"saves_state": False}, loops="iterate")


def test_the_explanation_names_order_loops_and_what_is_not_connected() -> None:
    master = loop(0.01, synchronous=False)
    text = explain(master, delay_ledger(master))
    assert "order of a step: remote | controller <-> plant" in text
    assert "iterated with saved states" in text
    assert "events at 1, 1.1, 1.2, 1.3 s" in text
    alone = Linear("x", A, B, C, np.zeros((2, 1)), ["vs"], ["r", "l"])
    single = Master(LoopPlan([], stop_s=1.0), [alone])
    assert "not connected: x.vs keeps its start value 0" in explain(single, delay_ledger(single))


def test_steps_of_one_length_refuse_events_off_the_grid() -> None:
    rigid = gain("a", 0.0)
    rigid.description = rigid.description.__class__(**{**vars(rigid.description), "variable_step": False})
    with pytest.raises(GraphError, match=r"use 0\.01 or 0\.02"):
        Master(LoopPlan([], stop_s=1.0, step_s=0.01, event_times_s=[0.015]), [rigid])


@pytest.mark.parametrize("latency", [0.05, 0.0537])
def test_a_start_far_from_rest_comes_through_a_channel_with_its_kink(latency: float) -> None:
    """x'' = -w^2 x from x = 0, x' = w: sin(w (t - latency)) begins at full slope; its integral is exact."""
    w = 4.0
    A2, zero = np.array([[0.0, w], [-w, 0.0]]), np.zeros((1, 1))
    swing = Linear(
        "swing", A2, np.zeros((2, 1)), np.array([[1.0, 0.0]]), zero, ["u"], ["y"], x0=np.array([0.0, 1.0])
    )
    total = Linear("sum", zero, np.ones((1, 1)), np.ones((1, 1)), zero, ["u"], ["y"])
    wires = [("swing.y", "late.u"), ("late.y", "sum.u")]
    parts = [swing, total, Delay("late", latency)]

    def error(**options: Any) -> float:
        run = Master(
            LoopPlan(wires, stop_s=1.0, step_s=0.01, latency_s={"late": latency}, **options), parts
        ).run()
        exact = (1.0 - np.cos(w * np.maximum(run.time_s - latency, 0.0))) / w
        assert len(run.time_s) == 101  # the kink is a communication point and no row
        return float(np.max(np.abs(run["sum.y"] - exact)))

    assert error() < 1e-8 < 1e-6 < error(at_rest=True)  # a tick of 1 ns times the largest value, 1


def test_a_jump_inside_a_channel_reaches_the_loop_at_its_instant() -> None:
    """A signal cut to zero at 0.5 s: the integral of what arrives is exact, edges included."""
    ramp = Linear(
        "ramp", np.array([[0.0]]), np.array([[0.0]]), np.array([[0.0]]), np.array([[0.0]]), ["u"], ["y"]
    )
    ramp.C, ramp.x0 = np.array([[1.0]]), np.array([1.0])
    total = Linear(
        "sum", np.array([[0.0]]), np.array([[1.0]]), np.array([[1.0]]), np.array([[0.0]]), ["u"], ["y"]
    )
    cut = Delay("cut", 0.05, zero_from=0.5)
    wires = list(itertools.chain([("ramp.y", "cut.u"), ("cut.y", "sum.u")]))
    run = Master(
        LoopPlan(wires, stop_s=1.0, step_s=0.01, event_times_s=[0.5], latency_s={"cut": 0.05}),
        [ramp, total, cut],
    ).run()
    assert run["sum.y"][-1] == pytest.approx(0.5, abs=2e-9)  # a tick of 1 ns
