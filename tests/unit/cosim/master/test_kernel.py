"""The compiled kernel against the Python reference, to the bit; what stops it; what it leaves to Python."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmu_runner import decay_block
from participants import Linear
from scenario_loop import Loop

from interarea.cosim.errors import GraphError, StepError
from interarea.cosim.master.instances import FmuParticipant
from interarea.cosim.master.kernel import build as kernel_build
from interarea.cosim.master.master import Master
from interarea.cosim.master.plan import LoopPlan
from interarea.cosim.scenario.scenario import load_scenario
from interarea.design.controllers.controller import Controller
from interarea.fmu_build.errors import BuildError
from interarea.fmu_build.open.fmu_file import FmuFile
from interarea.fmu_build.write.package import block_fmu

PULSE = {"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 0.5, "end_s": 0.7}
FAULT = {"kind": "bus_fault", "bus": 8, "start_s": 0.5033, "end_s": 0.6}
REMOTE = {"signal": "G2_dw", "latency_s": 0.1}
LOCAL = {"signal": "G4_dw", "latency_s": 0.1}

SCENARIOS: dict[str, dict[str, Any]] = {
    "synchronous": {},
    "without a channel on the local signal": {"channels": {"remote": REMOTE}},
    "unequal latencies": {"channels": {"remote": REMOTE | {"latency_s": 0.0331}, "local": LOCAL}},
    "a fault between grid points": {"event": [FAULT]},
    "outages, zero and hold": {
        "channels": {
            "remote": REMOTE | {"outages_s": [[0.61, 0.9], [1.2, 1.5]]},
            "local": LOCAL | {"outages_s": [[0.75, 1.0]], "on_loss": "hold"},
        }
    },
    "frames, jitter and loss": {
        "channels": {
            "remote": REMOTE
            | {
                "reporting_interval_s": 0.02,
                "jitter_s": 0.03,
                "seed": 7,
                "loss": {"kind": "bernoulli", "rate": 0.2},
            },
            "local": LOCAL,
        }
    },
    "straight lines": {"master": {"inputs": "linear"}},
    "held inputs, Jacobi": {"master": {"inputs": "hold-jacobi"}},
    "held inputs, Gauss-Seidel": {"master": {"inputs": "hold-gauss-seidel"}},
    "an extrapolated loop": {"channels": {"remote": REMOTE}, "master": {"loops": "extrapolate"}},
    "no controller": {"controller": "none", "channels": {}},
}


def document(**changes: Any) -> dict[str, Any]:
    channels = {"remote": REMOTE, "local": LOCAL}
    fields = {"controller": "wdc", "stop_s": 2.0, "channels": channels, "event": [PULSE]}
    return {"case": "two-area-thesis", **fields} | changes


def assembled(cache: Path, by_hand: Controller, **changes: Any) -> Loop:
    return Loop(load_scenario(document(**changes)), cache=cache, controller=by_hand)


@pytest.mark.parametrize("changes", SCENARIOS.values(), ids=SCENARIOS.keys())
def test_the_kernel_gives_the_bits_of_the_reference(
    changes: dict[str, Any], cache: Path, by_hand: Controller
) -> None:
    with assembled(cache, by_hand, **changes) as loop:
        master = loop.master
        fast = master.run()
        swept = master.repeated
        counted = loop.result().packets.rows
        master.engine = "python"
        master.start()
        slow = master.run()
        assert (fast.engine, slow.engine) == ("kernel", "python")
        assert fast.data.equals(slow.data)
        assert master.repeated == swept
        assert loop.result().packets.rows == counted


@pytest.mark.slow
def test_a_limit_reached_just_at_the_end_of_a_step_is_stepped_over_as_the_reference_does(cache: Path) -> None:
    """A controller of `study actuators` whose loop over a dc link has no slope that agrees at 2.61 s."""
    saved = json.loads(Path(__file__).with_name("limit_at_step_end.json").read_text(encoding="utf-8"))
    fault = [
        {"kind": "bus_fault", "bus": 7, "x_pu": 1e-4, "start_s": 1.0, "end_s": 1.2},
        {"kind": "branch_trip", "branch": "7-8 a", "start_s": 1.2},
    ]
    fields = {"case": "two-area-actuators", "controller": "given", "stop_s": 2.7, "event": fault}
    channel = {"from_tie_p": {"signal": "tie_p", "latency_s": 0.0, "on_loss": "zero"}}
    scenario = load_scenario({**fields, "channels": channel})
    with Loop(scenario, cache=cache, controller=Controller.from_dict(saved)) as loop:
        fast = loop.master.run()
        swept = loop.master.repeated
        loop.master.engine = "python"
        loop.master.start()
        slow = loop.master.run()
    assert fast.engine == "kernel" and fast.time_s[-1] == 2.7
    assert fast.data.equals(slow.data) and loop.master.repeated == swept


def test_the_engine_that_ran_is_in_the_result(cache: Path, by_hand: Controller) -> None:
    with assembled(cache, by_hand) as loop:
        loop.master.advance(until_s=0.2)
        assert loop.master.trajectory.engine == "kernel"
        assert "stepped by: kernel" in loop.result().explain()
        loop.master.engine = "python"
        loop.master.advance(until_s=0.3)
        assert "stepped by: kernel, then python" in loop.result().explain()
        assert loop.master.trajectory.time_s[-1] == 0.3


def test_a_loop_without_a_channel_is_iterated_by_the_kernel(cache: Path, by_hand: Controller) -> None:
    with assembled(cache, by_hand, channels={"remote": REMOTE}) as loop:
        run = loop.master.run()
        assert run.engine == "kernel"
        assert loop.master.repeated > 0


def test_any_order_of_declaration_gives_the_same_bits(cache: Path, by_hand: Controller) -> None:
    with assembled(cache, by_hand) as loop:
        master = loop.master
        first = master.run().data
        wires = [(str(c.source), str(c.target)) for c in master.graph.connections]
        parts = [
            FmuParticipant(p.name, p.file, {n: v for n, (_, v) in p._start.items()})  # type: ignore[attr-defined]
            for p in master.participants.values()
        ]
        latency = master.plan.latency_s
    for _ in range(2):
        parts, wires = parts[::-1], wires[1:] + wires[:1]
        options: dict[str, Any] = {
            "stop_s": 2.0,
            "step_s": 0.01,
            "event_times_s": [0.7, 0.5],
            "latency_s": latency,
        }
        options["at_rest"] = True
        with Master(LoopPlan(wires, engine="kernel", **options), parts) as again:
            assert again.run().data.equals(first)


def test_kernel_and_python_take_over_from_each_other_at_any_point(cache: Path, by_hand: Controller) -> None:
    with assembled(cache, by_hand, channels={"remote": REMOTE}) as loop:
        master = loop.master
        whole = master.run().data
        master.start()
        while not master.finished:
            master.run(until_s=master.time_s + 0.13)
            for _ in range(7):
                master.step()
        assert master.trajectory.engine == "kernel, then python"
        assert master.trajectory.data.equals(whole)


def test_saving_restoring_and_forking_are_not_stopping(cache: Path, by_hand: Controller) -> None:
    with assembled(cache, by_hand, channels={"remote": REMOTE}) as loop:
        master = loop.master
        whole = master.run().data
        master.start()
        master.run(until_s=0.55)
        saved = master.save()
        ends = [master.run().data]
        for engine in ("kernel", "python"):
            master.restore(saved)
            master.engine = engine  # type: ignore[assignment]
            ends.append(master.run().data)
        master.release(saved)
        assert all(end.equals(whole) for end in ends)


def test_integers_and_reals_of_a_kicked_decay(cache: Path) -> None:
    """Its state jumps at 0.55 s: the Integer output counts it, the Real shows it."""
    file = FmuFile(block_fmu(decay_block(), cache))
    parts = [FmuParticipant("a", file, {"kicking": True}), FmuParticipant("b", file)]
    with Master(LoopPlan([("a.y", "b.u")], stop_s=2.0, step_s=0.1, event_times_s=[0.55]), parts) as master:
        fast = master.run()
        master.engine = "python"
        master.start()
        assert master.run().data.equals(fast.data)
    assert fast.engine == "kernel"
    assert list(np.unique(fast["a.kicks"])) == [0, 1]


# -- FMUs that others made ----------------------------------------------------------------


@pytest.fixture(scope="module")
def foreign(tmp_path_factory: pytest.TempPathFactory) -> dict[str, FmuFile]:
    builder = pytest.importorskip("pythonfmu.builder").FmuBuilder
    folder = tmp_path_factory.mktemp("pythonfmu")
    scripts = Path(__file__).parents[3] / "pythonfmus"
    return {n: FmuFile(builder.build_FMU(scripts / f"{n}.py", dest=folder)) for n in ("lag", "gate")}


def mixed(foreign: dict[str, FmuFile], **start: float) -> Master:
    """Lags in a ring, and gates whose every output feeds the next gate's inputs."""
    parts = [FmuParticipant(n, foreign["lag"], {"T": t}) for n, t in (("a", 0.5), ("b", 0.2))]
    parts += [FmuParticipant("g", foreign["gate"]), FmuParticipant("h", foreign["gate"], dict(start))]
    parts.append(FmuParticipant("sink", foreign["lag"]))
    wires = [("a.y", "b.u"), ("b.y", "a.u"), ("g.last", "h.u"), ("g.even", "h.open"), ("g.total", "h.add")]
    wires.append(("h.y", "sink.u"))
    return Master(LoopPlan(wires, stop_s=2.0, step_s=0.1, event_times_s=[0.55]), parts)


