"""The case two-area-hvdc: our plant, an independent program, and PSTess.

PSTess multiplies the EMFs by speed and takes torques as powers over speed, which the package does not. So the
independent program is held to PSTess with these terms, and the plant to the independent program without them.
PSTess's numbers are those of its linearisation put right for converters (docs/actuators.md).
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from independent.two_area_dc import DTESTDC, TwoAreaDc
from plant_shim import BlockShim
from published.test_two_area_svc import farthest

from interarea.models.blocks.plant import plant_block
from interarea.models.case.case import load_case
from interarea.models.grid.equilibrium import operating_point

PSTESS = json.loads((Path(__file__).parent / "two_area_hvdc.json").read_text())
OWN_LAGS = -50.0  #: of the measured dc voltage and of the order, which PSTess has not


def pstess():
    upper = [complex(*pair) for pair in PSTESS["eigenvalues"]]
    return np.array(upper + [np.conj(v) for v in upper if v.imag > 1e-9])


def test_the_independent_program_has_the_eigenvalues_of_pstess():
    model = TwoAreaDc(DTESTDC, speed_terms=True)
    assert np.max(np.abs(model.rates(model.x0))) < 1e-11
    values = np.linalg.eigvals(model.matrix())
    assert len(values) == len(pstess()) == 55
    large = np.abs(values) > 2e-3  # two near zero are one double one, of the common angle
    assert farthest(values[large], pstess()[np.abs(pstess()) > 2e-3]) < 1e-6


def test_the_link_rests_where_that_of_pstess_does():
    point = operating_point(load_case("two-area-hvdc"))
    at = dict(zip(point.state_names, point.x0, strict=True))
    rest = PSTESS["at_rest"]
    assert at["hvdc1.xr"] == pytest.approx(rest["alpha"], abs=1e-8)
    assert at["hvdc1.xi"] == pytest.approx(rest["gamma"], abs=1e-9)
    assert at["hvdc1.idc"] * 0.2 == pytest.approx(rest["i_dcr"], abs=1e-12)
    assert at["hvdc1.vm"] * 500.0 == pytest.approx(rest["Vdc"], abs=5e-5)


@pytest.mark.parametrize("network", ["dense", "sparse"])
def test_the_plant_has_the_eigenvalues_and_the_response_of_the_independent_program(network):
    model = TwoAreaDc(DTESTDC, speed_terms=False)
    M = model.matrix()
    plant = BlockShim(plant_block(load_case("two-area-hvdc"), network=network))
    A, B, _, _ = plant.jacobians()
    values, expected = np.linalg.eigvals(A), np.append(np.linalg.eigvals(M), [OWN_LAGS, OWN_LAGS])
    assert len(values) == len(expected) == 57
    # two eigenvalues near zero are one double one, of the common angle: there the root of rounding
    assert farthest(values[np.abs(values) > 1e-2], expected[np.abs(expected) > 1e-2]) < 1e-6
    column = B[:, plant.input_names.index("hvdc1_p_mod")]
    machines = [plant.state_names.index(f"G{k}.slip") for k in (1, 2, 3, 4)]
    vdr = PSTESS["at_rest"]["Vdc"] / 500.0
    for value in 1j * np.array([0.5, 2.0, 3.5, 8.0]):
        ours = np.linalg.solve(value * np.eye(57) - A, column)[machines]
        theirs = np.linalg.solve(value * np.eye(55) - M, model.input_column())[4:8]
        theirs = (
            theirs * 0.2 / vdr / (1.0 + 0.02 * value)
        )  # a power by the dc voltage, behind the order's lag
        assert np.max(np.abs(ours - theirs)) < 1e-6 * np.max(np.abs(theirs))
    # with the inverter's angle held the modes would be others: the bound above is no matter of course
    A[plant.state_names.index("hvdc1.xi")] = 0.0
    assert farthest(np.linalg.eigvals(A), expected) > 0.01


@pytest.mark.slow
def test_the_case_stands_still_for_20_s():
    plant = BlockShim(plant_block(load_case("two-area-hvdc")))
    _, x, _ = plant.run(20.0, 0.002)
    swinging = [k for k, name in enumerate(plant.state_names) if not name.endswith(".delta")]
    assert np.max(np.abs(x[:, swinging] - x[0, swinging])) < 1e-12
