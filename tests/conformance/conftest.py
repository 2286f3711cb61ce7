"""The FMUs of this folder's tests, built once per session."""

from __future__ import annotations

from pathlib import Path

import pytest
from fmu_blocks import blocks

from interarea.fmu_build.write.package import build_fmu


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return the FMU file of every block kind, by kind."""
    folder = tmp_path_factory.mktemp("fmus")
    return {kind: build_fmu(block, folder) for kind, block in blocks().items()}


@pytest.fixture(params=["decay", "controller", "channel", "concentrator", "detector", "pmu", "plant", "loop"])
def fmu(request: pytest.FixtureRequest, built: dict[str, Path]) -> Path:
    """Return the FMU file of each block kind in turn."""
    return built[request.param]


@pytest.fixture
def decay(built: dict[str, Path]) -> Path:
    """Return the FMU of the first-order lag."""
    return built["decay"]
