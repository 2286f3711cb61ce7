"""An FMU made by pythonfmu in a loop with ours, through a channel or not: the loop our own FMU makes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from interarea.cosim.errors import ScenarioError
from interarea.cosim.results.delay_ledger import delay_ledger
from interarea.cosim.results.run import Run
from interarea.cosim.run.run import run_scenario, run_system
from interarea.cosim.run.system import System
from interarea.cosim.scenario.scenario import load_scenario
from interarea.fmu_build.write.package import build_fmu
from interarea.models.blocks.controller import controller_block

pythonfmu = pytest.importorskip("pythonfmu.builder")

GAIN, LAG_S = -12.0, 0.1
PULSE = {"machine": "G1", "size_pu": 0.02, "start_s": 0.5, "end_s": 0.7}


@pytest.fixture(scope="module")
def damper(tmp_path_factory: pytest.TempPathFactory) -> Path:
    script = Path(__file__).parents[3] / "pythonfmus" / "damper.py"
    return Path(pythonfmu.FmuBuilder.build_FMU(script, dest=tmp_path_factory.mktemp("damper")))


@pytest.fixture(scope="module")
def ours(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same lag as a block of ours."""
    rate = 1.0 / LAG_S
    block = controller_block("ours", [[-rate]], [[rate * GAIN]], [[1.0]], [[0.0]], ["u"], ["y"], limit=10.0)
    return build_fmu(block, tmp_path_factory.mktemp("ours"))


def loop(file: Path, path: tuple[str, ...], step_s: float, **options: Any) -> System:
    system = System(stop_s=3.0, step_s=step_s).plant("two-area-thesis").fmu("damper", file, **options)
    system.channel("remote", latency_s=0.1)
    system.connect("plant.G4_dw", *path, "damper.u").connect("damper.y", "plant.G4_vs")
    return system.event("vref_pulse", **PULSE)


def dw24(system: System) -> np.ndarray:
    run = system.run()
    grid = np.isclose(run["time_s"] * 50, np.round(run["time_s"] * 50), atol=1e-9)  # what all steps share
    return (run["plant.G2_dw"] - run["plant.G4_dw"])[grid]


@pytest.mark.parametrize("path", [("remote",), ()])
def test_it_makes_the_loop_that_our_own_fmu_makes(damper: Path, ours: Path, path: tuple[str, ...]) -> None:
    """It holds its input over parts of a step: second order in the step, towards the run of our FMU."""
    exact = dw24(loop(ours, path, 0.005))
    peak = np.max(np.abs(exact))
    errors = [
        np.max(np.abs(dw24(loop(damper, path, h, gain=GAIN, T=LAG_S)) - exact)) / peak for h in (0.02, 0.01)
    ]
    assert errors[1] <= 1e-3
    assert errors[0] / errors[1] >= 3.0


def test_the_ledger_says_what_it_cannot_take(damper: Path) -> None:
    with loop(damper, (), 0.01, gain=GAIN).master() as master:
        assert delay_ledger(master)["damper.u"].note.startswith("no input derivatives: means over 4 parts")
    assert loop(damper, ("remote",), 0.01).self_test().passed


SCENARIO = """
case = "two-area-thesis"
stop_s = 1.0
connections = [["plant.G4_dw", "remote", "damper.u"], ["damper.y", "plant.G4_vs"]]
[channels.remote]
latency_s = 0.1
[fmus.damper]
file = "{file}"
start = {{gain = -12.0, T = 0.1}}
[[event]]
kind = "vref_pulse"
machine = "G1"
size_pu = 0.02
start_s = 0.5
end_s = 0.7
"""


def test_a_scenario_file_takes_it_beside_the_plant(damper: Path, tmp_path: Path) -> None:
    file = tmp_path / "foreign.toml"
    file.write_text(SCENARIO.format(file=damper.as_posix()), encoding="utf-8")
    run = run_system(file)
    assert isinstance(run, Run) and run.scenario.name == "foreign"
    system = loop(damper, ("remote",), 0.01, gain=GAIN, T=LAG_S)
    system.stop_s = 1.0
    assert run.data.equals(system.run().data)


def test_a_scenario_without_a_case_runs_fmus_alone(damper: Path, tmp_path: Path) -> None:
    """Two dampers in a row on a constant: the step answer of two lags."""
    table: dict[str, Any] = {
        "stop_s": 1.0,
        "step_s": 0.01,
        "fmus": {
            "a": {"file": str(damper), "start": {"u": 1.0, "gain": 1.0, "T": 0.2}},
            "b": {"file": str(damper), "start": {"gain": 1.0, "T": 0.1}},
        },
        "connections": [["a.y", "b.u"]],
    }
    result = run_system(table)
    t = result["time_s"]
    np.testing.assert_allclose(
        result["b.y"], 1 - (0.2 * np.exp(-t / 0.2) - 0.1 * np.exp(-t / 0.1)) / 0.1, atol=1e-4
    )
    with pytest.raises(ScenarioError, match="case is missing; run_system runs FMUs without one"):
        run_scenario(table)


def test_any_fmu_can_be_the_controller(damper: Path) -> None:
    """Its ports are matched by name, so this one is refused with what the plant has."""
    with pytest.raises(ScenarioError, match=r"none of its outputs .*'y': there are: G1_vs, G2_vs"):
        run_scenario({"case": "two-area-thesis", "controller": str(damper), "stop_s": 1.0})


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"fmus": {}}, "case is missing"),
        ({"event": [{"kind": "vref_pulse", **PULSE}]}, "event and controller need a case"),
        ({"connections": [["a.y"]]}, r"connections has \['a.y'\], allowed: source, channels, target"),
        ({"channels": {"c": {"latency_s": 0.1}}}, "channels.c: signal is missing"),
        ({"channels": {"c": {"latency_s": 0.1, "signal": "x"}}}, "channels.c: signal needs a case"),
        ({"fmus": {"plant": {"file": "a.fmu"}}}, "fmus.plant: its name must be an identifier other than"),
        ({"fmus": {"a": {"file": "a.fmu", "fil": 1}}}, "did you mean 'file'"),
    ],
)
def test_mistakes_of_such_a_scenario(change: dict[str, Any], says: str) -> None:
    table = {"stop_s": 1.0, "fmus": {"a": {"file": "a.fmu"}}, "connections": []}
    with pytest.raises(ScenarioError, match=says):
        load_scenario(table | change)
