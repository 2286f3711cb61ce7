"""The blocks that are fuzzed: one of every kind the program builds, the whole loop included."""

from __future__ import annotations

from pathlib import Path

import control
import numpy as np
from fmu_blocks import blocks

from interarea.cosim.export.container import container_block
from interarea.cosim.scenario.scenario import load_scenario
from interarea.design.controllers.controller import Controller
from interarea.fmu_build.write.cache import default_cache
from interarea.models.blocks.variables import Block


def fuzz_block(kind: str, cache: Path | None = None) -> Block:
    """Return the block of a kind; "loop" is the container of a bundled scenario."""
    if kind != "loop":
        return blocks()[kind]
    A, B = np.array([[-6.0, 0.0], [6.0, -20.0]]), np.array([[6.0, -6.0], [0.0, 0.0]])
    names = {"inputs": ["G2_dw", "G4_dw"], "outputs": ["G4_vs"]}
    lags = Controller("by_hand", control.ss(A, B, np.array([[0.0, 0.05]]), np.zeros((1, 2)), **names))
    loop = load_scenario("wide-area-damping")
    return container_block(loop, cache=cache or default_cache(), controller=lags)
