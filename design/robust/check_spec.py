"""What a robust design refuses before it starts: plants and caps for which no answer can come out."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import TYPE_CHECKING

import control
import numpy as np

from ..errors import InfeasibleDesign
from ..linear.linearise import select
from ..modes.modes import Modes
from ..synthesis.check import UNREACHABLE_MODE, describe_mode, describe_reach, modal_shares
from ..synthesis.generalized_plant import check_design_plant

if TYPE_CHECKING:
    from .design import RobustSpec


def check_spec(spec: RobustSpec) -> None:
    """Refuse orders, caps and conditions that contradict themselves.

    Raises
    ------
    ValueError
        Says which, and what is allowed.
    """
    if spec.dc_block and spec.washout_s > 0.0:
        raise ValueError(
            f"robust design: dc_block and washout_s = {spec.washout_s:g} s both make K(0) = 0; "
            "set dc_block = false or washout_s = 0"
        )
    filters = int(spec.washout_s > 0.0)
    wanted = [(who, order, filters) for who, (_, order) in spec.sees.items()]
    for who, order, least in wanted or [("the controller", spec.order, filters * len(spec.actuators))]:
        if not order > least:
            raise ValueError(
                f"robust design: order of {who} is {order}; its washouts take {least} states, at least "
                f"{least + 1} are needed"
            )
    for condition in spec.conditions:
        unknown = {*condition.lost, *condition.latency_s_of} - set(spec.signals)
        if unknown:
            raise ValueError(
                f"condition {condition.name!r} names {sorted(unknown)}; the controller's signals are "
                f"{', '.join(spec.signals)}"
            )
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
    """Refuse plants the design models cannot be made of, and unstable modes that are out of reach.

    Raises
    ------
    ValueError : a matrix that is not finite, D that is not zero, more states of K than of the plant.
    InfeasibleDesign : an unstable mode that no actuator moves or no signal shows.
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
                f"operating point {point!r}; nothing is gained beyond the plant's order, lower it"
            )
        require_moved(point, plant, spec)


def require_moved(
    point: str, plant: control.StateSpace, spec: RobustSpec, modes: Modes | None = None
) -> None:
    """Refuse a target mode, or an unstable one, that no actuator moves or no signal shows.

    modes : of the plant; the inter-area modes among them are targets. None: only unstable modes.

    Raises
    ------
    InfeasibleDesign
        Names the mode, with its controllability and observability.
    """
    picked = select(plant, list(spec.actuators), list(spec.signals))
    A, B, C = (np.asarray(M, dtype=float) for M in (picked.A, picked.B, picked.C))
    values, shares = modal_shares(A, B, C)
    targets = {f"mode {n!r}": m.eigenvalue for n, m in (modes or {}).items() if n.startswith("inter-area")}
    unstable = [complex(v) for v in values if not v.real < 0.0 and v.imag >= 0.0]
    for name, eigenvalue in [*targets.items(), *(("unstable mode", v) for v in unstable)]:
        share = float(shares[int(np.argmin(np.abs(values - eigenvalue)))])
        if not share >= UNREACHABLE_MODE:
            raise InfeasibleDesign(
                f"robust design, operating point {point!r}: {name} {describe_mode(eigenvalue)} cannot be "
                f"moved by {', '.join(spec.actuators)} from {', '.join(spec.signals)}: "
                f"{describe_reach(A, B, C, eigenvalue)}; choose another actuator or signal",
                constraint="controllability",
                asked=name,
                reachable=None,
            )
