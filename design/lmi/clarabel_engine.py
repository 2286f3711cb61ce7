"""Solve an LMI problem with cvxpy and Clarabel: the generic engine, cross-check of the structured one.

cvxpy receives every block in its real form (a complex Hermitian n x n block
becomes a real symmetric 2n x 2n one) as ``constant + E + E' >> 0``.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import cvxpy as cp
import numpy as np

from .problem import BlockLMI, Matrix, Problem, Solution
from .regions import real_form

#: What the statuses of cvxpy mean here.
_STATUS = {
    cp.OPTIMAL: "optimal",
    cp.OPTIMAL_INACCURATE: "almost optimal",
    cp.INFEASIBLE: "infeasible",
    cp.INFEASIBLE_INACCURATE: "infeasible",
}


def _multipliers(constraints: Sequence[Any], problem: Problem) -> tuple[Any, ...] | None:
    """Return the multiplier of each block, complex ones folded back; None where Clarabel gave none."""
    if any(c.dual_value is None for c in constraints):
        return None
    return tuple(
        _fold(np.asarray(c.dual_value, dtype=float), b)
        for c, b in zip(constraints, problem.blocks, strict=True)
    )


def _complementarity(
    multipliers: Sequence[Any], problem: Problem, values: Mapping[str, Matrix], numbers: Mapping[str, float]
) -> float:
    """Return how far the products of multipliers and blocks add up to nothing."""
    pairs = zip(multipliers, problem.blocks, strict=True)
    return abs(sum(float(np.vdot(Z, b.value(values, numbers)).real) for Z, b in pairs))


def solve_clarabel(
    problem: Problem,
    *,
    tolerance: float = 1e-8,
    method: str = "auto",
    iterations: int = 200,
    time_limit_s: float | None = None,
) -> Solution:
    """Solve `problem` with Clarabel through cvxpy.

    Parameters
    ----------
    problem : what to solve.
    tolerance : relative and absolute gap and feasibility asked of Clarabel.
    method : Clarabel's `direct_solve_method`, e.g. "auto", "qdldl", "faer".
    iterations : most iterations. time_limit_s : of Clarabel, s; the solution it has then is none.

    Returns
    -------
    Solution
        The multipliers of complex blocks are folded back to n x n Hermitian.
    """
    started = time.perf_counter()
    program, unknowns, scalars = _program(problem)
    options = {
        "direct_solve_method": method,
        "max_iter": iterations,
        "tol_gap_abs": tolerance,
        "tol_gap_rel": tolerance,
        "tol_feas": tolerance,
    }
    if time_limit_s is not None:
        options["time_limit"] = time_limit_s
    message = _run(program, options)
    status = _STATUS.get(str(program.status), "failed")
    count = program.solver_stats.num_iters if program.solver_stats is not None else 0
    values: Mapping[str, Matrix] = {}
    numbers: Mapping[str, float] = {}
    value = gap = float("nan")
    multipliers = None
    if status in ("optimal", "almost optimal"):
        if all(v.value is not None for v in program.variables()):
            values = {k: np.asarray(v.value, dtype=float) for k, v in unknowns.items()}
            numbers = {g: float(v.value) for g, v in scalars.items()}
            value = problem.objective(values, numbers)
            multipliers = _multipliers(program.constraints, problem)
        else:
            status = "failed"
    if multipliers is not None:
        gap = _complementarity(multipliers, problem, values, numbers) / (1.0 + abs(value))
    return Solution(
        status=status,
        values=values,
        scalars=numbers,
        objective=value,
        gap=gap,
        iterations=int(count or 0),
        seconds=time.perf_counter() - started,
        engine="clarabel",
        multipliers=multipliers,
        message=message,
    )


def _program(problem: Problem) -> tuple[cp.Problem, dict[str, cp.Variable], dict[str, cp.Variable]]:
    """The problem for cvxpy, one constraint for each block, with its matrices and its numbers by name."""
    unknowns = {v.name: cp.Variable((v.rows, v.cols), symmetric=v.symmetric) for v in problem.variables}
    scalars = {g: cp.Variable() for g in problem.scalars}
    constraints = [_expression(real_form(b), unknowns, scalars) >> 0 for b in problem.blocks]
    objective = sum((cp.sum(cp.multiply(G, unknowns[k])) for k, G in problem.objective_matrices.items()), 0.0)
    objective = objective + sum(c * scalars[g] for g, c in problem.objective_scalars.items())
    return cp.Problem(cp.Minimize(objective), constraints), unknowns, scalars


def _run(program: cp.Problem, options: Mapping[str, Any]) -> str:
    """Let Clarabel solve; return what cvxpy says of it."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            program.solve(solver=cp.CLARABEL, **options)
    except cp.error.SolverError as error:
        return f"failed: {error}"
    return str(program.status)


def _expression(
    block: BlockLMI, unknowns: Mapping[str, cp.Variable], scalars: Mapping[str, cp.Variable]
) -> cp.Expression:
    """Return constant + sum (L V R + its transpose) + sum g D."""
    total = cp.Constant(block.constant)
    for term in block.terms:
        product = term.left @ unknowns[term.variable] @ term.right
        total = total + product + product.T
    for g, D in block.scalars.items():
        total = total + scalars[g] * D
    return total


def _fold(Z: Matrix, block: BlockLMI) -> Matrix:
    """Return the n x n Hermitian multiplier with the same inner products as the real 2n x 2n one."""
    Z = (Z + Z.T) / 2
    if not block.is_complex:
        return Z
    n = block.size
    return Z[:n, :n] + Z[n:, n:] + 1j * (Z[n:, :n] - Z[:n, n:])
