"""Exact damping against latency for both wirings of a study, and the latency at which each turns unstable."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import control
import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq

from interarea.design.certificates.closed_loop import closed_loop_matrix, effort, swing_poles
from interarea.design.controllers.controller import Controller
from interarea.design.delay.curves import (
    damping_over_latency,
    delay_margin,
    delayed_loop,
    delayed_plant,
    rightmost_roots,
)
from interarea.design.errors import InfeasibleDesign, UncertifiedDesign
from interarea.design.linear.linearise import select, speeds_in_rad
from interarea.design.modes.modes import Modes
from interarea.design.reduction.gramians import ReductionError
from interarea.design.synthesis.study_designs import WdcSpec, design_wdc

Array = npt.NDArray[np.float64]
#: step of the curve, s
GRID_S = 0.02
#: frequencies in which a root counts as a swing, Hz
BAND_HZ = (0.1, 2.5)


def least_damping(
    plant: control.StateSpace, K: control.StateSpace, latency_s_of: Mapping[str, float]
) -> float:
    """Return the least damping ratio of the exact loop's roots within `BAND_HZ`; 1 if there is none."""
    roots = rightmost_roots(delayed_loop(plant, K, latency_s_of), right_of=-2.5)
    return least_swing(roots)


def latency_grid(values_s: Sequence[float]) -> Array:
    """Return the latencies of the curve, s: steps of `GRID_S`, and each of the table's values itself.

    >>> latency_grid([0.05]).tolist()
    [0.0, 0.02, 0.04, 0.05]
    """
    count = round(max(values_s) / GRID_S)
    steps = [round(GRID_S * k, 6) for k in range(count + 1)]
    return np.unique([*(s for s in steps if s <= max(values_s)), *values_s])


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
    grid = latency_grid(spec["latency"]["values_s"])
    wirings = {"synchronous": list(K.input_labels), "non_synchronous": [spec["remote"]]}
    result = {}
    for k, (wiring, signals) in enumerate(wirings.items()):
        margin = delay_margin(plant, K, signals)
        sweep = damping_over_latency(plant, K, grid, signals, roots=roots)
        damping = {name: sweep.damping(name) for name in roots}
        result[wiring] = {
            "margin_s": float(margin.margin_s) if np.isfinite(margin.margin_s) else None,
            "margin_searched_s": float(margin.searched_s),
            "damping": _rows(grid, [least_damping(plant, K, dict.fromkeys(signals, float(t))) for t in grid]),
            "inter_area": _rows(grid, damping[modes.inter_area.name]),
            "modes": {name: _rows(grid, z) for name, z in damping.items()},
        }
        progress((k + 1) / len(wirings))
    return result


def redesigned(
    relative: control.StateSpace,
    controller: Controller,
    omega_b: float,
    requests: Sequence[Mapping[str, Any]],
    base: WdcSpec,
) -> list[dict[str, Any]]:
    """Design the WDC again with each latency as a Padé model in its design plant; judge both exactly.

    relative : full plant without reference angle, speeds in pu. controller : the one designed without, by
    the specification `base`. requests : rows latency_s, on ("both" or "remote" signals), order and, unless
    the usual one, plant_order.

    Returns
    -------
    one row each: what was asked; margin_s (None: stable at every latency searched); `least_damping` of all
    swings at that latency, `least_damping_pade` the same by the Padé model, `least_damping_without` of the
    controller designed without; the price: `least_damping_undelayed`, `least_damping_remote_lost` (no
    latency either) and `effort`, pu per rad/s. `failed` says why there is no controller, else None.
    """
    plant = speeds_in_rad(relative, omega_b)
    rows: list[dict[str, Any]] = []
    for requested in requests:
        change = {key: requested[key] for key in ("order", "plant_order") if key in requested}
        spec = replace(base, latency_s=requested["latency_s"], latency_on=requested["on"], **change)
        signals = [spec.remote, spec.local] if spec.latency_on == "both" else [spec.remote]
        late = dict.fromkeys(signals, spec.latency_s)
        row: dict[str, Any] = {
            "latency_s": spec.latency_s,
            "on": spec.latency_on,
            "order": spec.order,
            "plant_order": spec.plant_order,
            "failed": None,
            "least_damping_without": least_damping(plant, controller.system, late),
        }
        rows.append(row)
        try:
            result = design_wdc(relative, spec, omega_b=omega_b).system
        except (ReductionError, InfeasibleDesign, UncertifiedDesign) as error:
            row["failed"] = str(error)
            continue
        margin = delay_margin(plant, result, signals).margin_s
        undelayed, lost = (
            closed_loop_matrix(plant, result, lost=missing) for missing in ((), (spec.remote,))
        )
        row |= {
            "margin_s": float(margin) if np.isfinite(margin) else None,
            "least_damping": least_damping(plant, result, late),
            "least_damping_pade": least_swing(pade_poles(plant, result, late, spec.pade_order)),
            "least_damping_undelayed": least_swing(np.linalg.eigvals(undelayed)),
            "least_damping_remote_lost": least_swing(np.linalg.eigvals(lost)),
            "effort": effort(plant, result),
        }
    return rows


def pade_poles(
    plant: control.StateSpace, K: control.StateSpace, latency_s_of: Mapping[str, float], order: int
) -> Any:
    """Return the poles of the loop with a Padé model in place of each latency."""
    G = select(plant, list(K.output_labels), list(K.input_labels))
    return np.linalg.eigvals(closed_loop_matrix(delayed_plant(G, latency_s_of, order), K))


def pade_record(
    plant: control.StateSpace,
    controller: Controller,
    spec: Mapping[str, Any],
    delay: Mapping[str, Mapping[str, Any]],
    order: int = 2,
) -> dict[str, Any]:
    """Return the error of a Padé model of the thesis's order: of the margin and of the least damping.

    delay : as `latency_analysis` returns it, exact. Margin: where the model's rightmost pole first crosses.
    """
    K = controller.system
    wirings = {"synchronous": list(K.input_labels), "non_synchronous": [spec["remote"]]}
    out: dict[str, Any] = {"order": order}
    for wiring, signals in wirings.items():

        def rightmost(latency_s: float, signals: list[str] = signals) -> float:
            poles = pade_poles(plant, K, dict.fromkeys(signals, latency_s), order)
            return float(np.max(poles.real))

        grid = np.arange(GRID_S, max(spec["latency"]["values_s"]) + 0.5 * GRID_S, GRID_S)
        crossed = next((float(at) for at in grid if rightmost(at) >= 0.0), None)
        margin = None if crossed is None else float(brentq(rightmost, crossed - GRID_S, crossed, xtol=1e-9))
        rows = []
        for value in spec["latency"]["values_s"]:
            late = dict.fromkeys(signals, value)
            exact = least_damping(plant, K, late)
            rows.append([value, exact, least_swing(pade_poles(plant, K, late, order))])
        out[wiring] = {
            "margin_s": margin,
            "margin_exact_s": delay[wiring]["margin_s"],
            "least_damping": rows,
            "largest_error": max(abs(model - exact) for _, exact, model in rows),
        }
    return out


def least_swing(poles: Any) -> float:
    """Return the least damping ratio of the poles within `BAND_HZ`; 1 if there is none."""
    hertz = np.abs(poles.imag) / (2.0 * np.pi)
    swings = poles[(hertz >= BAND_HZ[0]) & (hertz <= BAND_HZ[1])]
    return float(np.min(-swings.real / np.abs(swings))) if swings.size else 1.0


def _rows(latency_s: Any, values: Any) -> list[list[float]]:
    return [[float(d), float(z)] for d, z in zip(latency_s, values, strict=True)]
