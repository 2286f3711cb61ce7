"""A series capacitor in the tie of two-area-svc: our plant against an independent program.

No published record of a grid with one was found. The program makes the bus matrix anew at each evaluation;
the plant has a node of the line's current. Without the capacitor both are held to PSTess
(`test_two_area_svc.py`).
"""

from __future__ import annotations

import numpy as np
import pytest
from independent.two_area_svc import BUSES, TwoAreaTcsc
from plant_shim import BlockShim
from published.test_two_area_svc import farthest

from interarea.models.blocks.plant import plant_block
from interarea.models.case.case import load_case

X0, T = 0.044, 0.015


def case_of(model):
    """The case with what the program takes from its power flow: KE of exciters, Q of two sources."""
    at = {bus: k for k, bus in enumerate(BUSES)}
    drawn = {f"Q{bus}": {"Q_mvar": -100.0 * float(model.S0[at[bus]].imag)} for bus in (3, 101)}
    exciters = {f"G{k + 1}": {"exciter": {"KE": float(model.KE[k])}} for k in range(4)}
    row = {"branch": "3-101 a", "x0_pu": X0, "x_max_pu": 0.08, "T_s": T}
    return load_case("two-area-svc").with_changes(
        {"loads": drawn, "machines": exciters, "tcscs": {"tcsc1": row}}
    )


@pytest.mark.parametrize("network", ["dense", "sparse"])
def test_the_plant_has_the_eigenvalues_and_the_response_of_the_independent_program(network):
    model = TwoAreaTcsc(X0, T)
    assert np.max(np.abs(model.rates(model.x0))) < 1e-11
    plant = BlockShim(plant_block(case_of(model), network=network))
    A, B, _, _ = plant.jacobians()
    M = model.matrix()
    values, expected = np.linalg.eigvals(A), np.linalg.eigvals(M)
    assert len(values) == len(expected) == 55
    # two eigenvalues near zero are one double one, of the common angle: there the root of rounding
    assert farthest(values[np.abs(values) > 1e-2], expected[np.abs(expected) > 1e-2]) < 1e-6
    column = B[:, plant.input_names.index("tcsc1_x_mod")]
    machines = [plant.state_names.index(f"G{k}.slip") for k in (1, 2, 3, 4)]
    for value in 1j * np.array([0.5, 2.0, 3.5, 8.0]):
        ours = np.linalg.solve(value * np.eye(55) - A, column)[machines]
        theirs = np.linalg.solve(value * np.eye(55) - M, model.input_column())[4:8]
        assert np.max(np.abs(ours - theirs)) < 1e-6 * np.max(np.abs(theirs))


def test_without_the_capacitor_the_modes_are_others():
    """The bounds above are no matter of course."""
    one, other = TwoAreaTcsc(X0, T), TwoAreaTcsc(0.0, T)
    assert farthest(np.linalg.eigvals(one.matrix()), np.linalg.eigvals(other.matrix())) > 0.05
