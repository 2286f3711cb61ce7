"""Where an oscillation comes from, by the dissipating energy flow at each terminal (Maslennikov, Wang and
Litvinov 2017).

    W(t) = integral of (dP d(theta) + dQ d(ln V))

of the signals in a narrow band around one frequency. P and Q are positive out of the bus, into line or
machine. Where W rises, energy leaves the bus; where it falls, energy enters, and the source is beyond that
terminal. This is proved for networks without losses, loads of constant power and classical machines alone;
resistance of lines, loads and some exciters move energy too (Chevalier, Vorobev and Turitsyn 2019). The
answer is therefore a hint; its checks: the ends of a line agree, one terminal dominates, both halves agree.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import median_filter

from .line_ends import LineEnds, line_ends, pairs_of
from .record import BAND_HZ, Array, Record, RecordError
from .terminals import Narrow, Terminal, terminals_of

_LEAST_PERIODS = 10.0
_CLEAR = 2.0  # of the largest inflow over the next: less is no single source
_STANDS_OUT = 5.0  # of the line over the median of the spectrum around it
_FLOOR_HZ = 0.8


@dataclass(frozen=True)
class Flow:
    """Energy flow at a terminal. slope : of W, its power; below 0: energy enters there. halves : of the
    record's two halves. rms : of P in the band. machine : whether the terminal is one of a machine."""

    terminal: str
    slope: float
    halves: tuple[float, float]
    rms: float
    machine: bool


