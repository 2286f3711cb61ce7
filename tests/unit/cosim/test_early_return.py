"""Steps that an FMU does not do to their end: gone on with, or rolled back to the instant it reached."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from misbehaving import misbehaving_fmu

from interarea.cosim.errors import GraphError, StepError
from interarea.cosim.run.system import System
from interarea.cosim.scenario.scenario import load_scenario

ENGINES = ("kernel", "python")


@pytest.fixture(scope="module")
def misbehaving(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return misbehaving_fmu(tmp_path_factory.mktemp("misbehaving"))


def chain(misbehaving: Path, early_at: float, **options: Any) -> System:
    """dx/dt = 2 - t; dy/dt = x, y jumps by 0.5 at `early_at`, where its FMU returns; dz/dt = y."""
    system = System(stop_s=1.0, step_s=0.1, **options)
    system.fmu("ramp", misbehaving, x0=2.0, u=-1.0)
    system.fmu("y", misbehaving, early_at=early_at, kick=0.5).fmu("z", misbehaving)
    return system.connect("ramp.y", "y.u").connect("y.y", "z.u")


def test_the_word_of_0_1_for_continue_is_still_read(misbehaving: Path) -> None:
    same = {"case": "two-area-thesis", "stop_s": 1.0, "master": {"early": "go on"}}
    assert load_scenario(same).master.early == "continue"
    with chain(misbehaving, 0.4321, early="go on").master() as master:
        assert master.plan.early == "continue"


def exact(t: np.ndarray, at: float) -> tuple[np.ndarray, np.ndarray]:
    late = np.maximum(t - at, 0.0)
    return 2 * t - t**2 / 2 + 0.5 * (t >= at), t**2 - t**3 / 6 + 0.5 * late


@pytest.mark.parametrize("engine", ENGINES)
def test_an_fmu_that_returns_early_goes_on_from_there(misbehaving: Path, engine: str) -> None:
    """It gets its input along the same polynomial: what it integrates is exact, jump and all."""
    result = chain(misbehaving, 0.4321, engine=engine).run()
    y, _ = exact(result["time_s"], 0.4321)
    np.testing.assert_allclose(result["y.y"], y, rtol=1e-12)


def test_both_engines_give_the_same_bits(misbehaving: Path) -> None:
    kernel, python = (chain(misbehaving, 0.4321, engine=engine).run().data for engine in ENGINES)
    assert kernel.equals(python)


def test_rolled_back_the_others_see_it_at_its_instant(misbehaving: Path) -> None:
    """z integrates the jump of y from the instant it happened (a tick is 1 ns), not from the step's end."""
    going_on = chain(misbehaving, 0.4321).run()
    with chain(misbehaving, 0.4321, early="roll back").master() as master:
        rolled = master.run()
        assert master.rolled_back == 1
    y, z = exact(rolled.time_s, 0.4321)
    np.testing.assert_allclose(rolled["y.y"], y, atol=1e-12)
    np.testing.assert_allclose(rolled["z.y"], z, atol=1e-9)
    assert np.max(np.abs(going_on["z.y"] - z)) > 1e-3
    np.testing.assert_array_equal(rolled.time_s, going_on["time_s"])
    assert rolled.data.equals(chain(misbehaving, 0.4321, early="roll back").run().data)


@pytest.mark.parametrize("early", ["continue", "roll back"])
def test_an_fmu_that_takes_short_steps_only_gets_them(misbehaving: Path, early: str) -> None:
    """Steps of 30 ms at most where 100 are asked: halved until it takes them."""
    system = System(stop_s=1.0, step_s=0.1, early=early)
    system.fmu("a", misbehaving, longest=0.03, u=1.0)
    result = system.run()
    np.testing.assert_allclose(result["a.y"], result["time_s"], rtol=1e-12)


@pytest.mark.parametrize("early", ["continue", "roll back"])
@pytest.mark.parametrize(
    ("start", "says", "time_s"),
    [
        ({"longest": 1e-17}, "returned discard|returns discard repeatedly and stays at", 0.0),
        ({"end_at": 0.55}, r"asks for the simulation to end at t = 0\.55 s", 0.5),
        ({"back_at": 0.25}, r"names t = -0\.8 s as the time it reached, outside its step", 0.2),
    ],
)
def test_what_cannot_go_on_fails_with_the_results_so_far(
    misbehaving: Path, early: str, start: dict[str, float], says: str, time_s: float
) -> None:
    system = System(stop_s=1.0, step_s=0.1, early=early).fmu("a", misbehaving, u=1.0, **start)
    with pytest.raises(StepError, match=says) as caught:
        system.run()
    assert (caught.value.instance, caught.value.call) == ("a", "fmi2DoStep")
    assert caught.value.time_s == pytest.approx(time_s, abs=1e-6)
    assert caught.value.trajectory is not None
    assert caught.value.trajectory.time_s[-1] == pytest.approx(time_s, abs=0.1 + 1e-12)
    run = caught.value.trajectory
    np.testing.assert_allclose(run["a.y"], run.time_s, atol=1e-12)


def test_rolling_back_asks_for_saved_states_and_python(tmp_path: Path, misbehaving: Path) -> None:
    lame = misbehaving_fmu(tmp_path, saves_state=False)
    with pytest.raises(GraphError, match="a cannot save its state"):
        System(stop_s=1.0, early="roll back").fmu("a", lame).run()
    with pytest.raises(GraphError, match="cannot roll back"):
        System(stop_s=1.0, early="roll back", engine="kernel").fmu("a", misbehaving).master()
    with pytest.raises(GraphError, match="early = 'never': allowed are continue, roll back"):
        System(stop_s=1.0, early="never").fmu("a", misbehaving).master()
