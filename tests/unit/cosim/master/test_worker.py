"""An FMU in a worker process: same bits as in this one, and a crash that only fails the run."""

from __future__ import annotations

import signal
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from misbehaving import misbehaving_fmu

from interarea.cosim.errors import GraphError, ScenarioError, StepError
from interarea.cosim.master.isolated import WorkerParticipant
from interarea.cosim.run.run import run_system
from interarea.cosim.run.system import System
from interarea.cosim.scenario.scenario import load_scenario


@pytest.fixture(scope="module")
def misbehaving(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return misbehaving_fmu(tmp_path_factory.mktemp("misbehaving"))


def ring(misbehaving: Path, isolated: str) -> System:
    """dx/dt = y, dy/dt = x with x(0) = 1, y(0) = 0, iterated: states are saved in the worker too."""
    system = System(stop_s=1.0, step_s=0.1)
    system.fmu("x", misbehaving, x0=1.0, isolate="x" in isolated).fmu(
        "y", misbehaving, isolate="y" in isolated
    )
    return system.connect("x.y", "y.u").connect("y.y", "x.u")


@pytest.mark.slow
@pytest.mark.parametrize("isolated", ["x"])
def test_isolated_or_not_the_bits_are_the_same(misbehaving: Path, isolated: str) -> None:
    shared, there = ring(misbehaving, "").run(), ring(misbehaving, isolated).run()
    assert there.data.equals(shared.data)
    np.testing.assert_allclose(there["x.y"], np.cosh(there["time_s"]), rtol=1e-6)


@pytest.mark.slow
def test_an_fmu_that_aborts_fails_the_run_and_the_caller_lives(misbehaving: Path) -> None:
    system = System(stop_s=1.0, step_s=0.1).fmu("x", misbehaving, u=1.0)
    system.fmu("bad", misbehaving, isolate=True, abort_at=0.45).connect("x.y", "bad.u")
    with pytest.raises(
        StepError, match=r"bad: fmi2DoStep at t = 0\.4 s: the FMU crashed its process"
    ) as caught:
        system.run()
    if sys.platform != "win32":
        assert signal.SIGABRT.name in str(caught.value)
    assert 'its last log line: "about to abort"' in str(caught.value)
    run = caught.value.trajectory
    assert run is not None and run.time_s[-1] == 0.4
    np.testing.assert_allclose(run["bad.y"], run.time_s**2 / 2, rtol=1e-12)


@pytest.mark.slow
def test_a_crashed_worker_is_started_again_for_another_run(misbehaving: Path) -> None:
    system = System(stop_s=1.0, step_s=0.1).fmu("bad", misbehaving, isolate=True, u=1.0, abort_at=0.45)
    with system.master() as master:
        with pytest.raises(StepError, match="crashed its process"):
            master.run()
        part = master.participants["bad"]
        assert isinstance(part, WorkerParticipant)
        part.set_start({"u": 1.0})
        master.start()
        run = master.run()
    np.testing.assert_allclose(run["bad.y"], run.time_s, rtol=1e-12)


@pytest.mark.slow
def test_errors_of_the_fmu_travel_with_all_they_say(misbehaving: Path) -> None:
    system = System(stop_s=1.0, step_s=0.1).fmu("a", misbehaving, isolate=True, u=1.0, end_at=0.55)
    with pytest.raises(
        StepError, match=r"a: fmi2DoStep at t = 0\.5 s: asks for the simulation to end"
    ) as caught:
        system.run()
    assert (caught.value.instance, caught.value.time_s) == ("a", 0.5)
    assert caught.value.trajectory is not None and caught.value.trajectory.time_s[-1] == 0.5


@pytest.mark.slow
@pytest.mark.parametrize("early", ["continue", "roll back"])
def test_early_returns_of_an_isolated_fmu(misbehaving: Path, early: str) -> None:
    runs = []
    for isolate in (False, True):
        system = System(stop_s=1.0, step_s=0.1, early=early)
        system.fmu("a", misbehaving, isolate=isolate, u=1.0, early_at=0.4321, kick=0.5)
        runs.append(system.run().data)
    assert runs[0].equals(runs[1])
    assert runs[0]["a.y"].iloc[-1] == pytest.approx(1.5, rel=1e-12)


@pytest.mark.slow
def test_an_fmu_that_hangs_is_ended_and_may_run_again(misbehaving: Path) -> None:
    system = System(stop_s=1.0, step_s=0.1)
    system.fmu("stuck", misbehaving, isolate=True, time_limit_s=1.0, u=1.0, hang_at=0.45)
    with system.master() as master:
        with pytest.raises(
            StepError,
            match=r"stuck: fmi2DoStep at t = 0\.4 s: no answer within 1 s.*allow more with time_limit_s",
        ) as caught:
            master.run()
        run = caught.value.trajectory
        assert run is not None and run.time_s[-1] == 0.4
        part = master.participants["stuck"]
        assert isinstance(part, WorkerParticipant)
        part.set_start({"u": 1.0})
        master.start()
        np.testing.assert_allclose(master.run()["stuck.y"][-1], 1.0, rtol=1e-12)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="a signal interrupts what the main thread waits for")
