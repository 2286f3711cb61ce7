"""Limits widened on request, so that a device rests where its machine does."""

from __future__ import annotations

from collections.abc import Mapping

from ..errors import BeyondLimit, DeviceError
from .gates import GATES, spelled_out
from .language.expression import Node, evaluate, parse
from .language.structure import Model
from .rest import BEYOND, rest_of

ROOM = 0.1  #: a widened limit lies that share beyond the signal at rest
_LEAST_ROOM = 0.01  #: pu
_MOST = 12  #: limits of one device
_STEPS = 6  #: of Newton's method: one for a linear limit, one more for each gate that changes sides
_REACHED = 1e-12  #: relative, some thousand units of rounding


def released(
    model: Model,
    values: Mapping[str, float | str],
    inputs: Mapping[str, float],
    output: float | None,
    who: str,
    room: float = BEYOND,
) -> dict[str, float]:
    """Return the parameters to change, with their new values, for the device to rest; as `rest_of`.

    A limit is moved to a tenth beyond the signal, by the first parameter in it that moves it; a level (pu)
    comes before a gain, and what is bounded by a parameter before that bound. room : as `rest_of` takes it.

    Raises
    ------
    DeviceError : what keeps the device from resting is no limit, or none that a parameter moves.
    """
    values, changed = dict(values), {}
    for _ in range(_MOST):
        try:
            rest_of(model, values, inputs, output, who, room=room)
        except BeyondLimit as error:
            name, value = _moved(model, values, inputs, output, error, who)
            values[name] = changed[name] = value
        else:
            return changed
    raise DeviceError(
        f"{who}: {_MOST} limits widened, and a signal is still beyond a limit; check its parameters"
    )


def _moved(
    model: Model, values: Mapping[str, float | str], inputs: Mapping[str, float], output: float | None,
    error: BeyondLimit, who: str,
) -> tuple[str, float]:  # fmt: skip
    """The parameter that moves the limit, and its value for which the signal has room."""
    point = rest_of(model, values, inputs, output, who, check=False)
    known = {**point.instance.values, **inputs, **point.signals}
    limit = spelled_out(parse(error.limit, who), model)
    room = max(ROOM * abs(error.value), _LEAST_ROOM)
    expected = error.value + (room if error.above else -room)
    bounds = {part.name for part in limit.args} if limit.op in GATES else set()
    concerned = [model.device.by_name[name] for name in limit.names if name in model.device.by_name]
    for parameter in sorted(concerned, key=lambda p: (p.name in bounds, p.unit != "pu")):
        value = _solved(limit, parameter.name, known, expected)
        if value is not None and parameter.low <= value <= parameter.high:
            return parameter.name, value
    raise error


def _solved(limit: Node, name: str, known: Mapping[str, float], expected: float) -> float | None:
    """Value of `name` for which `limit`, linear in it or a gate of such, is as `expected`; None if none."""
    value = float(known[name])
    for _ in range(_STEPS):
        at = float(evaluate(limit, {**known, name: value}))
        if abs(at - expected) <= _REACHED * max(1.0, abs(expected)):
            return value
        slope = float(evaluate(limit, {**known, name: value + 1.0})) - at
        if slope == 0.0:
            return None
        value += (expected - at) / slope
    return None
