"""The plant as sparse blocks against complex steps in C: state matrix and inputs."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from plant_shim import BlockShim

from interarea.design.linear.sparse_plant import SparsePlant, sparse_plant
from interarea.fmu_build.write.cache import default_cache
from interarea.fmu_build.write.device_slopes import DeviceSlopes
from interarea.models.blocks.plant import plant_block
from interarea.models.case.case import Case
from interarea.models.grid.powerflow import solve_powerflow

Matrix = npt.NDArray[np.float64]


def agreeing_blocks(case: Case) -> tuple[SparsePlant, Matrix, Matrix]:
    """Return the blocks of a case in plant order, A and B of C; they agree to 1e-9 of the largest entry."""
    block = plant_block(case)
    slopes = DeviceSlopes(block, cache=default_cache())
    blocks = sparse_plant(slopes, block.data, solve_powerflow(case).voltages)
    A, B, _, _ = BlockShim(block).jacobians()
    assert np.max(np.abs(blocks.state_matrix() - A)) < 1e-9 * np.max(np.abs(A))
    assert np.max(np.abs(blocks.Bu.toarray() - B)) < 1e-9 * np.max(np.abs(B))
    return blocks, A, B
