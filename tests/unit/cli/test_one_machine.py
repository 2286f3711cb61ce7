"""A grid of one machine, alone or against an infinite bus: every command that looks at modes and verdicts."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import invoke

import interarea as ia
from interarea.cosim.records.model_source import source_by_model
from interarea.cosim.records.record import Channel, Record
from interarea.cosim.run.artefacts import sparse_linear_plant
from interarea.design.linear.zero_eigenvalues import zero_eigenvalues_of
from interarea.design.modes.all_modes import all_modes
from interarea.fmu_build.write.cache import default_cache
from interarea.models.case.case import Case

X, XD1, R, D, H = 0.1, 0.3, 0.05, 2.0, 6.5
RAW = f"""0, 100.0, 33, 0, 1, 60.0 / one machine


1,'A',20.0,{{kind_a}},1,1,1,1.0,0.0
2,'B',230.0,{{kind_b}},1,1,1,1.0,0.0
0 / END OF BUS DATA
2,'1',1,1,1,50.0,10.0
0 / END OF LOAD
0 / END OF FIXED SHUNT
1,'1',50.0,10.0,100.0,-100.0,1.0,0,100.0,0.0,{XD1}
{{second}}0 / END OF GENERATOR
1,2,'1',0.0,{X},0.0
0 / END OF BRANCH
Q
"""
GOVERNOR = f"1 'TGOV1' 1 {R} 0.5 1.0 0.0 2.1 7.0 0.0 /\n"
INFINITE = {"kind_a": "2", "kind_b": "3", "second": "2,'1',0,0,9999,-9999,1.0,0,100.0,0.0,0.0001\n"}


def grid(folder: Path, *, infinite: bool = False, governor: bool = True) -> Case:
    """Import a classical machine with a load, the other end of its line an infinite bus or not."""
    keys = INFINITE if infinite else {"kind_a": "3", "kind_b": "1", "second": ""}
    (folder / "one.raw").write_text(RAW.format(**keys))
    records = f"1 'GENCLS' 1 {H} {D} /\n" + GOVERNOR * governor + "2 'GENCLS' 1 0.0 0.0 /\n" * infinite
    (folder / "one.dyr").write_text(records)
    return ia.import_case(folder / "one.raw", dyr=folder / "one.dyr")


def steady_speed(case: Case, p_pu: float, droop: float) -> float:
    """Balance torques by hand: EMF behind X'd and the line, against load and step as admittances."""
    V = case.buses[1].V_pu * np.exp(1j * np.radians(case.buses[1].angle_deg))
    Y = np.conj(0.5 + 0.1j) / abs(V) ** 2
    E = V + 1j * (X + XD1) * Y * V

    def power(load: complex) -> float:
        return float(abs(E) ** 2 * (1.0 / (1j * (X + XD1) + 1.0 / load)).real)

    return (power(Y) - power(Y + p_pu / abs(V) ** 2)) / (D + droop)


@pytest.mark.parametrize(("p_pu", "governor"), [(0.01, True), (-0.02, True), (0.01, False)])
def test_after_a_load_step_it_settles_at_the_speed_of_a_calculation_by_hand(
    tmp_path: Path, p_pu: float, governor: bool
) -> None:
    case = grid(tmp_path, governor=governor)
    step = {"kind": "load_step", "bus": 2, "start_s": 1.0, "p_pu": p_pu}
    run = ia.simulate({"stop_s": 120.0, "event": [step]}, case=case)
    expected = steady_speed(case, p_pu, 1.0 / R if governor else 0.0)
    assert run["plant.G1_dw"][-1] == pytest.approx(expected, rel=1e-6)
    assert run.stable
    assert run.verdict.name == "settled"


def test_nothing_brings_back_a_machine_without_damping_and_governor(tmp_path: Path) -> None:
    case = grid(tmp_path, governor=False)
    undamped = case.model_copy(update={"machines": (case.machines[0].model_copy(update={"D": 0.0}),)})
    step = {"kind": "load_step", "bus": 2, "start_s": 1.0, "p_pu": 0.01}
    run = ia.simulate({"stop_s": 20.0, "event": [step]}, case=undamped)
    torque = steady_speed(case, 0.01, 0.0) * D
    assert run["plant.G1_dw"][-1] == pytest.approx(torque / (2.0 * H) * 19.0, rel=1e-4)
    assert not run.stable


