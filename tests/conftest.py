"""Session fixtures: one folder of FMUs and designs for the whole run, small controllers and loops."""

from __future__ import annotations

import gc
import os
import signal
from pathlib import Path

import control
import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from interarea.design.controllers.controller import Controller
from interarea.fmu_build.write.compile import compile_binary, host_platform
from interarea.fmu_build.write.lane_library import plant_group
from interarea.models.blocks.plant import plant_sources
from interarea.models.case.case import Case, load_case

# Nothing is garbage while 7000 tests are collected: looking for it takes a third of the time.
gc.disable()

# How long one example takes says nothing on a machine that is busy; the same examples on every machine.
settings.register_profile(
    "interarea",
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("interarea")

# A shell lets what it runs in the background ignore Ctrl-C, and the commands of tests would inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)


#: Files whose slow tests take longest, longest first: begun first, or a worker waits for another at the end.
LONGEST = (
    "platforms/test_same_bits.py",
    "docs/test_site.py",
    "faults/test_signals.py",
    "platforms/test_environments.py",
    "unit/cosim/study/test_study.py",
    "platforms/test_wheel.py",
    "sweep/test_sweep_kills.py",
    "fuzz/test_group.py",
    "fuzz/test_fuzz.py",
    "unit/cosim/grid_study/test_beside_local.py",
    "unit/cosim/screen/test_wrong_study.py",
    "unit/cosim/grid_study/test_grid_page.py",
    "unit/design/robust/test_grids_with_loops.py",
    "fuzz/test_memory.py",
    "explorer/test_page_bits.py",
    "faults/test_build_faults.py",
    "unit/models/importers/test_import_broken.py",
    "conformance/test_zero_findings.py",
    "faults/test_memory_faults.py",
)


@pytest.hookimpl(trylast=True)  # what is not slow is deselected by then
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the longest files of slow tests; the others stay as they were collected."""
    place = {Path(__file__).parent / name: k for k, name in enumerate(LONGEST)}
    if all(item.get_closest_marker("slow") for item in items):
        items.sort(key=lambda item: place.get(item.path, len(LONGEST)))


def pytest_collection_finish() -> None:
    """Look for garbage again, but not among what was collected, which stays."""
    gc.freeze()
    gc.enable()


@pytest.fixture(scope="session")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the artefact folder: ``$INTERAREA_CACHE`` when set, else one for this session."""
    named = os.environ.get("INTERAREA_CACHE")
    if named:
        return Path(named)
    folder = tmp_path_factory.mktemp("cache")
    os.environ["INTERAREA_CACHE"] = str(folder)
    return folder


@pytest.fixture(autouse=True, scope="session")
def _one_cache(cache: Path) -> None:
    """Every test, and what it starts, finds the same artefacts.

    The first of the processes side by side makes the plant; another waits for it where it needs a plant.
    """
    if os.environ.get("PYTEST_XDIST_WORKER") == "gw0":
        compile_binary("plant", plant_sources(), host_platform(), cache=cache)
        plant_group(cache=cache)


@pytest.fixture(scope="session")
def two_area() -> Case:
    """Return the case of the thesis."""
    return load_case("two-area-thesis")


@pytest.fixture(scope="session")
def hand_controller() -> Controller:
    """Return a strictly proper controller written by hand: two lags on the difference of the speeds."""
    A = np.array([[-6.0, 0.0], [6.0, -20.0]])
    B = np.array([[6.0, -6.0], [0.0, 0.0]])
    C = np.array([[0.0, 0.05]])
    system = control.ss(A, B, C, np.zeros((1, 2)), inputs=["G2_dw", "G4_dw"], outputs=["G4_vs"])
    return Controller("by_hand", system)


@pytest.fixture(scope="session")
def by_hand(hand_controller: Controller) -> Controller:
    """Return the controller written by hand, to stand in for the one a scenario names."""
    return hand_controller