def test_foreign_fmus_with_values_of_every_type(foreign: dict[str, FmuFile]) -> None:
    with mixed(foreign) as master:
        fast = master.run()
    with mixed(foreign) as master:
        master.engine = "python"
        slow = master.run()
    assert (fast.engine, slow.engine) == ("kernel", "python")
    assert fast.data.equals(slow.data)
    assert set(fast["h.even"]) == {True, False}
    assert fast["h.y"].min() == -1.0 < fast["h.y"].max()
    assert fast["h.total"][-1] > fast["g.total"][-1] > 10


def check_the_same_stop(make: Callable[[], Master], says: str) -> StepError:
    """Run `make()` with both engines: the same error, the same results so far; return the kernel's error."""
    caught = []
    for engine in ("kernel", "python"):
        master = make()
        master.engine = engine  # type: ignore[assignment]
        with master, pytest.raises(StepError, match=says) as error:
            master.run()
        caught.append(error.value)
    fast, slow = caught
    assert str(fast) == str(slow)
    assert (fast.instance, fast.call, fast.time_s) == (slow.instance, slow.call, slow.time_s)
    assert fast.trajectory is not None and slow.trajectory is not None
    assert fast.trajectory.data.equals(slow.trajectory.data)
    return fast


def test_nan_is_named_and_the_results_so_far_are_kept(foreign: dict[str, FmuFile]) -> None:
    says = "h: reading outputs at t = 1 s: output y is nan"
    stop = check_the_same_stop(lambda: mixed(foreign, nan_at=1.0), says)
    assert stop.trajectory is not None
    assert stop.trajectory.time_s[-1] == pytest.approx(0.9)


