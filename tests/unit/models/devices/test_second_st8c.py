"""ST8C against a second writing of its block diagram in IEEE 421.5-2016, which shares nothing with it."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from interarea.models.devices.library import library
from interarea.models.devices.rest import rest_of
from interarea.models.devices.rows import numbers_of, row_of

ST8C = {"SW1": 0.0, "TR": 0.02, "KPR": 8.0, "KIR": 4.0, "VPIMAX": 4.5, "VPIMIN": -1.0, "KPA": 3.0, "KIA": 0.5}
ST8C |= {
    "VAMAX": 1.1,
    "VAMIN": -0.9,
    "KA": 6.0,
    "TA": 0.01,
    "VRMAX": 6.0,
    "VRMIN": -5.0,
    "KF": 0.9,
    "TF": 0.02,
}
ST8C |= {"KC1": 0.1, "KP": 1.2, "KI1": 0.1, "XL": 0.05, "THETAP": 10.0, "VB1MAX": 8.0}
ST8C |= {"KC2": 0.05, "KI2": 0.3, "VB2MAX": 2.0}
EFD = 1.9  #: at rest
#: what is done to the exciter -> voltage and field current over time, step of the reference
DONE = {
    "a step of the reference": (lambda t: 1.0, lambda t: 1.9 + 0.4 * min(t, 1.5), 0.03),
    "a fault": (
        lambda t: 0.45 if 0.2 < t < 0.35 else 1.0 - 0.06 * math.exp(-2.0 * t),
        lambda t: 1.9 + (1.2 * math.exp(-3.0 * (t - 0.2)) if t > 0.2 else 0.0),
        0.0,
    ),
    "a voltage that stays high": (lambda t: 1.0 if t < 0.2 else 1.15, lambda t: 1.9 - 0.3 * min(t, 1.0), 0.0),
    "a swing": (lambda t: 1.0 + 0.04 * math.sin(6.0 * t), lambda t: 1.9 + 0.5 * math.sin(6.0 * t - 0.8), 0.0),
}


def phasors(v: float) -> dict[str, float]:
    """Voltage and current of the machine at a terminal voltage, one angle between them."""
    return {"vt": v, "vc": v, "vd": 0.6 * v, "vq": 0.8 * v, "id": 0.7, "iq": 0.5}


def f_ex(loading: float) -> float:
    """The rectifier of IEEE 421.5, annex D."""
    if loading <= 0.0:
        return 1.0
    if loading <= 0.433:
        return 1.0 - 0.577 * loading
    if loading < 0.75:
        return math.sqrt(0.75 - loading**2)
    return max(1.732 * (1.0 - loading), 0.0)


def bridges(p: dict[str, float], v: float, ifd: float) -> tuple[float, float]:
    """Bridge voltages by the terminal voltage and by the current."""
    ph = phasors(v)
    volt, current = complex(ph["vq"], -ph["vd"]), complex(ph["iq"], -ph["id"])
    gain = p["KP"] * cmath.exp(1j * math.radians(p["THETAP"]))
    source = p["KP"] if p["SW1"] == 2 else abs(gain * volt + 1j * (p["KI1"] + gain * p["XL"]) * current)
    first = min(source * f_ex(p["KC1"] * ifd / source), p["VB1MAX"])
    if p["KI2"] <= 0.0:
        return first, 0.0
    second = p["KI2"] * abs(current)
    return first, min(second * f_ex(p["KC2"] * ifd / second), p["VB2MAX"])


def written_again(p: dict[str, float], done: str, stop_s: float, h: float, every: int) -> np.ndarray:
    """Field voltage by Heun's method in steps of `h`; the PI blocks stand still at their limits (annex E)."""
    voltage, field, step = DONE[done]
    first, second = bridges(p, voltage(0.0), field(0.0))
    vr = (EFD - second) / first
    v, fi, xa, xp, reference = (
        voltage(0.0),
        p["KF"] * field(0.0),
        vr / p["KA"],
        p["KF"] * field(0.0),
        voltage(0.0),
    )

    def pi(gain: float, error: float, x: float, low: float, high: float) -> tuple[float, bool]:
        whole = gain * error + x
        return min(max(whole, low), high), low <= whole <= high

    def rates(t: float, s: tuple[float, ...]) -> tuple[float, ...]:
        v, fi, xp, xa, vr = s
        error = reference + step - v
        vp, free_p = pi(p["KPR"], error, xp, p["VPIMIN"], p["VPIMAX"])
        va, free_a = pi(p["KPA"], vp - fi, xa, p["VAMIN"], p["VAMAX"])
        return (
            (voltage(t) - v) / p["TR"],
            (p["KF"] * field(t) - fi) / p["TF"],
            p["KIR"] * error if free_p else 0.0,
            p["KIA"] * (vp - fi) if free_a else 0.0,
            (p["KA"] * va - vr) / p["TA"],
        )

    state, out = (v, fi, xp, xa, vr), []
    for k in range(round(stop_s / h) + 1):
        t = k * h
        if k % every == 0:
            first, second = bridges(p, voltage(t), field(t))
            out.append(first * state[4] + second)
        a = rates(t, state)
        b = rates(t + h, tuple(x + h * y for x, y in zip(state, a, strict=True)))
        state = tuple(x + 0.5 * h * (y + z) for x, y, z in zip(state, a, b, strict=True))
        state = (*state[:4], min(max(state[4], p["VRMIN"]), p["VRMAX"]))
    return np.array(out)


@pytest.mark.slow
@pytest.mark.parametrize(("done", "source"), [*((name, 0.0) for name in DONE), ("a fault", 2.0)])
def test_st8c_follows_a_second_writing(done: str, source: float) -> None:
    """Within 3.1e-3 of the range of the field voltage, 5e-5 where no input jumps."""
    p = ST8C | {"SW1": source}
    voltage, field, step = DONE[done]
    model = library()["st8c"]
    numbers = numbers_of(model.device, row_of(model.device, p), 100.0, 60.0)

    def seen(t: float) -> dict[str, float]:
        rest = {"vs": step if t >= 0.0 else 0.0, "pe": 0.8, "slip": 0.0, "ifd": field(max(t, 0.0))}
        return phasors(voltage(max(t, 0.0))) | rest

    point = rest_of(model, numbers, seen(-1.0), EFD, "test")
    stop, every, h = 2.0, 100, 1e-4
    times = np.arange(0.0, stop + 1e-9, every * h)
    run = solve_ivp(
        lambda t, x: point.instance.run(x, seen(t))[1],
        (0.0, stop),
        point.states,
        t_eval=times,
        rtol=1e-7,
        atol=1e-9,
        max_step=0.002,
    )
    ours = np.array([point.instance.run(x, seen(t))[0]["efd"] for t, x in zip(times, run.y.T, strict=True)])
    expected = written_again(p, done, stop, h, every)
    assert np.ptp(expected) > 0.5
    error = np.abs(ours - expected).max() / np.ptp(expected)
    assert error < (3.5e-3 if done in ("a fault", "a voltage that stays high") else 5e-5)
