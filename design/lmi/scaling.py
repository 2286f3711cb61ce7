"""An LMI problem in other coordinates: those in which a given solution has unknowns and blocks of size one.

Lyapunov matrices of control designs are near singular at the optimum, where a generic solver loses its last
digits or stops. The problem in other coordinates is the same one, exactly.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from .problem import BlockLMI, Matrix, MatrixVariable, Problem, Solution, Term

#: least eigenvalue of an unknown or of a block, relative to its largest, that is still scaled to one
FLOOR = 1e-2
_LEAST = 1e-12  # of a diagonal entry of a block


def rescaled(problem: Problem, near: Solution) -> tuple[Problem, Callable[[Solution], Solution]]:
    """Return `problem` with unknowns V = P W Q and blocks T S T^H, and what takes a solution back.

    near : values and scalars at which the unknowns W and the blocks have sizes of about one; it decides the
    coordinates alone, not what is found. P and Q are roots of a symmetric V, numbers of another; T is the
    root of the inverse of S. The multipliers are not taken back.
    """
    sides = {v.name: _sides(v, np.asarray(near.values[v.name])) for v in problem.variables}
    blocks = tuple(_block(b, near, sides) for b in problem.blocks)
    objective = {k: sides[k][0].T @ G @ sides[k][1].T for k, G in problem.objective_matrices.items()}

    def back(solution: Solution) -> Solution:
        values = {k: sides[k][0] @ W @ sides[k][1] for k, W in solution.values.items()}
        return replace(solution, values=values, multipliers=None)

    return replace(problem, blocks=blocks, objective_matrices=objective), back


def _sides(variable: MatrixVariable, V: Matrix) -> tuple[Matrix, Matrix]:
    """P and Q of an unknown."""
    if variable.symmetric:
        sizes, U = np.linalg.eigh(V)
        P = U * np.sqrt(_floored(np.abs(sizes)))
        return P, P.T
    size = np.sqrt(float(np.linalg.norm(V, 2)) or 1.0)
    return size * np.eye(variable.rows), size * np.eye(variable.cols)


def _block(block: BlockLMI, near: Solution, sides: Mapping[str, tuple[Matrix, Matrix]]) -> BlockLMI:
    """T S T^H of a block."""
    S = block.value(near.values, near.scalars)
    d = 1.0 / np.sqrt(np.maximum(np.abs(np.diag(S)), _LEAST))
    sizes, U = np.linalg.eigh(d[:, None] * S * d)
    T = (U / np.sqrt(_floored(np.abs(sizes)))).conj().T * d

    def turned(M: Matrix) -> Matrix:
        result = T @ M @ T.conj().T
        return np.asarray((result + result.conj().T) / 2)

    terms = tuple(
        Term(t.variable, T @ t.left @ sides[t.variable][0], sides[t.variable][1] @ t.right @ T.conj().T)
        for t in block.terms
    )
    return BlockLMI(
        block.name, turned(block.constant), terms, {g: turned(D) for g, D in block.scalars.items()}
    )


def _floored(sizes: Matrix) -> Matrix:
    """Sizes of at least FLOOR of the largest, 1 where all are 0."""
    largest = float(sizes.max(initial=0.0))
    return np.maximum(sizes, FLOOR * largest) if largest > 0.0 else np.ones_like(sizes)
