"""Solve an LMI problem with one of the engines, and check what it claims.

Engines
-------
structured : the primal-dual interior-point method of `interior_point`, which keeps
    the products L V R; the default at every size.
clarabel : cvxpy + Clarabel, generic; the cross-check.

Both run with BLAS pinned to one thread: the wheels of numpy and scipy carry
thread pools of their own that fight over the cores on small matrices.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import replace

import numpy as np

from interarea.models.threads import one_blas_thread

from .problem import BlockLMI, MatrixVariable, Problem, Solution

ENGINES = ("structured", "clarabel")


_RECORD: ContextVar[list[tuple[Problem, Solution]] | None] = ContextVar("record", default=None)


@contextmanager
def recorded() -> Iterator[list[tuple[Problem, Solution]]]:
    """Collect every problem that `solve` is given inside the block, with its solution, in order."""
    record: list[tuple[Problem, Solution]] = []
    token = _RECORD.set(record)
    try:
        yield record
    finally:
        _RECORD.reset(token)


def solve(problem: Problem, engine: str = "structured", *, tolerance: float = 1e-7) -> Solution:
    """Solve `problem`.

    Parameters
    ----------
    problem : what to solve.
    engine : "structured" or "clarabel".
    tolerance : relative duality gap asked for.

    Returns
    -------
    Solution
        With status "failed" where the engine's "optimal" violates a block by
        more than rounding; use `usable` before building on it.

    Raises
    ------
    ValueError
        If the engine is unknown.
    """
    if engine not in ENGINES:
        raise ValueError(f"solve: engine is {engine!r}, allowed: {', '.join(ENGINES)}")
    with one_blas_thread():
        if engine == "structured":
            from .interior_point.engine import solve_structured

            solution = solve_structured(problem, tolerance=tolerance)
        else:
            from .clarabel_engine import solve_clarabel

            solution = solve_clarabel(problem, tolerance=min(tolerance, 1e-8))
        if solution.status in ("optimal", "almost optimal"):
            worst = violation(problem, solution)
            if not worst <= 1e-5:
                text = f"{solution.message}; a block is violated by {worst:.2g} of its size"
                solution = replace(solution, status="failed", message=text)
    record = _RECORD.get()
    if record is not None:
        record.append((problem, solution))
    return solution


def violation(problem: Problem, solution: Solution) -> float:
    """Return the largest -lambda_min(S_k) / max(1, |S_k|) of the blocks: <= 0 if all hold, NaN is inf."""
    worst = -np.inf
    for block in problem.blocks:
        S = block.value(solution.values, solution.scalars)
        if not np.all(np.isfinite(S)):
            return float("inf")
        lam = np.linalg.eigvalsh(S)
        worst = max(worst, float(-lam[0] / max(abs(lam[0]), abs(lam[-1]), 1.0)))
    return float(worst)


def usable(problem: Problem, solution: Solution, *, rounding: float = 1e-7) -> bool:
    """Return whether a controller may be recovered from the solution: its blocks hold to rounding.

    Generic engines end a hair outside the cone. Whoever uses this closes the loop and checks it.
    """
    if solution.status not in ("optimal", "almost optimal") or not np.isfinite(solution.objective):
        return False
    return violation(problem, solution) <= rounding


def elastic(problem: Problem, *, bound: float = 1.0) -> Problem:
    """Return the problem "how far is it from feasible": minimise t with S_k + t |C_k| I >= 0, t >= -bound.

    A positive optimum proves that the blocks cannot all hold, and its
    multipliers are the certificate: sum_k <Z_k, S_k(.)> is constant and negative.
    """
    name = "t"
    while name in problem.scalars or name in {v.name for v in problem.variables}:
        name += "'"
    blocks = []
    for b in problem.blocks:
        size = max(1.0, float(np.linalg.norm(b.constant, 2)))
        blocks.append(replace(b, scalars={**b.scalars, name: size * np.eye(b.size)}))
    floor = BlockLMI(f"{name} >= -{bound:g}", bound * np.eye(1), (), {name: np.eye(1)})
    variables: tuple[MatrixVariable, ...] = problem.variables
    return Problem(variables, (*problem.scalars, name), (*blocks, floor), {}, {name: 1.0})


def infeasibility(problem: Problem, engine: str = "structured") -> float:
    """Return the smallest t of `elastic`: > 0 if the problem is infeasible, < 0 if strictly feasible.

    Raises
    ------
    SolverError
        If the engine gives no answer to the elastic problem, which always has one.
    """
    from ..errors import SolverError

    solution = solve(elastic(problem), engine)
    if solution.status not in ("optimal", "almost optimal"):
        raise SolverError(
            f"elastic LMI problem: {engine} stopped with {solution.status} ({solution.message})"
        )
    return solution.objective
