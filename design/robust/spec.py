"""What a robust design refuses before it starts: plants and caps for which no answer can come out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise

import control
import numpy as np

from ..delay.signal_conditions import Condition
from ..errors import InfeasibleDesign
from ..linear.linearise import select
from ..modes.modes import Mode
from ..synthesis.check import describe_mode, describe_reach, out_of_reach
from ..synthesis.generalized_plant import check_design_plant
from .smoothed_objective import COMMON_SPEED, BandOffsets
from .stages import Stage
from .swing_penalty import SwingPenalty


@dataclass(frozen=True)
class RobustSpec:
    """Requirements of a robust design, and the extent of its search.

    signals : controller inputs (speeds, rad/s), e.g. ("G2_dw", "G4_dw").
    actuators : controller outputs (pu), e.g. ("G4_vs",).
    order : states of the controller in all, those of its washouts counted.
    sees : actuator -> (signals, order) of a decentralised controller; empty = one full controller.
    effort_cap : (omega, cap) nodes in rad/s and pu per rad/s, log-log interpolated; None = no cap.
    effort_under : names of the conditions under which it holds; none = all.
    stages : of the search, each with more conditions, by steps that follow each eigenvalue from a first guess
    for the loops; none = L-BFGS on all of them from random starts.
    washout_s : time constant of sT/(1+sT) in series with each output; 0 = none.
    dc_block : K(0) = 0 by D = C A^-1 B instead of a washout in series, without a state.
    slowest_pole, fastest_pole : rad/s, of the controller; with `dc_block` the slowest is the least corner of
        its high pass.
    feedthrough : whether D of the controller is free too, which costs no state.
    """

    signals: tuple[str, ...]
    actuators: tuple[str, ...]
    conditions: tuple[Condition, ...]
    order: int = 6
    sees: Mapping[str, tuple[tuple[str, ...], int]] = field(default_factory=dict)
    effort_cap: tuple[tuple[float, float], ...] | None = ((0.05, 0.15), (300.0, 0.15))
    effort_under: tuple[str, ...] = ()
    washout_s: float = 0.0
    feedthrough: bool = False
    dc_block: bool = True
    slowest_pole: float = 0.3
    fastest_pole: float = 280.0
    offsets: BandOffsets = field(default_factory=BandOffsets)
    #: operating point -> damping wanted there on top of `offsets`
    more: Mapping[str, BandOffsets] = field(default_factory=dict)
    #: condition, or kind of it (`Condition.kind`), -> damping wanted under it on top of both
    more_under: Mapping[str, BandOffsets] = field(default_factory=dict)
    rho: float = 600.0  #: how closely the smoothed worst follows the worst
    plant_order: int = 16
    pade_order: int = 3
    starts: int = 6
    evaluations: int = 1800  #: of each start
    polishes: int = 20  #: rounds of the best start at most; ends when three gain less than 1e-5 in all
    seed: int = 1
    swing: SwingPenalty | None = None  #: on the first swing, once the linear design is there
    margins_deg: tuple[float, ...] = ()  #: of the first swing, from one to the next
    #: each round of the search looks at the models within this (damping) of the worst; inf = at all
    within: float = np.inf
    start: control.StateSpace | None = None  #: a controller to start from, beside the random ones
    starts_on: int = 0  #: operating points, the first ones, on which the starts are tried; 0 = all
    stages: tuple[Stage, ...] = ()

    def __post_init__(self) -> None:
        check_spec(self)


def check_spec(spec: RobustSpec) -> None:
    """Reject contradictory orders, caps and conditions.

    Raises
    ------
    ValueError
        Says which, and what is allowed.
    """
    filters = int(spec.washout_s > 0.0)
    requested = [(who, order, filters) for who, (_, order) in spec.sees.items()]
    for who, order, least in requested or [("the controller", spec.order, filters * len(spec.actuators))]:
        if not order > least:
            raise ValueError(
                f"robust design: order of {who} is {order}; its washouts take {least} states, at least "
                f"{least + 1} are needed"
            )
    if spec.start is None and spec.starts < 1:
        raise ValueError("robust design: starts = 0, allowed only with an initial controller")
    for condition in spec.conditions:
        unknown = {*condition.lost, *condition.latency_s_of, *condition.scale_of} - set(spec.signals)
        if unknown:
            raise ValueError(
                f"condition {condition.name!r} names {sorted(unknown)}; the controller's signals are "
                f"{', '.join(spec.signals)}"
            )
    _check_stages(spec)
    _check_bounds(spec)


def _check_stages(spec: RobustSpec) -> None:
    """Refuse stages and caps for conditions that are not among those of the design."""
    known = {condition.name for condition in spec.conditions}
    requested = [("effort_under", spec.effort_under)]
    requested += [(f"stage {k}", stage.conditions) for k, stage in enumerate(spec.stages, start=1)]
    for what, names in requested:
        if strange := sorted(set(names) - known):
            raise ValueError(f"robust design: {what} names unknown {strange}; the design has {sorted(known)}")


def _check_bounds(spec: RobustSpec) -> None:
    """Refuse bounds of poles and effort that leave no controller."""
    if not 0.0 < spec.slowest_pole < spec.fastest_pole < np.inf:
        raise ValueError(
            f"robust design: slowest_pole = {spec.slowest_pole:g} and fastest_pole = {spec.fastest_pole:g} "
            "rad/s contradict each other, allowed: 0 < slowest_pole < fastest_pole"
        )
    for at, cap in spec.effort_cap or ():
        if not (0.0 < at < np.inf and 0.0 < cap < np.inf):
            raise ValueError(
                f"robust design: effort_cap has the node ({at:g} rad/s, {cap:g}), allowed: both positive and "
                "finite; a cap of 0 leaves no controller"
            )
    for (low, _), (high, _) in pairwise(spec.effort_cap or ()):
        if not high > low:
            raise ValueError(
                f"robust design: effort_cap has {high:g} rad/s after {low:g} rad/s, allowed: rising ones"
            )


def check_plants(plants: Mapping[str, control.StateSpace], spec: RobustSpec) -> None:
    """Reject plants without a design model, and unstable modes that are not controllable or observable.

    Raises
    ------
    ValueError : a matrix that is not finite, D that is not zero, more states of K than of the plant.
    InfeasibleDesign : an unstable mode that is not controllable or not observable.
    """
    order = max([order for _, order in spec.sees.values()], default=spec.order)
    for point, plant in plants.items():
        try:
            check_design_plant(select(plant, list(spec.actuators), list(spec.signals)))
        except ValueError as error:
            raise ValueError(f"operating point {point!r}: {error}") from error
        if order > plant.nstates:
            raise ValueError(
                f"robust design: order {order} of the controller is above the plant's {plant.nstates} at "
                f"operating point {point!r}; a controller order above the plant's has no benefit, reduce it"
            )
        require_moved(point, plant, spec)


def require_moved(
    point: str, plant: control.StateSpace, spec: RobustSpec, modes: Mapping[str, Mode] | None = None
) -> None:
    """Reject a target mode or unstable mode that is not controllable or not observable.

    modes : of the plant; the inter-area modes among them are targets. None: only unstable modes.

    Raises
    ------
    InfeasibleDesign
        Names the mode, with its controllability and observability.
    """
    picked = select(plant, list(spec.actuators), list(spec.signals))
    A, B, C = (np.asarray(M, dtype=float) for M in (picked.A, picked.B, picked.C))
    values = np.linalg.eigvals(A)
    targets = {f"mode {n!r}": m.eigenvalue for n, m in (modes or {}).items() if n.startswith("inter-area")}
    unstable = [complex(v) for v in values if not v.real < 0.0 and v.imag >= 0.0 and abs(v) > COMMON_SPEED]
    for name, eigenvalue in [*targets.items(), *(("unstable mode", v) for v in unstable)]:
        if out_of_reach(A, B, C, complex(values[np.argmin(np.abs(values - eigenvalue))])):
            raise InfeasibleDesign(
                f"robust design, operating point {point!r}: {name} {describe_mode(eigenvalue)} cannot be "
                f"moved by {', '.join(spec.actuators)} from {', '.join(spec.signals)}: "
                f"{describe_reach(A, B, C, eigenvalue)}; choose another actuator or signal",
                constraint="controllability",
                asked=name,
                reachable=None,
            )
