"""A connected output over the present step: what is known of it, and what its readers are given.

Before its owner has been stepped a signal is *predicted*: value and slope at
the start, bending on as it did before. After, it is *known* at both ends.
How it is drawn between the ends is its kind:

* ``hermite``  cubic from values and slopes at both ends;
* ``points``   cubic through the last four values, for an owner that offers no slopes;
* ``linear``   straight line between the values;
* ``held``     the value at the start of the step, all along it;
* ``newest``   the newest value there is, all along the step (Gauss-Seidel).

On a step of one tick beside an event a signal may jump. Where it does, its readers are given
the value after the jump all along, with the slope that the owner reports, none if it reports
none: a line across the jump would have a slope of 1e9 times the jump, which a reader with direct
feedthrough passes on as the slope of its own output. Where it does not jump it is a straight
line between its two values. Nothing before is used after.
"""

from __future__ import annotations

from typing import Literal

from .. import polynomials as ip
from ..clock import seconds

Kind = Literal["hermite", "points", "linear", "held", "newest"]

#: A change within one tick (1 ns) beyond this share of the largest value so far is a jump: as a motion it
#: would have a time constant below 1e-9 s / 1e-6 = 1 ms, faster than any communication step.
JUMP = 1e-6


class Signal:
    """One output `index` of participant `owner`; `slope_index` is its place among the bound slopes."""

    __slots__ = (
        "d", "h_last", "index", "kind", "name", "nominal", "owner", "peak", "s0", "s1", "slope_index",
        "ticks", "v0", "v1", "values",
    )  # fmt: skip

    def __init__(
        self, name: str, owner: str, index: int, slope_index: int, kind: Kind, nominal: float
    ) -> None:
        self.name, self.owner, self.index, self.slope_index = name, owner, index, slope_index
        self.kind: Kind = kind
        self.nominal = nominal
        self.start(0, 0.0, 0.0)

    def start(self, tick: int, value: float, slope: float) -> None:
        """Forget the past; value and slope now."""
        self.v0 = self.v1 = value
        self.s0 = self.s1 = slope
        self.d: ip.Polynomial = (value, slope, 0.0, 0.0)
        self.h_last = 0.0  # length of the step that `d` describes; 0: no past to continue
        self.peak = abs(value)
        self.ticks = [tick]
        self.values = [value]

    def begin(self, tick: int, edge: bool) -> None:
        """Start a step at `tick`: the end of the last one is its start; predict."""
        self.v0, self.s0 = self.v1, self.s1
        v = self.v0
        if self.kind == "hermite":
            if edge or self.h_last == 0.0:
                self.d = (v, self.s0, 0.0, 0.0)
            else:
                self.d = ip.continued(self.d, self.h_last, v, self.s0)
        elif self.kind == "points":
            d = ip.through([seconds(k - tick) for k in self.ticks], self.values, len(self.ticks) - 1)
            self.d = (v, d[1], 0.0, 0.0) if edge else d
        elif self.kind == "linear":
            self.d = (v, self.d[1] if self.h_last != 0.0 else 0.0, 0.0, 0.0)
        else:
            self.d = (v, 0.0, 0.0, 0.0)

    def know(self, tick: int, end: int, edge: bool, value: float, slope: float) -> None:
        """Take value and slope at the end of the step [tick, end], computed or supposed."""
        self.v1, self.s1 = value, slope
        if self.kind == "held":
            return
        if self.kind == "newest":
            self.d = (value, 0.0, 0.0, 0.0)
            return
        h = seconds(end - tick)
        if edge and abs(value - self.v0) > JUMP * max(self.peak, abs(value)):
            self.d = ip.after_jump(value, slope if self.kind == "hermite" else 0.0, h)
        elif edge or self.kind == "linear":
            self.d = ip.line(self.v0, value, h)
        elif self.kind == "hermite":
            self.d = ip.hermite(self.v0, self.s0, value, slope, h)
        else:
            times = [seconds(k - tick) for k in self.ticks[-3:]] + [h]
            self.d = ip.through(times, [*self.values[-3:], value], len(times) - 2)

    def accept(self, tick: int, end: int, edge: bool) -> None:
        """End the step: remember it for the next."""
        self.peak = max(self.peak, abs(self.v1))
        self.h_last = 0.0 if edge else seconds(end - tick)
        if self.kind == "points":
            if edge:
                self.ticks, self.values = [end], [self.v1]
            else:
                self.ticks = [*self.ticks[-3:], end]
                self.values = [*self.values[-3:], self.v1]

    def copy(self) -> tuple[object, ...]:
        """Return all that changes during a run."""
        return (self.v0, self.s0, self.v1, self.s1, self.d, self.h_last, self.peak, self.ticks, self.values)

    def paste(self, copied: tuple[object, ...]) -> None:
        """Go back to what `copy` returned."""
        self.v0, self.s0, self.v1, self.s1, self.d, self.h_last, self.peak, self.ticks, self.values = copied  # type: ignore[assignment]
