"""(s - A_k)^-1 of many small devices at once."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Matrix = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]

_CONDITION = 1e6  # of a device's eigenvectors: beyond (equal time constants in a row) its matrix is inverted


class Modal:
    """Devices A (K, m, m), B (K, m, 2), C (K, 2, m) in coordinates of their modes: A = X diag(values) X^-1.

    Few devices have defective matrices; they keep their states, which one inverse for each s then serves.
    """

    def __init__(self, A: Matrix, B: Matrix, C: Matrix) -> None:
        self.values, X = np.linalg.eig(A.astype(complex))
        with np.errstate(all="ignore"):
            good = np.linalg.cond(X) <= _CONDITION
        self._plain = np.flatnonzero(~good)
        X[self._plain] = np.eye(A.shape[1])
        self._A = A[self._plain]
        self.X: ComplexArray = X
        self.inverse: ComplexArray = np.linalg.inv(X)
        self.B: ComplexArray = self.inverse @ B
        self.C: ComplexArray = C @ X

    def at(self, s: complex) -> DevicesAt:
        """Return (s - A_k)^-1 in the same coordinates."""
        with np.errstate(divide="ignore"):
            scale = 1.0 / (s - self.values)
        inner = np.asarray(np.linalg.inv(s * np.eye(self._A.shape[1]) - self._A), dtype=complex)
        return DevicesAt(scale, self._plain, inner)


class DevicesAt:
    """(s - A_k)^-1 of all devices at one s, in the coordinates of `Modal`."""

    def __init__(self, scale: ComplexArray, plain: npt.NDArray[np.int64], inner: ComplexArray) -> None:
        self._scale, self._plain, self._inner = scale, plain, inner

    def times(self, x: npt.NDArray[Any], transposed: bool = False) -> ComplexArray:
        """Return (s - A_k)^-1 x, (K, m, ...), or its transpose times x."""
        found = self._scale.reshape(*self._scale.shape, *[1] * (x.ndim - 2)) * x
        if len(self._plain):
            inner = np.swapaxes(self._inner, 1, 2) if transposed else self._inner
            found[self._plain] = np.einsum("kij,kj...->ki...", inner, x[self._plain])
        return np.asarray(found)
