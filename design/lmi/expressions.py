"""Write linear matrix inequalities as the papers do and compile them into a `Problem`.

    program = Program()
    X, Y = program.symmetric("X", n), program.symmetric("Y", n)
    Ah, Bh, Ch = program.matrix("A^", n, n), program.matrix("B^", n, p), program.matrix("C^", m, n)
    M = bmat([[X @ A + Bh @ C, Ah], [A, A @ Y + B @ Ch]])
    N = bmat([[X, np.eye(n)], [np.eye(n), Y]])
    program.require("Lyapunov matrix", N)                 # N >= 0
    program.require("damping", regions.sector(M, 0.3))
    program.minimise(trace(X) + trace(Y))

Everything is affine in the unknowns: a product of two unknowns is refused.
Terms that share a factor are merged, so that a closed loop's M has one term
per variable, which is what makes the structured engine fast.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .problem import BlockLMI, Matrix, MatrixVariable, Problem, Term

#: One product ``L V R`` or, if the flag is set, ``L V^T R``.
Product = tuple[Matrix, MatrixVariable, bool, Matrix]


class Affine:
    """A matrix that is affine in the unknowns: constant + sum L V R + sum L V^T R + sum g D."""

    __array_ufunc__ = None  # ndarray @ Affine must come to __rmatmul__

    def __init__(
        self, constant: Matrix, products: Sequence[Product] = (), scalars: Mapping[str, Matrix] | None = None
    ) -> None:
        self.constant = constant
        self.products = tuple(products)
        self.scalars: dict[str, Matrix] = dict(scalars or {})

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return (int(self.constant.shape[0]), int(self.constant.shape[1]))

    @property
    def T(self) -> Affine:
        """Transpose."""
        products = [(R.T, v, not v.symmetric and not t, L.T) for L, v, t, R in self.products]
        return Affine(self.constant.T, products, {g: D.T for g, D in self.scalars.items()})

    @property
    def H(self) -> Affine:
        """Conjugate transpose."""
        return self.T.conj()

    def conj(self) -> Affine:
        """Complex conjugate (the unknowns are real)."""
        products = [(L.conj(), v, t, R.conj()) for L, v, t, R in self.products]
        return Affine(self.constant.conj(), products, {g: D.conj() for g, D in self.scalars.items()})

    def __matmul__(self, other: Affine | Matrix) -> Affine:
        if isinstance(other, Affine):
            return _product(self, other)
        other = np.atleast_2d(np.asarray(other))
        products = [(L, v, t, R @ other) for L, v, t, R in self.products]
        return Affine(self.constant @ other, products, {g: D @ other for g, D in self.scalars.items()})

    def __rmatmul__(self, other: Matrix) -> Affine:
        other = np.atleast_2d(np.asarray(other))
        products = [(other @ L, v, t, R) for L, v, t, R in self.products]
        return Affine(other @ self.constant, products, {g: other @ D for g, D in self.scalars.items()})

    def __mul__(self, factor: complex) -> Affine:
        if not np.isscalar(factor):
            raise TypeError("LMI expression: * takes a number; write @ for a matrix product")
        products = [(factor * L, v, t, R) for L, v, t, R in self.products]
        return Affine(factor * self.constant, products, {g: factor * D for g, D in self.scalars.items()})

    __rmul__ = __mul__

    def __truediv__(self, divisor: float) -> Affine:
        return self * (1.0 / divisor)

    def __neg__(self) -> Affine:
        return self * -1.0

    def __add__(self, other: Affine | Matrix | float) -> Affine:
        other = affine(other, self.shape)
        if other.shape != self.shape:
            raise ValueError(f"LMI expression: cannot add {other.shape} to {self.shape}")
        scalars = dict(self.scalars)
        for g, D in other.scalars.items():
            scalars[g] = scalars[g] + D if g in scalars else D
        return Affine(self.constant + other.constant, self.products + other.products, scalars)

    __radd__ = __add__

    def __sub__(self, other: Affine | Matrix | float) -> Affine:
        return self + affine(other, self.shape) * -1.0

    def __rsub__(self, other: Affine | Matrix | float) -> Affine:
        return affine(other, self.shape) + self * -1.0

    def value(self, values: Mapping[str, Matrix], scalars: Mapping[str, float] | None = None) -> Matrix:
        """Return the matrix at given unknowns."""
        S: Matrix = np.array(self.constant)
        for L, v, transposed, R in self.products:
            V = values[v.name]
            S = S + L @ (V.T if transposed else V) @ R
        for g, D in self.scalars.items():
            S = S + (scalars or {})[g] * D
        return S


@dataclass(frozen=True)
class Scalar:
    """A real number to be found; ``g * D`` is an expression for any matrix D."""

    name: str

    __array_ufunc__ = None

    def __mul__(self, matrix: Matrix | float) -> Affine:
        D = np.atleast_2d(np.asarray(matrix))
        return Affine(np.zeros(D.shape), (), {self.name: D})

    __rmul__ = __mul__


def _product(left: Affine, right: Affine) -> Affine:
    """Product of two expressions of which one is constant."""
    if not right.products and not right.scalars:
        return left @ right.constant
    if not left.products and not left.scalars:
        return right.__rmatmul__(left.constant)
    unknowns = sorted({v.name for _, v, _, _ in (*left.products, *right.products)})
    raise ValueError(
        f"LMI expression: product of two unknowns (among {unknowns}) is bilinear; "
        "change variables or fix one of the factors to a matrix"
    )


def affine(value: Affine | Scalar | Matrix | float, shape: tuple[int, int] | None = None) -> Affine:
    """Return `value` as an expression; 0 becomes a zero matrix of `shape`."""
    if isinstance(value, Affine):
        return value
    if isinstance(value, Scalar):
        return value * np.eye(1)
    array = np.asarray(value)
    if array.ndim == 0 and shape is not None:
        if array != 0:
            raise ValueError("LMI expression: only 0 may stand for a matrix; write a number times np.eye(n)")
        array = np.zeros(shape)
    return Affine(np.atleast_2d(array))


def bmat(rows: Sequence[Sequence[Affine | Scalar | Matrix | float]]) -> Affine:
    """Return the block matrix; 0 stands for a zero block where its row and column tell the size."""
    grid = [[entry if _is_zero(entry) else affine(entry) for entry in row] for row in rows]  # type: ignore[arg-type]
    heights = [_common(row, 0) for row in grid]
    widths = [_common(column, 1) for column in zip(*grid, strict=True)]
    top, left = np.cumsum([0, *heights]), np.cumsum([0, *widths])
    total = Affine(np.zeros((top[-1], left[-1])))
    for i, row in enumerate(grid):
        place_row = np.eye(top[-1])[:, top[i] : top[i + 1]]
        for j, entry in enumerate(row):
            if isinstance(entry, Affine):
                if entry.shape != (heights[i], widths[j]):
                    raise ValueError(
                        f"bmat: block ({i + 1}, {j + 1}) is {entry.shape}, its row and column require "
                        f"({heights[i]}, {widths[j]})"
                    )
                total = total + place_row @ (entry @ np.eye(left[-1])[left[j] : left[j + 1]])
    return total


def _is_zero(entry: object) -> bool:
    return isinstance(entry, int | float) and entry == 0


def _common(entries: Iterable[Any], axis: int) -> int:
    """Size of a block row or column, from its first block that is not a plain 0."""
    for entry in entries:
        if isinstance(entry, Affine):
            return entry.shape[axis]
    raise ValueError("bmat: a row or column holds only zeros; write np.zeros((rows, cols)) in one place")


@dataclass(frozen=True)
class Linear:
    """A linear objective: sum trace(G^T V) + sum c g."""

    matrices: Mapping[str, Matrix]
    scalars: Mapping[str, float]

    def __add__(self, other: Linear | Scalar) -> Linear:
        other = linear(other)
        matrices, scalars = dict(self.matrices), dict(self.scalars)
        for k, G in other.matrices.items():
            matrices[k] = matrices[k] + G if k in matrices else G
        for k, c in other.scalars.items():
            scalars[k] = scalars.get(k, 0.0) + c
        return Linear(matrices, scalars)

    __radd__ = __add__

    def __mul__(self, factor: float) -> Linear:
        return Linear(
            {k: factor * G for k, G in self.matrices.items()},
            {k: factor * c for k, c in self.scalars.items()},
        )

    __rmul__ = __mul__


def linear(value: Linear | Scalar) -> Linear:
    """Return a scalar unknown as an objective."""
    return Linear({}, {value.name: 1.0}) if isinstance(value, Scalar) else value


def trace(expression: Affine) -> Linear:
    """Return the trace of a square expression as an objective (its constant is left out)."""
    if expression.shape[0] != expression.shape[1]:
        raise ValueError(f"trace: {expression.shape} is not square")
    matrices: dict[str, Matrix] = {}
    for L, v, transposed, R in expression.products:
        G = np.real(R @ L) if transposed else np.real(R @ L).T
        matrices[v.name] = matrices.get(v.name, 0.0) + G
    return Linear(matrices, {g: float(np.trace(D).real) for g, D in expression.scalars.items()})


class Program:
    """Collects unknowns, inequalities and an objective; `problem()` compiles them."""

    def __init__(self) -> None:
        self._variables: list[MatrixVariable] = []
        self._scalars: list[str] = []
        self._blocks: list[BlockLMI] = []
        self._objective = Linear({}, {})

    def symmetric(self, name: str, size: int) -> Affine:
        """Add a symmetric unknown (size, size)."""
        return self._variable(MatrixVariable(name, size, size, True))

    def matrix(self, name: str, rows: int, cols: int) -> Affine:
        """Add an unknown (rows, cols)."""
        return self._variable(MatrixVariable(name, rows, cols, False))

    def scalar(self, name: str) -> Scalar:
        """Add a real unknown."""
        self._scalars.append(name)
        return Scalar(name)

    def _variable(self, v: MatrixVariable) -> Affine:
        self._variables.append(v)
        return Affine(np.zeros((v.rows, v.cols)), [(np.eye(v.rows), v, False, np.eye(v.cols))])

    def require(self, name: str, expression: Affine) -> None:
        """Require the Hermitian `expression` >= 0.

        Raises
        ------
        ValueError
            If the expression is not Hermitian (shown by a trial value).
        """
        self._blocks.append(compile_block(name, expression))

    def minimise(self, objective: Linear | Scalar) -> None:
        """Add to the objective."""
        self._objective = self._objective + objective

    def problem(self) -> Problem:
        """Return the compiled problem."""
        return Problem(
            tuple(self._variables),
            tuple(self._scalars),
            tuple(self._blocks),
            dict(self._objective.matrices),
            dict(self._objective.scalars),
        )


def compile_block(name: str, expression: Affine) -> BlockLMI:
    """Return the inequality ``expression >= 0`` with as few terms as merging finds.

    A Hermitian S equals (S + S^H) / 2, so every product L V R of S becomes half
    a term L V R + h.c.; the half from the mirrored place merges with it.
    """
    rows, cols = expression.shape
    if rows != cols:
        raise ValueError(f"LMI {name!r}: expression is {rows} x {cols}, wanted square")
    _check_hermitian(name, expression)
    merged: dict[str, list[tuple[Matrix, Matrix]]] = {}
    for L, v, transposed, R in expression.products:
        pair = (R.conj().T, L.conj().T) if transposed else (L, R)
        _merge(merged.setdefault(v.name, []), 0.5 * pair[0], pair[1], v.symmetric)
    terms = []
    for variable, pairs in merged.items():
        for L, R in _settle(pairs):
            terms.append(Term(variable, _real_if_real(L), _real_if_real(R)))
    halves = {g: _real_if_real((D + D.conj().T) / 2) for g, D in expression.scalars.items()}
    constant = _real_if_real((expression.constant + expression.constant.conj().T) / 2)
    return BlockLMI(name, constant, tuple(terms), {g: D for g, D in halves.items() if np.any(D)})


def _check_hermitian(name: str, expression: Affine) -> None:
    """Try the expression at pseudo-random unknowns; the LMI layer cannot see a sign slip otherwise."""
    generator = np.random.default_rng(1)
    values: dict[str, Matrix] = {}
    for _, v, _, _ in expression.products:
        if v.name not in values:
            V = generator.standard_normal((v.rows, v.cols))
            values[v.name] = V + V.T if v.symmetric else V
    S = expression.value(values, {g: float(generator.standard_normal()) for g in expression.scalars})
    skew = float(np.abs(S - S.conj().T).max(initial=0.0))
    if not skew <= 1e-9 * (1.0 + float(np.abs(S).max(initial=0.0))):
        raise ValueError(
            f"LMI {name!r}: expression is not Hermitian (differs from its transpose by {skew:.3g})"
        )


def _merge(pairs: list[tuple[Matrix, Matrix]], L: Matrix, R: Matrix, symmetric: bool) -> None:
    """Add the half-term (L, R) to the list, joining it with one that shares a factor."""
    candidates = [(L, R), (R.conj().T, L.conj().T)] if symmetric else [(L, R)]
    for k, (L0, R0) in enumerate(pairs):
        for L1, R1 in candidates:
            factor = _multiple(L1, L0)
            if factor is not None:
                pairs[k] = (L0, R0 + factor * R1)
                return
            factor = _multiple(R1, R0)
            if factor is not None:
                pairs[k] = (L0 + factor * L1, R0)
                return
    pairs.append((L, R))


def _settle(pairs: list[tuple[Matrix, Matrix]]) -> list[tuple[Matrix, Matrix]]:
    """Merge until nothing merges any more and drop what cancelled."""
    while True:
        again: list[tuple[Matrix, Matrix]] = []
        for L, R in pairs:
            if np.any(L) and np.any(R):
                _merge(again, L, R, False)
        if len(again) == len(pairs):
            return again
        pairs = again


def _multiple(P: Matrix, Q: Matrix) -> complex | None:
    """Return the number c with P = c Q (to rounding), or None."""
    norm = np.vdot(Q, Q).real
    if norm == 0.0:
        return None
    c = complex(np.vdot(Q, P) / norm)
    if c == 0 or not np.allclose(P, c * Q, rtol=1e-13, atol=1e-13 * float(np.abs(P).max())):
        return None
    return c


def _real_if_real(a: Matrix) -> Matrix:
    return np.ascontiguousarray(a.real) if np.iscomplexobj(a) and not np.any(a.imag) else a
