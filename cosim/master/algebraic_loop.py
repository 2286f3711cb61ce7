"""Loops without a channel, at the start and in a step, by sweeps that learn (`Broyden`).

At the start outputs go through connections into inputs until all agree. In a step the members are stepped,
what came out is compared with what was supposed, the states are put back, and they are stepped again.

Sweeps solve x = g(x) by Broyden's first method started from the plain sweep. The first correction is the
plain sweep x <- g(x): waveform relaxation. Each later one updates an approximate inverse Jacobian of
r(x) = g(x) - x by one rank, in several dimensions what Aitken's process is in one: contracting loops converge
faster, loops with gain above one converge at all. For an affine g of n unknowns it is exact after at most 2 n
sweeps.

Where an output reaches a limit just at the end of a step, its slope there jumps with what is supposed, and no
slope solves the loop. After `_MAX_SWEEPS` slopes are therefore no unknowns any more: the supposed one is that
of the straight line over the step.
"""

from __future__ import annotations

from collections.abc import Mapping

from ..clock import Step
from ..errors import StepError
from ..polynomials import slope_at, value_at
from .graph import Graph, LoopSet
from .node import Node
from .signals import Signal


def _product(matrix: list[list[float]], vector: list[float]) -> list[float]:
    """Return matrix times vector, every sum in the order of the columns, as the kernel has it."""
    product = [0.0] * len(vector)
    for i, row in enumerate(matrix):
        total = 0.0
        for j, value in enumerate(vector):
            total += row[j] * value
        product[i] = total
    return product


class Broyden:
    """Corrections for n unknowns. Plain loops over doubles, so a kernel can repeat them to the bit."""

    def __init__(self, n: int) -> None:
        self._n = n
        self._inverse = [
            [1.0 if i == j else 0.0 for j in range(n)] for i in range(n)
        ]  # of minus the Jacobian
        self._residual: list[float] | None = None
        self._step: list[float] = []

    def correct(self, x: list[float], residual: list[float]) -> list[float]:
        """Return the next x given r(x) = g(x) - x at the present one."""
        n, inverse = self._n, self._inverse
        if self._residual is not None:
            change = [self._residual[i] - residual[i] for i in range(n)]
            predicted = _product(inverse, change)
            denominator = 0.0
            for i in range(n):
                denominator += self._step[i] * predicted[i]
            if denominator != 0.0:
                row = [0.0] * n
                for j in range(n):
                    total = 0.0
                    for i in range(n):
                        total += self._step[i] * inverse[i][j]
                    row[j] = total
                for i in range(n):
                    factor = (self._step[i] - predicted[i]) / denominator
                    for j in range(n):
                        inverse[i][j] += factor * row[j]
        step = _product(inverse, residual)
        self._residual, self._step = list(residual), step
        return [x[i] + step[i] for i in range(n)]


_MAX_SWEEPS = 50  # with slopes as unknowns, and as many with straight lines
_LEAST_SCALE = 1e-4  # of the nominal value: a signal smaller than that is measured against it


def iterate_loop(
    group: LoopSet, nodes: Mapping[str, Node], signals: list[Signal], step: Step, tolerance: float
) -> int:
    """Step the members of a loop until its tearing `signals` end as supposed; return how many repetitions.

    A signal's unknowns are its value and H times its slope at the end of the step. Changes are judged against
    the largest value the signal has had; the slope's weight is 1/8, what it can move the cubic by.

    Raises
    ------
    StepError : no agreement after 50 sweeps and 50 more with straight lines.
    """
    h = step.length_s
    members = [nodes[name].participant for name in group.members]
    states = [p.save() for p in members]
    solver = Broyden(2 * len(signals))
    supposed = [v for s in signals for v in (value_at(s.d, h), h * slope_at(s.d, h))]
    error = 0.0
    try:
        for sweep in range(2 * _MAX_SWEEPS):
            if sweep:
                for p, state in zip(members, states, strict=True):
                    p.restore(state)
                for k, s in enumerate(signals):
                    s.know(step.start, step.end, step.edge, supposed[2 * k], supposed[2 * k + 1] / h)
            for name in group.members:
                nodes[name].advance(step)
            residual, error = _residual(signals, supposed, h, step.edge or sweep >= _MAX_SWEEPS)
            if error <= tolerance:
                return sweep
            if sweep + 1 == _MAX_SWEEPS:
                solver, residual = Broyden(2 * len(signals)), _residual(signals, supposed, h, True)[0]
            supposed = solver.correct(supposed, residual)
            if sweep + 1 >= _MAX_SWEEPS:
                _straighten(supposed, signals)
    finally:
        for p, state in zip(members, states, strict=True):
            p.release(state)
    raise not_settled(group, error, tolerance, step)


