r"""Sets of actuators, and their scores at other operating points.

A mode there is the one of the base point of most similar shape: with :math:`w^T v = 1` at both points (0, 1)

.. math:: |(w_0^T v_1)(w_1^T v_0)|

is 1 for the same mode and 0 for another, independent of units and scaling of states.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ..linear.sparse_plant import SparsePlant
from .modes import Mode, ModeError

_SAME = 0.25  # less is another mode


@dataclass(frozen=True)
class LoopSet:
    """Actuators, each with its best signal.

    score : least over modes of the largest index. left : the same after the worst loss of one signal.
    decides : the mode that decides the score. loops : actuator -> signal, for its best mode.
    holds : the least score at other operating points, at `weakest_point`; None if none were given.
    """

    actuators: tuple[str, ...]
    score: float
    left: float
    decides: str
    loops: Mapping[str, str]
    holds: float | None = None
    weakest_point: str = ""

    @property
    def reason(self) -> str:
        """Reason of the rank, as a sentence."""
        message = f"least score {self.score:.2f} ({self.decides}); {self.left:.2f} with the worst signal lost"
        return message if self.holds is None else f"{message}; {self.holds:.2f} at {self.weakest_point}"


@dataclass(frozen=True)
class LoopPoint:
    """An operating point beside the base one: its plant and modes (`all_modes`), in words `name`."""

    name: str
    plant: SparsePlant
    modes: Sequence[Mode]

    def reach(self, targets: Sequence[Mode], actuators: Sequence[str]) -> npt.NDArray[np.float64]:
        """Return the shift of each target by each actuator here, relative to the largest, (targets,
        actuators).

        Rows of targets that do not exist here are 1: there is no requirement.
        """
        local = [self.like(target) for target in targets]
        B = self.plant.Bu[:, [self.plant.inputs.index(name) for name in actuators]].toarray()
        result = np.ones((len(targets), len(actuators)))
        for row, mode in zip(result, local, strict=True):
            if mode is not None:
                moved = np.abs(mode.left @ B)
                row[:] = moved / max(float(moved.max()), 1e-300)
        return result

    def like(self, target: Mode) -> Mode | None:
        """Return the mode here most similar to one of the base point, None if there is none.

        Raises
        ------
        ModeError : a grid of other machines or devices.
        """
        best, most = None, _SAME
        for mode in self.modes:
            if len(mode.right) != len(target.right):
                raise ModeError(
                    f"point {self.name!r} has {len(mode.right)} states, the base one {len(target.right)}; "
                    "wanted: the same machines and devices at both"
                )
            identical = abs((target.left @ mode.right) * (mode.left @ target.right))
            if identical > most:
                best, most = mode, float(identical)
        return best


def held(
    sets: Sequence[LoopSet], targets: Sequence[Mode], actuators: Sequence[str], points: Sequence[LoopPoint]
) -> tuple[LoopSet, ...]:
    """Return sets with their score at the worst point, ranked by the lower of both scores."""
    reaches = [(point.name, point.reach(targets, actuators)) for point in points]
    place = {name: k for k, name in enumerate(actuators)}
    result = []
    for one in sets:
        own = [place[name] for name in one.actuators]
        scores = [(float(reach[:, own].max(axis=1).min()), name) for name, reach in reaches]
        holds, weakest = min(scores, key=lambda row: row[0])
        result.append(replace(one, holds=holds, weakest_point=weakest))
    return tuple(sorted(result, key=lambda one: -min(one.score, one.holds or 0.0)))


def gone(targets: Sequence[Mode], points: Sequence[LoopPoint]) -> tuple[str, ...]:
    """Return which targets do not exist at a point, in words."""
    return tuple(
        f"at {point.name}: no mode with the shape of {target.name} below the damping limit"
        for point in points
        for target in targets
        if point.like(target) is None
    )
