"""IEEE/CIGRE DLLs in a run: in a process of their own, called at their sample times."""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from zig_compiler import lag_dll

import interarea
from interarea.cosim.errors import GraphError, ScenarioError, StepError
from interarea.cosim.export.instances import members_of
from interarea.cosim.run.controllers import controller_of
from interarea.cosim.run.run import system_of
from interarea.cosim.run.system import System
from interarea.cosim.scenario.scenario import load_scenario
from interarea.fmu_build.errors import FmuFileError
from interarea.fmu_build.write.real_code import build_dll
from interarea.models.case.case import load_case

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the DLLs are compiled for Linux")
SCENARIO = """
name = "with-dll"
case = "two-area-thesis"
stop_s = 3.0
step_s = 0.01
connections = [
    ["plant.G2_dw", "remote", "mine.G2_dw"],
    ["plant.G4_dw", "mine.G4_dw"],
    ["mine.G4_vs", "plant.G4_vs"],
]
[fmus.mine]
file = "robust.so"
start = { limit = 0.15 }
[channels.remote]
latency_s = 0.1
[[event]]
kind = "vref_pulse"
machine = "G1"
size_pu = 0.05
start_s = 1.0
end_s = 1.2
"""


@pytest.fixture(scope="module")
def robust(cache: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the DLL of the bundled controller `robust`, to be called every millisecond."""
    case = load_case("two-area-thesis")
    controller = controller_of("robust", case, cache)
    assert controller is not None
    folder = tmp_path_factory.mktemp("dll")
    return build_dll(controller.block(case.omega_b), folder, platform="linux64", cache=cache)


def loop(step_s: float, dll: Path | None, cache: Path) -> np.ndarray:
    """Speed of G2 in a loop that is closed by the FMU of `robust` or by its DLL."""
    system = System(stop_s=3.0, step_s=step_s, cache=cache)
    system.plant("two-area-thesis")
    if dll is None:
        system.controller("robust")
    else:
        system.fmu("controller", dll)
    system.channel("remote", latency_s=0.1)
    system.connect("plant.G2_dw", "remote", "controller.G2_dw").connect("plant.G4_dw", "controller.G4_dw")
    system.connect("controller.G4_vs", "plant.G4_vs")
    system.event("vref_pulse", machine="G1", size_pu=0.05, start_s=1.0, end_s=1.2)
    data = system.run().data
    return np.interp(np.arange(0.0, 3.0, 0.01), data["time_s"].to_numpy(), data["plant.G2_dw"].to_numpy())


@pytest.mark.slow
def test_a_dll_closes_the_loop_as_the_fmu_does(robust: Path, cache: Path) -> None:
    """The DLL's output is held over a step, so the difference is half a step of delay and falls with it."""
    fmu = loop(0.01, None, cache)
    errors = [np.abs(loop(step_s, robust, cache) - fmu).max() / np.abs(fmu).max() for step_s in (0.01, 0.002)]
    assert errors[1] < 5e-4
    assert 4.0 < errors[0] / errors[1] < 6.0


@pytest.mark.slow
def test_a_scenario_names_a_dll_among_its_fmus(robust: Path, tmp_path: Path) -> None:
    (tmp_path / "robust.so").write_bytes(robust.read_bytes())
    file = tmp_path / "loop.toml"
    file.write_text(SCENARIO)
    run = interarea.simulate(file)
    assert float(np.abs(run.data["mine.G4_vs"]).max()) > 1e-3
    file.write_text(SCENARIO.replace("limit = 0.15", "limit = 1e-4"))
    assert float(np.abs(interarea.simulate(file).data["mine.G4_vs"]).max()) == 1e-4


@pytest.mark.slow  # two runs of a plant
def test_a_scenario_names_a_dll_as_its_controller(robust: Path, cache: Path) -> None:
    """Signals find its inputs by their names, as those of an FMU; as with connections in words."""
    table = tomllib.loads(SCENARIO) | {"stop_s": 1.5}
    table["fmus"]["mine"] = {"file": str(robust)}
    short = {k: v for k, v in table.items() if k not in ("connections", "fmus")}
    short["controller"] = str(robust)
    short["channels"] = {"remote": {"signal": "G2_dw", "latency_s": 0.1}}
    run, both = interarea.simulate(short), interarea.simulate(table)
    result, expected = run.data["controller.G4_vs"].to_numpy(), both.data["mine.G4_vs"].to_numpy()
    assert np.abs(result).max() > 1e-3
    assert np.abs(result - expected).max() < 1e-12, np.abs(result - expected).max()
    loaded = load_scenario(short)
    assert system_of(loaded, cache=cache).linear_swings() == "controller may have any effect"
    with pytest.raises(ScenarioError, match="controller run as DLLs, which an archive"):
        members_of(loaded, cache=cache)
    with pytest.raises(ScenarioError, match="controller_gain and controller_limit_pu have no effect on"):
        load_scenario(short | {"controller_gain": 2.0})
    with pytest.raises(ScenarioError, match="is a DLL, its equations"):
        controller_of(robust, loaded.load_case(), cache)


@pytest.mark.slow
def test_what_is_wrong_with_a_dll_is_one_error(robust: Path, tmp_path: Path, cache: Path) -> None:
    system = System(stop_s=1.0, step_s=0.01, cache=cache)
    with pytest.raises(GraphError, match=r"no 'limmit' in robust\.so"):
        system.fmu("mine", robust, start={"limmit": 1.0}).run()
    for name, content in (("text.so", b"hello"), ("windows.dll", b"MZ" + bytes(62)), ("empty.so", b"")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(FmuFileError, match="the system cannot load it") as refused:
            System(stop_s=1.0, cache=cache).fmu("mine", tmp_path / name)
        assert "\n" not in str(refused.value)
    with pytest.raises(FmuFileError, match="no IEEE/CIGRE DLL: it does not have Model_GetInfo"):
        System(stop_s=1.0, cache=cache).fmu(
            "mine", lag_dll("NO_INTERFACE", tmp_path, cache, "-DModel_GetInfo=other")
        )
    for defect in ("CRASH_ON_LOAD", "CRASH"):
        with pytest.raises(StepError, match=r"the DLL crashed its process \(SIGABRT\)") as error:
            System(stop_s=1.0, step_s=0.01, cache=cache).fmu("mine", lag_dll(defect, tmp_path, cache)).run()
        assert "\n" not in str(error.value)
    preset = System(stop_s=0.1, step_s=0.01, cache=cache).fmu("mine", robust, start={"G4_vs": 0.01}).run()
    (line,) = preset.fmu_log  # what a DLL says with return code 1
    assert "output G4_vs starts at 0, not at the 0.01" in line
    with pytest.raises(GraphError, match=r"robust\.so: limit = 'much', allowed: a number"):
        system.fmu("mine", robust, start={"limit": "much"}).run()
    bad = System(stop_s=1.0, step_s=0.01, cache=cache).fmu("mine", robust, start={"limit": -1.0})
    with pytest.raises(StepError, match="limit was set to -1; allowed are 0 to"):
        bad.run()