@dataclass(frozen=True)
class Source:
    """Result of the energy flow. flows : the largest first. source : terminal through which most energy
    enters; "" if none can be named. why : in words. lines : agreement of their two ends."""

    source_file: str
    frequency_hz: float
    length_s: float
    unit: str
    flows: tuple[Flow, ...]
    source: str
    why: str
    lines: tuple[LineEnds, ...]
    notes: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return plain types, for JSON."""
        plain = {k: v for k, v in vars(self).items() if k not in ("flows", "lines", "notes")}
        plain["flows"] = [{**vars(f), "halves": list(f.halves)} for f in self.flows]
        return {**plain, "lines": [line.as_dict() for line in self.lines], "notes": list(self.notes)}


def located(
    record: Record,
    *,
    band_hz: tuple[float, float] = BAND_HZ,
    frequency_hz: float | None = None,
    at: Mapping[str, str] | None = None,
    rated_hz: float | None = None,
) -> Source:
    """Return the source of the largest oscillation in a band.

    frequency_hz : of the oscillation; that of the largest peak in the powers. at, rated_hz : as in
    `terminals_of`.

    Raises
    ------
    RecordError : no terminal with power, voltage and angle, no oscillation, or too few periods of it.
    """
    terminals, notes = terminals_of(record, at, rated_hz)
    f = (
        frequency_hz
        if frequency_hz is not None
        else strongest_line(record, [t.P for t in terminals], band_hz)
    )
    if not 0.0 < f < 0.4 / record.step_s:
        raise RecordError(f"{record.source}: {f:g} Hz, allowed: above 0 and below {0.4 / record.step_s:g}")
    if not record.length_s * f >= _LEAST_PERIODS:
        raise RecordError(
            f"{record.source}: {record.length_s:.4g} s are {record.length_s * f:.3g} periods of {f:.3g} Hz, "
            f"wanted: {_LEAST_PERIODS:g} at least, {_LEAST_PERIODS / f:.3g} s"
        )
    narrow = Narrow(f, record.step_s)
    flows = _flows(terminals, narrow)
    source, why = _verdict(flows)
    lines = tuple(line_ends(a, b, narrow) for a, b in pairs_of(terminals))
    apart = [line for line in lines if not line.agree and source in line.ends]
    if apart:
        source, why = "", f"{apart[0].text}; {why}"
    without_q = [t.name for t in terminals if t.Q is None]
    if without_q:
        notes.append(f"{', '.join(without_q[:4])}: no reactive power, its term is omitted")
    order = sorted(flows, key=lambda flow: -abs(flow.slope))
    unit = f"{terminals[0].unit} rad/s"
    return Source(record.source, f, record.length_s, unit, tuple(order), source, why, lines, tuple(notes))


def strongest_line(record: Record, signals: Sequence[Array], band_hz: tuple[float, float]) -> float:
    """Return the frequency (Hz) with the largest peak in signals of a record, of a Hann window.

    Raises RecordError if no peak is clear or the record is too short for the band.
    """
    P = np.column_stack([x - np.linspace(x[0], x[-1], len(x)) for x in signals])
    window = np.hanning(len(P))[:, None]
    size = np.sqrt(
        np.sum(np.abs(np.fft.rfft((P - P.mean(axis=0)) * window, 4 * len(P), axis=0)) ** 2, axis=1)
    )
    f = np.fft.rfftfreq(4 * len(P), record.step_s)
    inside = (f >= max(band_hz[0], _LEAST_PERIODS / record.length_s)) & (f <= band_hz[1])
    if not inside.any():
        raise RecordError(
            f"{record.source}: {record.length_s:.4g} s have fewer than {_LEAST_PERIODS:g} periods of "
            f"{band_hz[1]:g} Hz, allowed: a longer record, or a higher band"
        )
    floor = median_filter(size, round(_FLOOR_HZ / f[1]), mode="nearest")  # ambient power is red
    over = size / np.maximum(floor, 1e-15 * size.max() + np.finfo(float).tiny)  # powers may be constant
    f, size, over = f[inside], size[inside], over[inside]
    if not over.max() >= _STANDS_OUT:
        band = f"{band_hz[0]:g} to {band_hz[1]:g} Hz"
        raise RecordError(
            f"{record.source}: no oscillation exceeds the background at {band}: largest ratio "
            f"{over.max():.2g}, "
            f"wanted: {_STANDS_OUT:g}, or --frequency"
        )
    size = np.where(over >= _STANDS_OUT, size, 0.0)
    return float(f[np.argmax(size)])


def _flows(terminals: Sequence[Terminal], narrow: Narrow) -> list[Flow]:
    """Return the slopes of W at terminals, of the record and of its halves."""
    measured = (
        [t.P for t in terminals],
        [np.zeros_like(t.P) if t.Q is None else t.Q for t in terminals],
        [t.log_v for t in terminals],
        [t.angle for t in terminals],
    )
    P, *others = (narrow.of(np.column_stack(x)) for x in measured)
    power = narrow.power(P, *others)
    middle = len(power) // 2
    slopes = [narrow.slopes(part).tolist() for part in (power, power[:middle], power[middle:])]
    rms = P.std(axis=0).tolist()
    return [
        Flow(t.name, whole, (first, second), size, t.machine)
        for t, whole, first, second, size in zip(terminals, *slopes, rms, strict=True)
    ]


def _verdict(flows: Sequence[Flow]) -> tuple[str, str]:
    """Return the terminal through which the energy comes in, or "", and why.

    Where machines were measured they alone are judged: what comes in from a line may have come from any.
    """
    flows = [flow for flow in flows if flow.machine] or flows
    into = sorted((flow for flow in flows if flow.slope < 0.0), key=lambda flow: flow.slope)
    if not into:
        return "", "no terminal supplies energy: the source is not at an observed terminal"
    first = into[0]
    if (other := _otherwise(flows, first)) is not None:
        return (
            "",
            f"the whole record indicates {first.terminal}, one of its halves {other}: no steady source",
        )
    if len(into) > 1 and not first.slope <= _CLEAR * into[1].slope:
        both = f"{first.terminal} ({first.slope:.3g}) and {into[1].terminal} ({into[1].slope:.3g})"
        return "", f"{both} are too similar: two sources, or one that is not observed"
    rest = f"{first.slope / into[1].slope:.3g} times the next" if len(into) > 1 else "the only one"
    return first.terminal, f"most energy is supplied through {first.terminal}, {rest}"


def _otherwise(flows: Sequence[Flow], first: Flow) -> str | None:
    """Return what else comes first in a half of the record; None where it is `first` in both."""
    other = next((f for k in (0, 1) for f in flows if f.halves[k] < first.halves[k]), None)
    if other is not None:
        return other.terminal
    return None if max(first.halves) < 0.0 else "no terminal"
