"""The loop in one FMU against the master over separate FMUs: two independent ways to the same trajectory.

Inside the container plant and controller are integrated as one system; the master hands cubics between
them. What differs is fourth order in the step, 2e-5 of a signal's range in all cases here.
"""

from __future__ import annotations

import io
import sys
import zipfile
from pathlib import Path
from typing import Any

import control
import fmpy
import numpy as np
import numpy.typing as npt
import pytest
from fmpy.validation import validate_fmu
from fmu_runner import Runner
from lxml import etree

from interarea.cli.app import main
from interarea.cosim.errors import ScenarioError
from interarea.cosim.export.container import chain_of, container_block, write_container
from interarea.cosim.export.instances import members_of
from interarea.cosim.export.joint import run_joint
from interarea.cosim.run.run import run_scenario
from interarea.cosim.scenario.scenario import load_scenario
from interarea.design.controllers.bank import ControllerBank
from interarea.design.controllers.controller import Controller
from interarea.fmu_build.open.real_code import RealCodeLibrary
from interarea.fmu_build.write.compile import host_platform
from interarea.fmu_build.write.description_xml import record_entries
from interarea.fmu_build.write.real_code import build_dll, port_name
from interarea.models.blocks.binary_table import pack_record
from interarea.models.blocks.container import LoopMember, loop_block