def test_a_failing_fmu_is_named_with_call_time_and_its_last_log_line(cache: Path) -> None:
    """x jumps to about 2.6 at 0.55 s, above its ceiling of 2."""
    file = FmuFile(block_fmu(decay_block(), cache))
    start = {"kicking": True, "ceiling": 2.0}

    def make() -> Master:
        parts = [FmuParticipant("fine", file), FmuParticipant("bad", file, dict(start))]
        return Master(LoopPlan([("fine.y", "bad.u")], stop_s=2.0, step_s=0.1), parts)

    says = 'bad: fmi2DoStep at t = 0.5 s: returned discard.*"fmi2DoStep: decay: x = '
    stop = check_the_same_stop(make, says)
    assert stop.trajectory is not None
    assert stop.trajectory.time_s[-1] == 0.5
    assert "above the ceiling" in stop.last_log


# -- stopping -----------------------------------------------------------------------------


@pytest.fixture
def long_run(cache: Path, by_hand: Controller) -> Iterator[Master]:
    with assembled(cache, by_hand, stop_s=1000.0) as loop:
        loop.master.start()
        loop.master.run(until_s=0.1)
        yield loop.master


def test_ctrl_c_stops_within_50_ms_and_the_run_can_go_on(long_run: Master) -> None:
    sent: list[float] = []

    def interrupt() -> None:
        sent.append(time.process_time())  # of which a run takes all; others may hold the processor
        os.kill(os.getpid(), signal.SIGINT)

    timer = threading.Timer(0.1, interrupt)
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        long_run.run()
    assert time.process_time() - sent[0] < 0.05
    timer.join()
    so_far = long_run.trajectory.data
    assert 1.0 < long_run.time_s < 999.0
    until = long_run.time_s + 0.5
    went_on = long_run.run(until_s=round(until, 2)).data
    long_run.start()
    again = long_run.run(until_s=round(until, 2)).data
    assert again.equals(went_on)
    assert again[: len(so_far)].equals(so_far)


