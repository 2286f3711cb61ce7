"""The linear loop after a fault, and the duration of a run that shows its decay.

After a fault the tripped branch is out and lost signals are zero. This loop, linearised at a new power flow
without the branch, decides whether the swing decays. If there is no power flow without the branch (its loads
are of constant power, those of a run are not), or the grid splits, the loop with the branch is used and
reported (`FaultLoops.unsolved`).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log
from pathlib import Path
from typing import TypeAlias

import control
import numpy as np

from interarea.design.certificates.large_loop import LargePlant
from interarea.design.controllers.bank import ControllerBank
from interarea.design.controllers.controller import Controller
from interarea.design.delay.curves import delayed_loop, rightmost_roots
from interarea.design.delay.signal_conditions import Condition
from interarea.design.linear.linearise import select
from interarea.design.linear.matrices import ZERO_EIGENVALUE, decays
from interarea.models.case.case import Case, CaseError
from interarea.models.case.variants import operating_variant
from interarea.models.grid.powerflow import PowerFlowError

from ..results.verdict import SETTLED_SHARE
from .family import FamilyPlant

ControllerOrBank: TypeAlias = Controller | ControllerBank
NORMAL = Condition("normal")  #: all signals at once, none wrong
SLOW = 0.05  #: 1/s: a loop whose slowest root decays less fast is run for `LONG_S` at least
LONG_S, LONGEST_S = 60.0, 240.0  #: of such a run
_LEFT = -2.5  # 1/s: roots left of it are slow for no run


@dataclass(frozen=True)
class LoopEnd:
    """The linear loop after a fault. root : the rightmost except structural zeros, 1/s.

    Of a plant above `family.DENSE_STATES` states, the rightmost of the swings.
    """

    stable: bool
    root: complex

    def run_s(self, stop_s: float, since_s: float) -> float:
        """Return the necessary duration of a run: `stop_s`, or more if the slowest root requires it.

        If that root decays by less than `SLOW`: at least `LONG_S`, until a fifth of the swing since `since_s`
        remains, at most `LONGEST_S`.

        >>> LoopEnd(True, -0.1 + 0j).run_s(10.0, 1.5), round(LoopEnd(True, -0.02 + 0.6j).run_s(10.0, 1.5), 3)
        (10.0, 81.972)
        >>> LoopEnd(False, 0.03 + 0.6j).run_s(10.0, 1.5)
        60.0
        """
        rate = -self.root.real
        if rate >= SLOW:
            return stop_s
        needed = since_s + log(1.0 / SETTLED_SHARE) / rate if rate > 0.0 else LONG_S
        return max(stop_s, LONG_S, min(needed, LONGEST_S))


class FaultLoops:
    """Linear loops of one operating point with each tripped branch out, computed on request."""

    def __init__(self, case: Case, controller: ControllerOrBank, cache: Path) -> None:
        self.case, self.controller, self._cache = case, controller, cache
        self._plants: dict[str | None, FamilyPlant] = {}
        self.unsolved: list[str] = []  #: branches without which there is no power flow
        self._ends: dict[tuple[object, ...], LoopEnd] = {}  #: by branch, condition and `controlled`

    def end(
        self,
        trip: str | None,
        condition: Condition = NORMAL,
        *,
        controlled: bool = True,
    ) -> LoopEnd:
        """Return the loop with branch `trip` out and the signals in that condition."""
        if trip is not None and not self.case.branch(trip).in_service:
            trip = None  # it is out already
        late, scales = (tuple(sorted(of.items())) for of in (condition.latency_s_of, condition.scale_of))
        key = (trip, tuple(condition.lost), late, scales, controlled)
        if key not in self._ends:
            self._ends[key] = self._end(self._plant(trip), condition, controlled)
        return self._ends[key]

    def _plant(self, trip: str | None) -> FamilyPlant:
        if trip not in self._plants:
            signals, actuators = tuple(self.controller.inputs), tuple(self.controller.outputs)
            try:
                case = self.case if trip is None else operating_variant(self.case, out=(trip,))
                self._plants[trip] = FamilyPlant.of(case, signals, actuators, self._cache)
            except (PowerFlowError, CaseError):
                if trip is None:
                    raise
                self.unsolved.append(trip)
                self._plants[trip] = self._plant(None)
        return self._plants[trip]

    def _end(self, plant: FamilyPlant, condition: Condition, controlled: bool) -> LoopEnd:
        bank, lost = self.controller, condition.lost
        K = bank.acting(lost) if isinstance(bank, ControllerBank) else bank
        system = _remaining(K.system if controlled else K.scaled(0.0).system, plant)
        signals = [str(name) for name in system.input_labels]
        there = [name for name in signals if name not in lost]
        late, scales = (
            {name: of[name] for name in there if name in of}
            for of in (condition.latency_s_of, condition.scale_of)
        )
        seen = Condition("after a fault", tuple(name for name in signals if name in lost), late, scales)
        if isinstance(plant.judged, LargePlant):
            facts = plant.judged.facts(system, seen)
            return LoopEnd(facts.stable, complex(facts.rightmost))
        return _dense_end(plant.judged, system, seen)


def _remaining(K: control.StateSpace, plant: FamilyPlant) -> control.StateSpace:
    """Return `K` without the ports of a device that is out together with the branch."""
    small = plant.small
    there = plant.blocks.inputs if small is None else small.input_labels
    seen = K.input_labels if small is None else small.output_labels
    signals = [name for name in K.input_labels if name in seen]
    actuators = [name for name in K.output_labels if name in there]
    return select(K, signals, actuators) if signals and actuators else control.ss([], [], [], [])


def _dense_end(plant: control.StateSpace, K: control.StateSpace, condition: Condition) -> LoopEnd:
    loop = delayed_loop(plant, K, condition.latency_s_of, lost=condition.lost, scale_of=condition.scale_of)
    roots = rightmost_roots(loop, right_of=_LEFT)
    moving = roots[np.abs(roots) > ZERO_EIGENVALUE]
    if not moving.size:
        return LoopEnd(True, complex(_LEFT))
    root = complex(moving[int(np.argmax(moving.real))])
    return LoopEnd(decays(roots), complex(root.real, abs(root.imag)))
