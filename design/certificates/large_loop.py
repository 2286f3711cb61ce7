"""What a controller does on a plant too large for dense eigenvalues, with the verdicts of a small one.

Inter-area modes are followed from the open loop while the gain of the loop rises from 0 to 1, late and with
losses as a condition says, so that among a hundred local modes they keep their names; the least damped swing
is searched for and counted; and what grows at all is counted on the right half plane. All by Newton's method
and the argument principle on the delayed equations themselves: no dense matrix, no Padé model in a verdict.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import control
import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize_scalar

from ..delay.late_plant import LatePlant
from ..delay.signal_conditions import Condition
from ..errors import UncertifiedDesign
from ..linear.resolvent import Shifted
from ..linear.sparse_plant import SparsePlant
from ..modes.all_modes import RESIDUAL, all_modes
from ..modes.mode_count import OnTheLine, all_that_grows, count_modes
from ..modes.modes import Mode, damping_ratio
from ..reduction.gramians import matrices
from ..reduction.low_rank import input_columns, output_rows
from .closed_loop import largest_real_gain

ComplexArray = npt.NDArray[np.complex128]

SWING_HZ = (0.1, 2.5)  #: frequencies in which a root counts as a swing
#: roots damped better than this are filters and the latency's own chain of roots, not swings
WELL_DAMPED = 0.6
_BELOW = (0.05, 0.1, 0.2, 0.4)  # damping ratios up to which the least damped swing is looked for, in turn
_FIRST, _SHORTEST, _LONGER = 0.05, 1e-7, 1.6  # steps of the gain
_MOST_STEPS = 300  # of a mode that is followed, halved ones counted
_BESIDE = 0.3  # of a step's length: how far from the secant a followed mode may end
_SAME_SHAPE = 0.6  # |w' v| of a mode before the step and after it, at least
_EFFORT_RAD_S, _EFFORT_POINTS, _PEAKS = (1e-2, 1e3), 300, 4


@dataclass(frozen=True)
class LoopFacts:
    """One condition: whether nothing grows, and the damping of swings (1 where none is below `WELL_DAMPED`).

    rightmost : largest real part of the swings that were looked at, 1/s; of all roots only the count tells.
    """

    stable: bool
    rightmost: float
    worst_swing: float
    inter_area: float


@dataclass(frozen=True)
class LargePlant:
    """An operating point as sparse blocks. areas : machine -> area number; omega_b : rated speed, rad/s."""

    plant: SparsePlant
    areas: Mapping[str, int]
    omega_b: float

    @cached_property
    def inter_area(self) -> tuple[Mode, ...]:
        """The inter-area modes of the open loop, as `interarea modes` names them."""
        modes = all_modes(self.plant, self.areas, band_hz=SWING_HZ, below=_BELOW[-1])
        return tuple(mode for mode in modes.modes if mode.name.startswith("inter-area"))

    def late(self, K: control.StateSpace, condition: Condition, gain: float = 1.0) -> LatePlant:
        """Return the loop under a condition, its gain lowered to a share."""
        A, B, C, D = matrices(K)
        there = np.array(
            [0.0 if name in condition.lost else condition.scale_of.get(name, 1.0) for name in K.input_labels]
        )
        names = {"inputs": list(K.input_labels), "outputs": list(K.output_labels)}
        seen = control.ss(A, B * there, gain * C, gain * D * there, **names)
        late = {name: s for name, s in condition.latency_s_of.items() if name not in condition.lost}
        return LatePlant(self.plant, seen, late, omega_b=self.omega_b, high_hz=SWING_HZ[1])

    def facts(self, K: control.StateSpace, condition: Condition) -> LoopFacts:
        """Judge one condition.

        Raises
        ------
        UncertifiedDesign : an inter-area mode that was lost on its way from the open loop.
        ModeError : modes found and counted that differ.
        """
        loop = self.late(K, condition)
        swings: list[complex] = []
        for below in (*_BELOW, WELL_DAMPED):
            modes = all_modes(self.plant, self.areas, band_hz=SWING_HZ, below=below, loop=loop)
            swings = [mode.eigenvalue for mode in modes.modes]
            if swings:
                break
        between = [damping_ratio(s) for s in self.followed(K, condition).values()]
        try:
            grows = count_modes(loop, all_that_grows(loop), swings).modes
        except OnTheLine:  # neither growing nor decaying
            grows = 1
        return LoopFacts(
            stable=grows == 0,
            rightmost=max((s.real for s in swings), default=-np.inf),
            worst_swing=min(map(damping_ratio, swings), default=1.0),
            inter_area=min((z for z in between if z < WELL_DAMPED), default=1.0),
        )

    def followed(self, K: control.StateSpace, condition: Condition) -> dict[str, complex]:
        """Return the inter-area modes of the loop by the names that they have in the open one."""
        ends: dict[str, complex] = {}
        for mode in self.inter_area:
            ends[mode.name] = end = self.follow(K, condition, mode)
            twins = [n for n, s in ends.items() if n != mode.name and abs(s - end) <= 1e-7 * (1.0 + abs(end))]
            if twins:
                raise UncertifiedDesign(
                    f"condition {condition.name!r}: modes {twins[0]!r} and {mode.name!r} are both "
                    f"tracked to {end:.6g}; one of them is unknown, so this controller is not certified"
                )
        return ends

    def follow(self, K: control.StateSpace, condition: Condition, mode: Mode) -> complex:
        """Return where a mode of the open loop ends in the closed one, 1/s.

        By secant and Newton; a step whose end is off the secant or of another shape is halved.

        Raises
        ------
        UncertifiedDesign : it was lost on its way.
        """
        s, x, y = mode.eigenvalue, mode.right, mode.left
        gain, step, slope, tries = 0.0, _FIRST, 0.0j, 0
        while gain < 1.0:
            tries += 1
            step = min(step, 1.0 - gain)
            loop = self.late(K, condition, gain + step)
            end, right, left, residual = loop.exact(s + step * slope, x, y)
            rotated = abs(complex((y @ right) * (left @ x) / ((y @ x) * (left @ right))))
            off = abs(end - s - step * slope)
            near = off <= _BESIDE * abs(end - s) + 1e-3 * abs(s) and np.sqrt(rotated) >= _SAME_SHAPE
            if residual <= RESIDUAL and near:
                gain, slope, s, x, y = gain + step, (end - s) / step, end, right, left
                step *= _LONGER
            else:
                step *= 0.5
            if not step >= _SHORTEST or tries > _MOST_STEPS:
                raise UncertifiedDesign(
                    f"condition {condition.name!r}: {mode.name!r} could not be tracked beyond {gain:.4g} "
                    f"of the loop gain, near {s:.6g}; its damping is unknown, so this controller is not "
                    "certified"
                )
        return s

    def response(self, actuators: Sequence[str], signals: Sequence[str]) -> Callable[[complex], ComplexArray]:
        """Return s -> G(s) (signals, actuators), speeds in rad/s."""
        B = input_columns(self.plant, list(actuators))
        C = self.omega_b * output_rows(self.plant, {name: {name: 1.0} for name in signals})
        return lambda s: np.asarray(C @ Shifted(self.plant, s).solve(B))

    def loss_criterion(self, K: control.StateSpace, present: Sequence[str]) -> float:
        """Return `closed_loop.loss_criterion` of this plant, from 1e-3 rad/s on."""
        G = self.response(K.output_labels, present) if present else None
        return 0.0 if G is None else largest_real_gain(K, present, lambda s: G(s).real, at_rest=False)

    def effort(self, K: control.StateSpace) -> float:
        """Return the largest gain of K (I - G K)^-1 over frequency, pu per rad/s, the loop being stable.

        Searched at 300 frequencies from 0.01 to 1000 rad/s and at those of the swings, then polished.
        """
        G = self.response(K.output_labels, K.input_labels)
        A, B, C, D = matrices(K)

        def size(omega: float) -> float:
            k = C @ np.linalg.solve(1j * omega * np.eye(len(A)) - A, B) + D
            return float(np.linalg.norm(np.linalg.solve(np.eye(len(D)) - k @ G(1j * omega), k), 2))

        loop = self.late(K, Condition("normal"))
        swings = all_modes(self.plant, self.areas, band_hz=SWING_HZ, below=_BELOW[2], loop=loop).modes
        at = np.geomspace(*_EFFORT_RAD_S, _EFFORT_POINTS)
        at = np.unique([*at, *(mode.eigenvalue.imag for mode in swings)])
        sizes = np.array([size(omega) for omega in at])
        best = max(float(sizes.max()), float(np.linalg.norm(D, 2)))  # the latter at all higher frequencies
        # a broad peak has many of the largest values: of each its highest
        beside = np.concatenate([[0.0], sizes, [0.0]])
        peaks = np.flatnonzero((sizes >= beside[:-2]) & (sizes >= beside[2:]))
        for k in peaks[np.argsort(-sizes[peaks])][:_PEAKS]:
            bounds = at[max(k - 1, 0)], at[min(k + 1, len(at) - 1)]
            result = minimize_scalar(lambda omega: -size(omega), bounds=bounds, method="bounded")
            best = max(best, -float(result.fun))
        return best
