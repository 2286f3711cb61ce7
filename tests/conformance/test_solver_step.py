"""`solver.step`: the Runge-Kutta step that a user chooses, its default, its limits."""

from __future__ import annotations

import itertools
import re
import tomllib
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmu_runner import Runner, decay_block
from plant_lanes import PlantLanes

from interarea.fmu_build.write.description_xml import record_entries
from interarea.fmu_build.write.package import build_fmu
from interarea.models.blocks.binary_table import pack_record
from interarea.models.blocks.channel import channel_block
from interarea.models.blocks.container import LoopMember, loop_block
from interarea.models.blocks.controller import controller_block
from interarea.models.blocks.plant import event_parameters, plant_block
from interarea.models.blocks.variables import Block
from interarea.models.case.case import Case, CaseError, case_of, load_case
from interarea.models.case.events import events_of
from interarea.models.case.write_toml import export_toml

CASE = "kundur-thyristor"
STEPS_S = (0.02, 0.01, 0.005, 0.0025)
TIMES = np.arange(0.0, 2.001, 0.04)


def pulse() -> dict[str, float | int]:
    """A small pulse of a set-point: no limit is reached, so the method keeps its order."""
    row = {"kind": "vref_pulse", "machine": "G1", "size_pu": 0.005, "start_s": 0.2, "end_s": 0.6}
    return event_parameters(load_case(CASE), events_of([row], where="test"))


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory, cache: Path) -> Path:
    return build_fmu(plant_block(load_case(CASE)), tmp_path_factory.mktemp("step") / "plant.fmu", cache=cache)


def speeds(fmu: Path, **start: float) -> np.ndarray:
    with Runner(fmu) as run:
        return run.start(pulse() | start).run(TIMES, "G1_dw")


def with_step(fmu: Path, step_s: float) -> np.ndarray:
    with Runner(fmu) as run:
        return run.start(pulse() | {"solver.step": step_s}).run(TIMES, "G1_dw")


@pytest.mark.slow
def test_errors_fall_with_the_fourth_power_of_the_step(fmu: Path) -> None:
    exact = with_step(fmu, 0.0005)
    errors = [np.abs(with_step(fmu, h) - exact).max() for h in STEPS_S]
    assert errors[0] < 1e-6
    for coarse, fine in itertools.pairwise(errors):
        assert 11.0 < coarse / fine < 25.0, errors  # 16 in the limit of short steps


@pytest.mark.slow
def test_a_step_set_is_a_step_built_in(fmu: Path, cache: Path, tmp_path: Path) -> None:
    other = build_fmu(
        plant_block(load_case(CASE).with_changes({"solver_step_s": 0.004})),
        tmp_path / "plant.fmu",
        cache=cache,
    )
    np.testing.assert_array_equal(speeds(other), with_step(fmu, 0.004))
    np.testing.assert_array_equal(speeds(fmu), with_step(fmu, 0.001))
    assert "0.004 s (the\nparameter <code>solver.step</code>)" in page(other)


def page(fmu: Path) -> str:
    return (Path(fmpy.extract(str(fmu))) / "documentation" / "index.html").read_text()


def test_the_step_travels_with_the_state(fmu: Path) -> None:
    """A state saved with one step and put into an instance with another goes on with its own."""
    with Runner(fmu) as first, Runner(fmu) as second:
        first.start(pulse() | {"solver.step": 0.02})
        second.start(pulse())
        first.step(0.0, 0.4)
        saved = first.fmu.getFMUstate()
        restored = second.fmu.deSerializeFMUstate(first.fmu.serializeFMUstate(saved))
        second.fmu.setFMUstate(restored)
        assert second.get("solver.step") == 0.02
        for run in (first, second):
            run.step(0.4, 0.4)
        assert first.get("G1_dw") == second.get("G1_dw")
        for run, state in ((first, saved), (second, restored)):
            run.fmu.freeFMUstate(state)


def runge_kutta(z: float) -> float:
    """What one step multiplies x by, x' = z x over a step of 1: the exponential's first five terms."""
    return 1.0 + z * (1.0 + z / 2.0 * (1.0 + z / 3.0 * (1.0 + z / 4.0)))


def test_rounding_of_a_step_adds_no_substep(cache: Path, tmp_path: Path) -> None:
    """0.3 - 0.2 is less than 0.1 and 0.8 - 0.7 more: ten substeps of 0.01 s each, not eleven."""
    path = build_fmu(decay_block(), tmp_path / "decay.fmu", cache=cache)
    with Runner(path) as run:
        run.start({"rate": 20.0})
        for k in range(10):
            run.step(0.1 * k, 0.1)
            assert run.get("y") == pytest.approx(runge_kutta(-0.2) ** (10 * (k + 1)), rel=1e-13)
    assert abs(runge_kutta(-0.2 * 10 / 11) ** 11 / runge_kutta(-0.2) ** 10 - 1.0) > 1e-6


