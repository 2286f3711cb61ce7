"""What flows at each terminal of a record: P, Q, voltage and angle, measured or of phasors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from .record import Array, Record, RecordError

_ROTATING = {"speed", "rotor angle"}  # what only a machine has
_PHASES = 3.0  # of a line whose voltage is from phase to ground


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


def terminals_of(record: Record, at: Mapping[str, str] | None = None) -> tuple[list[Terminal], list[str]]:
    """Return the terminals with enough measured, and notes on the others.

    at : terminal -> the terminal that has its voltage and angle, as ``branch[7-8]`` -> ``bus7``.

    A terminal needs P (or V, I and both angles) and an angle (or a speed or frequency, whose integral is
    taken). Power counts out of the bus, that of a machine, which has a speed, into it.
    Phasors in kV from phase to ground and A give three phases.
    """
    terminals, notes = [], []
    for name in record.terminals:
        terminal, missing = _terminal(record, name, (at or {}).get(name, name))
        if terminal is not None:
            terminals.append(terminal)
        elif missing:
            notes.append(f"{name}: no {missing}, left out")
    if not terminals:
        raise RecordError(
            f"{record.source}: no terminal has power and angle, wanted at each: V, I and their angles, "
            "or P, Q, V and an angle"
        )
    return terminals, notes


def _terminal(record: Record, name: str, place: str) -> tuple[Terminal | None, str]:
    """Return a terminal, or None and what it lacks ("" where it has no power at all)."""
    voltage, angle = record.of(place, "voltage"), record.of(place, "voltage angle")
    current, turned = record.of(name, "current"), record.of(name, "current angle")
    P, Q = record.of(name, "active power"), record.of(name, "reactive power")
    unit = _unit_of(record, name, "active power")
    if P is None:
        if current is None:
            return None, ""
        if voltage is None or angle is None or turned is None:
            return None, "voltage with its angle" if turned is not None else "angle of the current"
        both = _unit_of(record, place, "voltage") == "kV"
        S = voltage * current * np.exp(1j * (angle - turned)) * (_PHASES * 1e-3 if both else 1.0)
        P, Q, unit = np.asarray(S.real), np.asarray(S.imag), "MW" if both else "pu"
    machine = bool(record.terminals[name].keys() & _ROTATING)
    if machine:  # its power counts into the bus
        P, Q = -P, None if Q is None else -Q
    if voltage is None or not np.min(voltage) > 0.0:
        return None, "voltage above 0"
    if angle is None:
        angle = _integrated(record, place)
    if angle is None:
        return None, "angle, frequency or speed"
    return Terminal(name, P, Q, np.log(voltage), angle, unit, machine), ""


def _unit_of(record: Record, terminal: str, quantity: str) -> str:
    name = record.terminals.get(terminal, {}).get(quantity)
    return next((c.unit for c in record.channels if c.name == name), "")


def _integrated(record: Record, place: str) -> Array | None:
    """Return the angle (rad) that a frequency or speed adds up to; of a speed in pu at 60 Hz."""
    frequency, speed = record.of(place, "frequency"), record.of(place, "speed")
    if frequency is None and speed is None:
        return None
    hertz = frequency if frequency is not None else 60.0 * np.asarray(speed)
    turned = 2.0 * np.pi * record.step_s * np.asarray(hertz - np.mean(hertz))
    return np.concatenate([[0.0], np.cumsum(0.5 * (turned[1:] + turned[:-1]))])
