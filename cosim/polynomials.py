"""The arithmetic of inputs over a step, in one place.

A signal over the step [t, t + h] is its value and first three derivatives at
t, (d0, d1, d2, d3): u(t + s) = d0 + s (d1 + s (d2/2 + s d3/6)). Plain double
arithmetic, one operation after the other, so that a kernel in C which repeats
these lines gives the same bits.
"""

from __future__ import annotations

from collections.abc import Sequence

Polynomial = tuple[float, float, float, float]


def value_at(d: Polynomial, s: float) -> float:
    """Return u(t + s).

    >>> value_at((1.0, 2.0, 6.0, 12.0), 2.0)
    33.0
    """
    return d[0] + s * (d[1] + s * (d[2] / 2.0 + s * (d[3] / 6.0)))


def slope_at(d: Polynomial, s: float) -> float:
    """Return du/dt(t + s)."""
    return d[1] + s * (d[2] + s * (d[3] / 2.0))


def mean_between(d: Polynomial, a: float, b: float) -> float:
    """Return the mean of u(t + s) over a <= s <= b (Simpson: exact for a cubic)."""
    return (value_at(d, a) + 4.0 * value_at(d, 0.5 * (a + b)) + value_at(d, b)) / 6.0


def hermite(v0: float, s0: float, v1: float, s1: float, h: float) -> Polynomial:
    """Return the cubic with values v0, v1 and slopes s0, s1 at both ends of a step of length h."""
    mean = (v1 - v0) / h
    d2 = 2.0 * (3.0 * mean - 2.0 * s0 - s1) / h
    d3 = 6.0 * (s0 + s1 - 2.0 * mean) / h / h
    return (v0, s0, d2, d3)


def line(v0: float, v1: float, h: float) -> Polynomial:
    """Return the straight line from v0 to v1."""
    return (v0, (v1 - v0) / h, 0.0, 0.0)


def after_jump(v1: float, s1: float, h: float) -> Polynomial:
    """Return the line of slope s1 that ends at v1: a step of length h whose signal jumped at its start.

    >>> after_jump(3.0, 2.0, 0.5)
    (2.0, 2.0, 0.0, 0.0)
    """
    return (v1 - h * s1, s1, 0.0, 0.0)


def continued(d: Polynomial, h: float, v: float, s: float) -> Polynomial:
    """Return value v and slope s at the end of a step of length h, bending on as the cubic d did over it."""
    return (v, s, d[2] + h * d[3], d[3])


def through(times: Sequence[float], values: Sequence[float], at: int) -> Polynomial:
    """Return the polynomial through up to four points (Newton's divided differences) at point `at`.

    times : increasing, s, in any common origin; at : index of the point whose derivatives are returned.
    """
    n = len(times)
    if n == 1:
        return (values[0], 0.0, 0.0, 0.0)
    if n == 2:
        return (values[at], (values[1] - values[0]) / (times[1] - times[0]), 0.0, 0.0)
    f01 = (values[1] - values[0]) / (times[1] - times[0])
    f12 = (values[2] - values[1]) / (times[2] - times[1])
    f012 = (f12 - f01) / (times[2] - times[0])
    t = times[at]
    a, b = t - times[0], t - times[1]
    if n == 3:
        return (values[at], f01 + f012 * (a + b), 2.0 * f012, 0.0)
    f23 = (values[3] - values[2]) / (times[3] - times[2])
    f123 = (f23 - f12) / (times[3] - times[1])
    f0123 = (f123 - f012) / (times[3] - times[0])
    c = t - times[2]
    d1 = f01 + f012 * (a + b) + f0123 * (a * b + a * c + b * c)
    d2 = 2.0 * f012 + 2.0 * f0123 * (a + b + c)
    return (values[at], d1, d2, 6.0 * f0123)
