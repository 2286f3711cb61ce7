"""Loops of a case of any size, ranked from its sparse plant."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from interarea.design.modes.all_modes import all_modes
from interarea.design.modes.loop_choice import LoopChoice, choose_loops
from interarea.models.case.case import Case

from ..run.artefacts import sparse_linear_plant


def ranked_loops(
    case: Case, cache: Path, *, band_hz: tuple[float, float], below: float, **options: Any
) -> LoopChoice:
    """Rank loops and sets for modes of a band, Hz, whose damping ratio is below a limit.

    options : of `choose_loops`.

    Raises
    ------
    UserError : no operating point, no such mode, signal or actuator.
    """
    plant = sparse_linear_plant(case, cache)
    found = all_modes(plant, case.areas, band_hz=band_hz, below=below)
    return choose_loops(plant, found.modes, case.areas, **options)
