"""What a study found, as `study.json` holds it: plain numbers under the names that others read."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import control
import numpy as np

from interarea.design.linear.linearise import select
from interarea.design.linear.norms import hinf_of
from interarea.design.modes.loop_selection import Loops
from interarea.design.modes.modes import Modes, modes_of
from interarea.models.case.case import Case

from ..run.artefacts import linear_plant
from .figures import OMEGA, StudyParts, loop_functions, weight_gains
from .methods import hankel_row
from .runs import WIRINGS, StudyRun
from .tables import latency_name

SCHEMA = 1


def study_rows(parts: StudyParts, loops: Loops, states: int) -> dict[str, Any]:
    """Return study.json without its figures and provenance; `states` counts the reference angle."""
    return {
        "schema": SCHEMA,
        "title": parts.spec["title"],
        "case": parts.case.name,
        "plant": {"states": states, "relative_states": parts.plant.nstates},
        "modes": mode_rows(parts.modes),
        "participation": participation_rows(parts),
        "loops": loop_rows(loops),
        "reduction": reduction_rows(parts),
        "controllers": {
            name: {**(c.certificate or {}), "reduction_price": c.design["reduction_price"]}
            for name, c in parts.controllers.items()
        },
        "sensitivity": sensitivity_row(parts),
        "delay": {wiring: dict(row) for wiring, row in parts.delay.items()},
        "delay_table": delay_table(parts),
        "latency_comparison": latency_comparison(parts),
        "scenarios": {name: scenario_row(run) for name, run in parts.runs.items()},
    }


def mode_rows(modes: Modes) -> dict[str, dict[str, Any]]:
    """Return name -> frequency_hz, damping_ratio, eigenvalue [re, im]."""
    return {
        name: {
            "frequency_hz": float(mode.frequency_hz),
            "damping_ratio": float(mode.damping_ratio),
            "eigenvalue": [float(mode.eigenvalue.real), float(mode.eigenvalue.imag)],
        }
        for name, mode in modes.items()
    }


def participation_rows(parts: StudyParts) -> dict[str, dict[str, float]]:
    """Return mode -> machine -> its share of what the states of all machines take part in the mode."""
    rows = {}
    for name, mode in parts.modes.items():
        shares = {
            m.name: sum(
                share for state, share in mode.participation.items() if state.startswith(f"{m.name}.")
            )
            for m in parts.case.machines
        }
        whole = sum(shares.values())
        rows[name] = {machine: float(share / whole) for machine, share in shares.items()}
    return rows


def modes_without_stabilizers(case: Case, cache: Path) -> dict[str, dict[str, Any]]:
    """Return `mode_rows` of a case whose machines have no stabilizer."""
    change = {m.name: {"stabilizer": None} for m in case.machines if m.stabilizer is not None}
    bare = case.with_changes({"machines": change}, name=f"{case.name}-no-stabilizers") if change else case
    return mode_rows(modes_of(linear_plant(bare, cache), bare.areas))


def loop_rows(loops: Loops) -> dict[str, Any]:
    """Return ranking (machine of the actuator, signal, index), the selected loop and the coordinates."""
    ranking = [
        {
            "actuator": loop.actuator.removesuffix("_vs"),
            "signal": loop.signal,
            "index": float(loop.index),
            "geometric": float(loop.geometric),
        }
        for loop in loops.ranking
    ]
    best = loops.selected
    return {
        "ranking": ranking,
        "selected": {"actuator": best.actuator.removesuffix("_vs"), "signal": best.signal},
        "coordinates": loops.coordinates,
    }


def reduction_rows(parts: StudyParts) -> dict[str, dict[str, Any]]:
    """Return order -> method, error and bound, absolute and relative to the norm of the plant."""
    out = {}
    for order, reduction in parts.reductions.items():
        system = reduction.system
        size = hinf_of(system.A, system.B, system.C, system.D).value
        signals = [parts.spec["remote"], parts.spec["local"]]
        seen = parts.difference if parts.spec["reduction"][order] == "difference" else signals
        full = select(parts.plant, list(system.input_labels), seen)
        sigma = np.asarray(reduction.hankel_values)
        following = float(sigma[reduction.order]) if reduction.order < sigma.size else 0.0
        out[order] = {
            "plant": ", ".join(system.output_labels) + " from " + ", ".join(system.input_labels),
            "method": reduction.method,
            "error": float(reduction.error),
            "bound": None if reduction.bound is None else float(reduction.bound),
            "relative_error": float(reduction.error / size),
            "relative_bound": None if reduction.bound is None else float(reduction.bound / size),
            "relative_next_hankel": following / float(sigma[0]),
            "hankel_values": [float(s) for s in sigma[:20]],
            "mode_errors": mode_errors(system, parts.modes),
            "optimal_hankel": hankel_row(full, reduction.order),
        }
    return out


def mode_errors(system: control.StateSpace, modes: Modes) -> dict[str, float]:
    """Return mode -> distance of the nearest pole of a reduced plant from its root, over the root's size."""
    poles = np.linalg.eigvals(np.asarray(system.A))
    return {
        name: float(np.min(np.abs(poles - mode.eigenvalue)) / abs(mode.eigenvalue))
        for name, mode in modes.items()
    }


