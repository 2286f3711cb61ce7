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

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.ndimage import median_filter
from scipy.signal import butter, sosfiltfilt

from interarea.models.devices.language.device import USUAL_HZ

from .record import BAND_HZ, Array, Record, RecordError

_SIDE_HZ, _SIDE = 0.15, 0.25  # of the band-pass, at most this share of the frequency
_EDGE_PERIODS = 2.0  # left out at both ends, where the filter sets in
_LEAST_PERIODS = 10.0
_CLEAR = 2.0  # of the largest inflow over the next: less is no single source
_AGREE = 0.2  # of the difference of the ends of a line over their mean
_STANDS_OUT = 5.0  # of the line over the median of the spectrum around it
_FLOOR_HZ = 0.8
_ROTATING = {"speed", "rotor angle"}  # what only a machine has
_PHASES = 3.0  # of a line whose voltage is from phase to ground


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
    lines: tuple[tuple[str, str, float], ...]
    notes: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return plain types, for JSON."""
        plain = {k: v for k, v in vars(self).items() if k not in ("flows", "lines", "notes")}
        plain["flows"] = [{**vars(f), "halves": list(f.halves)} for f in self.flows]
        return {**plain, "lines": [list(line) for line in self.lines], "notes": list(self.notes)}


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
    flows = _flows(record, terminals, f)
    source, why = _verdict(flows)
    lines = tuple(_line_ends(flows))
    apart = [line for line in lines if not line[2] <= _AGREE]
    if apart and source in {name for line in apart for name in line[:2]}:
        source, why = "", f"the ends of {apart[0][0]} and {apart[0][1]} disagree by {apart[0][2]:.0%}; {why}"
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


def _flows(record: Record, terminals: Sequence[Terminal], f: float) -> list[Flow]:
    """Return slope of W at each terminal, of the record and of its halves."""
    side = min(_SIDE_HZ, _SIDE * f)
    sos = butter(
        2, [2.0 * record.step_s * (f - side), 2.0 * record.step_s * (f + side)], "band", output="sos"
    )

    def swinging(values: Array) -> Array:
        line = np.linspace(values[0], values[-1], len(values))
        return np.asarray(sosfiltfilt(sos, values - line))

    edge = min(round(_EDGE_PERIODS / f / record.step_s), len(record.time_s) // 8)
    flows = []
    for t in terminals:
        P, theta = swinging(t.P), swinging(t.angle)
        power = P * np.gradient(theta, record.step_s)
        if t.Q is not None:
            power = power + swinging(t.Q) * np.gradient(swinging(t.log_v), record.step_s)
        power = power[edge : len(power) - edge]
        middle = len(power) // 2
        W = np.cumsum(power) * record.step_s
        slopes = [_slope(w, record.step_s) for w in (W, W[:middle], W[middle:])]
        flows.append(Flow(t.name, slopes[0], (slopes[1], slopes[2]), float(P.std()), t.machine))
    return flows


def _slope(W: Array, step_s: float) -> float:
    """Return the slope of the line through W."""
    return float(np.polyfit(np.arange(len(W)) * step_s, W, 1)[0])


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


def _line_ends(flows: Sequence[Flow]) -> list[tuple[str, str, float]]:
    """Return the pairs of terminals that are the two ends of one line, and how much their flows differ.

    In the IEEE form both have one device name, such as ``Ln:4-6``, at two substations.
    """
    pairs = []
    for a, b in combinations(flows, 2):
        ends = [":".join(flow.terminal.split(":")[2:]) for flow in (a, b)]
        if ends[0] and ends[0] == ends[1] and "-" in ends[0]:
            mean = 0.5 * (abs(a.slope) + abs(b.slope))
            pairs.append((a.terminal, b.terminal, abs(a.slope + b.slope) / mean if mean > 0.0 else 0.0))
    return pairs


@dataclass(frozen=True, eq=False)
class Terminal:
    """A place where power flows out of a bus. P, Q : MW, Mvar or pu. log_v : ln |V|. angle : rad.
    machine : whether it is one of a machine."""

    name: str
    P: Array
    Q: Array | None
    log_v: Array
    angle: Array
    unit: str
    machine: bool


def terminals_of(
    record: Record, at: Mapping[str, str] | None = None, rated_hz: float | None = None
) -> tuple[list[Terminal], list[str]]:
    """Return the terminals with sufficient measurements, and notes on the others.

    at : terminal -> the terminal that has its voltage and angle, as ``branch[7-8]`` -> ``bus7``. rated_hz :
    of speeds in pu; None: 60, with a note where a speed is used.

    Only powers of one unit can be compared: that of most machines, without machines that of most terminals.
    A terminal needs P (or V, I and both angles) and an angle (or a speed or frequency, whose integral is
    taken). Power counts out of the bus, that of a machine, which has a speed, into it.
    Phasors in kV from phase to ground and A give three phases.
    """
    terminals, notes, by_speed = [], [], []
    for name in record.terminals:
        place = (at or {}).get(name, name)
        terminal, missing = _terminal(record, name, place, rated_hz or USUAL_HZ)
        if terminal is not None:
            terminals.append(terminal)
            measured = record.terminals.get(place, {}).keys()
            by_speed += [] if measured & {"voltage angle", "frequency"} else [name]
        elif missing:
            notes.append(f"{name}: no {missing}, left out")
    if not terminals:
        raise RecordError(
            f"{record.source}: no terminal has power and angle, wanted at each: V, I and their angles, "
            "or P, Q, V and an angle"
        )
    if by_speed and rated_hz is None:
        notes.append(f"speeds are taken as pu of {USUAL_HZ:g} Hz; a case has the rated frequency")
    return _of_one_unit(terminals, notes), notes


def _of_one_unit(terminals: Sequence[Terminal], notes: list[str]) -> list[Terminal]:
    """Return the terminals whose powers can be compared; add a note on the others."""
    units = Counter(t.unit for t in terminals if t.machine) or Counter(t.unit for t in terminals)
    unit = units.most_common(1)[0][0]
    other = [t for t in terminals if t.unit != unit]
    if other:
        names = ", ".join(t.name for t in other[:4]) + (f" and {len(other) - 4} more" if other[4:] else "")
        notes.append(f"{names}: power in {other[0].unit}, not in {unit} as elsewhere: left out")
    return [t for t in terminals if t.unit == unit]


def _terminal(record: Record, name: str, place: str, rated_hz: float) -> tuple[Terminal | None, str]:
    """Return a terminal, or None and what it lacks ("" where it has no power at all)."""
    voltage, angle = record.of(place, "voltage"), record.of(place, "voltage angle")
    P, Q = record.of(name, "active power"), record.of(name, "reactive power")
    unit = _unit_of(record, name, "active power")
    if P is None:
        S, unit, missing = _of_phasors(record, name, place)
        if S is None:
            return None, missing
        P, Q = np.asarray(S.real), np.asarray(S.imag)
    machine = bool(record.terminals[name].keys() & _ROTATING)
    if machine:  # its power counts into the bus
        P, Q = -P, None if Q is None else -Q
    if voltage is None or not np.min(voltage) > 0.0:
        return None, "voltage above 0"
    if angle is None:
        angle = _integrated(record, place, rated_hz)
    if angle is None:
        return None, "angle, frequency or speed"
    return Terminal(name, P, Q, np.log(voltage), angle, unit, machine), ""


def _of_phasors(record: Record, name: str, place: str) -> tuple[npt.NDArray[np.complex128] | None, str, str]:
    """Return P + jQ of the phasors at a terminal, its unit, and what is missing; as `_terminal`."""
    voltage, angle = record.of(place, "voltage"), record.of(place, "voltage angle")
    current, turned = record.of(name, "current"), record.of(name, "current angle")
    if current is None:
        return None, "", ""
    if voltage is None or angle is None or turned is None:
        return None, "", "voltage with its angle" if turned is not None else "angle of the current"
    both = _unit_of(record, place, "voltage") == "kV"
    if both != (_unit_of(record, name, "current") == "A"):
        return None, "", "voltage and current that are both pu, or kV and A"
    S = voltage * current * np.exp(1j * (angle - turned)) * (_PHASES * 1e-3 if both else 1.0)
    return S, "MW" if both else "pu", ""


def _unit_of(record: Record, terminal: str, quantity: str) -> str:
    name = record.terminals.get(terminal, {}).get(quantity)
    return next((c.unit for c in record.channels if c.name == name), "")


def _integrated(record: Record, place: str, rated_hz: float) -> Array | None:
    """Return the angle (rad) that a frequency, or a speed in pu of `rated_hz`, adds up to."""
    frequency, speed = record.of(place, "frequency"), record.of(place, "speed")
    if frequency is None and speed is None:
        return None
    hertz = frequency if frequency is not None else rated_hz * np.asarray(speed)
    turned = 2.0 * np.pi * record.step_s * np.asarray(hertz - np.mean(hertz))
    return np.concatenate([[0.0], np.cumsum(0.5 * (turned[1:] + turned[:-1]))])
