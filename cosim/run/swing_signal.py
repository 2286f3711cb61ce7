"""The speed difference that runs of a case are judged by: stated, or read from the inter-area mode."""

from __future__ import annotations

from pathlib import Path

from interarea.design.linear.linearise import remove_reference
from interarea.design.modes.all_modes import all_modes
from interarea.design.modes.modes import Mode, ModeError, modes_of
from interarea.fmu_build.write.cache import cached_json, code_hash, content_hash, numerics_versions
from interarea.models.case.case import Case
from interarea.models.case.checks import islands_of

from ..results.ringdown import Swing
from ..scenario.names import two_machines
from .artefacts import linear_matrices, plant_fmu, sparse_linear_plant, states_beyond_dense

#: of a grid too large for matrices: where areas swing against each other, and damping ratios below which they
#: are sought in turn
_BAND_HZ, _BELOW = (0.1, 0.9), (0.1, 0.2, 0.4)


def swing_of(case: Case, cache: Path, stated: tuple[str, ...] | None = None) -> Swing:
    """Return the speed difference that runs of a case are judged by.

    stated : two machines, of the scenario; else those the case states; else the extreme machines of the
        inter-area mode (the least damped one), of the local mode in a single area.
    """
    machines = [m.name for m in case.machines]
    if stated is not None:
        return Swing(*two_machines(stated, machines), "stated by the scenario")
    if case.swing is not None:
        return Swing(*two_machines(case.swing, machines), "stated by the case")
    if len(machines) == 1:
        return Swing(machines[0], "", "the only machine")
    key = content_hash(
        plant_fmu(case, cache).name, case.areas, code_hash(modes_of.__module__), numerics_versions()
    )
    return Swing(*cached_json(cache, "swing", key, lambda: _extremes(case, cache)))


def _extremes(case: Case, cache: Path) -> tuple[str, str, str]:
    """Return the two machines that swing furthest against each other, and in which mode."""
    parts = islands_of(case)
    if len(parts) > 1:
        within = [[m.name for m in case.machines if m.bus in part] for part in parts]
        largest = max(within, key=len)
        reason = f"first and last machine of the largest of {len(parts)} islands"
        return largest[0], largest[-1], reason
    try:
        modes = _modes(case, cache)
        between = [m for m in modes if m.name.startswith("inter-area")]
        mode = min(between or modes, key=lambda m: m.damping_ratio)
    except ModeError:
        first, last = case.machines[0].name, case.machines[-1].name
        return first, last, "first and last machine: the case has no mode with a name"
    shape = mode.shape
    far = max(shape, key=lambda m: abs(shape[m]))
    against = min(shape, key=lambda m: (shape[m] * shape[far].conjugate()).real)
    ahead, behind = sorted((far, against), key=list(shape).index)
    return ahead, behind, f"extreme machines of mode {mode.name!r} at {mode.frequency_hz:.3f} Hz"


def _modes(case: Case, cache: Path) -> list[Mode]:
    """Return the named modes of a case, of a grid too large for matrices those of `_BAND_HZ` alone.

    Raises
    ------
    ModeError : there are none.
    """
    if not states_beyond_dense(case):
        return list(modes_of(remove_reference(linear_matrices(case, cache)), case.areas).values())
    plant = sparse_linear_plant(case, cache)
    swings: list[Mode] = []
    for below in _BELOW:
        modes = all_modes(plant, case.areas, band_hz=_BAND_HZ, below=below).modes
        swings = [m for m in modes if m.name.startswith(("inter-area", "local"))]
        if any(m.name.startswith("inter-area") for m in swings):
            break
    if not swings:
        raise ModeError(f"{case.name}: no swing mode between {_BAND_HZ[0]} and {_BAND_HZ[1]} Hz")
    return swings
