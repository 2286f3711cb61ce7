"""Order and positions of a sparse network's factors, for all switching states (plant/network/sparse.h)."""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import sparse

IntArray = npt.NDArray[np.int64]

#: complex multiplications of the dense product that cost as much as one of a sparse solution, measured
SPARSE_PRICE = 3.5


@dataclass(frozen=True)
class SparsePattern:
    """Rows of L and U of a structurally symmetric matrix; arrays read-only.

    A row is the position of a node in the order of elimination. Rows before `first` have no current, so a
    solution for currents at the active nodes needs only the rows from `first` on.
    """

    row: IntArray  #: (nodes,) row of each node
    first: int
    lower: IntArray  #: (nodes + 1,) first entry of each row of L
    needed: IntArray  #: (nodes,) first entry of each row of L in a column from `first` on
    lower_column: IntArray  #: (fill,)
    upper: IntArray  #: (nodes + 1,)
    upper_column: IntArray  #: (fill,)

    @property
    def fill(self) -> int:
        """Number of entries of L, and of U."""
        return len(self.lower_column)

    @property
    def multiplications(self) -> int:
        """Complex multiplications of one solution at the required rows."""
        forward = int(np.sum(self.lower[self.first + 1 :] - self.needed[self.first :]))
        backward = self.fill - int(self.upper[self.first])
        return forward + backward + len(self.row) - self.first

    def places(self, ends: npt.ArrayLike) -> IntArray:
        """Return the positions of the entries (from, to) and (to, from) of branches, (branches, 2).

        An entry of L by its number, one of U by `fill` plus its number. ends : (branches, 2) nodes.
        """
        n = len(self.row)
        at = self.row[np.asarray(ends, dtype=int).reshape(-1, 2)]
        low, high = at.min(axis=1), at.max(axis=1)
        lower_key = np.repeat(np.arange(n), np.diff(self.lower)) * n + self.lower_column
        upper_key = np.repeat(np.arange(n), np.diff(self.upper)) * n + self.upper_column
        below = np.searchsorted(lower_key, high * n + low)
        above = np.searchsorted(upper_key, low * n + high) + self.fill
        rising = at[:, 0] < at[:, 1]
        return np.stack([np.where(rising, above, below), np.where(rising, below, above)], axis=1)


def sparse_pattern(nodes: int, ends: npt.ArrayLike, active: npt.ArrayLike) -> SparsePattern:
    """Return the pattern of a network of `nodes` nodes with branches at `ends` (branches, 2).

    active : nodes with currents and required voltages, at least one. Order: minimum degree, then by height
    in the elimination tree: rows of one height need nothing of each other, and a processor works on several
    at a time. Nodes on no path from an active one to the root come first.
    """
    order, rows = _minimum_degree(nodes, np.asarray(ends, dtype=int).reshape(-1, 2))
    above = _next_eliminated(order, rows)
    marked = np.zeros(nodes, dtype=bool)
    marked[np.asarray(active, dtype=int)] = True
    for node in order:
        if marked[node] and above[node] >= 0:
            marked[above[node]] = True
    height = np.zeros(nodes, dtype=np.int64)  # in the part of the tree that is active, or is not
    for node in order:
        if above[node] >= 0 and marked[node] == marked[above[node]]:
            height[above[node]] = max(height[above[node]], height[node] + 1)
    eliminated = np.array(order, dtype=np.int64)
    final = eliminated[np.lexsort((height[eliminated], marked[eliminated]))]
    row = np.empty(nodes, dtype=np.int64)
    row[final] = np.arange(nodes)
    first = int(np.count_nonzero(~marked))
    counts = np.array([len(r) for r in rows], dtype=np.int64)
    below = np.repeat(row[eliminated], counts)
    column = row[np.concatenate([*rows, np.zeros(0, dtype=np.int64)])]
    upper = sparse.csr_matrix((np.ones(len(below)), (below, column)), shape=(nodes, nodes))
    lower = upper.T.tocsr()
    for matrix in (upper, lower):
        matrix.sort_indices()
    starts = np.asarray(lower.indptr, dtype=np.int64)
    early = np.cumsum(np.concatenate([[0], lower.indices < first]))
    return SparsePattern(
        row=row,
        first=first,
        lower=starts,
        needed=starts[:-1] + (early[starts[1:]] - early[starts[:-1]]),
        lower_column=lower.indices.astype(np.int64),
        upper=upper.indptr.astype(np.int64),
        upper_column=upper.indices.astype(np.int64),
    )


def _next_eliminated(order: list[int], rows: list[IntArray]) -> list[int]:
    """Return of each node the first that is eliminated of those it then hangs together with, -1 at a root."""
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    above = [-1] * len(order)
    for node, row in zip(order, rows, strict=True):
        if len(row):
            above[node] = int(row[np.argmin(place[row])])
    return above


def _minimum_degree(nodes: int, ends: IntArray) -> tuple[list[int], list[IntArray]]:
    """Return the order of elimination and of each node in it those it then hangs together with."""
    near: list[set[int]] = [set() for _ in range(nodes)]
    for a, b in ends.tolist():
        if a != b:
            near[a].add(b)
            near[b].add(a)
    heap = [(len(neighbours), k) for k, neighbours in enumerate(near)]
    heapq.heapify(heap)
    order: list[int] = []
    rows: list[IntArray] = []
    done = [False] * nodes
    while heap:
        degree, k = heapq.heappop(heap)
        if done[k] or degree != len(near[k]):
            continue
        done[k] = True
        neighbours = near[k]
        order.append(k)
        rows.append(np.fromiter(sorted(neighbours), dtype=np.int64, count=len(neighbours)))
        for j in neighbours:
            others = near[j]
            before = len(others)
            others |= neighbours
            others.discard(j)
            others.discard(k)
            if len(others) != before:
                heapq.heappush(heap, (len(others), j))
        near[k] = set()
    return order, rows
