"""The damping that a controller takes from each mode: open-loop modes, tracked into the closed loop.

A bound on the worst swing of all lets a controller take from every mode but the worst; here each is compared
with itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import control

from ..delay.signal_conditions import Condition
from ..errors import UncertifiedDesign
from ..modes.all_modes import all_modes
from ..modes.modes import damping_ratio
from .large_loop import SWING_HZ, LargePlant

#: damping ratio above which a mode is no concern, before and after
CALM = 0.1
_BELOW = 0.2  # damping ratio of the modes of the open loop that are followed


@dataclass(frozen=True)
class ModeChange:
    """A mode of the open loop at an operating point, and what is left of it at worst.

    least : damping ratio; where it could not be followed, that of the worst swing of the loop, which is less.
    """

    point: str
    mode: str
    frequency_hz: float
    without: float
    least: float
    condition: str

    @property
    def taken(self) -> float:
        """By how much less than `CALM`, or than without control, it is damped."""
        return min(self.without, CALM) - self.least

    @property
    def text(self) -> str:
        """The change in words."""
        return (
            f"{self.mode} ({self.frequency_hz:.2f} Hz) at {self.point} from {self.without:.4f} to "
            f"{self.least:.4f} under {self.condition}"
        )


def most_taken(modes: Sequence[Mapping[str, Any]]) -> str:
    """Return the mode of a certificate's record that loses most damping, as a sentence."""
    if not modes:
        return f"no swing mode below a damping ratio of {_BELOW:g} without control"
    worst = max((ModeChange(**mode) for mode in modes), key=lambda change: change.taken)
    if not worst.taken > 0.0:
        return f"no mode loses damping below {CALM:g}"
    return f"the damping ratio decreases most for {worst.text}"


def mode_changes(
    point: str,
    plant: LargePlant,
    K: control.StateSpace,
    conditions: Sequence[Condition],
    worst_swing: Mapping[str, float],
) -> tuple[ModeChange, ...]:
    """Return every swing mode of a plant damped by less than 0.2, with the least left of it.

    conditions : of which the worst counts. worst_swing : name of a condition -> damping of the worst swing.
    """
    modes = all_modes(plant.plant, plant.areas, band_hz=SWING_HZ, below=_BELOW).modes
    changes = []
    for mode in modes:
        left = []
        for condition in conditions:
            try:
                value = damping_ratio(plant.follow(K, condition, mode))
            except UncertifiedDesign:
                value = worst_swing[condition.name]
            left.append((value, condition.name))
        least, name = min(left)
        changes.append(ModeChange(point, mode.name, mode.frequency_hz, mode.damping_ratio, least, name))
    return tuple(changes)
