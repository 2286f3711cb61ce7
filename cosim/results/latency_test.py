r"""Measure the latency of every connection and compare it with what the delay ledger states.

The system is run once more with the same master, order, step and channels, and a stand-in in place of every
other instance: same ports, same direct dependences, same abilities. Each of its outputs sends an impulse of
its own, a Gaussian with its own height (the tag: it shows a crossed or scaled connection) and centre; each
of its inputs keeps the first two moments of what it is handed over the steps. The latency of a connection is
the distance of the two centres,

.. math:: \int t\,u(t)\,dt \Big/ \int u(t)\,dt - t_0,

which is exact to rounding for an impulse a few steps wide (trapezoid sums of a Gaussian converge faster than
any power). Where an output depends directly on the input, what counts is the input's value when the outputs
are read, so the centre is taken over these values. Channels take part as they are, with what is random, lost
or rounded switched off; their latency is the distance between what they are sent and what they put out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, cast

from interarea.fmu_build.open.ports import Description, Port

from .. import polynomials as ip
from ..clock import Clock, seconds, to_ticks
from ..master.graph import Connection, End
from ..master.master import Master
from ..participant import Participant
from ..scenario.channels import Delays
from .delay_ledger import delay_ledger

TOLERANCE_S = 1e-6
_WIDTHS = 9.0  # an impulse is over after so many widths to each side: exp(-9^2 / 2) = 3e-18
_INTEGER_SCALE = 1e6
_NODES = (
    (-math.sqrt(0.6), 5.0 / 18.0),
    (0.0, 8.0 / 18.0),
    (math.sqrt(0.6), 5.0 / 18.0),
)  # Gauss, exact to t^5


@dataclass(frozen=True)
class Measured:
    """Of one connection: latency stated and measured (s), and the height of the impulse that came, over the
    height it should have."""

    connection: Connection
    stated_s: float
    measured_s: float
    height: float

    @property
    def difference_s(self) -> float:
        return self.measured_s - self.stated_s

    @property
    def agrees(self) -> bool:
        return abs(self.difference_s) <= TOLERANCE_S and abs(self.height - 1.0) <= 1e-5


@dataclass(frozen=True)
class SelfTest:
    """One row for each connection."""

    rows: tuple[Measured, ...]

    @property
    def passed(self) -> bool:
        return all(r.agrees for r in self.rows)

    @property
    def worst_s(self) -> float:
        """Largest difference between measured and stated latency."""
        return max((abs(r.difference_s) for r in self.rows), default=0.0)

    def __getitem__(self, target: str) -> Measured:
        """Return the row of the connection into `instance.input`."""
        for row in self.rows:
            if str(row.connection.target) == target:
                return row
        raise KeyError(f"no connection into {target!r}")

    def __str__(self) -> str:
        width = max([len(str(r.connection)) for r in self.rows], default=10)
        lines = [f"{'self-test (ms)':<{width}}  {'stated':>12} {'measured':>12} {'difference':>12}"]
        for r in self.rows:
            measured = round(1e3 * r.measured_s, 6) + 0.0  # no "-0.000000"
            numbers = f"{1e3 * r.stated_s:12.6f} {measured:12.6f} {1e3 * r.difference_s:12.1e}"
            tag = "" if abs(r.height - 1.0) <= 1e-5 else f"  impulse {r.height:.6g} times as high as sent"
            lines.append(
                f"{r.connection!s:<{width}}  {numbers}  {'' if r.agrees else 'DIFFERS'}{tag}".rstrip()
            )
        verdict = "every connection has the latency stated" if self.passed else "the ledger is wrong"
        return "\n".join([*lines, f"largest difference {self.worst_s:.1e} s: {verdict}"])


def self_test(
    master: Master,
    channels: Mapping[str, Participant],
    *,
    delays: Callable[[Clock], Mapping[str, Delays]],
    points: Callable[[float], Iterable[int]] = lambda stop_s: (),
    interval_s: float = 0.0,
) -> SelfTest:
    """Send a tagged impulse through every connection of `master`, which itself is not touched.

    channels : fresh instances of its channels, with nothing random, lost or rounded; closed again.
    delays : clock -> what is stated of the channels. points : stop time -> see `Master`.
    interval_s : longest reporting interval of the channels.
    """
    width_s = 3.0 * max(master.step_s, interval_s)
    ends = sorted({c.source for c in master.graph.connections if c.source.instance not in channels})
    tags = {e: _Tag(1.0 + k / len(ends), _WIDTHS * width_s + 0.37 * k * master.step_s, width_s)
            for k, e in enumerate(ends)}  # fmt: skip
    latest = max([t.centre_s for t in tags.values()], default=0.0)
    longest = sum(master.plan.latency_s.values()) + 2.0 * len(master.participants) * max(
        master.step_s, interval_s
    )
    step = to_ticks(master.step_s, "step_s")
    steps = -(-to_ticks(round(latest + _WIDTHS * width_s + longest, 6), "length") // step)
    parts: list[_StandIn | _Tap] = []
    for name, p in master.participants.items():
        if name in channels:
            parts.append(_Tap(channels[name]))
        else:
            own = {e.variable: t for e, t in tags.items() if e.instance == name}
            parts.append(_StandIn(name, p.description, own, master.plan.latency_s.get(name, 0.0)))
    plan = replace(
        master.plan,
        start_s=0.0,
        stop_s=seconds(steps * step),
        step_s=master.step_s,
        event_times_s=(),
        points=points(seconds(steps * step)),
        engine="python",
        early="continue",
        at_rest=True,
    )
    rig = Master(plan, cast(list[Participant], parts))
    with rig:
        rig.run()
    ledger = delay_ledger(rig, delays(rig.clock))
    probe_of = {p.name: p for p in parts}
    rows = []
    for r in ledger.rows:
        c = r.connection
        sent = probe_of[c.source.instance].sent(c.source.variable)
        got = probe_of[c.target.instance].got(c, r.direct)
        height = got.area / (c.gain * sent.area) if sent.area else math.nan
        rows.append(Measured(c, r.total_s - r.measuring_s, got.centre - sent.centre, height))
    return SelfTest(tuple(rows))


@dataclass(frozen=True)
class _Tag:
    """A Gaussian impulse."""

    height: float
    centre_s: float
    width_s: float

    def at(self, t: float) -> tuple[float, float]:
        """Return value and slope."""
        z = (t - self.centre_s) / self.width_s
        value = self.height * math.exp(-0.5 * z * z)
        return value, -z / self.width_s * value

    @property
    def area(self) -> float:
        return self.height * self.width_s * math.sqrt(2.0 * math.pi)


@dataclass(frozen=True)
class _Impulse:
    """Area and centre of an impulse."""

    area: float
    centre: float


def _impulse(pieces: Mapping[float, tuple[float, float]]) -> _Impulse:
    """Return the sum of pieces, each (area, first moment)."""
    area = math.fsum(a for a, _ in pieces.values())
    return _Impulse(area, math.fsum(m for _, m in pieces.values()) / area if area else math.nan)


class _Probe:
    """What both probes share: values seen at communication points, as samples and as a staircase."""

    name: str
    description: Description

    def __init__(self) -> None:
        self._points: dict[str, dict[float, float]] = {}

    def see(self, variable: str, t: float, value: float) -> None:
        """Note the value at a communication point (again, when a step is repeated)."""
        self._points.setdefault(variable, {})[t] = value

    def samples(self, variable: str) -> _Impulse:
        """The values at the points, each standing for the time half-way to both neighbours."""
        seen = self._points[variable]
        times = sorted(seen)
        pieces = {}
        for before, t, after in zip(times, times[1:], times[2:], strict=False):
            weight = 0.5 * (after - before)
            pieces[t] = (weight * seen[t], weight * t * seen[t])
        return _impulse(pieces)

    def staircase(self, variable: str) -> _Impulse:
        """The values, each held until the next point."""
        seen = self._points[variable]
        times = sorted(seen)
        pieces = {}
        for t, after in pairwise(times):
            pieces[t] = ((after - t) * seen[t], 0.5 * (after * after - t * t) * seen[t])
        return _impulse(pieces)

    def _held(self, variable: str) -> bool:
        return self.description.output_of[variable].discrete

    def sent(self, variable: str) -> _Impulse:
        """The impulse that left by an output."""
        return self.staircase(variable) if self._held(variable) else self.samples(variable)


class _StandIn(_Probe):
    """Has the ports and abilities of an instance; sends impulses and measures what it is handed."""

    def __init__(self, name: str, like: Description, tags: Mapping[str, _Tag], latency_s: float) -> None:
        super().__init__()
        self.name, self.description, self.tags, self.latency_s = name, like, tags, latency_s

    def bind(self, inputs: tuple[str, ...], slopes: tuple[str, ...]) -> None:
        self.inputs, self.slopes = tuple(inputs), tuple(slopes)
        self.u = [0.0] * max(1, len(inputs))
        self.du = [0.0] * max(1, 3 * len(inputs))
        self.y = [0.0] * max(1, len(self.description.outputs))
        self.dy = [0.0] * max(1, len(slopes))

    def begin(self, start_s: float, stop_s: float) -> None:
        self.time = start_s
        self.sent_at = start_s
        self.poly: dict[str, ip.Polynomial] = {}
        self.over: dict[str, dict[float, tuple[float, float]]] = {n: {} for n in self.inputs}
        self.delayed: dict[str, dict[float, float]] = {n: {} for n in self.inputs}

    def ready(self) -> None: ...

    def send(self, order: int) -> None:
        self.sent_at = self.time
        for i, name in enumerate(self.inputs):
            d = [self.u[i], 0.0, 0.0, 0.0]
            d[1 : 1 + order] = self.du[3 * i : 3 * i + order]
            self.poly[name] = (d[0], d[1], d[2], d[3])

    def advance(self, time_s: float, length_s: float) -> None:
        h = length_s
        for name, d in self.poly.items():
            area = moment = 0.0
            for z, weight in _NODES:
                s = 0.5 * h * (1.0 + z)
                area += weight * h * ip.value_at(d, s)
                moment += weight * h * (time_s + s) * ip.value_at(d, s)
            self.over[name][time_s] = (area, moment)
            late = self.latency_s
            self.delayed[name][time_s + max(h, late)] = ip.value_at(d, max(0.0, h - late))
        self.time = time_s + h

    def receive(self, slopes: bool) -> None:
        value_of = {}
        for j, port in enumerate(self.description.outputs):
            value, slope = self.tags[port.name].at(self.time) if port.name in self.tags else (0.0, 0.0)
            self.y[j] = _as(port, value)
            value_of[port.name] = slope
            if port.name in self.tags:
                self.see(port.name, self.time, self.y[j])
        for m, name in enumerate(self.slopes):
            self.dy[m] = value_of[name]
        for name, d in self.poly.items():
            self.see(f"into {name}", self.time, ip.value_at(d, self.time - self.sent_at))

    def sent(self, variable: str) -> _Impulse:
        tag = self.tags[variable]
        return super().sent(variable) if self._held(variable) else _Impulse(tag.area, tag.centre_s)

    def got(self, connection: Connection, direct: bool) -> _Impulse:
        name = connection.target.variable
        if self.latency_s:
            self._points[f"late {name}"] = self.delayed[name]
            return _shifted(self.samples(f"late {name}"), connection.offset, self.delayed[name])
        if direct:
            return _shifted(self.samples(f"into {name}"), connection.offset, self._points[f"into {name}"])
        pieces = self.over[name]
        if connection.offset:
            starts = sorted(pieces)
            ends = [*starts[1:], self.time]
            pieces = {
                a: (pieces[a][0] - connection.offset * (b - a),
                    pieces[a][1] - connection.offset * 0.5 * (b * b - a * a))
                for a, b in zip(starts, ends, strict=True)
            }  # fmt: skip
        return _impulse(pieces)

    def save(self) -> Any:
        return self.time, self.sent_at, dict(self.poly)

    def restore(self, state: Any) -> None:
        self.time, self.sent_at, poly = state
        self.poly = dict(poly)

    def release(self, state: Any) -> None: ...

    def last_log(self) -> str:
        return ""

    def close(self) -> None: ...


class _Tap(_Probe):
    """A channel as it is; notes what it puts out."""

    def __init__(self, inner: Participant) -> None:
        super().__init__()
        self.inner = inner
        self.name, self.description = inner.name, inner.description
        self._names = [p.name for p in inner.description.outputs]
        self._time = 0.0

    def __getattr__(self, name: str) -> Any:
        return getattr(self.inner, name)

    def begin(self, start_s: float, stop_s: float) -> None:
        self._time = start_s
        self.inner.begin(start_s, stop_s)

    def advance(self, time_s: float, length_s: float) -> None:
        self.inner.advance(time_s, length_s)
        self._time = time_s + length_s

    def receive(self, slopes: bool) -> None:
        self.inner.receive(slopes)
        for j, name in enumerate(self._names):
            self.see(name, self._time, self.inner.y[j])

    def got(self, connection: Connection, direct: bool) -> _Impulse:
        output = partner(connection.target)
        return super().sent(output)


def partner(end: End) -> str:
    """Return the output that carries on what comes into a channel's input: y of u, y[3] of u[3]."""
    return "y" + end.variable.removeprefix("u")


def _as(port: Port, value: float) -> float:
    if port.type == "Integer":
        return float(round(_INTEGER_SCALE * value))
    return float(value > 0.5) if port.type == "Boolean" else value


def _shifted(impulse: _Impulse, offset: float, points: Mapping[float, float]) -> _Impulse:
    """Take a constant offset out of an impulse measured at points."""
    if not offset:
        return impulse
    times = sorted(points)
    base = offset * (times[-1] + times[-2] - times[1] - times[0]) / 2.0
    moment = sum(
        offset * 0.5 * (after - before) * t
        for before, t, after in zip(times, times[1:], times[2:], strict=False)
    )
    area = impulse.area - base
    return _Impulse(area, (impulse.area * impulse.centre - moment) / area)
