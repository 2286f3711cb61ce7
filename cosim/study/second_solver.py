"""Every LMI that the study's controllers come from, solved again by cvxpy with Clarabel: a second opinion.

The designs are made again with their problems recorded, and each problem goes to Clarabel as well, in
coordinates that fit our solution (`design/lmi/scaling.py`): without them Clarabel gives no answer to two of
the fault-tolerant design, 2 and 4. What both found is put back into the inequalities by this package, not by
either solver.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from interarea.design.errors import SolverError
from interarea.design.lmi.clarabel_engine import solve_clarabel
from interarea.design.lmi.problem import Problem, Solution
from interarea.design.lmi.scaling import rescaled
from interarea.design.lmi.solve import recorded, violation
from interarea.design.synthesis.study_designs import StudySpec
from interarea.fmu_build.write.cache import cached_json, code_hash, content_hash, numerics_versions
from interarea.models.case.case import load_case
from interarea.models.threads import one_thread

from ..run.artefacts import plant_fmu
from ..run.controllers import designed_anew

#: most by which the objectives may differ, relative to 1 + |objective|
TOLERANCE = 1e-6
#: after which Clarabel is said to have no answer, s
TIME_LIMIT_S = 120.0


def second_solver_record(
    case_name: str, names: Sequence[str], specs: Mapping[str, StudySpec], cache: Path
) -> dict[str, Any]:
    """Return `tolerance`, `time_limit_s` and `rows`, one for each LMI of the named controllers.

    Each row: controller, problem (counted from 1), unknowns, `objective` of both solvers, `difference`
    relative to 1 + |objective| (None where Clarabel gave no answer), `violation` of both (largest part of its
    size by which a block fails to be positive; below 0 it is strictly inside), `seconds` of both, `status`.

    Raises
    ------
    SolverError : the solvers disagree by more than the tolerance.
    """
    case = load_case(case_name)
    key = content_hash(
        plant_fmu(case, cache).name,
        [list(names), {name: asdict(spec) for name, spec in specs.items()}],
        [TOLERANCE, TIME_LIMIT_S],
        code_hash(__name__),
        code_hash("interarea.design.synthesis.study_designs"),
        numerics_versions(),
    )

    def make() -> list[dict[str, Any]]:
        rows = []
        for name in names:
            with recorded() as record:
                designed_anew(case, name, cache, specs)
            rows += [compared(name, k + 1, problem, solution) for k, (problem, solution) in enumerate(record)]
        return rows

    with one_thread():
        rows = cached_json(cache, "second-solver", key, make)
    return {"tolerance": TOLERANCE, "time_limit_s": TIME_LIMIT_S, "rows": rows}


def compared(
    name: str, number: int, problem: Problem, first: Solution, *, time_limit_s: float = TIME_LIMIT_S
) -> dict[str, Any]:
    """Return one row of `second_solver_record`; see there."""
    stated, back = rescaled(problem, first) if first.values else (problem, lambda solution: solution)
    second = back(solve_clarabel(stated, time_limit_s=time_limit_s))
    solved = second.status in ("optimal", "almost optimal")
    difference = None
    if solved:
        difference = (second.objective - first.objective) / (1.0 + abs(first.objective))
        if not abs(difference) <= TOLERANCE:
            raise SolverError(
                f"{name}, LMI {number}: the structured engine ends at {first.objective:.6g}, Clarabel at "
                f"{second.objective:.6g}; they differ by {difference:.2g}, allowed is {TOLERANCE:g}"
            )
    return {
        "controller": name,
        "problem": number,
        "unknowns": sum(v.size for v in problem.variables) + len(problem.scalars),
        "objective": [first.objective, second.objective if solved else None],
        "difference": difference,
        "violation": [violation(problem, first), violation(problem, second) if solved else None],
        "seconds": [first.seconds, second.seconds],
        "status": second.status if solved else f"no answer: {second.message}",
    }
