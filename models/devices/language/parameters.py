"""The table of a device file that declares its parameters: unit, range, default, what each is."""

from __future__ import annotations

from typing import Any

from .device import KINDS, NO_LIMIT, UNITS, Parameter
from .source import Source

_KEYS = ("unit", "min", "above", "max", "default", "text")


def read_parameters(source: Source, kind: str, references: tuple[str, ...]) -> dict[str, Parameter]:
    """Return the parameters by name; none has the name of a signal of a `kind` or of a reference.

    Raises
    ------
    DeviceError : a name that is taken or no name, a key that does not exist, a default beyond its range.
    """
    signals = {*KINDS[kind].inputs, KINDS[kind].output, *KINDS[kind].also, *references}
    parameters = {}
    for name, row in source.table("parameters").items():
        line = source.line_of(name, "parameters")
        source.name_of(name, line)
        if name in signals:
            raise source.fail(f"{name} is a signal of a {kind}; name the parameter otherwise", line)
        if not isinstance(row, dict):
            raise source.fail(f"{name}: allowed: a table with unit, min or above, default, text", line)
        parameters[name] = _parameter(source, name, row, line)
    return parameters


def _parameter(source: Source, name: str, row: dict[str, Any], line: int) -> Parameter:
    for key in row:
        if key not in _KEYS:
            raise source.fail(f"{name}.{key[:40]}: allowed: {', '.join(_KEYS)}", line)
    unit, text = row.get("unit", "1"), row.get("text", "")
    if unit not in UNITS:
        raise source.fail(f"{name}.unit = {str(unit)[:40]!r}, allowed: {', '.join(UNITS)}", line)
    if not isinstance(text, str):
        raise source.fail(f"{name}.text, allowed: a text", line)
    numbers = {k: source.number(row[k], f"{name}.{k}", line) for k in row if k not in ("unit", "text")}
    low = numbers.get("min", numbers.get("above", -NO_LIMIT))
    high, default = numbers.get("max", NO_LIMIT), numbers.get("default")
    parameter = Parameter(name, unit, text, low, high, "above" in row, default)
    if not (low < high if parameter.open else low <= high):
        begins = "above" if parameter.open else "min"
        raise source.fail(
            f"{name}: {begins} = {low:g}, max = {high:g}, allowed: a range that holds a number", line
        )
    if default is not None and abs(default) < NO_LIMIT and not parameter.holds(default):
        raise source.fail(f"{name}.default = {default:g} is outside its own range", line)
    return parameter
