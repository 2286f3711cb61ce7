"""Admittances: stamps by hand, laws of the bus matrix."""

from __future__ import annotations

import numpy as np
import pytest

from interarea.models.case.case import CaseError, load_case
from interarea.models.case.schema import Branch
from interarea.models.grid.network import (
    admittance_matrix,
    branch_stamp,
    machine_norton_admittance,
)


def test_transformer_stamp_is_an_ideal_ratio_before_a_pi_circuit() -> None:
    branch = Branch(name="t", from_bus=1, to_bus=2, r=0.01, x=0.2, b=0.04, tap=1.05, shift_deg=30.0)
    t = 1.05 * np.exp(1j * np.pi / 6.0)
    V = np.array([1.02 * np.exp(0.3j), 0.97 * np.exp(-0.1j)])
    inner = V[0] / t  # behind the ideal transformer
    series = (inner - V[1]) / (0.01 + 0.2j)
    into = np.array([(series + 0.02j * inner) / np.conj(t), -series + 0.02j * V[1]])
    assert branch_stamp(branch) @ V == pytest.approx(into, rel=1e-14)


def test_rows_of_the_bus_matrix_add_up_to_what_goes_to_ground() -> None:
    case = load_case("kundur-manual")
    ground = admittance_matrix(case) @ np.ones(11)
    expected = np.zeros(11, dtype=complex)
    for branch in case.branches:
        for bus in (branch.from_bus, branch.to_bus):
            expected[bus - 1] += 0.5j * branch.b
    expected[6] += 2.0j
    expected[8] += 3.5j
    assert ground == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("name", ["kundur-manual", "new-england", "nets-nyps"])
def test_bus_matrix_is_symmetric_without_phase_shifters(name: str) -> None:
    Y = admittance_matrix(load_case(name))
    assert np.array_equal(Y, Y.T)


def test_two_equal_circuits_less_one_leave_half() -> None:
    case = load_case("kundur-manual")
    with_both, with_one = admittance_matrix(case), admittance_matrix(case, without=["8-9 a"])
    assert with_one[7, 8] == pytest.approx(0.5 * with_both[7, 8], rel=1e-14)
    with pytest.raises(CaseError, match="did you mean 8-9 a"):
        admittance_matrix(case, without=["8-9a"])


def test_machine_admittance_is_on_the_base_of_the_case() -> None:
    y = machine_norton_admittance(load_case("kundur-manual"))
    assert y == pytest.approx(np.full(4, 9.0 / (0.0025 + 0.25j)), rel=1e-14)
