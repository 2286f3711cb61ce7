r"""Sensitivity of the swing modes to a parameter of the plant.

With left and right eigenvectors :math:`w^T A = \lambda w^T,\ A v = \lambda v,\ w^T v = 1`,

.. math:: \frac{d\lambda}{dp} = w^T \frac{dA}{dp} v .

A(p) is the exact Jacobian of the plant at the operating point for p, so the derivative includes the effect of
the parameter on the operating point. dA/dp is a central difference of these Jacobians, extrapolated once:
error of order h^4, estimated from the two steps. [Kundur1994, sec. 12.2]
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..linear.sparse_plant import SparsePlant
from .modes import Mode, Modes

Matrix = NDArray[np.float64]


@dataclass(frozen=True)
class Sensitivity:
    """Derivative of one eigenvalue with respect to one parameter."""

    mode: str
    parameter: str
    value: float  #: of the parameter, in its own unit
    eigenvalue: complex  #: 1/s
    derivative: complex  #: d(eigenvalue)/d(parameter), 1/s per unit of the parameter
    error: float  #: estimated error of `derivative`, same unit

    @property
    def frequency_slope(self) -> float:
        """d(frequency)/d(parameter), Hz per unit of the parameter."""
        return float(self.derivative.imag / (2.0 * np.pi))

    @property
    def damping_slope(self) -> float:
        r"""d(damping ratio)/d(parameter), :math:`\zeta = -\mathrm{Re}\lambda/|\lambda|`."""
        z, d = self.eigenvalue, self.derivative
        size = abs(z)
        return float(-d.real / size + z.real * (z.conjugate() * d).real / size**3)


def eigenvalue_sensitivity(
    modes: Modes,
    matrix_of: Callable[[float], Matrix],
    value: float,
    *,
    parameter: str,
    relative_step: float = 1e-3,
    step: float | None = None,
) -> Mapping[str, Sensitivity]:
    r"""Return the sensitivity of every mode of `modes` to one parameter, by mode name.

    Parameters
    ----------
    modes : of the plant at `value`, from the same states as `matrix_of` returns.
    matrix_of : state matrix A (n, n) of the plant for a value of the parameter, operating point included.
    value : of the parameter. At 0 the difference is one-sided (many parameters may not be negative) and its
        step is `relative_step` itself.
    relative_step : of the wider difference, times \|value\|. step : to both sides, in its place, also at 0.

    Raises
    ------
    ValueError : a value or step that is not finite, or a matrix of another size.

    >>> from interarea.design.modes.modes import Mode, Modes, Participation
    >>> A = lambda c: np.array([[0.0, 1.0], [-4.0, -c]])  # frequency 2 rad/s, damping c
    >>> lam = -0.2 + 1j * np.sqrt(4.0 - 0.2**2)
    >>> v = np.array([1.0, lam]); w = np.array([lam + 0.4, 1.0])
    >>> mode = Mode("swing", lam, {}, Participation(), 1.0, v, w / (w @ v))
    >>> found = eigenvalue_sensitivity(Modes({"swing": mode}, np.array([lam])), A, 0.4, parameter="c")
    >>> bool(abs(found["swing"].derivative - (-0.5 - 0.5j * 0.2 / lam.imag)) < 1e-9)
    True
    """
    if not (np.isfinite(value) and 0.0 < relative_step < 0.5):
        raise ValueError(
            f"{parameter} = {value!r}, relative_step = {relative_step!r}, allowed: finite, above 0"
        )
    difference = _forward if value == 0.0 and step is None else _central
    wide = relative_step * (abs(value) or 1.0) if step is None else step
    coarse, fine = (difference(matrix_of, value, h) for h in (wide, wide / 2.0))
    dA = (4.0 * fine - coarse) / 3.0
    result = {}
    for name, mode in modes.items():
        if dA.shape != (mode.right.size,) * 2:
            raise ValueError(
                f"{parameter}: A has shape {dA.shape}, mode {name!r} has {mode.right.size} states; "
                "the parameter must not add or remove states"
            )
        result[name] = Sensitivity(
            mode=name,
            parameter=parameter,
            value=value,
            eigenvalue=mode.eigenvalue,
            derivative=mode.sensitivity(dA),
            error=abs(mode.sensitivity(dA - fine)),
        )
    return result


def sparse_sensitivity(
    modes: Sequence[Mode],
    plant_of: Callable[[float], SparsePlant],
    value: float,
    *,
    parameter: str,
    step: float | None = None,
) -> Mapping[str, Sensitivity]:
    """Return the sensitivities of modes of a sparse plant: w' A(p) v needs no matrix.

    plant_of : the plant for a value of the parameter, operating point included, of the same states.
    step : as `eigenvalue_sensitivity`.

    Raises
    ------
    ValueError : a value that is not finite, or another number of states.
    """
    if not np.isfinite(value):
        raise ValueError(f"{parameter} = {value!r}, allowed: finite")
    right = np.array([mode.right for mode in modes]).T
    left = np.array([mode.left for mode in modes])

    def values_of(p: float) -> NDArray[np.complex128]:
        plant = plant_of(p)
        if plant.nstates != len(right):
            raise ValueError(
                f"{parameter}: {plant.nstates} states at {p:g}, the modes have {len(right)}; "
                "the parameter must not add or remove states"
            )
        return np.asarray(np.sum(left.T * plant.times(right), axis=0))

    places = (0, 1, 2) if value == 0.0 and step is None else (1, -1)  # many parameters may not be negative
    wide = 1e-3 * (abs(value) or 1.0) if step is None else step
    steps = (wide, wide / 2.0)
    coarse, fine = (_slope([values_of(value + k * h) for k in places], h) for h in steps)
    derivative = (4.0 * fine - coarse) / 3.0
    return {
        mode.name: Sensitivity(mode.name, parameter, value, mode.eigenvalue, complex(d), float(abs(d - f)))
        for mode, d, f in zip(modes, derivative, fine, strict=True)
    }


def _slope(rows: Sequence[NDArray[np.complex128]], h: float) -> NDArray[np.complex128]:
    if len(rows) == 3:
        return np.asarray((-3.0 * rows[0] + 4.0 * rows[1] - rows[2]) / (2.0 * h))
    return np.asarray((rows[0] - rows[1]) / (2.0 * h))


def _central(matrix_of: Callable[[float], Matrix], value: float, h: float) -> Matrix:
    return (_matrix(matrix_of, value + h) - _matrix(matrix_of, value - h)) / (2.0 * h)


def _forward(matrix_of: Callable[[float], Matrix], value: float, h: float) -> Matrix:
    """Second order: (-3 A(p) + 4 A(p + h) - A(p + 2h)) / 2h."""
    at = [_matrix(matrix_of, value + k * h) for k in range(3)]
    return (-3.0 * at[0] + 4.0 * at[1] - at[2]) / (2.0 * h)


def _matrix(matrix_of: Callable[[float], Matrix], value: float) -> Matrix:
    A = np.asarray(matrix_of(value), dtype=float)
    if A.ndim != 2 or A.shape[0] != A.shape[1] or not np.all(np.isfinite(A)):
        raise ValueError(f"the matrix at {value:g} has shape {A.shape}, wanted: square and finite")
    return A
