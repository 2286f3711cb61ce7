"""The speed difference that runs of a case are judged by: stated, or read from the inter-area mode."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from interarea.design.linear.linearise import remove_reference
from interarea.design.modes.modes import ModeError, modes_of
from interarea.fmu_build.write.cache import cached_json, code_hash, content_hash, numerics_versions
from interarea.models.case.case import Case

from ..errors import ScenarioError, nearest
from ..results.ringdown import Swing
from .artefacts import linear_plant, plant_fmu


def swing_of(case: Case, cache: Path, stated: tuple[str, ...] | None = None) -> Swing:
    """Return the speed difference that runs of a case are judged by.

    stated : two machines, of the scenario; else those the case states; else the extreme machines of the
        inter-area mode (the least damped one), of the local mode in a single area.
    """
    machines = [m.name for m in case.machines]
    if stated is not None:
        return Swing(*_two_of(stated, machines), "stated by the scenario")
    if case.swing is not None:
        return Swing(*_two_of(case.swing, machines), "stated by the case")
    if len(machines) == 1:
        return Swing(machines[0], "", "the only machine")
    key = content_hash(
        plant_fmu(case, cache).name, case.areas, code_hash(modes_of.__module__), numerics_versions()
    )
    return Swing(*cached_json(cache, "swing", key, lambda: _extremes(case, cache)))


def _two_of(names: tuple[str, ...], machines: Sequence[str]) -> tuple[str, str]:
    for name in names:
        if name not in machines:
            raise ScenarioError(f"swing: machine {name!r} does not exist; {nearest(name, machines)}")
    return names[0], names[1]


def _extremes(case: Case, cache: Path) -> tuple[str, str, str]:
    """Return the two machines that swing furthest against each other, and in which mode."""
    try:
        modes = modes_of(remove_reference(linear_plant(case, cache)), case.areas)
        between = [m for m in modes.values() if m.name.startswith("inter-area")]
        mode = min(between or modes.values(), key=lambda m: m.damping_ratio)
    except ModeError:
        first, last = case.machines[0].name, case.machines[-1].name
        return first, last, "first and last machine: the case has no mode with a name"
    shape = mode.shape
    far = max(shape, key=lambda m: abs(shape[m]))
    against = min(shape, key=lambda m: (shape[m] * shape[far].conjugate()).real)
    ahead, behind = sorted((far, against), key=list(shape).index)
    return ahead, behind, f"extreme machines of mode {mode.name!r} at {mode.frequency_hz:.3f} Hz"
