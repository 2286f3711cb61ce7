"""From a graph to what the master steps: a signal for each connected output, a node for each participant.

And which of them are stepped together, in which order, and what is done with each loop without a channel.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from interarea.fmu_build.open.ports import Description

from ..errors import GraphError
from ..participant import Participant
from ..stepping_words import Inputs, Loops
from .graph import Graph, LoopSet
from .node import Feed, Node
from .signals import Kind, Signal


def make_signals(participants: Mapping[str, Participant], graph: Graph, inputs: Inputs) -> list[Signal]:
    """Return the signals in the order of their names, and bind each participant's inputs and slopes."""
    signals = []
    for end in sorted({c.source for c in graph.connections}):
        p = participants[end.instance]
        index = next(k for k, o in enumerate(p.description.outputs) if o.name == end.variable)
        port = p.description.outputs[index]
        kind = _kind(p, port.discrete, inputs)
        signals.append(Signal(str(end), end.instance, index, -1, kind, port.nominal))
    for name, p in participants.items():
        sloped = [s for s in signals if s.owner == name and s.kind == "hermite"]
        for k, s in enumerate(sloped):
            s.slope_index = k
        p.bind(
            [c.target.variable for c in graph.into(name)],
            [p.description.outputs[s.index].name for s in sloped],
        )
    return signals


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
        all_held = all(f.signal.kind == "held" for f in feeds)
        parts = 1 if holds or order or all_held or not d.variable_step else substeps
        owned = [s for s in signals if s.owner == name]
        nodes[name] = Node(p, feeds, owned, order=order, substeps=parts)
    return nodes


class Stepping:
    """`groups` in stepping order; `iterated`: the members of those whose step is repeated until it agrees.

    Raises
    ------
    GraphError : loops = "iterate", and an FMU in a loop cannot save its state.
    """

    def __init__(
        self,
        descriptions: Mapping[str, Description],
        graph: Graph,
        signals: Sequence[Signal],
        inputs: Inputs,
        loops: Loops,
        tolerance: float,
    ) -> None:
        self._descriptions, self._signals = descriptions, signals
        self._holds, self._loops, self._tolerance = inputs.startswith("hold"), loops, tolerance
        waits = inputs != "hold-jacobi"  # where nobody waits for anybody everyone is a group
        self.groups = list(graph.groups) if waits else [LoopSet((name,)) for name in descriptions]
        self.iterated = {g.members for g in self.groups if g.tearing and self._iterates(g)}

    def tearing_signals(self, group: LoopSet) -> list[Signal]:
        """Return the signals of a loop that run against its order and are not held."""
        tearing = {str(c.source) for c in group.tearing}
        return [s for s in self._signals if s.name in tearing and s.kind != "held"]

    def how(self, group: LoopSet) -> str:
        """Return in words what is done with a loop."""
        if self._holds:
            return "inputs held, not iterated"
        if self._iterates(group):
            return f"iterated with saved states to {self._tolerance:g} of the largest value"
        names = ", ".join(self._cannot_rewind(group))
        return f"extrapolated: {names} cannot save its state" if names else "extrapolated"

    # -- private --------------------------------------------------------------------------

    def _iterates(self, group: LoopSet) -> bool:
        """Whether a loop is iterated: not with held inputs, not when told to extrapolate."""
        if self._holds or self._loops == "extrapolate":
            return False
        cannot_rewind = self._cannot_rewind(group)
        if self._loops == "iterate" and cannot_rewind:
            raise GraphError(
                f"loop {' -> '.join(group.members)}: {', '.join(cannot_rewind)} cannot save its state "
                '(canGetAndSetFMUstate), so the step cannot be iterated; use loops = "extrapolate"'
            )
        return not cannot_rewind

    def _cannot_rewind(self, group: LoopSet) -> list[str]:
        """Members that cannot go back to a saved state."""
        return [n for n in group.members if not self._descriptions[n].saves_state]
