"""A structured primal-dual interior-point engine for control LMIs.

Solves a `Problem`

    minimise c'y   subject to   S_k(y) = C_k + F_k(y) >= 0,   k = 1..K,

whose multipliers Z_k >= 0 satisfy F*(Z) = c, by an infeasible-start predictor-corrector
method (Mehrotra) in the Nesterov-Todd direction. The Schur complement keeps the Kronecker structure of
the matrix variables (`schur.py`); what remains is one Cholesky factor of
size m. Once C + F(y) has a Cholesky factor it *is* S, and every later y is strictly feasible.

Where no y satisfies the inequalities, Z tends to a certificate: F*(Z) = 0 and <C, Z> < 0.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from interarea.models.threads import one_blas_thread

from ..problem import BlockLMI, Problem, Solution
from .iteration import Iteration, Progress
from .operators import Vector

__all__ = ["Progress", "solve_structured"]

_Callback = Callable[[Progress], bool | None] | None


def solve_structured(
    problem: Problem,
    *,
    tolerance: float = 1e-7,
    max_iterations: int = 100,
    stop_gap: float | None = None,
    callback: _Callback = None,
) -> Solution:
    r"""Solve an LMI problem by the structured interior-point method.

    Parameters
    ----------
    problem : the problem; blocks real symmetric or complex Hermitian.
    tolerance : relative duality gap :math:`\langle S, Z\rangle / (1 + |c'y|)` to reach.
    max_iterations : most iterations; about 20 are usual.
    stop_gap : stop already at this (larger) gap: recovery of a controller at the exact
        optimum is singular.
    callback : called after every iteration with its `Progress`; a true answer stops the engine.

    Returns
    -------
    Solution
        "optimal": gap and multipliers within `tolerance`, the point strictly feasible by
        Cholesky. "almost optimal": strictly feasible, the optimum known less well, as the message says.
        "infeasible": `multipliers` hold the certificate. "failed": none of these.

    Raises
    ------
    ValueError
        `tolerance` or `max_iterations` not positive.
    """
    if not tolerance > 0.0 or not max_iterations > 0:
        raise ValueError(
            f"structured engine: tolerance {tolerance!r} and max_iterations {max_iterations!r} "
            "must be positive"
        )
    requested = max(tolerance, stop_gap or 0.0)
    with one_blas_thread(), np.errstate(all="ignore"):
        return _solve(problem, requested, max_iterations, callback)


def _solve(problem: Problem, tolerance: float, max_iterations: int, callback: _Callback) -> Solution:
    """Run the iteration; where it ends without a feasible point, look for one first and run again."""
    run = Iteration(problem, tolerance, max_iterations, callback)
    first = run.solve()
    if run.exact or run.stopped or first.status != "failed":
        return first
    search, feasible = _phase_one(problem, run, max_iterations)
    spent = first.iterations + search.iterations
    if feasible is None:
        return replace(
            first,
            status="infeasible" if search.status == "infeasible" else "failed",
            multipliers=search.multipliers if search.status == "infeasible" else first.multipliers,
            message=search.message if search.status == "infeasible" else first.message,
            iterations=spent,
            seconds=first.seconds + search.seconds,
        )
    again = Iteration(problem, tolerance, max_iterations, callback, start=feasible).solve()
    seconds = first.seconds + search.seconds + again.seconds
    return replace(again, iterations=spent + again.iterations, seconds=seconds)


def _phase_one(problem: Problem, run: Iteration, max_iterations: int) -> tuple[Solution, Vector | None]:
    """Minimise t subject to S_k(y) + t I >= 0, t >= -b, from where `run` ended; return y once t < 0.

    Its multipliers satisfy F*(Z) = 0 and <C, Z> = -t: with t > 0 they are the certificate.
    """
    name = "t"
    while name in problem.scalars or any(name == v.name for v in problem.variables):
        name += "_"
    y = run.y if np.all(np.isfinite(run.y)) else np.zeros_like(run.y)
    blocks = [C + F for C, F in zip(run.affine.constants, run.affine.apply(y), strict=True)]
    lowest = min(float(np.linalg.eigvalsh(S)[0]) for S in blocks)
    size = max(1e-6 * max(float(np.linalg.norm(S)) for S in blocks), -2.0 * lowest)
    elastic = Problem(
        variables=problem.variables,
        scalars=(*problem.scalars, name),
        blocks=(
            *(replace(b, scalars={**b.scalars, name: np.eye(b.size)}) for b in problem.blocks),
            BlockLMI("floor", np.array([[size]]), (), {name: np.eye(1)}),
        ),
        objective_scalars={name: 1.0},
    )
    below = 0

    def enough(progress: Progress) -> bool:
        nonlocal below
        below += progress.objective < 0.0
        return below > 3 or progress.objective < -0.3 * size

    search = Iteration(elastic, 1e-6, max_iterations, enough, start=np.append(y, size))
    phase_one = search.solve()
    if search.exact and search.y[-1] < 0.0:
        return phase_one, search.y[:-1]
    certificate = run.farkas(list(phase_one.multipliers or ())[: len(problem.blocks)])
    if certificate is None:
        return replace(phase_one, status="failed"), None
    return replace(phase_one, status="infeasible", multipliers=tuple(certificate), message=run.verdict), None
