"""The published methods as printed, beside those that the study uses, and what reductions of order cost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import control
import numpy as np

from interarea.design.certificates.closed_loop import closed_loop_matrix, effort, swing_poles
from interarea.design.controllers.controller import Controller
from interarea.design.linear.linearise import remove_reference, select, speeds_in_rad
from interarea.design.linear.norms import hinf_of
from interarea.design.modes.modes import Modes, damping_ratio, modes_of
from interarea.design.reduction.balanced import balanced_truncation, hankel_reduction
from interarea.design.reduction.gramians import ReductionError
from interarea.design.synthesis.generalized_plant import effort_plant, mixed_sensitivity
from interarea.design.synthesis.printed_iteration import printed_iteration
from interarea.design.synthesis.reduced_order import closed_norm, on_difference, reduced_order
from interarea.design.synthesis.study_designs import FtcSpec, StudySpec, WdcSpec
from interarea.fmu_build.write.cache import cached_json, code_hash, content_hash, numerics_versions
from interarea.models.case.case import load_case
from interarea.models.threads import one_thread

from ..run.artefacts import linear_plant, plant_fmu
from ..run.controllers import controller_fmu, design_controller
from .delay import least_swing

#: of the inter-area mode, where two roots may share it, Hz; better damped roots are filters
INTER_AREA_HZ, WELL_DAMPED = (0.3, 0.9), 0.6


def hankel_row(plant: control.StateSpace, order: int) -> dict[str, float]:
    """Return optimal Hankel-norm reduction of a plant: errors, their bounds, relative to the plant's norm.

    `relative_hankel_error` is the Hankel norm of the error over the first Hankel value; its least possible
    value is `relative_next_hankel` of the balanced truncation beside it.
    """
    reduction = hankel_reduction(plant, order)
    size = hinf_of(plant.A, plant.B, plant.C, plant.D).value
    assert reduction.bound is not None and reduction.hankel_error is not None
    return {
        "relative_error": float(reduction.error / size),
        "relative_bound": float(reduction.bound / size),
        "relative_hankel_error": float(reduction.hankel_error / reduction.hankel_values[0]),
    }


def order_rows(plant: control.StateSpace, full: Controller, modes: Modes) -> list[dict[str, Any]]:
    """Return what each lower order of a controller costs on the full plant, from its own downwards.

    plant : without reference angle, speeds in rad/s. full : as synthesis gave it.

    Rows: order, `norm` (of the design's objective), `effort`, `inter_area` and `least_damping`; `failed` says
    why there is none, else None.
    """
    requested = full.design["specification"]
    K = full.system
    loop = select(plant, list(K.output_labels), list(K.input_labels))
    k, P = K, effort_plant(loop)
    if "low_pass" in requested:
        remote, local = requested["remote"], requested["local"]
        loop = select(plant, list(K.output_labels), {"difference": {remote: 1.0, local: -1.0}})
        column = list(K.input_labels).index(remote)
        k = control.ss(K.A, K.B[:, [column]], K.C, K.D[:, [column]])
        weights = WdcSpec(low_pass=requested["low_pass"], high_pass=tuple(requested["high_pass"])).weights()
        P = mixed_sensitivity(loop, *weights)
    rows: list[dict[str, Any]] = []
    for order in range(K.nstates, 2, -1):
        rows.append({"order": order, "failed": None})
        try:
            small = reduced_order(loop, k, order)
        except ReductionError as error:
            rows[-1]["failed"] = str(error)
            continue
        both = on_difference(small, remote, local, K.output_labels[0]) if "low_pass" in requested else small
        both = control.ss(
            both.A, both.B, both.C, both.D, inputs=list(K.input_labels), outputs=list(K.output_labels)
        )
        poles = np.linalg.eigvals(closed_loop_matrix(plant, both))
        if not np.max(poles.real) < 0.0:
            rows[-1]["failed"] = "the closed loop on the full plant is not stable"
            continue
        inter = swing_poles(plant, both, modes, steps=20)[modes.inter_area.name]
        rows[-1] |= {
            "norm": closed_norm(P, small),
            "effort": effort(plant, both),
            "inter_area": damping_ratio(inter),
            "least_damping": least_swing(poles),
        }
    return rows


def inter_area_roots(
    plant: control.StateSpace, controller: Controller, remote: str
) -> dict[str, list[list[float]]]:
    """Return for normal and remote_lost the roots (Hz, damping ratio) in the inter-area mode's band.

    Two where a mode of the controller shares the band: what the mode of the open loop becomes, and the other.
    """
    out = {}
    for name, lost in (("normal", ()), ("remote_lost", (remote,))):
        poles = np.linalg.eigvals(closed_loop_matrix(plant, controller.system, lost=lost))
        hertz, zeta = poles.imag / (2.0 * np.pi), -poles.real / np.maximum(np.abs(poles), 1e-12)
        inside = (hertz >= INTER_AREA_HZ[0]) & (hertz <= INTER_AREA_HZ[1]) & (zeta < WELL_DAMPED)
        out[name] = [[float(f), float(z)] for f, z in sorted(zip(hertz[inside], zeta[inside], strict=True))]
    return out


def printed_ftc(
    relative: control.StateSpace, omega_b: float, shipped: Controller, spec: FtcSpec
) -> dict[str, Any]:
    """Return what the iteration of eq. 4.29 as printed ends in, beside the fault-tolerant controller used.

    spec : what that one was specified by.

    Rows "printed" and "ours": damping ratio of every pole on the design plant, effort there, fastest pole of
    the controller (rad/s), and the rightmost pole on the full plant, normal and lost.
    """
    plant = speeds_in_rad(relative, omega_b)
    loop = select(plant, [spec.actuator], list(spec.signals))
    design_plant = balanced_truncation(loop, spec.plant_order).system
    result = printed_iteration(design_plant, spec.loss_of)
    rows = []
    for name, K in (("printed", result.controller), ("ours", shipped.system)):
        row: dict[str, Any] = {
            "method": name,
            "order": int(K.nstates),
            "fastest_pole": float(np.max(np.abs(np.linalg.eigvals(K.A)))),
        }
        for label, G in (("design_plant", design_plant), ("full_plant", plant)):
            for pattern, lost in {"normal": (), **spec.loss_of}.items():
                poles = np.linalg.eigvals(closed_loop_matrix(G, K, lost=lost))
                stable = bool(np.max(poles.real) < 0.0)
                row[f"{label}_{pattern}"] = {
                    "rightmost": float(np.max(poles.real)),
                    "damping_ratio": float(np.min(-poles.real / np.abs(poles))),
                    "stable": stable,
                }
            normal = row[f"{label}_normal"]["stable"]
            row[f"{label}_effort"] = effort(G, K) if normal else None
        rows.append(row)
    return {
        "theta_rad": list(result.facts["theta_rad"]),
        "damping_ratio_asked": [float(np.cos(theta)) for theta in result.facts["theta_rad"]],
        "stopped": result.facts["stopped"],
        "lmi_problems": result.solves,
        "rows": rows,
    }


def method_record(
    case_name: str, names: Sequence[str], remote: str, specs: Mapping[str, StudySpec], cache: Path
) -> dict[str, Any]:
    """Return `orders`, `inter_area_roots` of the named controllers and `printed_ftc` where there is one.

    specs : of controllers that are not as the study has them. All else is found in `cache`, so that a
    process of its own can make it.
    """
    case = load_case(case_name)
    controllers = {name: design_controller(case, name, cache, specs=specs) for name in names}
    key = content_hash(
        plant_fmu(case, cache).name,
        *(controller_fmu(c, case.omega_b, cache).name for c in controllers.values()),
        remote,
        code_hash(__name__),
        numerics_versions(),
    )

    def make() -> dict[str, Any]:
        relative = remove_reference(linear_plant(case, cache))
        plant, modes = speeds_in_rad(relative, case.omega_b), modes_of(relative, case.areas)
        full = {name: design_controller(case, name, cache, reduce=False, specs=specs) for name in names}
        record: dict[str, Any] = {
            "orders": {name: order_rows(plant, result, modes) for name, result in full.items()},
            "inter_area_roots": {n: inter_area_roots(plant, c, remote) for n, c in controllers.items()},
        }
        ftc = specs.get("ftc", FtcSpec())
        if "ftc" in controllers and isinstance(ftc, FtcSpec):
            record["printed_ftc"] = printed_ftc(relative, case.omega_b, controllers["ftc"], ftc)
        return record

    with one_thread():
        return dict(cached_json(cache, "methods", key, make))
