"""What a master steps together, in which order, and what it does with each loop without a channel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from interarea.fmu_build.open.ports import Description

from ..errors import GraphError
from ..stepping_words import Inputs, Loops
from .graph import Graph, LoopSet
from .signals import Signal


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
        self.iterated = {g.members for g in self.groups if g.torn and self._iterates(g)}

    def torn_signals(self, group: LoopSet) -> list[Signal]:
        """Return the signals of a loop that run against its order and are not held."""
        torn = {str(c.source) for c in group.torn}
        return [s for s in self._signals if s.name in torn and s.kind != "held"]

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
