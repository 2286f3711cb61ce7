"""Transfer matrices at many points s: by eigenvectors, or by the Schur form where poles are close."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from scipy.linalg import schur

if TYPE_CHECKING:
    import control

    from ..linear.matrices import LinearMatrices

ComplexArray = npt.NDArray[np.complex128]
_ACCURATE = 1e-9  # of the modal form against a solution of the equations


class TransferMatrix:
    """C (s I - A)^-1 B + D by the complex Schur form of A: accurate for poles of any multiplicity.

    A = Q T Q^H; (s I - T) x = b is solved from the last row up, for many s at once.
    """

    def __init__(self, system: control.StateSpace | LinearMatrices) -> None:
        A, B, C, self._D = (np.asarray(M, dtype=float) for M in (system.A, system.B, system.C, system.D))
        form = schur(A, output="complex") if A.size else (A, A)
        self._T: ComplexArray = np.asarray(form[0], dtype=np.complex128)
        Q: ComplexArray = np.asarray(form[1], dtype=np.complex128)
        self.poles: ComplexArray = np.diag(self._T).copy()
        self._left, self._right = Q.conj().T @ B, C @ Q

    @property
    def outputs(self) -> int:
        """Number of outputs."""
        return int(self._D.shape[0])

    def at(self, s: ComplexArray) -> ComplexArray:
        """Return the transfer matrix (N, outputs, inputs) at s (N,)."""
        return np.asarray(self._right @ self._solved(s, self._left[None]) + self._D)

    def slope(self, s: ComplexArray) -> ComplexArray:
        """Return its derivative (N, outputs, inputs)."""
        return np.asarray(-self._right @ self._solved(s, self._solved(s, self._left[None])))

    def _solved(self, s: ComplexArray, right_side: ComplexArray) -> ComplexArray:
        """Return (s I - T)^-1 `right_side`, (N, states, inputs)."""
        x: ComplexArray = np.zeros((len(s), *right_side.shape[1:]), dtype=complex)
        for k in reversed(range(len(self._T))):
            x[:, k] = (right_side[:, k] + np.matmul(self._T[k, k + 1 :], x[:, k + 1 :])) / (
                s - self._T[k, k]
            )[:, None]
        return x


class ModalForm(TransferMatrix):
    """The same by the eigenvectors of A: many times as quick, where its poles are apart."""

    def __init__(self, system: control.StateSpace | LinearMatrices) -> None:
        A, B, C, self._D = (np.asarray(M, dtype=float) for M in (system.A, system.B, system.C, system.D))
        poles, vectors = np.linalg.eig(A) if A.size else (np.zeros(0, complex), np.zeros((0, 0)))
        self.poles = np.asarray(poles, dtype=np.complex128)
        left = np.linalg.solve(vectors, B.astype(complex)) if A.size else np.zeros((0, B.shape[1]))
        self._residues = np.einsum("ij,jk->jik", C @ vectors, left).reshape(len(self.poles), self._D.size)

    def at(self, s: ComplexArray) -> ComplexArray:
        """Return the transfer matrix (N, outputs, inputs) at s (N,)."""
        value = (1.0 / (s[:, None] - self.poles[None, :])) @ self._residues
        return np.asarray(value.reshape(len(s), *self._D.shape) + self._D)

    def slope(self, s: ComplexArray) -> ComplexArray:
        """Return its derivative (N, outputs, inputs)."""
        value = -((s[:, None] - self.poles[None, :]) ** -2.0) @ self._residues
        return np.asarray(value.reshape(len(s), *self._D.shape))


def transfer_matrix(system: control.StateSpace | LinearMatrices) -> TransferMatrix:
    """Return the modal form where it agrees with a solution at two points, else the Schur form."""
    A, B, C, D = (np.asarray(M, dtype=float) for M in (system.A, system.B, system.C, system.D))
    with suppress(np.linalg.LinAlgError):  # eigenvectors that are one
        modal = ModalForm(system)
        for s in (0.3 + 2.0j, 0.1 + 7.0j):
            exact = C @ np.linalg.solve(s * np.eye(len(A)) - A, B) + D
            error = np.max(np.abs(modal.at(np.array([s]))[0] - exact), initial=0.0)
            if not error <= _ACCURATE * (1e-12 + np.max(np.abs(exact), initial=0.0)) + 1e-14:
                break
        else:
            return modal
    return TransferMatrix(system)