def _straighten(supposed: list[float], signals: list[Signal]) -> None:
    """Give each signal the slope of the straight line to its supposed value, times H."""
    for k, s in enumerate(signals):
        supposed[2 * k + 1] = supposed[2 * k] - s.v0


def _residual(
    signals: list[Signal], supposed: list[float], h: float, straight: bool
) -> tuple[list[float], float]:
    """Return what came out less what was supposed, values and slopes in turn, and the relative change.

    straight : slopes are no unknowns.
    """
    residual: list[float] = []
    error = 0.0
    for k, s in enumerate(signals):
        value = s.v1 - supposed[2 * k]
        slope = h * s.s1 - supposed[2 * k + 1] if s.kind == "hermite" and not straight else 0.0
        residual += [value, slope]
        scale = max(s.peak, abs(s.v1), _LEAST_SCALE * s.nominal)
        error = max(error, abs(value) / scale, abs(slope) / scale / 8.0)
    return residual, error


def not_settled(group: LoopSet, error: float, tolerance: float, step: Step) -> StepError:
    """Return the error of a loop whose last relative change `error` exceeds `tolerance`."""
    return StepError(
        f"the loop does not converge in {2 * _MAX_SWEEPS} sweeps: relative change {error:.3g}, "
        f"{tolerance:g} is allowed",
        instance=" -> ".join(group.members),
        call="iterating the step",
        time_s=step.start_s,
        advice="use a shorter step_s or a larger tolerance",
    )


_EXTRA_SWEEPS = 20


def initialise(graph: Graph, nodes: Mapping[str, Node], tick: int, tolerance: float) -> float:
    """Set the inputs of every participant (all in initialisation) from the outputs they are connected to.

    graph : without cuts, since a channel may pass its input on at the start time.
    Returns the largest remaining |output - value its readers were given|, relative to
    max(nominal, |value|); 0 when there is no loop.

    Raises
    ------
    StepError : a loop that does not reach `tolerance`.
    """
    for node in nodes.values():
        node.take_start(tick, slopes=False)
    worst = 0.0
    for group in graph.groups:
        if not group.tearing:
            _sweep(group.members, nodes, tick)
            continue
        tearing = {str(c.source): c.source for c in group.tearing}
        signals = [_signal(nodes[e.instance], e.variable) for _, e in sorted(tearing.items())]
        worst = max(worst, _solve(group.members, signals, nodes, tick, tolerance))
    return worst


def _signal(node: Node, variable: str) -> Signal:
    return next(s for s in node.signals if s.name == f"{node.participant.name}.{variable}")


def _sweep(members: tuple[str, ...], nodes: Mapping[str, Node], tick: int) -> None:
    for name in members:
        nodes[name].send_start()
        nodes[name].take_start(tick, slopes=False)


def _solve(
    members: tuple[str, ...], signals: list[Signal], nodes: Mapping[str, Node], tick: int, tolerance: float
) -> float:
    solver = Broyden(len(signals))
    x = [s.v1 for s in signals]
    sweeps = 2 * len(signals) + _EXTRA_SWEEPS
    for _ in range(sweeps):
        for s, value in zip(signals, x, strict=True):
            s.v1 = value
        _sweep(members, nodes, tick)
        residual = [s.v1 - value for s, value in zip(signals, x, strict=True)]
        relative = [abs(r) / max(s.nominal, abs(s.v1)) for r, s in zip(residual, signals, strict=True)]
        if max(relative) <= tolerance:
            return max(relative)
        x = solver.correct(x, residual)
    worst = max(range(len(signals)), key=lambda k: relative[k])
    raise StepError(
        f"the loop through {signals[worst].name} keeps a residual of {residual[worst]:.3g} "
        f"({relative[worst]:.3g} relative) after {sweeps} sweeps; {tolerance:g} is allowed",
        instance=" -> ".join(members),
        call="solving the initial values",
        time_s=None,
        advice="check the start values, or break the loop with a channel",
    )
