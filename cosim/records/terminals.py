"""The terminals of a record: places where power flows out of a bus, and energy in a narrow band."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.signal import butter, sosfiltfilt

from interarea.models.devices.language.device import USUAL_HZ

from .record import Array, Record, RecordError

_ROTATING = {"speed", "rotor angle"}  # what only a machine has
_PHASES = 3.0  # of a line whose voltage is from phase to ground
_SIDE_HZ, _SIDE = 0.15, 0.25  # of the band-pass, at most this share of the frequency
_EDGE_PERIODS = 2.0  # left out at both ends, where the filter sets in


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


class Narrow:
    """A narrow band around one frequency (Hz) of signals with a time step (s), by a filter of zero phase.

    Signals are arrays (points,) or (points, signals).
    """

    def __init__(self, frequency_hz: float, step_s: float) -> None:
        self.step_s = step_s
        side = min(_SIDE_HZ, _SIDE * frequency_hz)
        edges = [2.0 * step_s * (frequency_hz - side), 2.0 * step_s * (frequency_hz + side)]
        self._sos = butter(2, edges, "band", output="sos")
        self._edge = round(_EDGE_PERIODS / frequency_hz / step_s)

    def of(self, values: Array) -> Array:
        """Return what lies in the band."""
        line = np.linspace(values[0], values[-1], len(values))
        return np.asarray(sosfiltfilt(self._sos, values - line, axis=0))

    def inside(self, values: Array) -> Array:
        """Return values without the ends, where the filter sets in."""
        edge = min(self._edge, len(values) // 8)
        return values[edge : len(values) - edge]

    def power(self, P: Array, Q: Array, log_v: Array, angle: Array) -> Array:
        """Return dW/dt = P d(angle)/dt + Q d(ln V)/dt, without the ends. P, Q, log_v, angle : in the band."""
        d_angle, d_log_v = (np.gradient(x, self.step_s, axis=0) for x in (angle, log_v))
        return self.inside(P * d_angle + Q * d_log_v)

    def slopes(self, power: Array) -> Array:
        """Return the slopes of the lines through the energies of powers."""
        W = np.cumsum(power, axis=0) * self.step_s
        return np.asarray(np.polyfit(np.arange(len(W)) * self.step_s, W, 1)[0])


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
