"""One device by itself at a point of its machine: rest, poles, what a step makes of it."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.integrate

from ..errors import DeviceError, nearest
from .language.device import KINDS, USUAL_HZ
from .language.structure import Model
from .rest import RestPoint, rest_of
from .rows import numbers_of, row_of

Array = npt.NDArray[np.float64]
#: a machine at 0.82 pu of power and 1 pu of voltage; its phasors fit each other
POINT = {"vt": 1.0, "vd": 0.6, "vq": 0.8, "id": 0.7, "iq": 0.5, "pe": 0.82, "slip": 0.0, "ifd": 1.9}
POINT |= {"vc": 1.0, "vs": 0.0, "pm": 0.82, "efd": 1.8, "p_mod": 0.0, "q_mod": 0.0, "p": 0.4, "q": 0.1}
POINT |= {"b": 0.1, "i": 0.1, "ip": 0.4, "vdr": 1.04, "vdi": 1.0, "idc": 1.0, "delta": 0.7}
POINT |= {
    "vr": 0.8,
    "vi": 0.6,
    "ir": 0.38,
    "ii": 0.16,
    "v1": 1.0,
    "p1": -0.5,
    "v2": 1.0,
    "p2": 0.5,
    "ip1": -0.5,
    "q_mod1": 0.0,
    "q_mod2": 0.0,
    "vreg": 1.0,
    "vdrop": 1.0,
    "pbr": 0.4,
    "qbr": 0.1,
}
#: kind -> what is stepped and by how much
STEPS = {
    "exciter": ("vref", 0.01),
    "governor": ("pref", 0.01),
    "stabilizer": ("slip", 1e-3),
    "compensator": ("iq", 0.1),
    "limiter": ("ifd", 1.0),
    "svc": ("vref", 0.01),
    "statcom": ("vref", 0.01),
    "converter": ("pref", 0.01),
    "hvdc": ("pset", 0.01),
    "source": ("p", 1e-3),
    "vsc": ("p_mod", 0.01),
}
#: powers that are those of a device's own currents, of which voltage and current
_POWERS = {
    "converter": (("p", "vt", "ip"), ("q", "vt", "iq"), ("pbr", "vt", "ip"), ("qbr", "vt", "iq")),
    "vsc": (("p1", "v1", "ip1"), ("p2", "v2", "ip2")),
}
_VOLTAGES = ("vt", "v1", "v2")  #: magnitudes
_LARGEST = 1e3  #: of a signal at rest, pu or rad
_MOST_CALLS = 15_000  #: of the rates, for a step response; the devices of the package take up to 4000
_RTOL, _ATOL = 1e-8, 1e-10


@dataclass(frozen=True)
class Response:
    """A device at rest, its poles with its inputs held, and its output after a step.

    step : what is stepped, by how much. times : s. output : change of the output, pu, as many.
    """

    rest: RestPoint
    poles: npt.NDArray[np.complex128]
    step: tuple[str, float]
    times: Array
    output: Array


def response_of(
    model: Model,
    provided: Mapping[str, float | str],
    point: Mapping[str, float] | None = None,
    *,
    base_mva: float = 100.0,
    frequency_hz: float = USUAL_HZ,
    stop_s: float = 10.0,
) -> Response:
    """Return what the device with parameters `provided` does at `point` (values of `POINT` where not given).

    Raises
    ------
    DeviceError : a parameter that is missing, unknown or out of range, an input that does not exist, a
        device that cannot rest at the point.
    """
    device = model.device
    kind = KINDS[device.kind]
    seen = {name: POINT[name] for name in (*kind.inputs, kind.output) if name in POINT}
    for name, value in (point or {}).items():
        _check_signal(device.name, name, value, seen)
        seen[name] = value
    if not min(stop_s, base_mva, frequency_hz) > 0.0:
        setup = f"stop {stop_s:g} s, base {base_mva:g} MVA, {frequency_hz:g} Hz"
        raise DeviceError(f"{device.name}: {setup}, allowed: above 0")
    inputs = {name: seen[name] for name in kind.inputs}
    if device.kind == "converter":  # its currents are those of its powers
        seen["ip"], inputs["iq"] = seen["p"] / seen["vt"], seen["q"] / seen["vt"]
        if provided.get("REGCC") == 1.0:
            inputs |= {"e": 1.05, "delta": 0.7, "theta": float(np.angle(complex(seen["vr"], seen["vi"])))}
        inputs |= {"pbr": seen["p"], "qbr": seen["q"], "vreg": seen["vt"], "vdrop": seen["vt"]}
    if device.kind == "hvdc":  # it rests at its current, at any angles
        inputs |= {"iord": seen["idc"], "xr": 0.3, "xi": 0.3}
    if device.kind == "source":
        inputs |= {"e": 1.05, "theta": float(np.angle(complex(seen["vr"], seen["vi"])))}
    if device.kind == "vsc":
        inputs |= {"iq1": 0.1, "ip2": seen["p2"] / seen["v2"], "iq2": 0.1}
        seen["ip1"] = seen["p1"] / seen["v1"]
    output = seen[kind.output] if device.references else None
    try:
        row = row_of(device, provided)
    except DeviceError as error:
        raise DeviceError(f"{device.name}{error}") from None
    rest = rest_of(model, numbers_of(device, row, base_mva, frequency_hz), inputs, output, device.name)
    times, stepped = _step_response(rest, inputs, stop_s)
    return Response(rest, _poles(rest, inputs), STEPS[device.kind], times, stepped)


def _check_signal(who: str, name: str, value: float, seen: Mapping[str, float]) -> None:
    """Require that a device sees a signal, and that it can rest at such a value."""
    if name not in seen:
        raise DeviceError(f"{who}: {name} = {value:g} is not one of its signals; known: {', '.join(seen)}")
    voltage = name in _VOLTAGES
    if not (value > 0.0 if voltage else value >= -_LARGEST) or not value <= _LARGEST:
        allowed = f"above 0, at most {_LARGEST:g}" if voltage else f"{-_LARGEST:g} to {_LARGEST:g}"
        raise DeviceError(f"{who}: {name} = {value:g}, allowed: {allowed}")


def _poles(rest: RestPoint, inputs: Mapping[str, float]) -> npt.NDArray[np.complex128]:
    """Eigenvalues of the rates at rest by their derivatives with a complex step, rightmost first."""
    n = len(rest.states)
    A = np.empty((n, n))
    for k in range(n):
        x = np.array(rest.states, dtype=complex)
        x[k] += 1e-30j
        A[:, k] = np.array([complex(rate).imag for rate in rest.instance.run(list(x), inputs)[1]]) / 1e-30
    poles = np.linalg.eigvals(A).astype(complex)
    return poles[np.argsort(-poles.real)]


def _step_response(rest: RestPoint, inputs: Mapping[str, float], stop_s: float) -> tuple[Array, Array]:
    """Times and change of the output after the step of `STEPS`."""
    model, x0 = rest.instance.model, np.array(rest.states)
    device = model.device
    stepped, changed = type(rest.instance)(model, rest.instance.values), dict(inputs)
    name, size = STEPS[device.kind]
    (changed if name in inputs else stepped.values)[name] += size
    times = np.linspace(0.0, stop_s, 201)

    calls = itertools.count(1)

    def rates(time: float, x: Array) -> list[float]:
        if next(calls) > _MOST_CALLS:
            raise DeviceError(
                f"{device.name}: the step response reached {time:.3g} s after {_MOST_CALLS} evaluations: "
                "a gate switches repeatedly; change the parameters or the equilibrium"
            )
        for power, volt, current in _POWERS.get(device.kind, ()):
            changed[power] = changed[volt] * x[rest.instance.state_names.index(current)]
        return [float(rate) for rate in stepped.run(list(x), changed)[1]]

    states = np.tile(x0, (len(times), 1))
    if len(x0):
        solved = scipy.integrate.solve_ivp(
            rates, (0.0, stop_s), x0, method="LSODA", t_eval=times, rtol=_RTOL, atol=_ATOL
        )
        if not solved.success:
            raise DeviceError(
                f"{device.name}: the step response ends at {solved.t[-1]:g} s: {solved.message}"
            )
        states = solved.y.T
    values = [float(stepped.run(list(x), changed)[0][device.output]) - rest.output for x in states]
    return times, np.array(values)


def missing(model: Model, provided: Mapping[str, object]) -> list[str]:
    """Return the parameters without a default that `provided` lacks.

    Raises
    ------
    DeviceError : `provided` names what is no parameter of the device.
    """
    names = [p.name for p in model.device.parameters]
    for name in provided:
        if name not in names:
            raise DeviceError(
                f"{model.device.name}: {name} is not one of its parameters; {nearest(name, names)}"
            )
    return [p.name for p in model.device.parameters if p.default is None and p.name not in provided]
