"""The case mini-wecc: our plant, an independent program, and PSTess.

PSTess multiplies the EMFs of machines by speed, takes torques as powers over speed, and has the bridge
voltage of its exciters from an EMF that it has not multiplied; the package does none of it. So the
independent program is held to PSTess with these terms, the plant to the independent program without them,
and what they move is stated here.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from independent.mini_wecc import MiniWecc
from plant_shim import BlockShim
from published.test_two_area_svc import farthest
from scipy.optimize import linear_sum_assignment

from interarea.models.blocks.plant import plant_block
from interarea.models.case.case import load_case
from interarea.models.grid.powerflow import solve_powerflow

PSTESS = np.array(json.loads((Path(__file__).parent / "mini_wecc.json").read_text())["modes"])


def beside_pstess(values):
    """Frequency and damping ratio of the modes nearest those of PSTess, in their order."""
    upper = values[values.imag > 0.5]
    ours = np.array([upper.imag / (2.0 * np.pi), -upper.real / np.abs(upper)])
    apart = np.hypot(PSTESS[:, :1] - ours[0], PSTESS[:, :1] * (PSTESS[:, 1:] - ours[1]))
    return ours[:, linear_sum_assignment(apart)[1]].T


@pytest.fixture(scope="module")
def plant():
    return BlockShim(plant_block(load_case("mini-wecc")))


@pytest.fixture(scope="module")
def linear(plant):
    return plant.jacobians()[0]


def test_the_independent_program_has_the_modes_of_pstess():
    model = MiniWecc(speed_terms=True)
    assert np.max(np.abs(model.residual(model.z0))) < 1e-11
    modes = beside_pstess(np.linalg.eigvals(model.matrix()))
    assert np.max(np.abs(modes - PSTESS)) < 5.1e-5  # the digits of PSTess: half of the last is 5e-5


def test_the_plant_has_the_eigenvalues_of_the_independent_program(linear):
    expected = np.linalg.eigvals(MiniWecc(speed_terms=False).matrix())
    values = np.linalg.eigvals(linear)
    assert len(values) == len(expected) == 437
    assert farthest(values, expected) < 1e-9


def test_how_far_the_plant_is_from_pstess(linear):
    """Without these terms frequencies are higher, damping ratios lower but for the slowest mode."""
    moved = beside_pstess(np.linalg.eigvals(linear)) - PSTESS
    slowest, others = moved[0], moved[1:]
    assert slowest == pytest.approx([0.0019, 0.0139], abs=1e-4)
    assert np.min(moved[:, 0]) > 0.0
    assert np.max(moved[:, 0]) == pytest.approx(0.0057, abs=1e-4)
    assert np.max(others[:, 1]) < 0.0
    assert np.min(others[:, 1]) == pytest.approx(-0.0119, abs=1e-4)
    assert moved[3] == pytest.approx([0.0040, -0.0051], abs=1e-4)  # the least damped: .6226 Hz, .0493


@pytest.mark.slow
@pytest.mark.parametrize("name", ["mini-wecc", "mini-wecc-dc"])
def test_the_case_stands_still_for_20_s(name):
    plant = BlockShim(plant_block(load_case(name)))
    _, x, _ = plant.run(20.0, 0.005)
    swinging = [k for k, name in enumerate(plant.state_names) if not name.endswith(".delta")]
    assert np.max(np.abs(x[:, swinging] - x[0, swinging])) < 1e-12


def test_the_links_of_mini_wecc_dc_carry_what_the_injections_do(linear):
    """The same voltages; modes move since links keep their power where injections follow the voltage."""
    one, other = (solve_powerflow(load_case(name)) for name in ("mini-wecc", "mini-wecc-dc"))
    assert np.max(np.abs(one.voltages - other.voltages)) < 1e-9
    moved = beside_pstess(np.linalg.eigvals(BlockShim(plant_block(load_case("mini-wecc-dc"))).jacobians()[0]))
    moved -= beside_pstess(np.linalg.eigvals(linear))
    assert np.max(np.abs(moved), axis=0) == pytest.approx([0.0021, 0.0021], abs=1e-4)
