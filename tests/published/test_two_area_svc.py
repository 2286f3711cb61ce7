"""The case two-area-svc: our plant, an independent program, and PSTess.

PSTess multiplies the EMFs by speed and takes torques as powers over speed, which the package does not. So the
independent program is held to PSTess with these terms, and the plant to the independent program without them.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from independent.two_area_svc import TwoAreaSvc
from plant_shim import BlockShim
from scipy.optimize import linear_sum_assignment

from interarea.models.blocks.plant import plant_block
from interarea.models.case.case import load_case

PSTESS = json.loads((Path(__file__).parent / "two_area_svc.json").read_text())["eigenvalues"]
LAGS = -20.0  #: of load modulation that nothing drives, in PSTess alone


def farthest(one, other):
    distance = np.abs(one[:, None] - other[None, :])
    rows, columns = linear_sum_assignment(distance)
    return float(np.max(distance[rows, columns]))


def pstess():
    upper = [complex(*pair) for pair in PSTESS]
    whole = upper + [np.conj(v) for v in upper if v.imag > 1e-9]
    for _ in range(3):
        whole.remove(min(whole, key=lambda v: abs(v - LAGS)))
    return np.array(whole)


@pytest.fixture(scope="module")
def plant():
    return BlockShim(plant_block(load_case("two-area-svc")))


def test_the_independent_program_has_the_eigenvalues_of_pstess():
    model = TwoAreaSvc(speed_terms=True)
    assert np.max(np.abs(model.rates(model.x0))) < 1e-11
    values = np.linalg.eigvals(model.matrix())
    assert len(values) == len(pstess()) == 54
    assert farthest(values, pstess()) < 2.5e-4  # the perturbation of PSTess: 2.3e-4


@pytest.mark.slow
def test_the_plant_has_the_eigenvalues_of_the_independent_program(plant):
    model = TwoAreaSvc(speed_terms=False)
    A, B, _, _ = plant.jacobians()
    values = np.linalg.eigvals(A)
    expected = np.linalg.eigvals(model.matrix())
    assert len(values) == 54
    # two eigenvalues near zero are one double one, of the common angle: there the root of rounding
    moved = farthest(values[np.abs(values) > 1e-2], expected[np.abs(expected) > 1e-2])
    assert moved < 1e-6
    assert np.max(np.abs(values[np.abs(values) < 1e-2])) < 1e-3
    column = B[:, plant.input_names.index("svc1_v_mod")]
    s = 1j * np.array([0.5, 2.0, 3.5, 8.0])
    machines = [plant.state_names.index(f"G{k}.slip") for k in (1, 2, 3, 4)]
    for value in s:
        ours = np.linalg.solve(value * np.eye(54) - A, column)[machines]
        theirs = np.linalg.solve(value * np.eye(54) - model.matrix(), model.input_column())[4:8]
        assert np.max(np.abs(ours - theirs)) < 1e-6 * np.max(np.abs(theirs))
    # without its SVC's state the swing would be another: the bound above is no matter of course
    A[plant.state_names.index("svc1.b")] = 0.0
    assert farthest(np.linalg.eigvals(A), expected) > 0.1


@pytest.mark.slow
def test_the_case_stands_still_for_20_s(plant):
    _, x, _ = plant.run(20.0, 0.005)
    swinging = [k for k, name in enumerate(plant.state_names) if not name.endswith(".delta")]
    assert np.max(np.abs(x[:, swinging] - x[0, swinging])) < 1e-12
