"""Exact damping against latency for both wirings of a study, and the latency at which each turns unstable."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import control
import numpy as np

from interarea.design.controller import Controller
from interarea.design.delay import damping_over_latency, delay_margin
from interarea.design.modes import Modes

from .study_certificate import swing_poles

#: step of the curve, s
GRID_S = 0.01


def latency_analysis(
    plant: control.StateSpace,
    controller: Controller,
    spec: Mapping[str, Any],
    modes: Modes,
    progress: Callable[[float], None],
) -> dict[str, dict[str, Any]]:
    """Follow the swing modes of the exact delayed loop over latency, and find its margin.

    plant : full plant without reference angle, speeds in rad/s. modes : its swing modes.

    Returns
    -------
    wiring -> margin_s (None: stable at every latency searched), `damping` rows (latency s, least damping
    ratio of the swing modes), `inter_area` rows, `modes` mode -> rows.
    """
    K = controller.system
    roots = swing_poles(plant, K, modes)
    grid = np.round(np.arange(0.0, max(spec["latency"]["values_s"]) + GRID_S / 2, GRID_S), 6)
    wirings = {"synchronous": list(K.input_labels), "non_synchronous": [spec["remote"]]}
    found = {}
    for k, (wiring, signals) in enumerate(wirings.items()):
        margin = delay_margin(plant, K, signals)
        sweep = damping_over_latency(plant, K, grid, signals, roots=roots)
        damping = {name: sweep.damping(name) for name in roots}
        least = np.min(list(damping.values()), axis=0)
        found[wiring] = {
            "margin_s": float(margin.margin_s) if np.isfinite(margin.margin_s) else None,
            "margin_searched_s": float(margin.searched_s),
            "damping": _rows(grid, least),
            "inter_area": _rows(grid, damping[modes.inter_area.name]),
            "modes": {name: _rows(grid, z) for name, z in damping.items()},
        }
        progress((k + 1) / len(wirings))
    return found


def _rows(latency_s: Any, values: Any) -> list[list[float]]:
    return [[float(d), float(z)] for d, z in zip(latency_s, values, strict=True)]
