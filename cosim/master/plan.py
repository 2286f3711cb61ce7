"""A loop as a value: what a master is to step, apart from the participants themselves."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import KW_ONLY, dataclass, field
from typing import Literal, get_args

from ..errors import GraphError
from ..stepping_words import EARLY, INPUTS, LOOPS, Early, Inputs, Loops, early_word
from .step_choice import step_and_reason

Engine = Literal["auto", "kernel", "python"]
ENGINES: tuple[Engine, ...] = get_args(Engine)


@dataclass(frozen=True)
class LoopPlan:
    """Connections, latencies, instants and options of a loop; compared by value.

    Parameters
    ----------
    connections : pairs ("instance.output", "instance.input"), in any order.
    start_s, stop_s : s.
    step_s : communication step H, s; None: chosen from latencies and instants (`chosen_step`).
    event_times_s : instants that must be communication points (events, outages), s.
    points : further communication points, ticks: instants at which a held signal changes (`Clock`);
        left out when all inputs are held, as plain masters do.
    latency_s : instance -> least time its inputs need to reach its outputs (a promise of that instance), s.
    inputs : how inputs are handed over a step. loops : what to do with loops without a channel;
        ``auto`` iterates where all their FMUs can save their state.
    tolerance : of loops, relative to the largest value a signal has had.
    substeps : parts of a step for FMUs that take no input derivatives.
    engine : who steps in `Master.run`: ``kernel`` compiled code, for FMUs in this process; ``python`` the
        reference; ``auto`` the kernel where it can, else Python. `Master.ran` says which it was, and why.
    early : what follows when an FMU returns early from a step, see `early_return`; ``roll back`` needs every
        FMU to save its state, and Python to step.
    at_rest : all start where nothing moves (`clock_of`).

    Raises
    ------
    GraphError : an option that does not exist, or two that exclude each other.

    Examples
    --------
    >>> LoopPlan([("b.y", "a.u"), ("a.y", "b.u")], stop_s=1.0).connections
    (('a.y', 'b.u'), ('b.y', 'a.u'))
    """

    connections: Iterable[tuple[str, str]]
    _: KW_ONLY
    stop_s: float
    step_s: float | None = None
    start_s: float = 0.0
    event_times_s: Iterable[float] = ()
    points: Iterable[int] = ()
    latency_s: Mapping[str, float] = field(default_factory=dict)
    inputs: Inputs = "hermite"
    loops: Loops = "auto"
    tolerance: float = 1e-7
    substeps: int = 4
    engine: Engine = "auto"
    early: Early = "continue"
    at_rest: bool = False

    def __post_init__(self) -> None:
        fixed = {
            "connections": tuple(sorted(self.connections)),
            "event_times_s": tuple(self.event_times_s),
            "points": tuple(self.points),
            "latency_s": dict(self.latency_s),
            "early": early_word(self.early),
        }
        for name, value in fixed.items():
            object.__setattr__(self, name, value)
        words = {"inputs": INPUTS, "loops": LOOPS, "engine": ENGINES, "early": EARLY}
        for key, allowed in words.items():
            if getattr(self, key) not in allowed:
                raise GraphError(f"{key} = {getattr(self, key)!r}: allowed are {', '.join(allowed)}")
        if self.early == "roll back" and self.engine == "kernel":
            raise GraphError('engine = "kernel" cannot roll back early returns; use engine = "auto"')

    @property
    def chosen_step(self) -> tuple[float, str]:
        """The communication step H, s, and why it is that: given, or by `step_and_reason`."""
        if self.step_s is not None:
            return self.step_s, "given"
        return step_and_reason(self.latency_s.values(), [self.stop_s, *self.event_times_s])
