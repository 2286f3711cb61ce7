"""A record in place of a signal: the values of a user are sent while the flag says valid."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from interarea.fmu_build.open.ports import Description, Port
from interarea.models.arguments import checked_types
from interarea.models.devices.language.device import USUAL_HZ

from .record import Record, RecordError, deviation_hz

_SAME_S = 1e-9  # s: instants closer than this are one


class Playback:
    """A participant of a `System`: output ``y`` is the record from `start_s` to its end, else input ``u``.

    channel : name in the record. A frequency (Hz), or its deviation, becomes its deviation in pu of
    `nominal_hz`; others are sent as they are. Between points of the record its value is held.

    Raises
    ------
    RecordError : no such channel, a value that is no number, a start before 0, another rated frequency.

    Examples
    --------
    >>> import numpy as np
    >>> from interarea.cosim.records.record import Channel, Record
    >>> f = Channel("f", "frequency", "Hz", "")
    >>> made = Record("own", np.array([0.0, 0.5]), np.array([[50.1], [49.9]]), (f,))
    >>> wrong = Playback("wrong", made, "f", start_s=2.0, nominal_hz=50.0)
    >>> [round(wrong.sent(t, 0.001), 6) for t in (1.0, 2.0, 2.4, 2.5, 3.0)]
    [0.001, 0.002, 0.002, -0.002, 0.001]
    """

    @checked_types
    def __init__(
        self, name: str, record: Record, channel: str, *, start_s: float, nominal_hz: float = USUAL_HZ
    ) -> None:
        if not isinstance(record, Record):
            raise RecordError(f"{name}: record is {type(record).__name__}, wanted: that of read_record(...)")
        names = [c.name for c in record.channels]
        if channel not in names:
            raise RecordError(f"{record.source}: no channel {channel!r}, allowed: {', '.join(names)}")
        if not start_s >= 0.0:
            raise RecordError(f"{name}: start_s = {start_s:g}, allowed: 0 or later")
        k = names.index(channel)
        values = np.array(record.values[:, k])
        if not np.all(np.isfinite(values)):
            raise RecordError(f"{record.source}: {channel} has values that are not numbers, allowed: none")
        if record.channels[k].quantity == "frequency":
            values = deviation_hz(values, nominal_hz, f"{record.source}: {channel}") / nominal_hz
        self.name, self.start_s = name, start_s
        self._time_s, self._values = record.time_s - record.time_s[0], values
        self._end_s = record.length_s + record.step_s
        direct = {"y": frozenset({"u"})}
        self.description = Description((Port("u"),), (Port("y"),), direct, direct, saves_state=True)

    def sent(self, time_s: float, u: float) -> float:
        """Return what is sent at a time at which the true value is u."""
        into = time_s - self.start_s
        if not -_SAME_S <= into < self._end_s - _SAME_S:
            return u
        k = int(np.searchsorted(self._time_s, into + _SAME_S, side="right")) - 1
        return float(self._values[max(k, 0)])

    def bind(self, inputs: Sequence[str], slopes: Sequence[str]) -> None:
        """Make the buffers."""
        self.u, self.du = [0.0] * len(inputs), [0.0] * (3 * len(inputs))
        self.y, self.dy = [0.0], [0.0] * len(slopes)

    def begin(self, start_s: float, stop_s: float) -> None:
        """Start."""
        self._now_s, self._u = start_s, 0.0

    def ready(self) -> None:
        """Nothing is left to do."""

    def send(self, order: int) -> None:
        """Take the input."""
        if self.u:
            self._u = float(self.u[0])

    def advance(self, time_s: float, length_s: float) -> None:
        """Go on."""
        self._now_s = time_s + length_s

    def receive(self, slopes: bool) -> None:
        """Give the output."""
        self.y[0] = self.sent(self._now_s, self._u)

    def save(self) -> Any:
        """Return time and input."""
        return self._now_s, self._u

    def restore(self, state: Any) -> None:
        """Go back."""
        self._now_s, self._u = state

    def release(self, state: Any) -> None:
        """Nothing to free."""

    def last_log(self) -> str:
        """Nothing is logged."""
        return ""

    def close(self) -> None:
        """Nothing to end."""
