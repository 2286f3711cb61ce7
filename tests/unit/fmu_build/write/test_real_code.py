"""IEEE/CIGRE DLLs of blocks: the trajectories of the FMU to the bit, all state in the tool's arrays."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from fmu_runner import Runner, decay_block

from interarea.cosim.run.controllers import controller_of
from interarea.fmu_build.errors import BuildError
from interarea.fmu_build.open.real_code import ERROR, MESSAGE, OK, RealCode, RealCodeLibrary
from interarea.fmu_build.write.package import build_fmu
from interarea.fmu_build.write.real_code import build_dll, port_name
from interarea.models.blocks.channel import channel_block
from interarea.models.blocks.variables import Block
from interarea.models.case.case import load_case

STEP = 0.01


@pytest.fixture(scope="module")
def robust(cache: Path) -> Block:
    """Return the bundled controller `robust`."""
    case = load_case("two-area-thesis")
    controller = controller_of("robust", case, cache)
    assert controller is not None
    return controller.block(case.omega_b)


@pytest.fixture(scope="module")
def blocks(robust: Block) -> dict[str, Block]:
    """Return the blocks by kind."""
    return {"controller": robust, "channel": channel_block(capacity=256), "decay": decay_block()}


@pytest.fixture(scope="module")
def library(blocks: dict[str, Block], cache: Path, tmp_path_factory: pytest.TempPathFactory):  # type: ignore[no-untyped-def]
    """Return the loader of a block's DLL by kind."""
    folder = tmp_path_factory.mktemp("dll")

    def load(kind: str) -> RealCodeLibrary:
        path = folder / f"{kind}.so"
        if not path.exists():
            build_dll(blocks[kind], path, platform="linux64", sample_time_s=STEP, cache=cache)
        return RealCodeLibrary(path)

    return load


def signal(name: str, t: float) -> float:
    """An input at a time: a swing and a jump, different for each name."""
    k = len(name) + ord(name[1 % len(name)])
    return 2e-4 * float(np.sin(0.7 * k + 6.0 * t)) + (1e-4 if t > 0.5 else 0.0)


def start(model: RealCode, t: float = 0.0, signals: bool = True) -> RealCode:
    """Call what a tool calls before the first step."""
    for port in model.library.info.inputs if signals else ():
        model.inputs[port.name] = signal(port.name, t)
    assert model.call("Model_FirstCall", t) == OK
    assert model.call("Model_CheckParameters") == OK, model.text()
    assert model.call("Model_Initialize") in (OK, MESSAGE), model.text()
    return model


def step(model: RealCode, t: float) -> list[float]:
    """Call the model at a time; return its outputs."""
    for port in model.library.info.inputs:
        model.inputs[port.name] = signal(port.name, t)
    assert model.call("Model_Outputs", t) == OK, model.text()
    return [model.outputs[port.name] for port in model.library.info.outputs]


PARAMETERS = {
    "controller": {"limit": 0.02},
    "channel": {
        "latency": 0.123,
        "reporting_interval": 0.02,
        "jitter": 0.03,
        "loss_good": 0.2,
        "loss_bad": 0.2,
        "seed": 7,
        "outage[1].start": 0.6,
        "outage[1].end": 0.8,
    },
    "decay": {"rate": 3.0, "kick.time": 0.333, "kicking": 1},
}


@pytest.mark.parametrize("kind", list(PARAMETERS))
def test_the_fmu_and_the_dll_give_the_same_bits(
    kind: str,
    blocks: dict[str, Block],
    library,
    cache: Path,
    tmp_path: Path,  # type: ignore[no-untyped-def]
) -> None:
    values = PARAMETERS[kind]
    model = start(RealCode(library(kind), {port_name(name): value for name, value in values.items()}))
    info = model.library.info
    fmu = build_fmu(blocks[kind], tmp_path / "x.fmu", cache=cache)
    table = blocks[kind].table
    original = {port_name(v.name): v.name for v in table}
    inputs = [original[p.name] for p in info.inputs]
    outputs = [original[p.name] for p in info.outputs]
    rows = []
    with Runner(fmu) as it:
        it.start(dict(values) | {name: signal(name, 0.0) for name in inputs})
        time = 0.0
        for k in range(1, 201):
            t = k * STEP
            old = {name: it.get(name) for name in inputs}
            if kind != "channel":
                for name in inputs:
                    it.slopes(name, (signal(name, t) - old[name]) / (t - time))
            it.step(time, t - time)
            time += t - time
            it.set_of({name: signal(name, t) for name in inputs})
            rows.append([float(it.get(name)) for name in outputs])
            assert step(model, t) == rows[-1], f"first difference at {t:g} s"
    assert len({tuple(row) for row in rows}) > 50  # something happens