Array = npt.NDArray[np.float64]
TOLERANCE = 2e-5  # of a signal's range
PULSE = {"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 1.0, "end_s": 1.2}
FAULT = {"kind": "bus_fault", "bus": 8, "start_s": 1.0, "end_s": 1.0833, "x_pu": 1e-4}


def scenario(event: dict[str, Any] | None = None, **channel: Any) -> dict[str, Any]:
    """Return a scenario of 3 s with one channel and one event."""
    return {
        "name": "loop",
        "case": "two-area-thesis",
        "controller": "ftc",
        "stop_s": 3.0,
        "step_s": 0.01,
        "channels": {"remote": {"signal": "G2_dw", **channel}},
        "event": [PULSE if event is None else event],
    }


SCENARIOS = {
    "latency over many steps": scenario(latency_s=0.1),
    "latency off the grid": scenario(latency_s=0.0537),
    "latency below the step: repeated": scenario(latency_s=0.004),
    "no latency, outage and hold": scenario(latency_s=0.0, on_loss="hold", outages_s=[[1.5, 2.0333]]),
    "fault between two steps, outage": scenario(FAULT, latency_s=0.05, outages_s=[[1.0833, 1.7]]),
    "packets": scenario(
        latency_s=0.04,
        reporting_interval_s=0.02,
        jitter_s=0.03,
        loss={"kind": "bernoulli", "rate": 0.2},
        on_loss="hold",
        seed=5,
    ),
}


def simulate(file: Path, step_s: float, stop_s: float, names: list[str]) -> dict[str, Array]:
    """Step an FMU by hand from 0; return outputs at every communication point, the first included."""
    with Runner(file) as run:
        run.start()
        rows = [[run.get(n) for n in names]]
        for k in range(round(stop_s / step_s)):
            run.step(k * step_s, step_s)
            rows.append([run.get(n) for n in names])
    return dict(zip(names, np.array(rows, dtype=float).T, strict=True))


@pytest.fixture(scope="module")
def container(cache: Path, by_hand: Controller, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the container of the first scenario."""
    file = tmp_path_factory.mktemp("container") / "loop.fmu"
    loaded = load_scenario(SCENARIOS["latency over many steps"])
    return write_container(loaded, file, cache=cache, controller=by_hand)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENARIOS)
def test_container_follows_the_master(name: str, cache: Path, by_hand: Controller, tmp_path: Path) -> None:
    table = SCENARIOS[name]
    file = write_container(load_scenario(table), tmp_path / "loop.fmu", cache=cache, controller=by_hand)
    names = {
        "G2_dw": "plant.G2_dw",
        "G1_pe": "plant.G1_pe",
        "remote_y": "remote.y",
        "G4_vs": "controller.G4_vs",
    }
    result = simulate(file, 0.01, 3.0, [*names, "remote_valid", "remote_delivered", "remote_dropped"])
    master = run_scenario(table, cache=cache, controller=by_hand).trajectory
    rows = np.isin(np.round(master.time_s * 1e9), np.arange(0, 3_000_000_001, 10_000_000))
    for ours, column in names.items():
        expected = np.asarray(master[column])[rows]
        assert np.ptp(expected) > 0.0
        assert np.max(np.abs(result[ours] - expected)) <= TOLERANCE * np.ptp(expected), ours
    for count in ("valid", "delivered", "dropped"):
        assert np.array_equal(result[f"remote_{count}"], np.asarray(master[f"remote.{count}"])[rows]), count


@pytest.mark.slow
def test_a_guard_that_follows_a_flow_starts_from_the_flow_at_rest(cache: Path, tmp_path: Path) -> None:
    """A fault at once: a slow course that began at 0 would have turned the sides by a fifth."""
    early = FAULT | {"start_s": 0.05, "end_s": 0.15}
    table = scenario(early, latency_s=0.05) | {"controller": "two_actuators", "step_s": 0.0025, "stop_s": 1.5}
    table["channels"] |= {"flow": {"signal": "tie_p", "latency_s": 0.05}}
    file = write_container(load_scenario(table), tmp_path / "loop.fmu", cache=cache)
    result = simulate(file, 0.0025, 1.5, ["G2_vs", "G4_vs"])
    master = run_scenario(table, cache=cache).trajectory
    rows = np.isin(np.round(master.time_s * 1e9), np.arange(0, 1_500_000_001, 2_500_000))
    for name, ours in result.items():
        expected = np.asarray(master[f"controller.{name}"])[rows]
        assert np.max(np.abs(ours - expected)) <= 1e-4 * np.ptp(expected)


@pytest.mark.slow
def test_supervisor_inside_sees_the_flags_when_they_change(
    cache: Path, hand_controller: Controller, tmp_path: Path
) -> None:
    """A bank that falls back to the local signal: it switches with the outage, as outside."""
    K = hand_controller.system
    local = control.ss(K.A, K.B[:, 1:], K.C, K.D[:, 1:], inputs=["G4_dw"], outputs=["G4_vs"])
    bank = ControllerBank(
        "bank", (hand_controller, Controller("local", local)), fade_s=0.05, loss_s=0.013, return_s=0.2
    )
    table = scenario(latency_s=0.05, outages_s=[[1.5, 2.0333]])
    file = write_container(load_scenario(table), tmp_path / "loop.fmu", cache=cache, controller=bank)
    names = ["G2_dw", "G4_vs", "controller_active", "controller_switches"]
    result = simulate(file, 0.01, 3.0, names)
    master = run_scenario(table, cache=cache, controller=bank).trajectory
    rows = np.isin(np.round(master.time_s * 1e9), np.arange(0, 3_000_000_001, 10_000_000))
    assert set(result["controller_active"]) == {1.0, 2.0}
    for ours, column in (("G2_dw", "plant.G2_dw"), ("G4_vs", "controller.G4_vs")):
        expected = np.asarray(master[column])[rows]
        assert np.max(np.abs(result[ours] - expected)) <= 1e-4 * np.ptp(expected), ours
    for ours in ("active", "switches"):
        assert np.array_equal(result[f"controller_{ours}"], np.asarray(master[f"controller.{ours}"])[rows])


def test_latency_is_exact_inside(container: Path) -> None:
    """What comes out of the channel is what went in 0.1 s earlier: not held, not a step late."""
    result = simulate(container, 0.01, 3.0, ["G2_dw", "remote_y"])
    error = np.abs(result["remote_y"][10:] - result["G2_dw"][:-10])
    assert np.max(error) <= 1e-12 * np.ptp(result["G2_dw"])


@pytest.mark.parametrize("step_s", [0.02, 0.1, 1.0])
def test_the_tools_step_does_not_matter(step_s: float, container: Path) -> None:
    """Inner communication points are the container's own: the same bits whatever the tool's step."""
    fine = simulate(container, 0.01, 3.0, ["G2_dw", "G4_vs"])
    coarse = simulate(container, step_s, 3.0, ["G2_dw", "G4_vs"])
    for name, values in coarse.items():
        assert np.array_equal(values, fine[name][:: round(step_s / 0.01)]), name


def test_steps_off_the_inner_grid_change_nothing_but_rounding_and_the_cubic(container: Path) -> None:
    fine = simulate(container, 0.01, 3.0, ["G2_dw"])["G2_dw"]
    odd = simulate(container, 0.0375, 3.0, ["G2_dw"])["G2_dw"]
    assert np.max(np.abs(odd[::4] - fine[::15])) <= TOLERANCE * np.ptp(fine)


def test_saved_state_and_reset_give_the_same_bits(container: Path) -> None:
    with Runner(container) as run:
        run.start()
        fmu = run.fmu

        def until(first: int, last: int) -> list[float]:
            values = []
            for k in range(first, last):
                run.step(k * 0.01, 0.01)
                values += [run.get("G2_dw"), run.get("G4_vs"), run.get("remote_age")]
            return values

        head = until(0, 105)
        state = fmu.getFMUState()
        serialised = fmu.serializeFMUState(state)
        tail = until(105, 150)
        fmu.setFMUState(state)
        assert until(105, 150) == tail
        fmu.freeFMUState(state)
        fmu.reset()
        run.start()
        assert until(0, 105) == head
        again = fmu.deserializeFMUState(serialised)
        fmu.setFMUState(again)
        assert until(105, 150) == tail
        fmu.freeFMUState(again)


def test_scenario_is_in_the_parameters(container: Path) -> None:
    """Another latency and no event, set from outside like any parameter."""
    with Runner(container) as run:
        starts = {n: run.variables[n].start for n in ("remote.latency", "plant.event[1].start")}
        assert {n: float(v) for n, v in starts.items()} == {
            "remote.latency": 0.1,
            "plant.event[1].start": 1.0,
        }
        run.start({"plant.event[1].kind": 0, "remote.latency": 0.2})
        for k in range(120):
            run.step(k * 0.01, 0.01)
        assert abs(run.get("G2_dw")) < 1e-10
        assert run.get("remote_age") == pytest.approx(0.2)


def test_slopes_of_outputs_are_their_derivatives(container: Path) -> None:
    with Runner(container) as run:
        run.start()
        for k in range(150):
            run.step(k * 0.01, 0.01)
        before, slope = run.get("remote_y"), run.slope("remote_y")
        speed, rate = run.get("G2_dw"), run.slope("G2_dw")
        run.step(1.5, 1e-5)
        assert (run.get("remote_y") - before) / 1e-5 == pytest.approx(slope, rel=1e-3, abs=1e-9)
        assert (run.get("G2_dw") - speed) / 1e-5 == pytest.approx(rate, rel=1e-3, abs=1e-9)


@pytest.mark.slow
def test_archive_is_valid_and_its_sources_stand_alone(container: Path) -> None:
    assert validate_fmu(str(container)) == []
    schema = Path(fmpy.__file__).parent / "schema" / "fmi2" / "fmi2ModelDescription.xsd"
    with zipfile.ZipFile(container) as archive:
        document = etree.parse(io.BytesIO(archive.read("modelDescription.xml")))
        assert etree.XMLSchema(etree.parse(str(schema))).validate(document)
        sources = {n.removeprefix("sources/") for n in archive.namelist() if n.startswith("sources/")}
        assert {"plant_c.h", "channel_c.h", "state_space_c.h", "container.c"} <= sources
        assert not {"plant.c", "channel.c", "state_space.c"} & sources
        assert [e for e in document.iter("{*}ScalarVariable") if e.get("causality") == "input"] == []


def test_loops_that_one_block_cannot_hold(cache: Path, by_hand: Controller) -> None:
    loop = members_of(load_scenario(scenario(latency_s=0.1)), cache=cache, controller=by_hand)
    members = [LoopMember(m.name, b, pack_record(record_entries(b))) for m in loop.all if (b := m.block)]
    settings = {"step_s": 0.01, "stop_s": 1.0}
    with pytest.raises(ValueError, match=r"remote.y -> plant.G1_vs \(channel -> plant\) is not possible"):
        loop_block("x", members, [("remote.y", "plant.G1_vs")], **settings)
    with pytest.raises(ValueError, match=r"controller.G2_dw is fed twice"):
        loop_block("x", members, [*loop.connections, ("remote.y", "controller.G2_dw")], **settings)
    with pytest.raises(ValueError, match=r"plants \[\], allowed: one"):
        loop_block("x", [m for m in members if m.name != "plant"], [], **settings)
    with pytest.raises(ScenarioError, match="not an output of the plant"):
        container_block(
            load_scenario(scenario(latency_s=0.1) | {"channels": {"a": {"signal": "G9_dw"}}}),
            cache=cache,
            controller=by_hand,
        )


def test_command_writes_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "open.toml"
    file.write_text('case = "two-area-thesis"\nstop_s = 1.0\n', encoding="utf-8")
    out = tmp_path / "open.fmu"
    words = ["interarea", "container", str(file), "--out", str(out), "--platforms", host_platform()]
    monkeypatch.setattr(sys, "argv", words)
    with pytest.raises(SystemExit) as stopped:
        main()
    assert not stopped.value.code
    assert capfd.readouterr().out.strip() == str(out)
    result = fmpy.simulate_fmu(str(out), stop_time=0.1)
    assert abs(result["tie_p"][-1] - result["tie_p"][0]) < 1e-9


@pytest.mark.slow
def test_joint_run_has_the_masters_columns_and_the_containers_bits(
    cache: Path, hand_controller: Controller
) -> None:
    table = scenario(latency_s=0.0537, reporting_interval_s=0.02, loss={"kind": "bernoulli", "rate": 0.2})
    joint = run_joint(table, cache=cache, controller=hand_controller)
    apart = run_scenario(table, cache=cache, controller=hand_controller)
    assert set(joint.data) == set(apart.data)
    assert joint.units == apart.units
    speed = "plant.G2_dw"
    on_grid = apart.data.merge(joint.data[["time_s"]], on="time_s")
    assert len(on_grid) == len(joint.data) == 301
    span = np.ptp(joint[speed])
    assert np.max(np.abs(on_grid[speed] - joint[speed])) < TOLERANCE * span
    assert joint.packets["remote"]["sent"] == apart.packets["remote"]["sent"] > 100
    assert joint.ledger["remote.u"].total_s == pytest.approx(0.0637)
    assert joint.metrics.stable == apart.metrics.stable


def test_joint_scenario_is_not_run_by_a_master(hand_controller: Controller) -> None:
    with pytest.raises(ScenarioError, match="joint = true requests one block"):
        run_scenario({**scenario(), "master": {"joint": True}}, controller=hand_controller)
    with pytest.raises(ScenarioError, match="case is missing"):
        run_joint({"stop_s": 1.0, "fmus": {"a": {"file": "a.fmu"}}})


@pytest.mark.slow
def test_a_chain_is_the_loop_without_its_plant(cache: Path, by_hand: Controller, tmp_path: Path) -> None:
    """PMU, channel and controller as one DLL: its inputs are what the plant gives, latency the scenario's."""
    table = scenario(latency_s=0.07, pmu={"bus": 7}, reporting_interval_s=0.02)
    table["controller"] = "robust"
    chain = chain_of(load_scenario(table), cache=cache)
    kinds = [b.kind for b in chain.members.values()]
    assert kinds == ["pmu", "channel", "controller"]
    pmu, remote, controller = chain.members
    wired = [(f"{pmu}.deviation", f"{remote}.u"), (f"{remote}.y", f"{controller}.G2_dw")]
    assert sorted(chain.connections) == sorted(wired)
    dll = RealCodeLibrary(build_dll(chain, tmp_path, platform="linux64", cache=cache))
    shown = port_name(pmu)
    assert {p.name for p in dll.inputs} == {f"{shown}_re", f"{shown}_im", "G4_dw"}
    assert {p.name: p.start for p in dll.parameters}[f"{remote}_latency"] == 0.07
    with pytest.raises(ScenarioError, match="channels and a controller, got none"):
        chain_of(load_scenario({**table, "controller": "none", "channels": {}}), cache=cache)
