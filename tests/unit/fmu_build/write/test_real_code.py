"""IEEE/CIGRE DLLs of blocks: the trajectories of the FMU to the bit, all state in the tool's arrays."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from fmu_runner import Runner, decay_block

from interarea.cosim.run.controllers import controller_of
from interarea.fmu_build.errors import BuildError
from interarea.fmu_build.open.images import read_image
from interarea.fmu_build.open.real_code import (
    ERROR,
    MESSAGE,
    OK,
    REQUIRED,
    TEXT,
    Port,
    RealCode,
    RealCodeLibrary,
    Values,
)
from interarea.fmu_build.write import real_code
from interarea.fmu_build.write.package import build_fmu
from interarea.fmu_build.write.real_code import Chain, build_dll, port_name
from interarea.models.blocks.channel import channel_block
from interarea.models.blocks.pmu import pmu_block
from interarea.models.blocks.variables import Block
from interarea.models.case.case import load_case

STEP = 0.01
MANY = int(os.environ.get("INTERAREA_DLL_STEPS", "5000"))


@pytest.fixture(scope="module")
def robust(cache: Path) -> Block:
    """Return the bundled controller `robust`."""
    case = load_case("two-area-thesis")
    controller = controller_of("robust", case, cache)
    assert controller is not None
    return controller.block(case.omega_b)


@pytest.fixture(scope="module")
def blocks(robust: Block, cache: Path) -> dict[str, Block | Chain]:
    """Return the blocks by kind."""
    case = load_case("two-area-thesis")
    bank = controller_of("active", case, cache)
    assert bank is not None
    channel, pmu, supervisor = channel_block(capacity=256), pmu_block(capacity=64), bank.block(case.omega_b)
    wide = {"pmu": pmu, "remote": channel, "controller": robust}
    connections = [("pmu.deviation", "remote.u"), ("remote.y", "controller.G2_dw")]
    two = {"pmu": pmu, "near": channel, "far": channel, "bank": supervisor}
    first, second = (v.name for v in supervisor.table.of_role("input"))
    flags = [("pmu.deviation", "near.u"), ("near.y", f"bank.{first}"), ("near.valid", f"bank.{first}_valid")]
    return {
        "controller": robust,
        "supervisor": supervisor,
        "channel": channel,
        "pmu": pmu,
        "decay": decay_block(),
        "chain": Chain("wide", wide, connections),
        "chain with flags": Chain("two", two, [*flags, ("far.y", f"bank.{second}")]),
    }


@pytest.fixture(scope="module")
def library(blocks: dict[str, Block | Chain], cache: Path, tmp_path_factory: pytest.TempPathFactory):  # type: ignore[no-untyped-def]
    """Return the loader of a block's DLL by kind."""
    folder = tmp_path_factory.mktemp("dll")

    def load(kind: str) -> RealCodeLibrary:
        path = folder / f"{kind}.so"
        if not path.exists():
            build_dll(blocks[kind], path, platform="linux64", sample_time_s=STEP, cache=cache)
        return RealCodeLibrary(path)

    return load


def signal(name: str, t: float) -> float:
    """An input at a time: a swing and a jump, different for each name; of a flag whether it is up."""
    k = len(name) + ord(name[1 % len(name)])
    if name.endswith("_valid"):
        return float(not 0.4 < t < 0.7)
    if name.endswith("re"):
        return 1.0 + 0.05 * float(np.cos(3.0 * t))
    return 2e-4 * float(np.sin(0.7 * k + 6.0 * t)) + (1e-4 if t > 0.5 else 0.0)


def start(model: RealCode, t: float = 0.0, signals: bool = True) -> RealCode:
    """Call what a tool calls before the first step."""
    for port in model.library.inputs if signals else ():
        model.inputs[port.name] = signal(port.name, t)
    assert model.call("Model_FirstCall", t) == OK
    assert model.call("Model_CheckParameters") == OK, model.text()
    assert model.call("Model_Initialize") in (OK, MESSAGE), model.text()
    return model