def scenario_row(run: StudyRun) -> dict[str, Any]:
    """Return a run's numbers; `damping_ratio` is that of the inter-area mode's root, `modes` has all named.

    ring_down : of the inter-area mode as fitted to the run's speeds; None where it does not show.
    """
    m = run.metrics
    return {
        "title": run.title,
        "stable": bool(m["stable"]),
        "damping_ratio": m["damping_ratio"].get("inter-area"),
        "modes": m["damping_ratio"],
        "ring_down": m["ring_down"].get("inter-area"),
        "settling_time_s": m["settling_time_s"],
        "peak_dw24": m["peak_pu"],
        "energy": m["energy_pu2s"],
        "effort": m["effort_pu2s"],
    }


def delay_table(parts: StudyParts) -> list[dict[str, Any]]:
    """Return one row per simulated latency: exact and co-simulated damping of both wirings."""
    table = []
    for value in parts.spec["latency"]["values_s"]:
        row: dict[str, Any] = {"latency_s": value}
        for key, label in WIRINGS.items():
            run = parts.runs[latency_name(parts.spec["latency"]["controller"], label, value)]
            row[key] = {
                "least": _at(parts.delay[key]["damping"], value),
                "inter_area": _at(parts.delay[key]["inter_area"], value),
                "measured": run.metrics["late_damping"],
                "settling_time_s": run.metrics["settling_time_s"],
            }
        table.append(row)
    return table


def _at(pairs: list[list[float]], delay_s: float) -> float:
    """Return the value that was computed at this latency; nothing is interpolated."""
    by_latency = {row[0]: row[1] for row in pairs}
    return by_latency[delay_s]


def sensitivity_row(parts: StudyParts) -> dict[str, Any]:
    """Return |S(0)| and the largest |W1 S|, |W2 KS| of a loop on the full plant (frequencies drawn)."""
    s, ks = loop_functions(parts)
    low, high = weight_gains(parts)
    w2_ks = high * ks
    return {
        "controller": parts.spec["sensitivity"],
        "s_at_zero": float(s[0]),
        "w1_s": float(np.max(low * s)),
        "w2_ks": float(np.max(w2_ks)),
        "w2_ks_at_rad_s": float(OMEGA[np.argmax(w2_ks)]),
        f"w2_ks_at_{OMEGA[-1]:.0f}_rad_s": float(w2_ks[-1]),
    }


def latency_comparison(parts: StudyParts) -> dict[str, Any]:
    """Return from which latency on the synchronous wiring damps its least damped swing worse, by 0.01."""
    rows = (parts.delay[wiring]["damping"] for wiring in WIRINGS)
    worse = (at for (at, sync), (_, non) in zip(*rows, strict=True) if sync < non - 0.01)
    return {"synchronous_worse_from_s": next(worse, None)}


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file, hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
