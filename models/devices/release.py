"""Limits widened on request, so that a device rests where its machine does."""

from __future__ import annotations

from collections.abc import Mapping

from ..errors import BeyondLimit, DeviceError
from .language.expression import evaluate, parse
from .language.structure import Model
from .rest import BEYOND, rest_of

ROOM = 0.1  #: a widened limit lies that share beyond the signal at rest
_LEAST_ROOM = 0.01  #: pu
_MOST = 12  #: limits of one device


def released(
    model: Model,
    values: Mapping[str, float | str],
    inputs: Mapping[str, float],
    output: float | None,
    who: str,
    room: float = BEYOND,
) -> dict[str, float]:
    """Return the parameters to change, with their new values, for the device to rest; as `rest_of`.

    A limit is moved to a tenth beyond the signal, by the first parameter in it that moves it. room : as
    `rest_of` takes it.

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
    raise DeviceError(f"{who}: {_MOST} limits widened and still beyond one; look at its parameters")


def _moved(
    model: Model, values: Mapping[str, float | str], inputs: Mapping[str, float], output: float | None,
    error: BeyondLimit, who: str,
) -> tuple[str, float]:  # fmt: skip
    """The parameter that moves the limit, and its value for which the signal has room."""
    point = rest_of(model, values, inputs, output, who, check=False)
    known = {**point.instance.values, **inputs, **point.signals}
    limit = parse(error.limit, who)
    room = max(ROOM * abs(error.value), _LEAST_ROOM)
    expected = error.value + (room if error.above else -room)
    for name in limit.names:
        parameter = model.device.by_name.get(name)
        if parameter is None:
            continue
        at = float(evaluate(limit, known))
        slope = float(evaluate(limit, known | {name: known[name] + 1.0})) - at
        if slope == 0.0:
            continue
        value = known[name] + (expected - at) / slope
        if parameter.low <= value <= parameter.high:
            return name, float(value)
    raise error
