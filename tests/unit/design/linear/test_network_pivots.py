"""The network of a sparse plant: pivots where a bus's conductance is rounding alone."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import sparse

from interarea.design.linear.sparse_network import Network


@pytest.mark.parametrize("conductance", [0.0, 1e-15, -3e-17, 1e-4])
def test_a_bus_of_reactances_alone_is_solved_whatever_its_conductance_rounds_to(conductance):
    """Two buses, Y = g + jb: the parts of the first have g on the diagonal, which must not be a pivot."""
    b, g = 30.0, conductance
    G = np.array([[g, b, 0, -b], [-b, g, b, 0], [0, -b, 2.0, 2 * b], [b, 0, -2 * b, 2.0]])
    network = Network(SimpleNamespace(remaining=sparse.csc_matrix(G)), sparse.csc_matrix(G).data)
    right = np.array([1.0, -2.0, 0.5, 3.0])
    expected = np.linalg.solve(G, right)
    assert np.max(np.abs(network.solve(right) - expected)) < 1e-11 * np.max(np.abs(expected))
    sign, size = np.linalg.slogdet(G)
    assert np.exp(network.logarithm() - size) == pytest.approx(sign, abs=1e-10)