def step(model: RealCode, t: float) -> list[float]:
    """Call the model at a time; return its outputs."""
    for port in model.library.inputs:
        model.inputs[port.name] = signal(port.name, t)
    assert model.call("Model_Outputs", t) == OK, model.text()
    return [model.outputs[port.name] for port in model.library.outputs]


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
    "supervisor": {"limit": 0.03, "loss_time": 0.02},
    "pmu": {"nominal_frequency": 60.0, "half_window": 10},
    "chain": {
        "remote.latency": 0.05,
        "remote.reporting_interval": 0.02,
        "remote.jitter": 0.03,
        "remote.loss_good": 0.2,
        "pmu.half_window": 12,
        "controller.limit": 0.02,
    },
    "chain with flags": {"near.outage[1].start": 0.5, "near.outage[1].end": 0.9, "far.latency": 0.033},
}


class Fmus:
    """The FMUs of a block's or chain's members, stepped one after the other."""

    def __init__(self, block: Block | Chain, values: dict[str, float], cache: Path, folder: Path) -> None:
        one = isinstance(block, Block)
        self.members = {"": block} if isinstance(block, Block) else dict(block.members)
        self.feeds = {} if isinstance(block, Block) else {to: source for source, to in block.connections}
        self.stack, self.runners, self.time = ExitStack(), {}, 0.0
        for name, member in self.members.items():
            file = build_fmu(member, folder / f"{name or 'x'}.fmu", cache=cache)
            run = self.runners[name] = self.stack.enter_context(Runner(file))
            own = {
                k if one else k.partition(".")[2]: v
                for k, v in values.items()
                if one or k.startswith(f"{name}.")
            }
            run.start(own | self.inputs(name, 0.0))

    def inputs(self, name: str, t: float) -> dict[str, float]:
        """Inputs of a member at a time: of the member that feeds it, or from outside."""
        table, values = self.members[name].table, {}
        for v in (*table.of_role("input"), *table.of_role("input", integers=True)):
            source, _, port = self.feeds.get(f"{name}.{v.name}", "").partition(".")
            unbounded = self.members[name].kind not in ("pmu", "channel") or not name
            shown = v.name if unbounded else f"{name}_{v.name}"
            value = self.runners[source].get(port) if source else signal(shown, t)
            values[v.name] = value if v.type == "Real" else int(value)
        return values

    def step(self, t: float) -> None:
        """Step all to a time; inputs of what is not sampled along straight lines."""
        length = t - self.time
        for name, run in self.runners.items():
            new, table = self.inputs(name, t), self.members[name].table
            for v in table.of_role("input") if self.members[name].kind not in ("channel", "pmu") else ():
                run.slopes(v.name, (new[v.name] - run.get(v.name)) / length)
            run.step(self.time, length)
            run.set_of(new)
        self.time += length

    def outputs(self) -> Iterator[float]:
        """All outputs, member by member, in the order of a DLL."""
        for name, run in self.runners.items():
            table = self.members[name].table
            for v in (*table.of_role("output"), *table.of_role("output", integers=True)):
                yield float(run.get(v.name))


@pytest.mark.parametrize(
    ("kind", "count"),
    [(kind, 100) for kind in PARAMETERS]
    + [pytest.param(k, MANY, marks=[pytest.mark.slow, pytest.mark.timeout(3000)]) for k in PARAMETERS],
)
def test_the_fmu_and_the_dll_give_the_same_bits(
    kind: str,
    count: int,
    blocks: dict[str, Block | Chain],
    library,
    cache: Path,
    tmp_path: Path,  # type: ignore[no-untyped-def]
) -> None:
    """A chain against the FMUs of its members: outputs of each are the inputs of the next at that time."""
    values = PARAMETERS[kind]
    model = start(RealCode(library(kind), {port_name(name): value for name, value in values.items()}))
    fmus, different = Fmus(blocks[kind], values, cache, tmp_path), set()
    with fmus.stack:
        for k in range(1, count + 1):
            fmus.step(k * STEP)
            row = list(fmus.outputs())
            assert step(model, k * STEP) == row, f"first difference at {k * STEP:g} s"
            different.add(hash(tuple(row)))
    assert len(different) > 50  # something happens


