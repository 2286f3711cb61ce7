"""The cases two-area-hvdc and two-area-hvdc-modulated: our plant, an independent program, and PSTess.

PSTess multiplies the EMFs by speed and takes torques as powers over speed, which the package does not. So the
independent program is held to PSTess with these terms, and the plant to the independent program without them.
PSTess's numbers are those of its linearisation put right for converters (docs/actuators.md).
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from independent.two_area_dc import DTESTDC, DTESTDCR, TwoAreaDc
from plant_shim import BlockShim
from published.test_two_area_svc import farthest

from interarea.models.blocks.plant import plant_block
from interarea.models.case.case import load_case
from interarea.models.grid.equilibrium import operating_point

BOTH = {"two-area-hvdc": DTESTDC, "two-area-hvdc-modulated": DTESTDCR}
STATES = {"two-area-hvdc": 55, "two-area-hvdc-modulated": 68}
PSTESS = {
    name: json.loads((Path(__file__).parent / f"{name.replace('-', '_')}.json").read_text()) for name in BOTH
}
OWN_LAGS = -50.0  #: of the measured dc voltage and of the order, which PSTess has not


def pstess(name):
    upper = [complex(*pair) for pair in PSTESS[name]["eigenvalues"]]
    return np.array(upper + [np.conj(v) for v in upper if v.imag > 1e-9])


@pytest.mark.parametrize(("name", "off"), [("two-area-hvdc", 1e-6), ("two-area-hvdc-modulated", 2e-5)])
def test_the_independent_program_has_the_eigenvalues_of_pstess(name, off):
    model = TwoAreaDc(BOTH[name], speed_terms=True)
    assert np.max(np.abs(model.rates(model.x0))) < 1e-11
    values = np.linalg.eigvals(model.matrix())
    assert len(values) == len(pstess(name)) == STATES[name]
    large = np.abs(values) > 2e-3  # two near zero are one double one, of the common angle
    assert farthest(values[large], pstess(name)[np.abs(pstess(name)) > 2e-3]) < off


@pytest.mark.parametrize("name", BOTH)
def test_the_link_rests_where_that_of_pstess_does(name):
    case = load_case(name)
    point = operating_point(case)
    at = dict(zip(point.state_names, point.x0, strict=True))
    rest, base = PSTESS[name]["at_rest"], case.hvdcs[0].base_mva / 500.0
    assert at["hvdc1.xr"] == pytest.approx(rest["alpha"], abs=4e-8)
    assert at["hvdc1.xi"] == pytest.approx(rest["gamma"], abs=1e-9)
    assert at["hvdc1.idc"] * base == pytest.approx(rest["i_dcr"], abs=1e-12)
    assert at["hvdc1.vm"] * 500.0 == pytest.approx(rest["Vdc"], abs=5e-5)


@pytest.mark.slow
@pytest.mark.parametrize("network", ["dense", "sparse"])
@pytest.mark.parametrize("name", BOTH)
def test_the_plant_has_the_eigenvalues_and_the_response_of_the_independent_program(name, network):
    model, case = TwoAreaDc(BOTH[name], speed_terms=False), load_case(name)
    M, n = model.matrix(), STATES[name]
    plant = BlockShim(plant_block(case, network=network))
    A, B, _, _ = plant.jacobians()
    values, expected = np.linalg.eigvals(A), np.append(np.linalg.eigvals(M), [OWN_LAGS, OWN_LAGS])
    assert len(values) == len(expected) == n + 2
    # two eigenvalues near zero are one double one, of the common angle: there the root of rounding
    assert farthest(values[np.abs(values) > 1e-2], expected[np.abs(expected) > 1e-2]) < 1e-6
    column = B[:, plant.input_names.index("hvdc1_p_mod")]
    machines = [plant.state_names.index(f"{machine.name}.slip") for machine in case.machines]
    m = len(machines)
    vdr = PSTESS[name]["at_rest"]["Vdc"] / 500.0
    base = case.hvdcs[0].base_mva / 500.0  # kA
    for value in 1j * np.array([0.5, 2.0, 3.5, 8.0]):
        ours = np.linalg.solve(value * np.eye(n + 2) - A, column)[machines]
        theirs = np.linalg.solve(value * np.eye(n) - M, model.input_column())[m : 2 * m]
        theirs = (
            theirs * base / vdr / (1.0 + 0.02 * value)
        )  # a power by the dc voltage, behind the order's lag
        assert np.max(np.abs(ours - theirs)) < 1e-6 * np.max(np.abs(theirs))
    # with the inverter's angle held the modes would be others: the bound above is no matter of course
    A[plant.state_names.index("hvdc1.xi")] = 0.0
    assert farthest(np.linalg.eigvals(A), expected) > 0.01


@pytest.mark.slow
@pytest.mark.parametrize("name", BOTH)
def test_the_case_stands_still_for_20_s(name):
    plant = BlockShim(plant_block(load_case(name)))
    _, x, _ = plant.run(20.0, 0.002)
    swinging = [k for k, name in enumerate(plant.state_names) if not name.endswith(".delta")]
    assert np.max(np.abs(x[:, swinging] - x[0, swinging])) < 1e-12
