"""The latency table prints roots of the loop at its own latencies, not values between two of a curve."""

from __future__ import annotations

import numpy as np
import pytest

from interarea.cosim.study.delay import GRID_S, latency_grid
from interarea.cosim.study.rows import _at


def test_every_latency_of_the_table_is_on_the_grid() -> None:
    values = [0.03, 0.15, 0.3]
    grid = latency_grid(values)
    assert set(values) <= set(grid.tolist())
    assert grid[0] == 0.0 and grid[-1] == 0.3
    assert np.diff(grid).min() > 0.0 and np.diff(grid).max() <= GRID_S + 1e-12


def test_a_latency_that_was_not_computed_has_no_value() -> None:
    curve = [[0.14, 0.2], [0.15, 0.1431], [0.16, 0.09]]
    assert _at(curve, 0.15) == 0.1431
    with pytest.raises(KeyError):
        _at(curve, 0.155)
