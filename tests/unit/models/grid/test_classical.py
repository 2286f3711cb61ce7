"""Classical machines: against the swing equation in closed form, alone and beside round-rotor machines."""

from __future__ import annotations

import numpy as np
import pytest
from plant_shim import BlockFailure, BlockShim

from interarea.models.blocks.plant import event_parameters, plant_block
from interarea.models.case.case import Case, case_of, load_case
from interarea.models.case.events import events_of
from interarea.models.grid.equilibrium import operating_point

TWO = {
    "name": "two-machines",
    "source": "closed form",
    "frequency_hz": 50.0,
    "base_mva": 100.0,
    "buses": {"1": {}, "2": {"area": 2}},
    "branches": {"1-2": {"from": 1, "to": 2, "x": 0.4}},
    "loads": {"L": {"bus": 2, "P_mw": 0.0, "Q_mvar": 0.0}},
    "machines": {
        "A": {
            "bus": 1,
            "base_mva": 200.0,
            "model": "classical",
            "H": 4.0,
            "Xd1": 0.3,
            "P_mw": 80.0,
            "V_pu": 1.0,
        },
        "B": {
            "bus": 2,
            "area": 2,
            "base_mva": 100.0,
            "model": "classical",
            "H": 3.0,
            "D": 2.0,
            "Xd1": 0.2,
            "P_mw": 0.0,
            "V_pu": 1.02,
            "slack": True,
        },
    },
}
MIXED = {"machines": {"G1": {"model": "classical"}, "G3": {"model": "classical"}}}


def mixed() -> Case:
    """Kundur's two areas with a classical machine in front of a round-rotor one, twice."""
    return load_case("kundur-manual").with_changes(MIXED)


def test_two_machines_swing_as_the_closed_form_says():
    r"""2H_k s' = P_k - E_A E_B sin(d)/X: with K = E_A E_B cos(d0)/X the 4 eigenvalues are known."""
    case = case_of(TWO, where="test")
    point = operating_point(case)
    plant = BlockShim(plant_block(case))
    a, b = point.machines
    X = 0.3 * 100.0 / 200.0 + 0.4 + 0.2
    K = a.efd * b.efd * np.cos(a.delta - b.delta) / X
    assert a.efd * b.efd * np.sin(a.delta - b.delta) / X == pytest.approx(0.8, abs=1e-9)
    Ma, Mb, w = 2 * 4.0 * 2.0, 2 * 3.0, case.omega_b
    A = np.array([[0, 0, w, 0], [0, 0, 0, w], [-K / Ma, K / Ma, 0, 0], [K / Mb, -K / Mb, 0, -2.0 / Mb]])
    assert plant.state_names == ("A.delta", "B.delta", "A.slip", "B.slip")
    np.testing.assert_allclose(plant.jacobians()[0], A, atol=1e-9)
    assert np.abs(plant.derivatives(plant.x)[0]).max() < 1e-12


def test_nothing_moves_at_rest_beside_round_rotor_machines():
    plant = BlockShim(plant_block(mixed()))
    assert len(plant.x) == 24 - 8
    dx, y = plant.derivatives(plant.x)
    assert np.abs(dx).max() < 1e-11
    point = operating_point(mixed())
    values = dict(zip(plant.output_names, y, strict=True))
    for m, power in zip(mixed().machines, point.power_flow.generation, strict=True):
        assert values[f"{m.name}_pe"] == pytest.approx(power.real, abs=1e-9)
        assert values[f"{m.name}_vt"] == pytest.approx(m.V_pu, abs=1e-9)


def test_classical_is_the_limit_of_slow_fields():
    """A round-rotor machine with X'' = X' on both axes and very slow circuits keeps its EMF."""
    slow = {"Xd1": 0.3, "Xq1": 0.3, "Xd2": 0.3, "Xq2": 0.3}
    slow |= dict.fromkeys(("Td01", "Tq01", "Td02", "Tq02"), 1e7)
    base = load_case("kundur-manual").with_changes({"machines": {"defaults": {"saturation": "none"}}})
    swing = []
    for change in (slow, {"model": "classical"}):
        case = base.with_changes({"machines": {"G1": change, "G3": change}})
        values = np.linalg.eigvals(BlockShim(plant_block(case)).jacobians()[0])
        swing.append(sorted((e for e in values if e.imag > 2.0), key=lambda e: e.imag))
    np.testing.assert_allclose(swing[0], swing[1], atol=1e-5)


def test_directional_derivatives_agree_with_central_differences():
    plant = BlockShim(plant_block(mixed()))
    x = plant.x + 0.01 * np.random.default_rng(2).standard_normal(len(plant.x))
    A, _, C, _ = plant.jacobians(x)
    for k in range(len(x)):
        step = np.zeros(len(x))
        step[k] = 1e-5
        up, down = plant.derivatives(x + step), plant.derivatives(x - step)
        for exact, high, low in ((A[:, k], up[0], down[0]), (C[:, k], up[1], down[1])):
            np.testing.assert_allclose((high - low) / 2e-5, exact, atol=3e-6 * max(1.0, np.abs(exact).max()))


def test_events_find_their_machine_whatever_its_model():
    case = mixed()
    for name in ("G1", "G2", "G3", "G4"):
        event = events_of([{"kind": "machine_trip", "machine": name, "start_s": 0.0}], where="test")
        plant = BlockShim(plant_block(case), event_parameters(case, event))
        values = dict(zip(plant.output_names, plant.derivatives(plant.x)[1], strict=True))
        assert [m for m in ("G1", "G2", "G3", "G4") if values[f"{m}_pe"] == 0.0] == [name]


def resonant() -> Case:
    """A machine, a line and a capacitor that cancels what the bus sees: j0.2 + j0.3 against 200 Mvar."""
    machine = {"bus": 1, "base_mva": 100.0, "model": "classical", "H": 4.0, "Xd1": 0.2, "V_pu": 1.0}
    return case_of(
        {
            "name": "resonant",
            "source": "closed form",
            "frequency_hz": 50.0,
            "base_mva": 100.0,
            "buses": {"1": {}, "2": {}},
            "branches": {"1-2": {"from": 1, "to": 2, "x": 0.3}},
            "shunts": {"C": {"bus": 2, "Q_mvar": 200.0, "in_service": False}},
            "machines": {"A": machine | {"P_mw": 0.0, "slack": True}},
        },
        where="test",
    )


def test_a_switch_that_leaves_the_admittance_singular_names_the_bus():
    case = resonant()
    event = events_of([{"kind": "shunt_switch", "shunt": "C", "to": "in", "start_s": 0.5}], where="test")
    plant = BlockShim(plant_block(case), event_parameters(case, event))
    with pytest.raises(BlockFailure, match="singular at bus 2"):
        plant.run(1.0, 0.01)