@pytest.mark.slow
def test_modes_of_a_machine_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = ia.modes(grid(tmp_path))
    assert len(result) == 0
    assert result.growth is not None
    assert result.growth.stable
    with pytest.raises(ia.UserError, match="this system has no swing mode"):
        _ = result.inter_area
    assert invoke(("import", "one.raw", "--dyr", "one.dyr", "--out", "one.toml"), monkeypatch)[0] == 0
    words = ("modes", "one.toml", "--shapes", "--margins", "--sensitivity", "machines.G1.H")
    code, out, complaint = invoke(words, monkeypatch)
    assert (code, complaint) == (0, "")
    assert out.startswith("stable: of 4 eigenvalues none grows")
    assert "a single machine has no swing mode" in out
    code, out, _ = invoke((*words, "--json"), monkeypatch)
    assert (code, json.loads(out)["modes"]) == (0, {})
    assert invoke(("explore", "one.toml", "--out", "one.html"), monkeypatch)[0] == 0


def test_modes_against_an_infinite_bus(tmp_path: Path) -> None:
    case = grid(tmp_path, infinite=True, governor=False)
    # one machine, by hand: 2 H s^2 + D s + omega_b K = 0 with the slope K of its power over its angle
    E = 1.0 * np.exp(1j * np.radians(case.buses[0].angle_deg))
    V2 = case.buses[1].V_pu * np.exp(1j * np.radians(case.buses[1].angle_deg))
    emf = E + 1j * XD1 * (E - V2) / (1j * X)
    delta = np.angle(emf) - np.angle(V2)
    slope = abs(emf) * abs(V2) / (X + XD1) * np.cos(delta)
    expected = np.roots([2.0 * H, D, case.omega_b * slope])[0]
    (mode,) = ia.modes(case).values()
    assert abs(mode.eigenvalue.imag) == pytest.approx(abs(expected.imag), rel=1e-3)  # the bus has 1e-4 pu
    assert mode.eigenvalue.real == pytest.approx(expected.real, rel=1e-3)
    plant = sparse_linear_plant(case, default_cache())
    zeros = zero_eigenvalues_of(plant)
    assert (zeros.rotation, zeros.common_speed, zeros.infinite) == (False, False, ("G2",))
    near = np.sum(np.abs(np.linalg.eigvals(plant.state_matrix())) < 1e-5)
    result = all_modes(plant, case.areas, band_hz=(0.1, 3.0), below=0.2)
    assert zeros.count == result.near_zero == near == 2
    assert len(result.modes) == 1


def test_the_only_place_for_a_source_is_named(tmp_path: Path) -> None:
    """A machine against an infinite bus, no load: its torque is all that may swing, 0.02 pu at 0.9 Hz."""
    case = grid(tmp_path, infinite=True, governor=False).model_copy(update={"loads": ()})
    plant = sparse_linear_plant(case, default_cache())
    torque = np.zeros((plant.nstates, 1))
    torque[plant.speed[0]] = 0.02 / (2.0 * H)
    swing = plant.forced(2j * np.pi * 0.9, torque, np.zeros((len(plant.bus_names), 2, 1)))
    size, angle = plant.size_and_angle(swing.voltages)
    machine = plant.machines[0]
    rows = {
        (machine, "speed", "pu"): swing.states[plant.speed[0]],
        (machine, "rotor angle", "rad"): swing.states[plant.angle[0]],
        ("bus1", "voltage", "pu"): size[0],
        ("bus1", "voltage angle", "rad"): angle[0],
    }
    time_s = np.arange(0.0, 20.0, 0.05)
    values = np.array([np.real(row * np.exp(2j * np.pi * 0.9 * time_s)) for row in rows.values()]).T
    channels = tuple(Channel(f"{at} {quantity}", quantity, unit, at) for at, quantity, unit in rows)
    result = source_by_model(Record("one", time_s, values, channels), case, plant, frequency_hz=0.9)
    assert [c.places for c in result.candidates] == [(machine,)]
    assert result.source is not None
    assert result.source.amplitude[0] == pytest.approx(0.02, rel=1e-3)
    assert result.likelihood == 0.0