def test_another_thread_can_cancel(long_run: Master) -> None:
    done: list[float] = []
    thread = threading.Thread(target=lambda: done.append(long_run.run().time_s[-1]))
    thread.start()
    until = time.thread_time() + 0.02
    while time.thread_time() < until:  # beside the run
        pass
    long_run.cancel()
    thread.join()
    assert 0.1 < done[0] < 1000.0


def test_progress_is_told_and_may_cancel(long_run: Master) -> None:
    reported: list[tuple[float, float]] = []

    def progress(now_s: float, stop_s: float) -> None:
        reported.append((now_s, stop_s))
        if len(reported) == 3:
            long_run.cancel()

    run = long_run.run(progress=progress)
    assert [t for t, _ in reported] == sorted({t for t, _ in reported}) and len(reported) == 3
    assert run.time_s[-1] == pytest.approx(reported[-1][0], abs=0.01)
    assert reported[0][0] == 0.1  # where it stood: what was compiled before is no part of the rate
    assert reported[-1][1] == 1000.0


# -- what is left to Python ---------------------------------------------------------------


def test_participants_in_python_are_stepped_in_python_and_the_result_says_so() -> None:
    one = np.array([[-1.0]])
    part = Linear("x", one, one, one, np.zeros((1, 1)), ["u"], ["y"])
    run = Master(LoopPlan([], stop_s=0.1, step_s=0.01), [part]).run()
    assert run.engine == "python (x is not an FMU in this process)"
    with pytest.raises(GraphError, match=r'engine = "kernel" cannot step this: x is not an FMU'):
        Master(LoopPlan([], stop_s=0.1, step_s=0.01, engine="kernel"), [part]).run()
    with pytest.raises(GraphError, match="allowed are auto, kernel, python"):
        Master(LoopPlan([], stop_s=0.1, step_s=0.01, engine="fast"), [part])  # type: ignore[arg-type]


def test_without_a_compiler_python_steps_and_a_message_says_so(
    cache: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    file = FmuFile(block_fmu(decay_block(), cache))
    with Master(LoopPlan([], stop_s=1.0, step_s=0.1), [FmuParticipant("a", file)]) as master:
        fast = master.run()
    monkeypatch.setenv("CC", "no-such-compiler-anywhere")
    with Master(LoopPlan([], stop_s=1.0, step_s=0.1), [FmuParticipant("a", file)]) as master:
        slow = master.run()
    assert fast.engine == "kernel"
    assert slow.engine.startswith("python (the C compiler 'no-such-compiler-anywhere'")
    assert "stepping in Python" in caplog.text
    assert slow.data.equals(fast.data)
    with (
        Master(LoopPlan([], stop_s=1.0, step_s=0.1, engine="kernel"), [FmuParticipant("a", file)]) as master,
        pytest.raises(GraphError, match="no-such-compiler-anywhere"),
    ):
        master.run()


def test_a_kernel_of_another_layout_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernel_build, "_MIRRORED", kernel_build._MIRRORED[1:] + kernel_build._MIRRORED[:1])
    kernel_build._library.cache_clear()
    with pytest.raises(BuildError, match="has structures of"):
        kernel_build.load_kernel()
    kernel_build._library.cache_clear()


def test_a_discarded_step_is_handed_to_the_participant_with_what_was_sent(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Who finishes such a step sees the same in both engines: interval, inputs and their derivatives."""
    file = FmuFile(block_fmu(decay_block(), cache))
    seen: dict[str, list[tuple[str, float, float, list[float]]]] = {"kernel": [], "python": []}
    errors = []
    for engine, calls in seen.items():

        def finish(self: FmuParticipant, time_s: float, length_s: float, calls: Any = calls) -> None:
            calls.append((self.name, time_s, length_s, [self.u[0], *self.du[:3]]))

        monkeypatch.setattr(FmuParticipant, "discarded", finish)
        parts = [FmuParticipant("a", file), FmuParticipant("b", file, {"kicking": True, "ceiling": 2.0})]
        master = Master(LoopPlan([("a.y", "b.u")], stop_s=1.0, step_s=0.1), parts)
        master.engine = engine  # type: ignore[assignment]
        with master, pytest.raises(StepError, match=r"not allowed in state .step discarded") as error:
            master.run()  # taken as finished, but the FMU waits for its state to be put back
        errors.append(str(error.value))
    assert errors[0] == errors[1]
    assert seen["kernel"] == seen["python"]
    ((name, time_s, length_s, sent),) = seen["kernel"]
    assert (name, time_s, length_s) == ("b", 0.5, 0.1)
    assert sent[:2] == pytest.approx([np.exp(-0.5), -np.exp(-0.5)], rel=1e-6)
