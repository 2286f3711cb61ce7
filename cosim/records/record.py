"""A read-only record: named channels with quantity, unit and terminal on one uniform time axis."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from interarea.models.devices.language.device import USUAL_HZ
from interarea.models.errors import UserError, nearest

if TYPE_CHECKING:
    import pandas as pd

    from interarea.models.case.case import Case

Array = npt.NDArray[np.float64]
DEVIATION_HZ = 5.0  #: a frequency whose middle is below is a deviation
#: quantity -> the units in which a record holds it, the physical one first
UNITS = {
    "frequency": ("Hz",),
    "speed": ("pu",),
    "rotor angle": ("rad",),
    "voltage": ("kV", "pu"),
    "voltage angle": ("rad",),
    "current": ("A", "pu"),
    "current angle": ("rad",),
    "active power": ("MW", "pu"),
    "reactive power": ("Mvar", "pu"),
    "status": ("1",),
    "other": ("1",),
}
BAND_HZ = (0.1, 2.5)  #: in which oscillations are looked for, without another
ANGLES = ("rotor angle", "voltage angle", "current angle")
_STILL = 1e-12  # of the largest value of a channel: less than this is the rounding of its numbers


class RecordError(UserError):
    """A record that cannot be read or is not sufficient: the content, and what is required."""


@dataclass(frozen=True)
class Channel:
    """One measured signal. terminal : where, such as ``Sub:2:Ln:2``, ``G1``, ``bus7``; "" if not known."""

    name: str
    quantity: str
    unit: str
    terminal: str


@dataclass(frozen=True, eq=False)
class Record:
    """Measurements on a uniform time axis.

    time_s : (points,), from 0. values : (points, channels), angles unwrapped, no gaps. channels : their
    table. start : time of the first point as the source has it ("" where it has none). notes : what was
    assumed, filled, cut or resampled, a sentence each.
    """

    source: str
    time_s: Array
    values: Array
    channels: tuple[Channel, ...]
    notes: tuple[str, ...] = ()
    start: str = ""

    def __post_init__(self) -> None:
        for array in (self.time_s, self.values):
            array.setflags(write=False)

    @property
    def step_s(self) -> float:
        """Spacing of the points, s."""
        return float((self.time_s[-1] - self.time_s[0]) / (len(self.time_s) - 1))

    @property
    def length_s(self) -> float:
        """From the first point to the last, s."""
        return float(self.time_s[-1] - self.time_s[0])

    def __repr__(self) -> str:
        return (
            f"Record({self.source}: {self.length_s:g} s, {1.0 / self.step_s:g}/s, "
            f"{len(self.channels)} channels, {len(self.terminals)} terminals)"
        )

    @cached_property
    def _place(self) -> dict[str, int]:
        return {c.name: k for k, c in enumerate(self.channels)}

    def __getitem__(self, name: str) -> Array:
        """Return one channel (points,)."""
        if name not in self._place:
            raise RecordError(f"{self.source}: no channel {name!r}; {nearest(name, self._place)}")
        return np.asarray(self.values[:, self._place[name]])

    @cached_property
    def terminals(self) -> dict[str, dict[str, str]]:
        """Terminal -> quantity -> name of its channel; the first where there are several."""
        names: dict[str, dict[str, str]] = {}
        for c in self.channels:
            if c.terminal:
                names.setdefault(c.terminal, {}).setdefault(c.quantity, c.name)
        return names

    def of(self, terminal: str, quantity: str) -> Array | None:
        """Return the measurements of a quantity at a terminal, (points,); None if there are none."""
        if terminal not in self.terminals:
            raise RecordError(f"{self.source}: no terminal {terminal!r}; {nearest(terminal, self.terminals)}")
        name = self.terminals[terminal].get(quantity)
        return None if name is None else self[name]

    def still(self) -> tuple[str, ...]:
        """Return the constant channels."""
        span = np.ptp(self.values, axis=0)
        size = np.max(np.abs(self.values), axis=0)
        return tuple(
            c.name for c, s, most in zip(self.channels, span, size, strict=True) if s <= _STILL * most
        )

    def between(self, start_s: float, end_s: float) -> Record:
        """Return the record from `start_s` to `end_s`, its time from 0 again."""
        inside = (self.time_s >= start_s - 1e-9) & (self.time_s <= end_s + 1e-9)
        if not np.sum(inside) >= 2:
            raise RecordError(
                f"{self.source}: no data from {start_s:g} to {end_s:g} s, allowed: within 0 to "
                f"{self.length_s:g} s"
            )
        time = self.time_s[inside]
        return replace(self, time_s=time - time[0], values=self.values[inside].copy())

    def only(self, names: Iterable[str]) -> Record:
        """Return the record with some of its channels."""
        names = list(names)
        places = [self._place[n] for n in names]
        return replace(
            self, values=self.values[:, places].copy(), channels=tuple(self.channels[k] for k in places)
        )

    def table(self) -> pd.DataFrame:
        """Return the table of the channels: name, quantity, unit, terminal."""
        import pandas as pd

        return pd.DataFrame(
            [vars(c) for c in self.channels], columns=["name", "quantity", "unit", "terminal"]
        )

    def to_frame(self) -> pd.DataFrame:
        """Return a column for each channel, indexed by time_s; `attrs` has unit, quantity and terminal."""
        import pandas as pd

        index = pd.Index(self.time_s, name="time_s")
        frame = pd.DataFrame(self.values, index=index, columns=[c.name for c in self.channels])
        for key in ("unit", "quantity", "terminal"):
            frame.attrs[key] = {c.name: getattr(c, key) for c in self.channels}
        return frame


def rated_hz(case: Case | None) -> float:
    """Return the rated frequency of a case, Hz; without one the usual."""
    return USUAL_HZ if case is None else case.frequency_hz


def deviation_hz(frequency: Array, rated_hz: float, what: str) -> Array:
    """Return a frequency minus the rated one, Hz; values near 0 are taken as deviations already.

    what : the channel, for the message.

    Raises
    ------
    RecordError : an invalid rated frequency, or one that differs from that of the values.
    """
    if not 0.0 < rated_hz < np.inf:
        raise RecordError(f"{what}: a rated frequency of {rated_hz:g} Hz, allowed: above 0")
    middle = float(np.median(frequency))
    if abs(middle) < DEVIATION_HZ:
        return frequency
    if not abs(middle - rated_hz) < DEVIATION_HZ:
        raise RecordError(
            f"{what} is {middle:.4g} Hz, allowed: within {DEVIATION_HZ:g} Hz of the rated {rated_hz:g} Hz, "
            "or a deviation from it"
        )
    return np.asarray(frequency - rated_hz)