@pytest.mark.parametrize("kind", ["controller", "chain"])
def test_a_library_exports_the_interface_and_nothing_else(kind: str, library) -> None:  # type: ignore[no-untyped-def]
    """On Linux a function that it exported could give way to one of another library."""
    optional = {f"Model_{name}" for name in ("FirstCall", "Iterate", "PrintInfo")}
    assert set(read_image(library(kind).path.read_bytes()).exports) == {*REQUIRED, *optional}


def test_the_description_is_that_of_the_block(robust: Block, library) -> None:  # type: ignore[no-untyped-def]
    described = library("controller")
    assert described.info.version[:2] == [1, 1] and described.info.sample_time == STEP
    assert described.info.name.decode() == robust.name
    assert [p.name for p in described.inputs] == [v.name for v in robust.table.of_role("input")]
    limit = next(p for p in described.parameters if p.name == "limit")
    assert (limit.start, limit.low, limit.fixed, limit.unit) == (
        robust.table["limit"].start,
        0.0,
        False,
        "pu",
    )
    assert not any(p.name.startswith("A_") for p in described.parameters)


@pytest.mark.parametrize("kind", list(PARAMETERS))
def test_a_call_at_the_same_time_changes_nothing(kind: str, library) -> None:  # type: ignore[no-untyped-def]
    one, twice = (start(RealCode(library(kind))) for _ in range(2))
    for k in range(1, 30):
        step(twice, k * STEP)
        assert twice.call("Model_Iterate") == OK
        assert step(one, k * STEP) == step(twice, k * STEP)


@pytest.mark.slow
@pytest.mark.parametrize("kind", list(PARAMETERS))
def test_instances_side_by_side_are_as_alone_and_a_snapshot_goes_on_elsewhere(
    kind: str,
    library,
    tmp_path: Path,  # type: ignore[no-untyped-def]
) -> None:
    values = {port_name(name): value for name, value in PARAMETERS[kind].items()}
    alone = start(RealCode(library(kind), values))
    rows = [step(alone, k * STEP) for k in range(1, 81)]
    many = [start(RealCode(library(kind), values)) for _ in range(200)]
    saved = {0: many[7].snapshot()}
    for k, row in enumerate(rows[:20], start=1):
        assert all(step(model, k * STEP) == row for model in many)
        saved[k] = many[7].snapshot()
    for model in many[:100:10]:  # the others stay where they are
        assert [step(model, k * STEP) for k in range(21, 81)] == rows[20:]
    file = tmp_path / "snapshots"
    file.write_bytes(pickle.dumps(saved))
    program = (
        "import pickle, sys; from pathlib import Path; from test_real_code import *\n"
        "model = RealCode(RealCodeLibrary(sys.argv[1]), eval(sys.argv[3]))\n"
        "for call, saved in pickle.loads(Path(sys.argv[2]).read_bytes()).items():\n"
        "    model.restore(saved)\n"
        "    print([step(model, k * STEP) for k in range(call + 1, 81)])\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, str(many[0].library.path), str(file), repr(values)],
        capture_output=True,
        text=True,
        check=True,
        env={"PYTHONPATH": f"{Path(__file__).parent}:{Path(__file__).parents[3]}", "PATH": ""},
        timeout=120,
    )
    for call, line in enumerate(done.stdout.splitlines()):
        assert eval(line) == rows[call:], f"snapshot after call {call}"


