"""Devices in coordinates of their own modes, where (s - A_k)^-1 of all of them is nearly a diagonal."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import sparse

from .sparse_network import Elimination

Matrix = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
IntArray = npt.NDArray[np.int64]

_CONDITION = 1e6  # of a device's eigenvectors: beyond (equal time constants in a row) its matrix is inverted


def scattered(blocks: npt.NDArray[Any], rows: IntArray, columns: IntArray, shape: tuple[int, int]) -> Any:
    """Return blocks (K, i, j) at rows (K, i) and columns (K, j) as one matrix, less what is outside."""
    i = np.broadcast_to(rows[:, :, None], blocks.shape)
    j = np.broadcast_to(columns[:, None, :], blocks.shape)
    selected = (blocks != 0.0) & (i < shape[0]) & (j < shape[1])
    return sparse.csr_matrix((blocks[selected], (i[selected], j[selected])), shape=shape)


class Modal:
    """Devices A (K, m, m), B (K, m, 2 ends), C (K, 2 ends, m) with states x = X z, in which A is X^-1 A X.

    That is diagonal but for a few devices with defective matrices, which keep their states: one inverse for
    each s serves them. Sparse: `X`, `inverse` (n, n), `B` (n, rows), `C` (rows, n), whose rows are those of
    the network that is left, and their transposes `XT`, `inverseT`, `BT`, `CT`.
    `poles` (n,): eigenvalues of all A_k.
    """

    def __init__(
        self, A: Matrix, B: Matrix, C: Matrix, place: IntArray, states: int, left: Elimination
    ) -> None:
        sizes = np.sum(place < states, axis=1)
        self.poles: ComplexArray = np.zeros(states, dtype=complex)
        X = np.broadcast_to(np.eye(A.shape[1], dtype=complex), A.shape).copy()
        inverse, plain = X.copy(), np.zeros(len(A), dtype=bool)
        for size in np.unique(sizes):
            own = np.flatnonzero(sizes == size)
            values, vectors = np.linalg.eig(A[own, :size, :size])
            self.poles[place[own, :size]] = values
            with np.errstate(all="ignore"):
                good = np.linalg.cond(vectors) <= _CONDITION
            plain[own[~good]] = True
            X[own[good], :size, :size] = vectors[good]
            inverse[own[good], :size, :size] = np.linalg.inv(vectors[good])
        b, c = inverse @ B, C @ X
        retained, entries = left.remaining.shape[0], left.remaining.nnz
        self.X, self.inverse = (scattered(M, place, place, (states, states)) for M in (X, inverse))
        self.B = scattered(b, place, left.rows, (states, retained))
        self.C = scattered(c, left.rows, place, (retained, states))
        self.XT, self.inverseT, self.BT, self.CT = (
            M.T.tocsr() for M in (self.X, self.inverse, self.B, self.C)
        )
        # entries of the network matrix by 1/(s - pole), of each device's C (s - A)^-1 B
        of = np.where(plain[:, None, None, None], 0.0, c[:, :, None, :] * np.swapaxes(b, 1, 2)[:, None])
        places = left.places.reshape(len(A), B.shape[2] ** 2)
        self._taken = scattered(of.reshape(len(A), B.shape[2] ** 2, -1), places, place, (entries, states))
        self._retained = left.remaining.data
        self._plain = place[plain][place[plain] < states]
        self._A, self._b, self._c, self._places = A[plain], b[plain], c[plain], left.places[plain]
        inside = place[plain]
        numbers = np.arange(1.0, self._A.size + 1.0).reshape(self._A.shape)
        self._numbers = scattered(numbers, inside, inside, (states, states))
        self._defective = scattered(self._A, inside, inside, (states, states))
        self._values = self.poles.copy()
        self._values[self._plain] = 0.0

    def times(self, z: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return A of all devices times z (n,), the network between them cut."""
        result = self._values * z
        return np.asarray(result + self._defective @ z) if len(self._plain) else result

    def at(self, s: complex) -> DevicesAt:
        """Return (s - A_k)^-1, and the entries of N(s)."""
        with np.errstate(divide="ignore"):
            scale = 1.0 / (s - self._values)
        scale[self._plain] = 0.0
        network = self._retained - self._taken @ scale
        if not len(self._plain):
            return DevicesAt(scale, None, network)
        inner = np.linalg.inv(s * np.eye(self._A.shape[1]) - self._A)
        np.subtract.at(network, self._places.ravel(), (self._c @ inner @ self._b).ravel())
        data = inner.ravel()[self._numbers.data.astype(np.int64) - 1]
        shape = self._numbers.shape
        return DevicesAt(
            scale,
            sparse.csr_matrix((data, self._numbers.indices, self._numbers.indptr), shape=shape),
            network,
        )


class DevicesAt:
    """(s - A_k)^-1 of all devices at one s, in the coordinates of `Modal`; network : entries of N(s)."""

    def __init__(self, scale: ComplexArray, inner: Any, network: ComplexArray) -> None:
        self._scale, self._inner, self.network = scale, inner, network

    def times(self, z: npt.NDArray[Any], transposed: bool = False) -> ComplexArray:
        """Return (s - A_k)^-1 z, (n, ...), or its transpose times z."""
        result = (self._scale if z.ndim == 1 else self._scale[:, None]) * z
        if self._inner is not None:
            result += (self._inner.T if transposed else self._inner) @ z
        return np.asarray(result)
