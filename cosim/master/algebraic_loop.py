"""Loops without a channel: step, compare what came out with what was supposed, put back, step again."""

from __future__ import annotations

from collections.abc import Mapping

from ..clock import Step
from ..errors import StepError
from ..polynomials import slope_at, value_at
from .broyden import Broyden
from .graph import LoopSet
from .node import Node
from .signals import Signal

_MAX_SWEEPS = 50
_LEAST_SCALE = 1e-4  # of the nominal value: a signal smaller than that is measured against it


def iterate_loop(
    group: LoopSet, nodes: Mapping[str, Node], signals: list[Signal], step: Step, tolerance: float
) -> int:
    """Step the members of a loop until its torn `signals` end as supposed; return how often it was repeated.

    A signal's unknowns are its value and H times its slope at the end of the step. Changes are judged against
    the largest value the signal has had; the slope's weight is 1/8, what it can move the cubic by.

    Raises
    ------
    StepError : no agreement after 50 sweeps.
    """
    h = step.length_s
    members = [nodes[name].participant for name in group.members]
    states = [p.save() for p in members]
    solver = Broyden(2 * len(signals))
    supposed = [v for s in signals for v in (value_at(s.d, h), h * slope_at(s.d, h))]
    error = 0.0
    try:
        for sweep in range(_MAX_SWEEPS):
            if sweep:
                for p, state in zip(members, states, strict=True):
                    p.restore(state)
                for k, s in enumerate(signals):
                    s.know(step.start, step.end, step.edge, supposed[2 * k], supposed[2 * k + 1] / h)
            for name in group.members:
                nodes[name].advance(step)
            residual, error = _residual(signals, supposed, h, step.edge)
            if error <= tolerance:
                return sweep
            supposed = solver.correct(supposed, residual)
    finally:
        for p, state in zip(members, states, strict=True):
            p.release(state)
    raise not_settled(group, error, tolerance, step)


def _residual(
    signals: list[Signal], supposed: list[float], h: float, edge: bool
) -> tuple[list[float], float]:
    """Return what came out less what was supposed, values and slopes in turn, and the relative change."""
    residual: list[float] = []
    error = 0.0
    for k, s in enumerate(signals):
        value = s.v1 - supposed[2 * k]
        slope = h * s.s1 - supposed[2 * k + 1] if s.kind == "hermite" and not edge else 0.0
        residual += [value, slope]
        scale = max(s.peak, abs(s.v1), _LEAST_SCALE * s.nominal)
        error = max(error, abs(value) / scale, abs(slope) / scale / 8.0)
    return residual, error


def not_settled(group: LoopSet, error: float, tolerance: float, step: Step) -> StepError:
    """Return the error of a loop whose last relative change `error` exceeds `tolerance`."""
    return StepError(
        f"the loop does not settle in {_MAX_SWEEPS} sweeps: relative change {error:.3g}, "
        f"{tolerance:g} is allowed",
        instance=" -> ".join(group.members),
        call="iterating the step",
        time_s=step.start_s,
        advice="take a shorter step_s or a larger tolerance",
    )
