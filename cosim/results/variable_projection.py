"""Poles of a ring-down whose signals ring irregularly: variable projection with a robust loss.

A matrix pencil takes every jolt that a lost packet gives for part of a mode. Here the number of modes is
given; their poles alone are varied, the amplitudes follow by least squares (Golub and Pereyra 1973), and
a misfit counts by its size, not its square, once it is larger than most (soft L1).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from .matrix_pencil import amplitudes_of

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
_MOST_SECONDS_LEFT = 12.0  # 1/s: decay and growth that a window can show
_SPREAD = 1.4826  # of a normal distribution over its median deviation


def refined(time_s: Array, values: Array, poles: ComplexArray) -> ComplexArray:
    """Return poles near `poles` (upper halves of pairs, rad/s) with which the signals are fitted best.

    values : (points, signals), each of like size.
    """
    if not poles.size:
        return poles
    swinging = poles.imag > 0.0
    largest = 0.95 * np.pi / (time_s[1] - time_s[0])

    def poles_at(x: Array) -> ComplexArray:
        found = x[: poles.size].astype(complex)
        found[swinging] += 1j * x[poles.size :]
        return found

    def misfit(x: Array) -> Array:
        return np.asarray(amplitudes_of(time_s, values, poles_at(x))[1].ravel())

    low = np.concatenate([np.full(poles.size, -_MOST_SECONDS_LEFT), np.full(int(swinging.sum()), 1e-3)])
    high = np.concatenate([np.full(poles.size, 3.0), np.full(int(swinging.sum()), largest)])
    start = np.clip(np.concatenate([poles.real, poles.imag[swinging]]), low + 1e-6, high - 1e-6)
    scale = _SPREAD * float(np.median(np.abs(misfit(start))))
    if not scale > 0.0:
        return poles
    fit = least_squares(
        misfit, start, bounds=(low, high), loss="soft_l1", f_scale=scale, x_scale="jac", max_nfev=60
    )
    return poles_at(fit.x)
