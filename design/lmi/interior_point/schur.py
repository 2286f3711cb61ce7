"""The Schur complement H = F*(G F(.) G) of an LMI problem from its Kronecker structure.

For the terms (L1, R1) of a variable V1 and (L2, R2) of V2, summed over term pairs and blocks,

    H[(p,q),(r,s)] = 2 Re { conj(L1^H G L2)[p,r] (R1 G R2^H)[q,s]
                          + conj(L1^H G R2^H)[p,s] (R1 G L2)[q,r] }.

With G = Ri^H Ri, B = Ri W and W all distinct columns [L.., R^H..] of a block, every factor is a
corner of B^H B. All products of a pair of variables are gathered as rows of U (T, p r) and
W (T, q s) (a complex product is two real ones), and one product U'W gives the tensor
[p,r,q,s]. The second kind joins the first when V1 or V2 is symmetric, by swapping that
variable's indices, as H is folded over them anyway.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..problem import Matrix, Problem
from .operators import AffineMap, Coordinates, Vector

Index = npt.NDArray[np.intp]


class _Columns:
    """The distinct columns [L.., R^H..] of one block; a factor is kept up to a real number."""

    def __init__(self, block_size: int, kind: type) -> None:
        self.kind = kind
        self.parts = 2 if kind is np.complex128 else 1  #: real ones of a number
        self.width = 0
        self._parts: list[Matrix] = []
        self._first_column: dict[tuple[int, bytes], int] = {}
        self._block_size = block_size

    def place(self, factor: Matrix) -> tuple[int, float]:
        """Return (first column, real factor) under which `factor` (d, p) is stored."""
        factor = np.ascontiguousarray(factor.astype(self.kind) if self.kind is np.complex128 else factor.real)
        scale = float(np.abs(factor).max())
        if scale > 0.0:
            lead = factor.ravel()[int(np.argmax(np.abs(factor) > 1e-3 * scale))]
            scale = float(np.copysign(scale, lead.real if lead.real != 0.0 else lead.imag))
            factor = factor / scale + 0.0
        key = (factor.shape[1], factor.tobytes())
        if key not in self._first_column:
            self._first_column[key] = self.width
            self._parts.append(factor)
            self.width += factor.shape[1]
        return self._first_column[key], scale

    @property
    def reals(self) -> int:
        """Number of real numbers of the products of all columns."""
        return self.parts * self.width**2

    def corner(self, row: int, rows: int, col: int, cols: int, part: int) -> Index:
        """Return where the products of some columns with others stand; part : 0 real, 1 imaginary."""
        inside = (row + np.arange(rows))[:, None] * self.width + (col + np.arange(cols))[None, :]
        return np.asarray(self.parts * inside + part)

    def matrix(self) -> Matrix:
        """Return all columns (d, width)."""
        if not self._parts:
            return np.zeros((self._block_size, 0), dtype=self.kind)
        return np.ascontiguousarray(np.hstack(self._parts))


class _Term(NamedTuple):
    """A term by its block, its variable, the first columns of its factors and its weight."""

    block: int
    variable: int
    left: int
    right: int
    weight: float


def _placed_terms(problem: Problem, names: list[str], columns: list[_Columns]) -> list[_Term]:
    """The terms of all blocks, their factors among the columns of each."""
    terms = []
    for k, block in enumerate(problem.blocks):
        for term in block.terms:
            left, a = columns[k].place(term.left)
            right, b = columns[k].place(term.right.conj().T)
            terms.append(_Term(k, names.index(term.variable), left, right, a * b))
    return terms


class _Products:
    """Rows of U and W of one pair of variables: where to gather them, and their weights."""

    def __init__(self) -> None:
        self._u: list[Index] = []
        self._w: list[Index] = []
        self._weights: list[float] = []

    def add(self, u: Index, w: Index, weight: float) -> None:
        self._u.append(u.ravel())
        self._w.append(w.ravel())
        self._weights.append(weight)

    def close(self) -> None:
        """Freeze the lists into index arrays and buffers; products of the same factors are added up."""
        unique: dict[tuple[bytes, bytes], int] = {}
        rows: list[int] = []
        weights: list[float] = []
        for k, (u, w) in enumerate(zip(self._u, self._w, strict=True)):
            key = (u.tobytes(), w.tobytes())
            if key in unique:
                weights[unique[key]] += self._weights[k]
            else:
                unique[key] = len(rows)
                rows.append(k)
                weights.append(self._weights[k])
        self.count = len(rows)
        if self.count:
            self.u = np.array([self._u[k] for k in rows])
            self.w = np.array([self._w[k] for k in rows])
            self.weights = np.array(weights)[:, None]
            self.U, self.W = np.empty(self.u.shape), np.empty(self.w.shape)

    def tensor(self, gram: Vector, out: Vector) -> Vector:
        """Return sum_t U_t[i] W_t[j] as a matrix over (i, j)."""
        np.take(gram, self.u, out=self.U, mode="clip")
        np.take(gram, self.w, out=self.W, mode="clip")
        self.W *= self.weights
        view = out[: self.u.shape[1] * self.w.shape[1]].reshape(self.u.shape[1], self.w.shape[1])
        return np.dot(self.U.T, self.W, out=view)


class _Pair:
    """The block of H over two variables."""

    def __init__(self, first: Coordinates, second: Coordinates) -> None:
        self.first, self.second = first, second
        v1, v2 = first.variable, second.variable
        self.shape = (v1.rows, v1.cols, v2.rows, v2.cols)
        p, q, r, s = self.shape
        self.direct = _Products()
        self.crossed = _Products()
        self.fold_rows, self.fold_cols = v1.symmetric and p > 1, v2.symmetric and r > 1
        self._halve_rows = np.flatnonzero(first.upper[0] == first.upper[1])
        self._halve_cols = np.flatnonzero(second.upper[0] == second.upper[1])
        self._rows = first.upper[0] * q + first.upper[1]
        self._rows_mirrored = first.upper[1] * q + first.upper[0] if self.fold_rows else self._rows
        self._cols = second.upper[0] * s + second.upper[1]
        self._cols_mirrored = second.upper[1] * s + second.upper[0] if self.fold_cols else self._cols

    def add_terms(self, columns: _Columns, start: int, one: _Term, other: _Term) -> None:
        """Add both kinds of products of two terms of a block, whose columns begin at `start`."""
        p, q, r, s = self.shape
        weight = 2 * one.weight * other.weight
        for half in range(columns.parts):

            def at(row: int, rows: int, col: int, cols: int, half: int = half) -> Index:
                return start + columns.corner(row, rows, col, cols, half)

            self.direct.add(at(one.left, p, other.left, r), at(one.right, q, other.right, s), weight)
            self.add_crossed(at(one.left, p, other.right, s), at(one.right, q, other.left, r), weight)

    def close(self) -> int:
        """Freeze both kinds of products; return the number of entries."""
        self.direct.close()
        self.crossed.close()
        return int(np.prod(self.shape))

    def add_crossed(self, u: Index, w: Index, weight: float) -> None:
        """Add a product of the second kind, u over (p, s) and w over (q, r)."""
        if self.second.variable.symmetric:
            self.direct.add(u, w, weight)
        elif self.first.variable.symmetric:
            self.direct.add(w, u, weight)
        else:
            self.crossed.add(u, w, weight)

    def fill(self, gram: Vector, H: Vector, work: tuple[Vector, Vector]) -> None:
        """Write the block into H."""
        p, q, r, s = self.shape
        entries = work[1][: p * q * r * s].reshape(p, q, r, s)
        if self.direct.count:
            tensor = self.direct.tensor(gram, work[0]).reshape(p, r, q, s)
            np.copyto(entries, tensor.transpose(0, 2, 1, 3))
        else:
            entries[...] = 0.0
        if self.crossed.count:
            entries += self.crossed.tensor(gram, work[0]).reshape(p, s, q, r).transpose(0, 2, 3, 1)
        block = entries.reshape(p * q, r * s)
        if self.fold_rows:
            folded = block[self._rows]
            folded += block[self._rows_mirrored]
            folded[self._halve_rows] *= 0.5
            block = folded
        if self.fold_cols:
            folded = np.take(block, self._cols, axis=1)
            folded += np.take(block, self._cols_mirrored, axis=1)
            folded[:, self._halve_cols] *= 0.5
            block = folded
        H[self.first.span, self.second.span] = block


class SchurComplement:
    """Forms H for given scalings Ri_k; only its upper triangle is complete."""

    def __init__(self, problem: Problem, affine: AffineMap) -> None:
        self._affine = affine
        names = [v.name for v in problem.variables]
        columns = [_Columns(d, kind) for d, kind in zip(affine.sizes, affine.dtypes, strict=True)]
        terms = _placed_terms(problem, names, columns)
        starts = np.cumsum([0] + [c.reals for c in columns])
        self._gram = np.zeros(int(starts[-1]))
        self._columns = [c.matrix() for c in columns]
        self._grams: list[Matrix] = [
            self._gram[start : start + c.reals].view(c.kind).reshape(c.width, c.width)
            for start, c in zip(starts, columns, strict=False)
        ]
        place = [affine.coordinates[name] for name in names]
        self._pairs: dict[tuple[int, int], _Pair] = {}
        for one, other in product(terms, terms):
            i, j, k = one.variable, other.variable, one.block
            if other.block == k and j >= i:
                pair = self._pairs.setdefault((i, j), _Pair(place[i], place[j]))
                pair.add_terms(columns[k], int(starts[k]), one, other)
        most = max((pair.close() for pair in self._pairs.values()), default=1)
        self._work = (np.empty(most), np.empty(most))
        self._scalars = [
            (
                affine.scalar_index[name],
                [(k, np.asarray(b.scalars[name])) for k, b in enumerate(problem.blocks) if name in b.scalars],
            )
            for name in problem.scalars
        ]
        self.H = np.zeros((affine.m, affine.m))

    def form(self, scalings: Sequence[Matrix], metrics: Sequence[Matrix]) -> Vector:
        """Return H (m, m), upper triangle, for Ri_k (`scalings`) and G_k = Ri_k^H Ri_k (`metrics`)."""
        for Ri, W, gram in zip(scalings, self._columns, self._grams, strict=True):
            if W.shape[1]:
                B = Ri @ W
                np.dot(B.conj().T, B, out=gram)
        for pair in self._pairs.values():
            pair.fill(self._gram, self.H, self._work)
        for index, parts in self._scalars:
            middle: list[Matrix] = [np.zeros_like(G) for G in metrics]
            for k, D in parts:
                middle[k] = metrics[k] @ (D if metrics[k].dtype == np.complex128 else D.real) @ metrics[k]
            self.H[:, index] = self._affine.adjoint(middle)
        return self.H
