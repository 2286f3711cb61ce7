"""Bring all participants to one consistent start: outputs through connections into inputs, loops solved."""

from __future__ import annotations

from collections.abc import Mapping

from ..errors import StepError
from .broyden import Broyden
from .graph import Graph
from .node import Node
from .signals import Signal

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
        if not group.torn:
            _sweep(group.members, nodes, tick)
            continue
        torn = {str(c.source): c.source for c in group.torn}
        signals = [_signal(nodes[e.instance], e.variable) for _, e in sorted(torn.items())]
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
