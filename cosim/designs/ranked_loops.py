"""Ranking of loops for a case of any size, from its sparse plant."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from interarea.design.modes.all_modes import all_modes
from interarea.design.modes.loop_choice import LoopChoice, choose_loops
from interarea.design.modes.loop_points import LoopPoint
from interarea.models.case.case import Case

from ..run.artefacts import sparse_linear_plant

_BELOW = 0.4  # damping ratio up to which modes of other points are looked for


def ranked_loops(
    case: Case,
    cache: Path,
    *,
    band_hz: tuple[float, float],
    below: float,
    points: Mapping[str, Case] | None = None,
    **options: Any,
) -> LoopChoice:
    """Rank loops and sets for modes of a band, Hz, whose damping ratio is below a limit.

    points : name -> the grid at another operating point. options : of `choose_loops`.

    Raises
    ------
    UserError : no operating point, no such mode, signal or actuator.
    """
    plant = sparse_linear_plant(case, cache)
    result = all_modes(plant, case.areas, band_hz=band_hz, below=below)
    others = []
    for name, other in (points or {}).items():
        there = sparse_linear_plant(other, cache)
        # a mode that is a little better damped there is still the same one
        modes = all_modes(there, other.areas, band_hz=band_hz, below=max(below, _BELOW)).modes
        others.append(LoopPoint(name, there, modes))
    return choose_loops(plant, result.modes, case.areas, points=others, **options)