def test_an_event_that_rounding_puts_behind_the_end_belongs_to_the_step(cache: Path, tmp_path: Path) -> None:
    """3 x 0.1 is one ulp more than 0.3: a master that steps to 0.3 has reached it."""
    path = build_fmu(decay_block(), tmp_path / "decay.fmu", cache=cache)
    with Runner(path) as run:
        run.start({"rate": 0.0, "kicking": True, "kick.time": 3 * 0.1})
        run.step(0.0, 0.2)
        run.step(0.2, 0.3 - 0.2)
        assert (run.get("y"), run.get("kicks")) == (3.0, 1)
        run.step(0.3, 0.1)
        assert (run.get("y"), run.get("kicks")) == (3.0, 1)


@pytest.mark.parametrize("value", [0.0, -0.001, 0.2, float("nan")])
def test_a_step_out_of_range_is_refused(fmu: Path, value: float) -> None:
    with Runner(fmu) as run:
        with pytest.raises(Exception, match="fmi2SetReal"):
            run.start({"solver.step": value})
        assert "solver.step was set to" in run.log[-1]


def test_the_step_is_fixed_once_the_run_has_begun(fmu: Path) -> None:
    with Runner(fmu) as run:
        run.start()
        with pytest.raises(Exception, match="fmi2SetReal"):
            run.set_of({"solver.step": 0.002})
        assert "solver.step cannot be set in this state" in run.log[-1]


@pytest.mark.parametrize("step_s", [0.0033, 0.004, 0.01])
def test_a_step_beyond_stability_is_told(step_s: float, cache: Path) -> None:
    """T_A = 1 ms puts poles at -1001 1/s; limits that switch divide the steps and keep the growth bounded."""
    case = load_case("two-area-thesis")
    fault = {"kind": "bus_fault", "bus": 8, "x_pu": 1e-4, "start_s": 0.1, "end_s": 0.2}
    start = event_parameters(case, events_of([fault], where="test")) | {"solver.step": step_s}
    plants = PlantLanes(case, cache)
    reported = plants.run([start], stop_s=0.5, step_s=0.02, lanes=1).errors[0]
    assert "steps of" in reported
    assert "try a shorter solver.step" in reported
    taken, fastest, allowed = (
        float(re.search(rf"{before} (\S+)", reported)[1]) for before in ("steps of", "mode is at", "at most")
    )
    assert taken == pytest.approx(0.02 / np.ceil(0.02 / step_s - 1e-9), rel=1e-3)
    assert fastest == pytest.approx(1001.0, rel=5e-3)
    assert allowed == pytest.approx(2.785 / 1001.0, rel=5e-3)
    beside = plants.run([start, start | {"solver.step": 0.0025}], stop_s=0.5, step_s=0.02)
    assert beside.errors == [reported, ""]


def test_model_exchange_leaves_steps_to_its_importer(fmu: Path) -> None:
    rates = []
    for step in (0.0005, 0.05):
        with Runner(fmu, "me") as run:
            run.start(pulse() | {"solver.step": step})
            rates.append(run.every_real())
    assert np.sum(rates[0] != rates[1]) == 1  # the parameter itself


@pytest.mark.slow
def test_plants_side_by_side_take_each_its_own_step(fmu: Path, cache: Path) -> None:
    plants = PlantLanes(load_case(CASE), cache)
    rows = [pulse() | {"solver.step": h} for h in STEPS_S] + [pulse()]
    run = plants.run(rows, stop_s=TIMES[-1], step_s=0.04)
    alone = plants.run(rows, stop_s=TIMES[-1], step_s=0.04, lanes=1)
    np.testing.assert_array_equal(run.outputs, alone.outputs)
    for k, h in enumerate((*STEPS_S, 0.001)):
        np.testing.assert_allclose(run.of("G1_dw")[:, k], with_step(fmu, h), rtol=0, atol=1e-13)


def test_a_case_may_say_its_step() -> None:
    """A case without it keeps the hash it had; with it, it comes back from its own file."""
    case = load_case(CASE)
    chosen = case.with_changes({"solver_step_s": 0.005})
    assert plant_block(chosen).table["solver.step"].start == 0.005
    assert chosen.hash != case.hash == chosen.with_changes({"solver_step_s": "none"}).hash
    assert case_of(tomllib.loads(export_toml(chosen)), where="test").hash == chosen.hash


