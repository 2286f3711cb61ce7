"""Coordinates of a `Problem` and its affine map: S(y) = C + F(y), and the adjoint F*(Z).

A coordinate of a full variable is an entry; of a symmetric one an entry of the upper
triangle (the mirrored entry moves with it). All blocks live one after the other in one
vector of floats (a complex entry takes two), so that F is one sparse matrix: it holds
the half Q(y) = sum_t L_t V_t R_t + sum_g g D_g / 2, and F(y) = Q + Q^H, F*(Z) = 2 Re Q*(Z).
Terms whose Kronecker product would be large stay as two matrix products.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from ..problem import Matrix, MatrixVariable, Problem

Vector = npt.NDArray[np.float64]

#: Seconds, roughly: a stored entry in a sparse product, a call to BLAS, a flop in a small product.
_ENTRY_S, _CALL_S, _FLOP_S = 1.2e-9, 8e-6, 5e-11


@dataclass(frozen=True)
class Coordinates:
    """Where the coordinates of one variable lie in y, and the entries they move."""

    variable: MatrixVariable
    start: int
    index: npt.NDArray[np.intp]  #: (rows, cols) -> coordinate of that entry in y
    upper: tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]  #: entry (p, q) of each coordinate

    @property
    def size(self) -> int:
        return len(self.upper[0])

    @property
    def span(self) -> slice:
        return slice(self.start, self.start + self.size)

    def matrix(self, y: Vector) -> Vector:
        """Return the variable as a matrix."""
        return y[self.index]

    def vector(self, gradient: Vector) -> Vector:
        """Return the coordinates of a gradient over the entries (mirrored entries added)."""
        p, q = self.upper
        if not self.variable.symmetric:
            return gradient.ravel()
        return np.where(p == q, gradient[p, q], gradient[p, q] + gradient[q, p])


def coordinates_of(variable: MatrixVariable, start: int) -> Coordinates:
    """Lay out the coordinates of one variable from position `start` of y."""
    rows, cols = variable.rows, variable.cols
    if not variable.symmetric:
        index = start + np.arange(rows * cols).reshape(rows, cols)
        return Coordinates(variable, start, index, tuple(i.ravel() for i in np.indices((rows, cols))))  # type: ignore[arg-type]
    p, q = np.triu_indices(rows)
    index = np.empty((rows, rows), dtype=np.intp)
    index[p, q] = index[q, p] = start + np.arange(len(p))
    return Coordinates(variable, start, index, (p, q))


class AffineMap:
    """C, F and F* of a `Problem` in coordinates; m coordinates, K blocks of sizes d_k."""

    def __init__(self, problem: Problem) -> None:
        self.coordinates: dict[str, Coordinates] = {}
        start = 0
        for variable in problem.variables:
            self.coordinates[variable.name] = coordinates_of(variable, start)
            start += self.coordinates[variable.name].size
        self.scalar_index = {name: start + k for k, name in enumerate(problem.scalars)}
        self.m = start + len(problem.scalars)

        self.sizes = [block.constant.shape[0] for block in problem.blocks]
        self.is_complex = [
            any(
                np.iscomplexobj(a) and np.any(np.imag(a))
                for a in (
                    block.constant,
                    *(x for t in block.terms for x in (t.left, t.right)),
                    *block.scalars.values(),
                )
            )
            for block in problem.blocks
        ]
        floats = [d * d * (2 if c else 1) for d, c in zip(self.sizes, self.is_complex, strict=True)]
        self.starts = np.concatenate([[0], np.cumsum(floats)])
        self.dtypes: list[type] = [np.complex128 if c else np.float64 for c in self.is_complex]
        self.constants = self.views(np.zeros(self.starts[-1]))
        for C, block in zip(self.constants, problem.blocks, strict=True):
            provided = block.constant if C.dtype == np.complex128 else np.real(block.constant)
            C[...] = (provided + provided.conj().T) / 2.0
        self._assemble(problem)
        self.cost = self._objective(problem)

    def views(self, flat: Vector) -> list[Matrix]:
        """Return the blocks (d_k, d_k) as views of one vector of floats."""
        return [
            flat[a:b].view(kind).reshape(d, d)
            for a, b, kind, d in zip(self.starts[:-1], self.starts[1:], self.dtypes, self.sizes, strict=True)
        ]

    def _assemble(self, problem: Problem) -> None:
        rows, cols, data = [], [], []
        self._products: list[tuple[int, Coordinates, Matrix, Matrix]] = []
        for k, block in enumerate(problem.blocks):
            d, offset, width = self.sizes[k], int(self.starts[k]), 2 if self.is_complex[k] else 1

            def add(
                entry: npt.NDArray[np.intp],
                coordinate: npt.NDArray[np.intp],
                value: Matrix,
                offset: int = offset,
                width: int = width,
            ) -> None:
                for part, number in enumerate((value.real, value.imag)[:width]):
                    rows.append(offset + width * entry + part)
                    cols.append(coordinate)
                    data.append(number)

            for term in block.terms:
                place = self.coordinates[term.variable]
                a, p = np.nonzero(term.left)
                q, b = np.nonzero(term.right)
                rows_v, cols_v = place.variable.rows, place.variable.cols
                flops = 2.0 * d * cols_v * (rows_v + d) * width
                if len(a) * len(b) * width * _ENTRY_S > 2 * _CALL_S + flops * _FLOP_S:
                    kind = self.dtypes[k]
                    self._products.append((k, place, term.left.astype(kind), term.right.astype(kind)))
                    continue
                add(
                    (a[:, None] * d + b[None, :]).ravel(),
                    place.index[p[:, None], q[None, :]].ravel(),
                    (term.left[a, p][:, None] * term.right[q, b][None, :]).ravel(),
                )
            for name, D in block.scalars.items():
                a, b = np.nonzero(D)
                add(a * d + b, np.full(len(a), self.scalar_index[name]), D[a, b] / 2.0)
        shape = (int(self.starts[-1]), self.m)
        if rows:
            entries = (np.concatenate(data), (np.concatenate(rows), np.concatenate(cols)))
            self._half = sp.csr_matrix(entries, shape=shape)
        else:
            self._half = sp.csr_matrix(shape)
        self._half.sum_duplicates()
        self._half_transposed = self._half.T.tocsr()

    def _objective(self, problem: Problem) -> Vector:
        cost = np.zeros(self.m)
        for name, G in problem.objective_matrices.items():
            place = self.coordinates[name]
            cost[place.span] += place.vector(np.asarray(G, dtype=np.float64))
        for name, weight in problem.objective_scalars.items():
            cost[self.scalar_index[name]] += weight
        return cost

    def apply(self, y: Vector) -> list[Matrix]:
        """Return F_k(y), Hermitian, for every block."""
        half = self.views(np.asarray(self._half @ y))
        for k, place, left, right in self._products:
            half[k] += left @ place.matrix(y) @ right
        return [Q + Q.conj().T if Q.dtype == np.complex128 else Q + Q.T for Q in half]

    def adjoint(self, blocks: Sequence[Matrix]) -> Vector:
        """Return F*(Z) (m,) for Hermitian Z_k: <F(y), Z> = y' F*(Z)."""
        flat = np.concatenate([Z.ravel().view(np.float64) for Z in blocks])
        gradient: Vector = 2.0 * (self._half_transposed @ flat)
        for k, place, left, right in self._products:
            product = left.conj().T @ blocks[k] @ right.conj().T
            gradient[place.span] += 2.0 * place.vector(product.real)
        return gradient

    def column_norms(self) -> list[Vector]:
        """Return for every block the Frobenius norm of each coordinate's matrix (m,), bounds."""
        squares = []
        for k in range(len(self.sizes)):
            part = self._half[int(self.starts[k]) : int(self.starts[k + 1])]
            squares.append(4.0 * np.asarray(part.multiply(part).sum(axis=0)).ravel())
        for k, place, left, right in self._products:
            entries = np.outer((abs(left) ** 2).sum(axis=0), (abs(right) ** 2).sum(axis=1))
            squares[k][place.span] += 4.0 * place.vector(entries)
        return [np.sqrt(s) for s in squares]

    def unpack(self, y: Vector) -> tuple[Mapping[str, Vector], Mapping[str, float]]:
        """Return the variables and scalars that y stands for."""
        values = {name: place.matrix(y) for name, place in self.coordinates.items()}
        return values, {name: float(y[k]) for name, k in self.scalar_index.items()}