def test_an_interrupt_within_a_call_leaves_no_worker_for_long(misbehaving: Path) -> None:
    """It hears of its end after the call alone: with the patience of an end in order it would live 5 s."""
    system = System(stop_s=1.0, step_s=0.1)
    system.fmu("stuck", misbehaving, isolate=True, time_limit_s=60.0, u=1.0, hang_at=0.45)
    sent_s: list[float] = []
    workers: list[Any] = []
    with pytest.raises(KeyboardInterrupt), system.master() as master:
        part = master.participants["stuck"]
        assert isinstance(part, WorkerParticipant)

        def interrupt() -> None:
            workers.append(part._process)
            sent_s.append(time.monotonic())
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)

        threading.Timer(2.0, interrupt).start()
        master.run()
    assert time.monotonic() - sent_s[0] < 4.0
    assert workers[0].poll() is not None


def test_a_time_limit_needs_a_process_and_is_positive(misbehaving: Path) -> None:
    system = System(stop_s=1.0, step_s=0.1)
    with pytest.raises(ScenarioError, match="set isolate = true"):
        system.fmu("a", misbehaving, time_limit_s=1.0)
    with pytest.raises(ScenarioError, match="time_limit_s = -1, allowed: above 0"):
        system.fmu("a", misbehaving, isolate=True, time_limit_s=-1.0)
    with pytest.raises(ScenarioError, match=r"fmus\.a.*set isolate = true"):
        load_scenario({"stop_s": 1.0, "fmus": {"a": {"file": str(misbehaving), "time_limit_s": 1.0}}})


@pytest.mark.slow
def test_values_can_be_read_and_no_process_is_left(misbehaving: Path) -> None:
    system = System(stop_s=1.0, step_s=0.1).fmu("a", misbehaving, isolate=True, u=1.0)
    with system.master() as master:
        part = master.participants["a"]
        assert isinstance(part, WorkerParticipant)
        master.run()
        assert part.value_of("u") == 1.0
        with pytest.raises(GraphError, match="no variable 'v'"):
            part.value_of("v")
        process = part._process
        assert process is not None and process.poll() is None
    assert process.poll() == 0
    with pytest.raises(StepError, match="the instance has ended"):
        part.value_of("u")


@pytest.mark.slow
def test_a_scenario_file_isolates(misbehaving: Path, tmp_path: Path) -> None:
    file = tmp_path / "crash.toml"
    text = f'stop_s = 1.0\nstep_s = 0.1\n[fmus.bad]\nfile = "{misbehaving.as_posix()}"\nisolate = true\n'
    file.write_text(text + "start = {u = 1.0, abort_at = 0.75}\n", encoding="utf-8")
    with pytest.raises(StepError, match=r"bad: fmi2DoStep at t = 0\.7 s: the FMU crashed its process"):
        run_system(file)
