"""Sensitivity of a case's swing modes to any number in the case, on plant FMUs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from interarea.design.linear.linearise import linearise
from interarea.design.linear.sparse_plant import SparsePlant
from interarea.design.modes.modes import Mode, modes_of
from interarea.design.modes.sensitivity import Sensitivity, eigenvalue_sensitivity, sparse_sensitivity
from interarea.fmu_build.open.plant import open_plant
from interarea.fmu_build.write.package import build_fmu
from interarea.models.blocks.plant import plant_block
from interarea.models.case.case import Case
from interarea.models.case.parameter_path import parameter_step, parameter_value, with_parameter
from interarea.models.files import temporary_folder

from ..run.artefacts import linear_plant, sparse_linear_plant


def parameter_sensitivities(
    case: Case, paths: Sequence[str], cache: Path
) -> dict[str, Mapping[str, Sensitivity]]:
    """Return path -> mode name -> sensitivity, for numbers of `case` named by path (`machines.G1.H`).

    `redispatch.G1:G2` is the power that G2 delivers in place of G1, MW.

    Every value has its own power flow and operating point, because a load change moves the whole equilibrium.

    Raises
    ------
    CaseError : a path that is not a number of the case, or a neighbouring value that the case rejects.
    """
    modes = modes_of(linear_plant(case, cache), case.areas)
    by_mode: dict[str, Mapping[str, Sensitivity]] = {}
    for path in paths:

        def matrix_of(value: float, path: str = path) -> npt.NDArray[np.float64]:
            return state_matrix(with_parameter(case, path, value), cache)

        value = parameter_value(case, path)
        by_mode[path] = eigenvalue_sensitivity(
            modes, matrix_of, value, parameter=path, step=parameter_step(path)
        )
    return by_mode


def all_mode_sensitivities(
    case: Case, modes: Sequence[Mode], paths: Sequence[str], cache: Path
) -> dict[str, Mapping[str, Sensitivity]]:
    """Return the same for `modes` of the sparse plant of a case of any size.

    Raises
    ------
    CaseError : as `parameter_sensitivities`.
    """
    by_mode: dict[str, Mapping[str, Sensitivity]] = {}
    for path in paths:

        def plant_of(value: float, path: str = path) -> SparsePlant:
            return sparse_linear_plant(with_parameter(case, path, value), cache)

        value, step = parameter_value(case, path), parameter_step(path)
        by_mode[path] = sparse_sensitivity(modes, plant_of, value, parameter=path, step=step)
    return by_mode


def state_matrix(case: Case, cache: Path) -> npt.NDArray[np.float64]:
    """Return A (n, n) of the plant FMU of `case`; only the compiled binary is kept in the cache."""
    with temporary_folder() as folder:
        path = build_fmu(plant_block(case), folder / "plant.fmu", platforms=None, cache=cache)
        with open_plant(path) as plant:
            return np.asarray(linearise(plant).A, dtype=float)
