"""A linear matrix inequality problem in matrix variables, and its solution: plain data.

    minimise    sum_V trace(G_V^T V) + sum_g c_g g
    subject to  S_k = C_k + sum_t (L_t V_t R_t + (L_t V_t R_t)^H) + sum_g g D_kg >= 0,   k = 1..K

Variables V are real matrices, scalars g real numbers; C_k and D_kg are real
symmetric or complex Hermitian. A transpose needs no type of its own:
``L V^T R + h.c. = R^H V L^H + h.c.``. `expressions.py` writes such problems as the
papers do, `solve.py` solves them with one of the engines.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

Matrix = npt.NDArray[Any]


@dataclass(frozen=True)
class MatrixVariable:
    """A real matrix unknown; `symmetric` ones are square."""

    name: str
    rows: int
    cols: int
    symmetric: bool

    def __post_init__(self) -> None:
        if self.rows < 1 or self.cols < 1 or (self.symmetric and self.rows != self.cols):
            kind = " symmetric" if self.symmetric else ""
            raise ValueError(
                f"matrix variable {self.name!r}: {self.rows} x {self.cols}{kind} is not a matrix; "
                "give positive sizes, equal if symmetric"
            )

    @property
    def size(self) -> int:
        """Number of free real numbers."""
        return self.rows * (self.rows + 1) // 2 if self.symmetric else self.rows * self.cols


@dataclass(frozen=True)
class Term:
    """Adds ``L V R + (L V R)^H`` to a block: left L (n, rows), right R (cols, n)."""

    variable: str
    left: Matrix
    right: Matrix


@dataclass(frozen=True)
class BlockLMI:
    """One inequality ``constant + sum terms + sum g scalars[g] >= 0``, n x n Hermitian."""

    name: str
    constant: Matrix
    terms: tuple[Term, ...]
    scalars: Mapping[str, Matrix] = field(default_factory=dict)

    @property
    def size(self) -> int:
        """Rows of the block."""
        return int(self.constant.shape[0])

    @property
    def is_complex(self) -> bool:
        """Whether any of the data has an imaginary part."""
        arrays = [self.constant, *self.scalars.values()]
        arrays += [m for t in self.terms for m in (t.left, t.right)]
        return any(np.iscomplexobj(a) for a in arrays)

    def value(self, values: Mapping[str, Matrix], scalars: Mapping[str, float]) -> Matrix:
        """Return S (n, n) at the given matrices and scalars."""
        S = np.array(self.constant, dtype=complex if self.is_complex else float)
        for term in self.terms:
            P = term.left @ values[term.variable] @ term.right
            S += P + P.conj().T
        for name, D in self.scalars.items():
            S += scalars[name] * D
        return np.asarray((S + S.conj().T) / 2)


def _check_constants(block: BlockLMI) -> None:
    """Refuse a constant or a scalar's matrix that is not finite and Hermitian."""
    n = block.size
    for what, a in {"constant": block.constant, **block.scalars}.items():
        if a.shape != (n, n) or not np.all(np.isfinite(a)):
            raise ValueError(f"LMI {block.name!r}: {what} has shape {a.shape}, wanted finite ({n}, {n})")
        if not np.allclose(a, a.conj().T, atol=1e-9 * (1.0 + float(np.abs(a).max(initial=0.0)))):
            raise ValueError(f"LMI {block.name!r}: {what} is not Hermitian; write the symmetric form")


def _check_term(block: BlockLMI, term: Term, v: MatrixVariable) -> None:
    """Refuse a term whose factors do not fit its variable and block."""
    n = block.size
    if term.left.shape != (n, v.rows) or term.right.shape != (v.cols, n):
        raise ValueError(
            f"LMI {block.name!r}: term in {v.name!r} is {term.left.shape} V {term.right.shape}, "
            f"wanted ({n}, {v.rows}) V ({v.cols}, {n})"
        )
    if not (np.all(np.isfinite(term.left)) and np.all(np.isfinite(term.right))):
        raise ValueError(f"LMI {block.name!r}: term in {v.name!r} has numbers that are not finite")


@dataclass(frozen=True)
class Problem:
    """Minimise a linear objective under linear matrix inequalities; checked when made.

    `objective_matrices` adds ``trace(G^T V)`` for each G, `objective_scalars`
    adds ``c g``.
    """

    variables: tuple[MatrixVariable, ...]
    scalars: tuple[str, ...]
    blocks: tuple[BlockLMI, ...]
    objective_matrices: Mapping[str, Matrix] = field(default_factory=dict)
    objective_scalars: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        known = {v.name: v for v in self.variables}
        names = [*known, *self.scalars]
        if len(known) != len(self.variables) or len(set(names)) != len(names):
            raise ValueError(f"LMI problem: names of variables must be unique, got {names}")
        for block in self.blocks:
            _check_constants(block)
            for term in block.terms:
                if term.variable not in known:
                    raise ValueError(f"LMI {block.name!r}: unknown variable {term.variable!r}, known {names}")
                _check_term(block, term, known[term.variable])
            unknown = set(block.scalars) - set(self.scalars)
            if unknown:
                raise ValueError(
                    f"LMI {block.name!r}: unknown scalars {sorted(unknown)}, known {self.scalars}"
                )
        for name, G in self.objective_matrices.items():
            if name not in known or G.shape != (known[name].rows, known[name].cols):
                raise ValueError(f"LMI objective: {name!r} with shape {G.shape} matches no variable")
        if set(self.objective_scalars) - set(self.scalars):
            raise ValueError(f"LMI objective: {sorted(self.objective_scalars)} not all among {self.scalars}")

    def objective(self, values: Mapping[str, Matrix], scalars: Mapping[str, float]) -> float:
        """Return the objective at the given matrices and scalars."""
        matrices = sum(float(np.sum(G * values[k])) for k, G in self.objective_matrices.items())
        return matrices + sum(c * scalars[k] for k, c in self.objective_scalars.items())


@dataclass(frozen=True)
class Solution:
    """What an engine found. The status is its claim, not a verdict: check the blocks (`solve.violation`).

    `multipliers`: one Hermitian Z_k >= 0 per block; for status "infeasible" they
    are the certificate: sum_k <Z_k, .> vanishes on every variable and
    sum_k <Z_k, C_k> < 0.
    """

    status: str  #: "optimal" | "almost optimal" | "infeasible" | "failed"
    values: Mapping[str, Matrix]
    scalars: Mapping[str, float]
    objective: float
    gap: float  #: relative duality gap
    iterations: int
    seconds: float
    engine: str  #: "structured" | "clarabel"
    multipliers: tuple[Matrix, ...] | None = None
    message: str = ""
