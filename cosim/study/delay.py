"""Exact damping against latency for both wirings of a study, and the latency at which each turns unstable."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import control
import numpy as np

from interarea.design.certificates.closed_loop import swing_poles
from interarea.design.controllers.controller import Controller
from interarea.design.delay.curves import damping_over_latency, delay_margin, delayed_loop, rightmost_roots
from interarea.design.linear.linearise import speeds_in_rad
from interarea.design.modes.modes import Modes
from interarea.design.synthesis.study_designs import WdcSpec, design_wdc

#: step of the curve, s
GRID_S = 0.02
#: frequencies in which a root counts as a swing, Hz
BAND_HZ = (0.1, 2.5)


def least_damping(
    plant: control.StateSpace, K: control.StateSpace, latency_s_of: Mapping[str, float]
) -> float:
    """Return the least damping ratio of the exact loop's roots within `BAND_HZ`; 1 if there is none."""
    roots = rightmost_roots(delayed_loop(plant, K, latency_s_of), right_of=-2.5)
    hertz = np.abs(roots.imag) / (2.0 * np.pi)
    swings = roots[(hertz >= BAND_HZ[0]) & (hertz <= BAND_HZ[1])]
    return float(np.min(-swings.real / np.abs(swings))) if swings.size else 1.0


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
    ratio of all roots in the swing band), `inter_area` rows, `modes` mode -> rows.
    """
    K = controller.system
    roots = swing_poles(plant, K, modes)
    count = round(max(spec["latency"]["values_s"]) / GRID_S)
    grid = np.array([round(GRID_S * k, 6) for k in range(count + 1)])
    wirings = {"synchronous": list(K.input_labels), "non_synchronous": [spec["remote"]]}
    found = {}
    for k, (wiring, signals) in enumerate(wirings.items()):
        margin = delay_margin(plant, K, signals)
        sweep = damping_over_latency(plant, K, grid, signals, roots=roots)
        damping = {name: sweep.damping(name) for name in roots}
        found[wiring] = {
            "margin_s": float(margin.margin_s) if np.isfinite(margin.margin_s) else None,
            "margin_searched_s": float(margin.searched_s),
            "damping": _rows(grid, [least_damping(plant, K, dict.fromkeys(signals, float(t))) for t in grid]),
            "inter_area": _rows(grid, damping[modes.inter_area.name]),
            "modes": {name: _rows(grid, z) for name, z in damping.items()},
        }
        progress((k + 1) / len(wirings))
    return found


def redesigned(
    relative: control.StateSpace, controller: Controller, omega_b: float, latencies_s: Sequence[float]
) -> list[dict[str, float | int | None]]:
    """Design the WDC again with each latency as a Padé model in its design plant; judge both exactly.

    relative : full plant without reference angle, speeds in pu. controller : the one designed without.

    Returns
    -------
    one row per latency (s): order, margin_s (None: stable at every latency searched), and the least
    damping ratio of all swings at that synchronous latency, redesigned and as designed without.
    """
    plant = speeds_in_rad(relative, omega_b)
    rows: list[dict[str, float | int | None]] = []
    for latency in latencies_s:
        # the design plant has the Padé states too, and the controller may keep as many
        spec = WdcSpec(latency_s=latency)
        spec = replace(spec, order=spec.plant_order + spec.pade_order)
        made = design_wdc(relative, spec, omega_b=omega_b).system
        both = dict.fromkeys(made.input_labels, latency)
        margin = delay_margin(plant, made).margin_s
        rows.append(
            {
                "latency_s": latency,
                "order": made.nstates,
                "margin_s": float(margin) if np.isfinite(margin) else None,
                "least_damping": least_damping(plant, made, both),
                "least_damping_without": least_damping(plant, controller.system, both),
            }
        )
    return rows


def _rows(latency_s: Any, values: Any) -> list[list[float]]:
    return [[float(d), float(z)] for d, z in zip(latency_s, values, strict=True)]
