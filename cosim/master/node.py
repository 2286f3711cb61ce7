"""A participant with its place in the graph: fills its inputs over a step, steps it, takes its outputs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from .. import polynomials as ip
from ..clock import Step, seconds
from ..errors import StepError
from ..participant import Participant
from .signals import Signal


@dataclass(frozen=True)
class Feed:
    """Input number `place` of a participant is gain * signal + offset."""

    place: int
    signal: Signal
    gain: float
    offset: float

    @cached_property
    def same_unit(self) -> bool:
        return self.gain == 1.0 and self.offset == 0.0


class Node:
    """Steps one participant.

    order : highest input derivative it is sent (0: held inputs).
    substeps : parts a step is cut into when inputs can only be held; in each, the mean over the part is held.
    """

    def __init__(
        self,
        participant: Participant,
        feeds: Sequence[Feed],
        signals: Sequence[Signal],
        *,
        order: int,
        substeps: int,
    ) -> None:
        self.participant = participant
        self.feeds = tuple(feeds)
        self.signals = tuple(signals)
        self.order = order
        self.substeps = substeps
        self.has_slopes = any(s.slope_index >= 0 for s in signals)
        self._sent = [s.index for s in signals]

    def advance(self, step: Step) -> None:
        """Step the participant and tell its signals their ends."""
        p, t = self.participant, step.start_s
        if self.substeps > 1 and self.feeds and not step.edge:
            self._advance_in_parts(step)
        else:
            self._fill(self.order, 0.0)
            p.send(self.order)
            p.advance(t, step.length_s)
        p.receive(self.has_slopes)
        self.check(step.end)
        y, dy = p.y, p.dy
        for s in self.signals:
            slope = dy[s.slope_index] if s.slope_index >= 0 else 0.0
            s.know(step.start, step.end, step.edge, y[s.index], slope)

    def send_start(self) -> None:
        """Hand over the values at the start time."""
        for f in self.feeds:
            self.participant.u[f.place] = f.gain * f.signal.v1 + f.offset
        if self.feeds:
            self.participant.send(0)

    def take_start(self, tick: int, *, slopes: bool) -> None:
        """Read outputs at the start of the run, and slopes (which FMI allows after initialisation only)."""
        p = self.participant
        p.receive(slopes and self.has_slopes)
        self.check(tick)
        for s in self.signals:
            s.start(tick, p.y[s.index], p.dy[s.slope_index] if slopes and s.slope_index >= 0 else 0.0)

    def _fill(self, order: int, at: float) -> None:
        u, du = self.participant.u, self.participant.du
        for f in self.feeds:
            d, place, gain = f.signal.d, f.place, f.gain
            if at != 0.0:
                u[place] = gain * ip.value_at(d, at) + f.offset
            else:
                u[place] = d[0] if f.same_unit else gain * d[0] + f.offset
            if order:
                k = 3 * place
                du[k : k + 3] = gain * d[1], gain * d[2], gain * d[3]

    def _advance_in_parts(self, step: Step) -> None:
        p, n = self.participant, self.substeps
        length = step.end - step.start
        ends = [step.start + (length * (k + 1)) // n for k in range(n)]
        now = step.start
        for end in ends:
            if end == now:
                continue
            a, b = seconds(now - step.start), seconds(end - step.start)
            for f in self.feeds:
                p.u[f.place] = f.gain * ip.mean_between(f.signal.d, a, b) + f.offset
            p.send(0)
            p.advance(seconds(now), seconds(end - now))
            now = end
        self._fill(0, step.length_s)
        p.send(0)

    def check(self, tick: int) -> None:
        """Raise StepError when an output that something is connected to is not finite."""
        p = self.participant
        y = p.y
        bad = next((i for i in self._sent if not math.isfinite(y[i])), None)
        if bad is None:
            return
        raise StepError(
            f"output {p.description.outputs[bad].name} is {y[bad]}",
            instance=p.name,
            call="reading outputs",
            time_s=seconds(tick),
            last_log=p.last_log(),
        )