def test_what_a_tool_does_wrong_is_refused_in_words(library) -> None:  # type: ignore[no-untyped-def]
    def tried(time: float, **inputs: float) -> tuple[int, str]:
        for name, value in inputs.items():
            model.inputs[name] = value
        return model.call("Model_Outputs", time), model.text()

    model = RealCode(library("controller"))
    begun = "Model_Initialize was not called, a call failed since, or the states are of another model"
    assert tried(0.0) == (ERROR, begun)
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
    assert tried(3 * STEP)[0] == ERROR and "limit was set to -1" in model.text()
    model.parameters["limit"] = 0.02
    assert tried(3 * STEP) == (ERROR, begun)  # it failed after its begin
    start(model, 3 * STEP)
    assert tried(4 * STEP)[0] == OK
    model = RealCode(library("decay"), {"kicking": 2})
    assert model.call("Model_CheckParameters") == ERROR and "0 or 1 is needed" in model.text()
    model = RealCode(library("channel"), {"seed": 1.5})
    assert model.call("Model_CheckParameters") == ERROR and "a whole number is needed" in model.text()
    model = start(RealCode(library("channel")))
    model.parameters["jitter"] = 0.1
    assert model.call("Model_Outputs", STEP) == MESSAGE and "counts at the start only" in model.text()


def test_a_number_is_no_text() -> None:
    """A parameter may be a text of the interface: a number would be its address."""
    values = Values((Port("file", "", "", TEXT), Port("rate", "", "", 9)))
    values["file"] = "curve.csv"
    with pytest.raises(TypeError):
        values["file"] = 3
    with pytest.raises(TypeError):
        values["rate"] = "3"


def test_a_parameter_that_may_change_counts_from_then_on(library) -> None:  # type: ignore[no-untyped-def]
    model = start(RealCode(library("controller"), {"limit": 0.02}))
    for k in range(1, 50):
        step(model, k * STEP)
    model.parameters["limit"] = 0.001
    rows = np.array([step(model, k * STEP) for k in range(50, 150)])
    assert np.abs(rows).max() == 0.001


def test_blocks_that_no_dll_can_be_made_of(robust: Block, tmp_path: Path) -> None:
    with pytest.raises(BuildError, match="unknown platform 'vax'; allowed: linux64, win64, win32"):
        build_dll(robust, tmp_path, platform="vax")
    with pytest.raises(BuildError, match="sample time of a DLL: 0 s, allowed: above 0"):
        build_dll(robust, tmp_path, platform="linux64", sample_time_s=0.0)
    with pytest.raises(BuildError, match="is a plant of plant, allowed for a DLL: a controller"):
        build_dll(decay_block(kind="plant"), tmp_path, platform="linux64")
    members = {"remote": channel_block(capacity=16), "controller": robust}
    for connection, words in (
        (("controller.G4_vs", "remote.u"), "leads backwards or joins two types"),
        (("remote.valid", "controller.G2_dw"), "leads backwards or joins two types"),
        (("remote.z", "controller.G2_dw"), "remote.z is no output of a member"),
    ):
        with pytest.raises(BuildError, match=words):
            build_dll(Chain("wrong", members, [connection]), tmp_path, platform="linux64")
    twice = [("remote.y", "controller.G2_dw")] * 2
    with pytest.raises(BuildError, match=r"controller\.G2_dw is fed twice"):
        build_dll(Chain("wrong", members, twice), tmp_path, platform="linux64")
    with pytest.raises(BuildError, match="is a chain of decay, allowed for a DLL: a controller"):
        build_dll(Chain("wrong", {"decay": decay_block()}), tmp_path, platform="linux64")


def test_a_header_of_fmi_that_exports_in_another_way_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else the library would offer the functions of FMI beside those of the interface."""
    gather = real_code.gather_sources
    other = {"fmi2Functions.h": b"FMI2_Other_Export fmi2Component fmi2Instantiate(void);"}
    monkeypatch.setattr(real_code, "gather_sources", lambda files: {**gather(files), **other})
    with pytest.raises(BuildError, match="declares no function with FMI2_Export; reinstall fmpy"):
        real_code.dll_sources(decay_block().sources, 100)
