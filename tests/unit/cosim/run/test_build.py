"""Systems put together in Python: the same run as the scenario file, any FMU, steps by hand, mistakes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from participants import Delay, Linear

from interarea.cosim.errors import GraphError, ScenarioError
from interarea.cosim.run.run import run_scenario
from interarea.cosim.run.system import System
from interarea.design.controllers.controller import Controller
from interarea.fmu_build.errors import FmuFileError
from interarea.models.case.case import CaseError

PULSE = {"machine": "G1", "size_pu": 0.05, "start_s": 0.5, "end_s": 0.7}


def decay(name: str, rate: float, **abilities: bool) -> Linear:
    """dx/dt = rate (u - x), y = x, x(0) = 1."""
    one = np.array([[1.0]])
    return Linear(name, -rate * one, rate * one, one, 0 * one, ["u"], ["y"], x0=np.ones(1), **abilities)


def grid(controller: Controller, **options: object) -> System:
    system = System(stop_s=1.5, **options)  # type: ignore[arg-type]
    system.plant("two-area-thesis").controller(controller)
    system.channel("remote", latency_s=0.1, outages_s=[(1.0, 1.2)])
    system.connect("plant.G2_dw", "remote", "controller.G2_dw")
    system.connect("plant.G4_dw", "controller.G4_dw")
    system.connect("controller.G4_vs", "plant.G4_vs")
    return system.event("vref_pulse", **PULSE)


def test_a_system_in_python_is_the_scenario_to_the_bit(hand_controller: Controller) -> None:
    result = grid(hand_controller).run()
    scenario = {
        "case": "two-area-thesis",
        "controller": "wdc",
        "stop_s": 1.5,
        "channels": {"remote": {"signal": "G2_dw", "latency_s": 0.1, "outages_s": [[1.0, 1.2]]}},
        "event": [PULSE | {"kind": "vref_pulse"}],
    }
    run = run_scenario(scenario, controller=hand_controller)
    assert result.data.equals(run.data)
    assert result.units["plant.G2_dw"] == "pu" and result.data.attrs["units"]["time_s"] == "s"
    assert result.ledger["remote.u"].total_s == 0.1
    assert result.explain() == run.explain()


def test_stepped_by_hand_is_the_run_and_progress_counts_to_the_end() -> None:
    system = System(stop_s=1.0, step_s=0.1).add(decay("a", 1.0)).add(decay("b", 2.0)).connect("a.y", "b.u")
    seen: list[tuple[float, float]] = []
    whole = system.run(progress=lambda now, stop: seen.append((now, stop))).data
    with system.master() as master:
        times = []
        while master.step():
            times.append(master.time_s)
        assert master.finished
        assert master.trajectory.data.equals(whole)
    assert times == pytest.approx(np.arange(1, 11) / 10, abs=1e-15)
    assert seen[-1] == (1.0, 1.0) and [now for now, _ in seen] == sorted(now for now, _ in seen)


def test_a_progress_that_raises_stops_the_run_where_it_is() -> None:
    def stop_at_half(now: float, _: float) -> None:
        if now >= 0.5:
            raise KeyboardInterrupt

    system = System(stop_s=1.0, step_s=0.1).add(decay("a", 1.0))
    with system.master() as master:
        with pytest.raises(KeyboardInterrupt):
            master.run(progress=stop_at_half)
        run = master.trajectory
    assert run.time_s[-1] == 0.5
    np.testing.assert_allclose(run["a.y"], np.exp(-run.time_s), rtol=1e-12)


def test_a_path_goes_through_channels_and_any_participant() -> None:
    """A delay of 0.2 s, then a channel FMU of 0.1 s: y = exp(-(t - 0.3)) behind both, 1 before."""
    system = System(stop_s=1.0, step_s=0.05).add(decay("a", 1.0)).add(Delay("late", 0.2), latency_s=0.2)
    system.channel("line", latency_s=0.1)
    system.connect("a.y", "late.u").connect("late.y", "line").add(decay("end", 50.0))
    system.connect("line", "end.u")
    result = system.run()
    t = result["time_s"]
    assert [str(c) for c in system.master().graph.connections] == [
        "line.y -> end.u",
        "a.y -> late.u",
        "late.y -> line.u",
    ]
    exact = np.where(t < 0.3, 1.0, np.exp(-(t - 0.3)))
    np.testing.assert_allclose(result["line.y"], exact, atol=1e-6)
    assert {"line"} == set(result.packets.rows)


@pytest.mark.parametrize(
    ("mistake", "error", "says"),
    [
        (lambda s: s.connect("a.y"), GraphError, "a source and a target are needed"),
        (lambda s: s.connect("a.y", "remote", "b.u"), GraphError, "'remote' on the way is no channel"),
        (lambda s: s.add(decay("a", 1.0)), ScenarioError, "two instances are named 'a'"),
        (lambda s: s.channel("c", latency=0.1), ScenarioError, r"channels\.c\.latency"),
        (lambda s: s.channel("c", latenzy_s=0.1), ScenarioError, "did you mean 'latency_s'"),
        (lambda s: s.channel("c", jitter_s=0.1), ScenarioError, "set reporting_interval_s"),
        (
            lambda s: s.channel("c", outages_s=[(k, k + 0.5) for k in range(9)]),
            ScenarioError,
            r"channels\.c\.outages_s has 9 windows, allowed: at most 8",
        ),
        (lambda s: s.controller("wdc"), ScenarioError, "add the plant first"),
        (lambda s: s.plant("two-area-thesys"), CaseError, "two-area-thesis"),
        (lambda s: s.event("vref_pulse", **PULSE), ScenarioError, "add the plant first"),
        (lambda s: s.fmu("x", "missing.fmu"), FmuFileError, "missing.fmu: no such file, wanted: an FMU"),
        (lambda s: s.connect("a.y", "b.v").master(), GraphError, "b has no input 'v'; there are: u"),
        (lambda s: s.participant("aa"), GraphError, "did you mean 'a'"),
    ],
)
def test_mistakes_are_refused(mistake: object, error: type[Exception], says: str) -> None:
    system = System(stop_s=1.0).add(decay("a", 1.0)).add(decay("b", 1.0))
    with pytest.raises(error, match=says):
        mistake(system)  # type: ignore[operator]


def test_mistakes_beside_a_plant(tmp_path: Path) -> None:
    system = System(stop_s=1.0).plant("two-area-thesis")
    with pytest.raises(ScenarioError, match=r"'wdcc' is neither a name nor a file; did you mean 'wdc'"):
        system.controller("wdcc")
    with pytest.raises(CaseError, match="G9"):
        system.event("vref_pulse", **PULSE | {"machine": "G9"})
    with pytest.raises(ScenarioError, match="vref_pulse"):
        system.event("vref_puls", **PULSE)
    assert system.event_times_s == ()


def test_times_of_an_event_may_be_words_as_in_a_file() -> None:
    """6 cycles of the plant's 60 Hz are 0.1 s."""
    system = System(stop_s=2.0).plant("two-area-thesis")
    system.event("bus_fault", bus=8, start_s="1 s", end_s="start + 6 cycles")
    (event,) = system.events["plant"]
    assert event.start_s == 1.0
    assert event.end_s == pytest.approx(1.1, abs=1e-12)