def test_the_default_is_a_millisecond_or_the_shortest_time_constant() -> None:
    case = load_case(CASE)
    fast = case.with_changes({"machines": {"G2": {"exciter": {"TR": 0.0003}}}}, name="fast")
    assert plant_block(case).longest_step_s == 0.001
    assert plant_block(fast).longest_step_s == 0.0003
    assert plant_block(fast).table["solver.step"].start == 0.0003
    with pytest.raises(CaseError, match=r"solver_step_s.*0\.1"):
        case.with_changes({"solver_step_s": 0.5})
    with pytest.raises(ValueError, match=r"parameter solver.step says"):
        plant_block(case).__class__(**{**vars(plant_block(case)), "internal_step_s": 0.002})


@pytest.mark.slow
@pytest.mark.parametrize(
    "exciter", [{}, {"TA": 0.0002}, {"TR": 0.0003}, {"TA": 0.0005, "TR": 0.0005, "KA": 400.0}]
)
def test_the_default_is_accurate_through_the_fault_of_the_study(cache: Path, exciter: dict) -> None:
    """To 1e-7 pu of dw against steps of 0.1 ms or less, also with exciters faster than any shipped one."""
    case = load_case("two-area-thesis").with_changes(
        {"machines": {"defaults": {"exciter": exciter}}}, name="x"
    )
    clearing = 1.0 + 8.0 / 60.0
    fault = {"kind": "bus_fault", "bus": 8, "start_s": 1.0, "end_s": clearing, "x_pu": 1e-4}
    trip = {"kind": "branch_trip", "branch": "8-9 a", "start_s": clearing}
    start = event_parameters(case, events_of([fault, trip], where="test"))
    block = plant_block(case)
    fine = min(0.0001, block.longest_step_s / 4)
    rows = [start, start | {"solver.step": fine}]
    run = PlantLanes(case, cache).run(rows, stop_s=6.0, step_s=0.02)
    for m in case.machines:
        dw = run.of(f"{m.name}_dw")
        assert np.abs(dw[:, 0]).max() > 1e-3
        assert np.abs(dw[:, 0] - dw[:, 1]).max() <= 1e-7


def a_loop(case: Case) -> Block:
    """A plant, a first-order lag and a channel between them."""
    one = np.ones((1, 1))
    controller = controller_block("lag", -10.0 * one, 10.0 * one, one, 0.0 * one, ["G2_dw"], ["G1_vs"])
    blocks = {"plant": plant_block(case), "controller": controller, "remote": channel_block()}
    members = [LoopMember(name, block, pack_record(record_entries(block))) for name, block in blocks.items()]
    wires = [
        ("plant.G2_dw", "remote.u"),
        ("remote.y", "controller.G2_dw"),
        ("controller.G1_vs", "plant.G1_vs"),
    ]
    return loop_block("loop", members, wires, step_s=0.02, stop_s=2.0)


@pytest.mark.slow
def test_a_loop_takes_the_step_of_its_plant(cache: Path, tmp_path: Path) -> None:
    loop = a_loop(load_case(CASE))
    assert loop.longest_step_s == 0.001
    path = build_fmu(loop, tmp_path / "loop.fmu", cache=cache)
    start = {f"plant.{name}": value for name, value in pulse().items()} | {"remote.latency": 0.05}
    result = []
    for h in (0.00025, 0.001, 0.002, 0.01):
        with Runner(path) as run:
            result.append(run.start(start | {"plant.solver.step": h}).run(TIMES, "G1_dw"))
    errors = [np.abs(dw - result[0]).max() for dw in result[1:]]
    assert 0.0 < 50.0 * errors[0] < 10.0 * errors[1] < 1e-10
    # ten times the plant's step at the start makes the controller's 2 ms five times as long, no more
    assert errors[1] < errors[2] < 1e-9


def test_a_loop_tells_a_step_beyond_stability_of_its_plant(cache: Path, tmp_path: Path) -> None:
    case = load_case("two-area-thesis")
    path = build_fmu(a_loop(case), tmp_path / "loop.fmu", cache=cache)
    fault = {"kind": "bus_fault", "bus": 8, "x_pu": 1e-4, "start_s": 0.1, "end_s": 0.2}
    rows = event_parameters(case, events_of([fault], where="test"))
    start = {f"plant.{name}": value for name, value in rows.items()} | {"remote.latency": 0.05}
    with Runner(path) as run:
        run.start(start | {"plant.solver.step": 0.004})
        with pytest.raises(Exception, match="fmi2DoStep"):
            run.run(TIMES[:12], "G1_dw")
        assert "grow without bound" in run.log[-1]
        assert "try a shorter solver.step" in run.log[-1]
