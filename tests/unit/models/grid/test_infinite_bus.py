"""An infinite bus: an EMF that turns at nominal frequency whatever happens behind its impedance."""

from __future__ import annotations

import math

import numpy as np
import pytest
from plant_shim import BlockShim

from interarea.models.blocks.plant import plant_block
from interarea.models.case.case import Case, CaseError, case_of
from interarea.models.grid.equilibrium import operating_point

DOCUMENT = {
    "name": "omib",
    "source": "closed form",
    "frequency_hz": 50.0,
    "base_mva": 100.0,
    "buses": {"1": {}, "2": {"area": 2}},
    "branches": {"1-2": {"from": 1, "to": 2, "x": 0.4}},
    "machines": {
        "A": {"bus": 1, "base_mva": 200.0, "model": "classical", "H": 4.0, "D": 1.5, "Xd1": 0.3}
        | {"P_mw": 80.0, "V_pu": 1.0},
        "INF": {"bus": 2, "area": 2, "base_mva": 100.0, "model": "infinite_bus", "Xd1": 0.05}
        | {"P_mw": 0.0, "V_pu": 1.02, "slack": True},
    },
}


GOVERNOR = {"kind": "tgov1", "R": 0.05, "T1": 0.5, "T2": 1.0, "T3": 5.0, "Dt": 0.0, "Vmin": 0.0, "Vmax": 1.0}


def case(**change: object) -> Case:
    result = case_of(DOCUMENT, where="test")
    return result.with_changes({"machines": change}) if change else result


def test_one_machine_against_it_swings_as_the_closed_form_says() -> None:
    r"""2H s' = P - D s - E V sin(d)/X; the infinite bus itself has neither motion nor memory."""
    a, b = operating_point(case()).machines
    X = 0.3 * 0.5 + 0.4 + 0.05
    K, M, w = a.efd * b.efd * np.cos(a.delta - b.delta) / X, 2 * 4.0 * 2.0, 2 * math.pi * 50.0
    assert a.efd * b.efd * np.sin(a.delta - b.delta) / X == pytest.approx(0.8, abs=1e-9)
    plant = BlockShim(plant_block(case()))
    A = np.array([[0, 0, w, 0], [0, 0, 0, w], [-K / M, K / M, -1.5 / 8.0, 0], [0, 0, 0, 0]])
    np.testing.assert_allclose(plant.jacobians()[0], A, atol=1e-9)
    dx, y = plant.derivatives(plant.x)
    assert np.abs(dx).max() < 1e-12
    outputs = dict(zip(plant.output_names, y, strict=True))
    assert outputs["INF_delta"] == 0.0  # it is the centre against which angles count
    assert outputs["A_delta"] == pytest.approx(a.delta - b.delta, abs=1e-12)


def test_it_does_not_move_when_the_machine_does() -> None:
    plant = BlockShim(plant_block(case()))
    x = plant.x.copy()
    x[plant.state_names.index("A.delta")] += 1.0
    x[plant.state_names.index("A.slip")] += 0.01
    dx = dict(zip(plant.state_names, plant.derivatives(x)[0], strict=True))
    assert dx["INF.slip"] == 0.0 and dx["INF.delta"] == 0.0
    assert abs(dx["A.slip"]) > 1e-3


def test_it_is_the_limit_of_a_heavy_machine() -> None:
    heavy = {"model": "classical", "H": 1e9, "Xd1": 0.05}
    light = BlockShim(plant_block(case())).jacobians()[0]
    np.testing.assert_allclose(BlockShim(plant_block(case(INF=heavy))).jacobians()[0], light, atol=1e-8)


def test_two_of_them_are_the_centre_in_equal_parts() -> None:
    second = {"bus": 1, "base_mva": 50.0, "model": "infinite_bus", "Xd1": 0.2, "P_mw": 10.0, "V_pu": 1.0}
    both = case(SECOND=second)
    plant = BlockShim(plant_block(both))
    outputs = dict(zip(plant.output_names, plant.derivatives(plant.x)[1], strict=True))
    assert outputs["INF_delta"] == pytest.approx(-outputs["SECOND_delta"], abs=1e-12)
    assert abs(outputs["INF_delta"]) > 0.01


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ({"H": 3.0}, "neither inertia nor a governor"),
        ({"D": 1.0}, "neither inertia nor a governor"),
        ({"governor": GOVERNOR}, "neither inertia nor a governor"),
        ({"Xd1": "none"}, "a infinite_bus machine needs Xd1"),
    ],
)
def test_what_it_cannot_have_is_refused(row: dict, message: str) -> None:
    with pytest.raises(CaseError, match=message):
        case(INF=row)
