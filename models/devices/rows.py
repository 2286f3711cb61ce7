"""A device's row in a case: its parameters by name, checked against the device file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..errors import DeviceError, nearest
from .language.device import BASES, FBASE, MBASE, NO_LIMIT, USUAL_HZ, Device, Parameter
from .language.expression import evaluate

Value = float | str | None  #: None: an absent limit; a word: computed at rest


def row_of(device: Device, provided: Mapping[str, Any]) -> dict[str, Value]:
    """Return every parameter of `device` for what a row gives, in the order of the file.

    Raises
    ------
    DeviceError : ".KEY = value, ..." for a key that does not exist, is missing, is no number, or is out of
        range; a check between parameters that fails.
    """
    known = device.by_name
    for key, value in provided.items():
        if key not in known:
            raise DeviceError(f".{key} = {value!r}: no such key here; {nearest(key, known)}")
    row = {p.name: _value(device, p, provided) for p in device.parameters}
    _check(device, row)
    return row


def _value(device: Device, p: Parameter, provided: Mapping[str, Any]) -> Value:
    """One parameter of a row: what is given for it, if its range has that, or its default."""
    if p.name not in provided:
        if p.default is None:
            raise DeviceError(f".{p.name} is missing: {p.text}")
        return None if p.is_optional_limit else p.default
    value = provided[p.name]
    rule = device.computed.get(p.name)
    if (value is None and p.is_optional_limit) or (rule is not None and value == rule.when):
        retained: Value = value
        return retained
    if isinstance(value, bool) or not isinstance(value, int | float):
        more = f" or {rule.when!r}" if rule is not None and isinstance(rule.when, str) else ""
        raise DeviceError(f".{p.name} = {value!r}, allowed: a number{more}")
    if not p.holds(value):
        raise DeviceError(f".{p.name} = {value!r}, allowed: {_range(p.low, p.high, open_=p.open)}")
    if p.name in device.switches and value != round(value):
        raise DeviceError(
            f".{p.name} = {value!r}, allowed: a whole number, {_range(p.low, p.high, open_=p.open)}"
        )
    return float(value)


def numbers_of(
    device: Device, row: Mapping[str, Value], mbase: float, frequency_hz: float
) -> dict[str, float | str]:
    """Return a row as numbers: absent limits as +-1e30, words as they are, MBASE in MVA, FBASE in Hz."""
    values: dict[str, float | str] = {MBASE: mbase, FBASE: frequency_hz}
    for p in device.parameters:
        value = row[p.name]
        values[p.name] = (p.default if p.default is not None else NO_LIMIT) if value is None else value
    return values


def _check(device: Device, row: Mapping[str, Value]) -> None:
    values = numbers_of(device, row, 100.0, USUAL_HZ)
    for rule in device.checks:
        names = [name for name in dict.fromkeys(rule.node.names) if name not in BASES]
        computed = (name in device.computed and values[name] == device.computed[name].when for name in names)
        if any(computed) or evaluate(rule.node, values):
            continue
        parts = ", ".join(f"{name} = {row[name]:g}" if row[name] is not None else name for name in names)
        raise DeviceError(f": {parts}{rule.says}")


def _range(low: float, high: float, *, open_: bool) -> str:
    least = "" if low <= -NO_LIMIT else f"above {low:g}" if open_ else f"at least {low:g}"
    most = "" if high >= NO_LIMIT else f"at most {high:g}"
    return " and ".join(part for part in (least, most) if part) or "a number"
