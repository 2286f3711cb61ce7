"""Each FMU by itself in every tool: FMPy (both kinds), cofmupy, libcosim, Ecos, and inside fmucontainer."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import fmpy
import numpy as np
import numpy.typing as npt
import pytest
from tools.conftest import RunTool, require

from interarea.cosim.export.instances import Member, members_of
from interarea.cosim.run.run import run_scenario
from interarea.cosim.scenario.scenario import load_scenario
from interarea.design.controllers.controller import Controller
from interarea.fmu_build.open.fmu_file import FmuFile
from interarea.fmu_build.write.package import block_fmu, build_fmu
from interarea.models.blocks.channel import channel_block
from interarea.models.blocks.plant import event_parameters, plant_block
from interarea.models.case.case import Case

Array = npt.NDArray[np.float64]
STEP, STOP = 0.01, 1.5
OUTPUTS = {"plant": ["G2_dw", "G2_vt", "tie_p"], "controller": ["G4_vs"], "channel": ["y", "age"]}
PULSE = {"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 0.2, "end_s": 0.4}
SCENARIO = {
    "name": "loop",
    "case": "two-area-thesis",
    "controller": "ftc",
    "stop_s": STOP,
    "step_s": STEP,
    "channels": {"remote": {"signal": "G2_dw", "latency_s": 0.1}},
    "event": [PULSE],
}


@pytest.fixture(scope="module")
def members(two_area: Case, hand_controller: Controller, cache: Path) -> dict[str, Member]:
    """Return each kind with start values under which its outputs move: an event, an input, an outage."""
    events = load_scenario(SCENARIO).event
    channel = {"u": 0.7, "latency": 0.1, "outage[1].start": 0.5, "outage[1].end": 0.8, "on_loss": 0}
    parts = {
        "plant": (plant_block(two_area), event_parameters(two_area, events)),
        "controller": (hand_controller.block(two_area.omega_b), {"G2_dw": 0.02}),
        "channel": (channel_block(), channel),
    }
    return {
        kind: Member(kind, FmuFile(block_fmu(block, cache)), block, start)
        for kind, (block, start) in parts.items()
    }


@pytest.fixture(scope="module")
def fmus(members: dict[str, Member], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return the FMU of each kind, start values baked in."""
    folder = tmp_path_factory.mktemp("fmus")
    return {kind: build_fmu(m.baked(), folder / f"{kind}.fmu") for kind, m in members.items()}


@pytest.fixture(scope="module")
def expected(fmus: dict[str, Path]) -> dict[str, dict[str, Array]]:
    """Return the outputs of each FMU at the communication points, stepped by hand call by call."""
    return {kind: _stepped(fmus[kind], OUTPUTS[kind]) for kind in fmus}


def _stepped(file: Path, names: list[str]) -> dict[str, Array]:
    from fmu_runner import Runner

    rows = []
    with Runner(file) as run:
        run.start({})
        for k in range(round(STOP / STEP)):
            run.fmu.doStep(currentCommunicationPoint=k * STEP, communicationStepSize=STEP)
            rows.append([run.get(n) for n in names])
    return dict(zip(names, np.array(rows).T, strict=True))


@pytest.mark.tools
@pytest.mark.parametrize(
    "driver",
    [pytest.param("cofmupy_fmu", marks=pytest.mark.slow), "libcosim_fmu", "ecos_fmu"],
)
@pytest.mark.parametrize("kind", ["plant", "controller", "channel"])
def test_tool_gives_what_the_calls_give(
    driver: str,
    kind: str,
    fmus: dict[str, Path],
    expected: dict[str, dict[str, Array]],
    run_tool: RunTool,
) -> None:
    """No connection, no delay: the same numbers to rounding (tools add up time in floats)."""
    trajectory = run_tool(driver, fmus[kind], STEP, STOP, OUTPUTS[kind])
    for name, values in expected[kind].items():
        assert np.ptp(values) > 0.0
        assert np.allclose(trajectory[name], values, rtol=0.0, atol=1e-11), name


