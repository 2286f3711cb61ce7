"""The FMUs of this folder's tests, built once per session."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fmu_runner import decay_block

from interarea.fmu_build import build_fmu
from interarea.models.case import load_case
from interarea.models.channel_block import channel_block
from interarea.models.controller_block import controller_block
from interarea.models.plant_block import plant_block
from interarea.models.variables import Block

A = np.array([[-1.0, 4.0, 0.0], [-4.0, -1.0, 0.5], [0.0, 0.0, -3.0]])
B = np.array([[0.0, 1.0], [1.0, 0.0], [0.5, -0.5]])
C = np.array([[0.5, 0.0, 1.0]])


def blocks() -> dict[str, Block]:
    """Return one block of every kind."""
    controller = controller_block("controller", A, B, C, np.zeros((1, 2)), ["G2_dw", "G4_dw"], ["G4_vs"])
    return {
        "decay": decay_block(),
        "controller": controller,
        "channel": channel_block(),
        "plant": plant_block(load_case("two-area-thesis")),
    }


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return the FMU file of every block kind, by kind."""
    folder = tmp_path_factory.mktemp("fmus")
    return {kind: build_fmu(block, folder) for kind, block in blocks().items()}


@pytest.fixture(params=["decay", "controller", "channel", "plant"])
def fmu(request: pytest.FixtureRequest, built: dict[str, Path]) -> Path:
    """Return the FMU file of each block kind in turn."""
    return built[request.param]


@pytest.fixture
def decay(built: dict[str, Path]) -> Path:
    """Return the FMU of the first-order lag."""
    return built["decay"]
