"""From a graph to what the master steps: a signal for each connected output, a node for each participant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..participant import Participant
from ..stepping_words import Inputs
from .graph import Graph
from .node import Feed, Node
from .signals import Kind, Signal


def make_signals(participants: Mapping[str, Participant], graph: Graph, inputs: Inputs) -> list[Signal]:
    """Return the signals in the order of their names, and bind each participant's inputs and slopes."""
    found = []
    for end in sorted({c.source for c in graph.connections}):
        p = participants[end.instance]
        index = next(k for k, o in enumerate(p.description.outputs) if o.name == end.variable)
        port = p.description.outputs[index]
        kind = _kind(p, port.discrete, inputs)
        found.append(Signal(str(end), end.instance, index, -1, kind, port.nominal))
    for name, p in participants.items():
        sloped = [s for s in found if s.owner == name and s.kind == "hermite"]
        for k, s in enumerate(sloped):
            s.slope_index = k
        p.bind(
            [c.target.variable for c in graph.into(name)],
            [p.description.outputs[s.index].name for s in sloped],
        )
    return found


def _kind(p: Participant, discrete: bool, inputs: Inputs) -> Kind:
    if discrete or inputs == "hold-jacobi":
        return "held"
    if inputs == "hold-gauss-seidel":
        return "newest"
    if inputs == "linear":
        return "linear"
    return "hermite" if p.description.output_order >= 1 else "points"


def make_nodes(
    participants: Mapping[str, Participant],
    graph: Graph,
    signals: Sequence[Signal],
    inputs: Inputs,
    substeps: int,
) -> dict[str, Node]:
    """Return each participant with its feeds; `substeps` are for those that take no input derivatives."""
    by_name = {s.name: s for s in signals}
    holds = inputs.startswith("hold")
    nodes = {}
    for name, p in participants.items():
        d = p.description
        into = graph.into(name)
        feeds = [Feed(k, by_name[str(c.source)], c.gain, c.offset) for k, c in enumerate(into)]
        order = 0 if holds else min(3, d.input_order)
        held = all(f.signal.kind == "held" for f in feeds)
        parts = 1 if holds or order or held or not d.variable_step else substeps
        mine = [s for s in signals if s.owner == name]
        nodes[name] = Node(p, feeds, mine, order=order, substeps=parts)
    return nodes