def test_the_description_is_that_of_the_block(robust: Block, library) -> None:  # type: ignore[no-untyped-def]
    info = library("controller").info
    assert info.version[:2] == (1, 1) and info.sample_time_s == STEP and info.texts["name"] == robust.name
    assert [p.name for p in info.inputs] == [v.name for v in robust.table.of_role("input")]
    limit = next(p for p in info.parameters if p.name == "limit")
    assert (limit.start, limit.low, limit.fixed, limit.unit) == (
        robust.table["limit"].start,
        0.0,
        False,
        "pu",
    )
    assert not any(p.name.startswith("A_") for p in info.parameters)


def test_a_call_at_the_same_time_changes_nothing(library) -> None:  # type: ignore[no-untyped-def]
    one, twice = (start(RealCode(library("controller"))) for _ in range(2))
    for k in range(1, 30):
        step(twice, k * STEP)
        assert twice.call("Model_Iterate") == OK
        assert step(one, k * STEP) == step(twice, k * STEP)


@pytest.mark.parametrize("kind", list(PARAMETERS))
def test_instances_side_by_side_are_as_alone_and_a_snapshot_goes_on_elsewhere(
    kind: str,
    library,
    tmp_path: Path,  # type: ignore[no-untyped-def]
) -> None:
    values = {port_name(name): value for name, value in PARAMETERS[kind].items()}
    alone = start(RealCode(library(kind), values))
    rows = [step(alone, k * STEP) for k in range(1, 101)]
    many = [start(RealCode(library(kind), values)) for _ in range(20)]
    for k, row in enumerate(rows[:50], start=1):
        assert all(step(model, k * STEP) == row for model in many)
    saved = tmp_path / "snapshot"
    saved.write_bytes(many[7].snapshot())
    program = (
        "import sys; from pathlib import Path; from test_real_code import *\n"
        "model = RealCode(RealCodeLibrary(sys.argv[1]), eval(sys.argv[3]))\n"
        "model.restore(Path(sys.argv[2]).read_bytes())\n"
        "print([step(model, k * STEP) for k in range(51, 101)])\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, str(many[0].library.path), str(saved), repr(values)],
        capture_output=True,
        text=True,
        check=True,
        env={"PYTHONPATH": f"{Path(__file__).parent}:{Path(__file__).parents[3]}", "PATH": ""},
        timeout=60,
    )
    assert eval(done.stdout) == rows[50:]


def test_what_a_tool_does_wrong_is_refused_in_words(library) -> None:  # type: ignore[no-untyped-def]
    def tried(time: float, **inputs: float) -> tuple[int, str]:
        for name, value in inputs.items():
            model.inputs[name] = value
        return model.call("Model_Outputs", time), model.text()

    model = RealCode(library("controller"))
    assert tried(0.0) == (ERROR, "Model_Initialize was not called, or the states are those of another model")
    start(model)
    step(model, STEP)
    code, text = tried(2 * STEP, G2_dw=float("nan"))
    assert code == ERROR and text == "input G2_dw is nan at time 0.02 s; a finite value is needed"
    code, text = tried(0.0, G2_dw=0.0)
    assert code == ERROR and "before the 0.01 s of the last call" in text
    assert tried(2 * STEP)[0] == OK  # the state is intact
    model.parameters["limit"] = -1.0
    assert (
        model.call("Model_CheckParameters") == ERROR
        and "limit was set to -1; allowed are 0 to" in model.text()
    )
    model = RealCode(library("channel"), {"seed": 1.5})
    assert model.call("Model_CheckParameters") == ERROR and "a whole number is needed" in model.text()
    model = start(RealCode(library("channel")))
    model.parameters["jitter"] = 0.1
    assert model.call("Model_Outputs", STEP) == MESSAGE and "counts at the start only" in model.text()


def test_a_parameter_that_may_change_counts_from_then_on(library) -> None:  # type: ignore[no-untyped-def]
    model = start(RealCode(library("controller"), {"limit": 0.02}))
    for k in range(1, 50):
        step(model, k * STEP)
    model.parameters["limit"] = 0.001
    rows = np.array([step(model, k * STEP) for k in range(50, 150)])
    assert np.abs(rows).max() == 0.001


def test_blocks_that_no_dll_can_be_made_of(robust: Block, tmp_path: Path) -> None:
    with pytest.raises(BuildError, match="unknown platform of a DLL 'vax'; allowed: linux64, win64, win32"):
        build_dll(robust, tmp_path, platform="vax")
    with pytest.raises(BuildError, match="sample time of a DLL: 0 s, allowed: above 0"):
        build_dll(robust, tmp_path, platform="linux64", sample_time_s=0.0)
    with pytest.raises(BuildError, match="is a plant with"):
        build_dll(decay_block(kind="plant"), tmp_path, platform="linux64")
