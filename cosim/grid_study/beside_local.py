"""Wide-area loop for the modes that local stabilizers leave weak; both are evaluated together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from interarea.design.controllers.controller import Controller
from interarea.models.case.case import Case

from ..designs.design_tables import AskTable
from .local_stabilizers import WASHOUT_S
from .weak_modes import WeakModes, modes_of_grid


def leaves_something(local: Controller, requested: AskTable) -> bool:
    """Whether inter-area modes remain weak with all stabilizers in service and every loop stable.

    Other requirements that they miss (one of them out, a local mode, a fault) are no reason for a loop.
    """
    rows = (local.certificate or {})["rows"]
    there = [row["inter_area"] for row in rows if row["condition"] == "N"]
    return all(row["stable"] for row in rows) and not min(there) >= requested.inter_area


def installable(case: Case, stabilizers: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Return the stabilizers (rows of `local_rival`) at machines without one: a machine has at most one."""
    free = {machine.name for machine in case.machines if machine.stabilizer is None}
    return [one for one in stabilizers if one["machine"] in free]


def with_stabilizers(case: Case, stabilizers: Sequence[Mapping[str, Any]], limit_pu: float) -> Case:
    """Return a grid with stabilizers as devices `speed` of their machines. limit_pu : of each output."""
    change = {one["machine"]: {"stabilizer": _device(one, limit_pu)} for one in stabilizers}
    return case.with_changes({"machines": change}, name=f"{case.name}-with-stabilizers")


def _device(one: Mapping[str, Any], limit_pu: float) -> dict[str, Any]:
    stages = {f"T{2 * k + half}": one[f"T{half}"] for k in range(one["stages"]) for half in (1, 2)}
    return {"K": one["K"], "Tw": WASHOUT_S, **stages, "Vs_min": -limit_pu, "Vs_max": limit_pu}


def beside_local(weak: WeakModes, local: Controller, cache: Path) -> WeakModes | None:
    """Return the grid with its local stabilizers; the requirements stay those of the grid without them.

    None : no machine can have one, or that grid is unstable or has no inter-area mode.
    """
    stabilizers = installable(weak.case, local.design["local"])
    if not stabilizers:
        return None
    case = with_stabilizers(weak.case, stabilizers, local.limit_pu)
    grid = modes_of_grid(case, cache)
    if grid.growing or not grid.inter_area:
        return None
    choices = weak.choices.model_copy(update={"inter_area": weak.required_damping})
    machines = tuple(one["machine"] for one in stabilizers)
    return WeakModes(case, grid.plant, grid.all_modes, grid.inter_area, grid.weak_others, choices, machines)