@pytest.mark.parametrize("kind", ["plant", "controller", "channel"])
def test_fmpy_co_simulation(kind: str, fmus: dict[str, Path], expected: dict[str, dict[str, Array]]) -> None:
    result = fmpy.simulate_fmu(
        str(fmus[kind]),
        fmi_type="CoSimulation",
        stop_time=STOP,
        step_size=STEP,
        output_interval=STEP,
        output=OUTPUTS[kind],
    )
    for name, values in expected[kind].items():
        assert np.allclose(result[name][1:], values, rtol=0.0, atol=1e-11), name


@pytest.mark.parametrize("kind", ["plant", "controller"])
def test_fmpy_model_exchange_with_cvode(
    kind: str, fmus: dict[str, Path], expected: dict[str, dict[str, Array]]
) -> None:
    """Another integrator on the same equations: equal to CVode's tolerance, not to rounding."""
    result = fmpy.simulate_fmu(
        str(fmus[kind]),
        fmi_type="ModelExchange",
        solver="CVode",
        relative_tolerance=1e-9,
        stop_time=STOP,
        output_interval=STEP,
        output=OUTPUTS[kind],
    )
    times, last = np.unique(np.round(result["time"], 9)[::-1], return_index=True)
    rows = len(result) - 1 - last  # after an event, where a time comes twice
    at = np.searchsorted(times, np.round(np.arange(1, round(STOP / STEP) + 1) * STEP, 9))
    for name, values in expected[kind].items():
        difference = result[name][rows][at] - values
        assert np.max(np.abs(difference)) <= 1e-5 * np.ptp(values), name


@pytest.mark.tools
@pytest.mark.slow
@pytest.mark.parametrize("sequential", [False, True])
def test_fmucontainer_gives_the_trajectory_of_held_inputs(
    sequential: bool, cache: Path, by_hand: Controller, tmp_path: Path
) -> None:
    """Parallel order is our "hold-jacobi"; sequential hands new values on within a step."""
    require("fmu_manipulation_toolbox")
    loop = members_of(load_scenario(SCENARIO), cache=cache, controller=by_hand)
    for member in loop.all:
        build_fmu(member.baked(), tmp_path / f"{member.name}.fmu", cache=cache)

    def port(end: str) -> list[str]:
        instance, variable = end.split(".", 1)
        return [f"{instance}.fmu", variable]

    table = {
        "name": "loop.fmu",
        "fmu": [f"{m.name}.fmu" for m in loop.all],
        "step_size": STEP,
        "sequential": sequential,
        "auto_link": False,
        "auto_input": False,
        "auto_output": False,
        "output": [["plant.fmu", "G2_dw", "G2_dw"], ["controller.fmu", "G4_vs", "G4_vs"]],
        "link": [[*port(a), *port(b)] for a, b in loop.connections],
    }
    (tmp_path / "loop.json").write_text(json.dumps(table), encoding="utf-8")
    tool = Path(sys.executable).with_name("fmucontainer")
    command = [str(tool), "-fmu-directory", str(tmp_path), "-container", "loop.json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    result = fmpy.simulate_fmu(
        str(tmp_path / "loop.fmu"), stop_time=STOP, step_size=STEP, output_interval=STEP
    )
    held = run_scenario(
        {**SCENARIO, "master": {"inputs": "hold-jacobi"}}, cache=cache, controller=by_hand
    ).trajectory
    exact = run_scenario(SCENARIO, cache=cache, controller=by_hand).trajectory
    for name, column in (("G2_dw", "plant.G2_dw"), ("G4_vs", "controller.G4_vs")):
        peak = np.max(np.abs(exact[column]))
        if not sequential:
            assert np.max(np.abs(result[name] - held[column])) <= 1e-9 * peak, name
        assert np.max(np.abs(result[name] - exact[column])) <= 0.1 * peak, name
