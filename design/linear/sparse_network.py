"""The network of a sparse plant: buses without a device eliminated, N(s) factored."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse.linalg import splu

from interarea.models.grid.sparse_pattern import sparse_pattern

ComplexArray = npt.NDArray[np.complex128]
IntArray = npt.NDArray[np.int64]

_LEAST_PIVOT = 1e-3  # of the largest entry in its column; below that no diagonal pivots


class Elimination:
    """The buses without a device taken out of G once, those on no path between devices: no fill."""

    def __init__(self, G: Any, bus: IntArray, buses: int) -> None:
        """G : (2 b, 2 b) real; bus : (K, ends) of each device, which stay; buses : b."""
        at = G.tocoo()
        ends = np.unique(np.stack([at.row // 2, at.col // 2], axis=1), axis=0)
        pattern = sparse_pattern(buses, ends[ends[:, 0] < ends[:, 1]], np.unique(bus))
        order = np.argsort(pattern.row)
        both = np.stack([2 * order, 2 * order + 1], axis=1).ravel()
        ordered = G[both][:, both].tocsc()
        k = self.first = 2 * pattern.first
        self.order = both
        self.row = pattern.row - pattern.first  #: (b,) place of each bus, negative where eliminated
        self._upper, self._lower = ordered[:k, k:], ordered[k:, :k]
        self._inner = splu(ordered[:k, :k].tocsc()) if k else None
        rows = 2 * self.row[bus]
        #: (K, 2 ends) of each device among those that are kept
        self.rows = np.stack([rows, rows + 1], axis=2).reshape(len(bus), -1)
        #: what is left of G, with an entry wherever a device has one, and where: (K, 2 ends, 2 ends)
        self.remaining, self.places = self._with_blocks(ordered[k:, k:] - self._filled(ordered.shape[0] - k))

    def _filled(self, count: int) -> Any:
        """What the eliminated buses add between those that are kept, in steps of some columns."""
        selected = np.flatnonzero(np.diff(self._upper.indptr))  # the others have no eliminated neighbour
        if self._inner is None or not len(selected):
            return sparse.csc_matrix((count, count))
        into = sparse.csr_matrix(
            (np.ones(len(selected)), (np.arange(len(selected)), selected)), shape=(len(selected), count)
        )
        parts = []
        for first in range(0, len(selected), 256):
            columns = self._upper[:, selected[first : first + 256]]
            result = self._lower @ self._inner.solve(columns.toarray())
            scale = np.max(np.abs(result), initial=0.0)
            parts.append(sparse.csc_matrix(np.where(np.abs(result) > 1e-15 * scale, result, 0.0)))
        return (sparse.hstack(parts, format="csc") @ into).tocsc()

    def _with_blocks(self, remaining: Any) -> tuple[Any, IntArray]:
        """The matrix with an entry wherever a device has one, zero or not, and where these are."""
        n, width = remaining.shape[0], self.rows.shape[1]
        i, j = (
            np.repeat(self.rows[:, :, None], width, axis=2),
            np.repeat(self.rows[:, None, :], width, axis=1),
        )
        ones = sparse.csc_matrix((np.ones(i.size), (i.ravel(), j.ravel())), shape=remaining.shape)
        pattern = (abs(remaining) + ones).tocsc()
        pattern.sort_indices()
        key = np.repeat(np.arange(n), np.diff(pattern.indptr)) * n + pattern.indices
        entries = remaining.tocoo()
        pattern.data = np.zeros(pattern.nnz)
        pattern.data[np.searchsorted(key, entries.col * n + entries.row)] = entries.data
        return pattern, np.searchsorted(key, j * n + i)

    def everywhere(self, V: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return the voltages at all buses, (2 b, ...), for currents at those that are kept alone."""
        whole = np.zeros((len(self.order), *V.shape[1:]), dtype=V.dtype)
        whole[self.order[self.first :]] = V
        if self._inner is not None:
            right = -(self._upper @ V)
            inner = (
                self._inner.solve(right.real) + 1j * self._inner.solve(right.imag)
                if np.iscomplexobj(right)
                else self._inner.solve(right)
            )
            whole[self.order[: self.first]] = inner
        return whole


class Network:
    """N(s), or G, on the buses that are left, factored."""

    def __init__(self, left: Elimination, entries: npt.NDArray[Any]) -> None:
        """entries : of the matrix, on the pattern of `left.remaining`."""
        retained = left.remaining
        matrix = sparse.csc_matrix((entries, retained.indices, retained.indptr), shape=retained.shape)
        # the order is a good one already, and the diagonal carries the devices: where it does not, such as at
        # a bus of a lossless machine whose conductance is rounding alone, another row of the column pivots
        self._complex = matrix.dtype.kind == "c"
        self._lu = splu(
            matrix, permc_spec="NATURAL", diag_pivot_thresh=_LEAST_PIVOT, options={"SymmetricMode": True}
        )

    def solve(self, right: npt.NDArray[Any], transposed: bool = False) -> npt.NDArray[Any]:
        """Return what is left of the network solved for (rows, ...)."""
        lu = self._lu
        mode = "T" if transposed else "N"
        if np.iscomplexobj(right) and not self._complex:
            return np.asarray(lu.solve(right.real.copy(), mode) + 1j * lu.solve(right.imag.copy(), mode))
        return np.asarray(lu.solve(np.ascontiguousarray(right), mode))

    def logarithm(self) -> complex:
        """Log det, its imaginary part up to multiples of 2 pi."""
        lu = self._lu
        result = np.sum(np.log(lu.U.diagonal().astype(complex)))
        return complex(result + (1j * np.pi if _is_odd(lu.perm_r[np.argsort(lu.perm_c)]) else 0.0))


def _is_odd(permutation: npt.NDArray[Any]) -> bool:
    """Whether a permutation exchanges an odd number of pairs."""
    n = len(permutation)
    if np.array_equal(permutation, np.arange(n)):
        return False
    seen, odd = np.zeros(n, dtype=bool), False
    for k in range(n):
        j, length = k, 0
        while not seen[j]:
            seen[j] = True
            j, length = int(permutation[j]), length + 1
        odd ^= length > 0 and length % 2 == 0
    return odd
