"""A small sweep: four seconds of the two-area case with a controller written by hand, packets and losses."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from interarea.cosim.sweep.front import run_sweep
from interarea.design.controllers.controller import Controller

SCENARIO: dict[str, Any] = {
    "case": "two-area-thesis",
    "stop_s": 4.0,
    "step_s": 0.02,
    "channels": {
        "remote": {"signal": "G2_dw", "latency_s": 0.1, "on_loss": "hold", "reporting_interval_s": 0.02},
        "local": {"signal": "G4_dw", "latency_s": 0.04, "reporting_interval_s": 0.02},
    },
    "event": [{"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 0.5, "end_s": 0.7}],
}
LATENCY = {"path": "channels.remote.latency_s", "values": [0.1, 0.2, 0.3]}
LOSS = {"path": "channels.*.loss.rate", "values": [0.0, 0.2, 0.5, 0.7]}


@pytest.fixture(scope="session")
def controller_file(hand_controller: Controller, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return hand_controller.save(tmp_path_factory.mktemp("controllers") / "by_hand.json")


@pytest.fixture(scope="session")
def document(controller_file: Path) -> Callable[..., dict[str, Any]]:
    """Return a function that gives the sweep as a dict, with changes to it and to its scenario."""

    def make(scenario: dict[str, Any] | None = None, **change: Any) -> dict[str, Any]:
        base = copy.deepcopy(SCENARIO) | {"controller": str(controller_file)} | (scenario or {})
        whole = {
            "name": "small",
            "scenario": base,
            "parameters": {"latency": LATENCY, "loss": LOSS},
            "seed": 3,
        }
        return whole | change

    return make


@pytest.fixture(scope="session")
def finished(
    document: Any, cache: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, pd.DataFrame]:
    """Return the folder of the small sweep, run by one process without being disturbed, and its rows."""
    folder = tmp_path_factory.mktemp("sweeps") / "undisturbed"
    run_sweep(document(), folder, workers=1, cache=cache)
    from interarea.cosim.sweep.parts import read_rows

    return folder, read_rows(folder)
