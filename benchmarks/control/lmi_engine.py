"""Time the structured interior-point engine against cvxpy + Clarabel on the same problems, in one run.

    python benchmarks/control/lmi_engine.py                     # every order, Clarabel up to n = 16 (minutes)
    python benchmarks/control/lmi_engine.py --clarabel-up-to 11
    python benchmarks/control/lmi_engine.py --random 300    # random plants against their Riccati levels
    python benchmarks/control/lmi_engine.py --ftc           # every half-step of the fault-tolerant design

Structured: median of `--repeats` runs, interleaved with Clarabel's one run (default settings). Every row says
whether the point returned is strictly feasible by its own eigenvalues, not by the engine's word.
`floor`: time of the m x m Cholesky factors alone, the least any method with this Schur complement needs.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from pathlib import Path

import numpy as np
from lmi_problems import (
    ORDERS,
    osborne,
    output_feedback_problem,
    random_plant,
    riccati_level,
    sensitivity_plant,
)
from scipy.linalg import lapack
from threadpoolctl import threadpool_limits

from interarea.cosim.run.artefacts import linear_plant
from interarea.design.linear.linearise import remove_reference
from interarea.design.lmi.clarabel_engine import solve_clarabel
from interarea.design.lmi.interior_point.engine import solve_structured
from interarea.design.lmi.problem import Problem, Solution
from interarea.design.lmi.solve import usable
from interarea.design.synthesis import fault_tolerant as synthesis_ftc
from interarea.design.synthesis.study_designs import design_ftc
from interarea.fmu_build.write.cache import default_cache
from interarea.models.case.case import load_case

#: Times Clarabel that the structured engine has to reach, by order.
LIMITS_S = {11: 30.0, 14: 50.0, 16: 100.0}
#: Times its own n = 11 that it may take, by order.
ALLOWED = {20: 5.0, 30: 20.0}


def smallest_margin(problem: Problem, solution: Solution) -> float:
    """Return the smallest eigenvalue over all blocks at the solution."""
    values = (block.value(solution.values, solution.scalars) for block in problem.blocks)
    return min(float(np.linalg.eigvalsh(S)[0]) for S in values)


def cholesky_seconds(m: int) -> float:
    """Return the time of one Cholesky factor of order m on one thread."""
    H = np.eye(m, order="F") * 4.0 + 1.0 / m
    times = []
    for _ in range(3):
        start = time.perf_counter()
        lapack.dpotrf(H, lower=1, clean=0)
        times.append(time.perf_counter() - start)
    return min(times)


def compare(order: int, repeats: int, with_clarabel: bool) -> dict[str, object]:
    """Solve one order with both engines and return its row."""
    problem = output_feedback_problem(sensitivity_plant(order))
    times = []
    solution = solve_structured(problem)
    clarabel = None
    for k in range(repeats):
        start = time.perf_counter()
        solution = solve_structured(problem)
        times.append(time.perf_counter() - start)
        if with_clarabel and k == repeats // 2:
            start = time.perf_counter()
            clarabel = solve_clarabel(problem)
            clarabel_seconds = time.perf_counter() - start
    m = sum(v.size for v in problem.variables) + len(problem.scalars)
    row: dict[str, object] = {
        "n": order,
        "m": m,
        "status": solution.status,
        "iterations": solution.iterations,
        "seconds": statistics.median(times),
        "floor": cholesky_seconds(m) * (solution.iterations + 1),
        "gap": solution.gap,
        "margin": smallest_margin(problem, solution),
        "objective": solution.objective,
    }
    if clarabel is not None:
        row |= {
            "clarabel_status": clarabel.status,
            "clarabel_seconds": clarabel_seconds,
            "ratio": clarabel_seconds / statistics.median(times),
            "clarabel_objective": clarabel.objective,
            "clarabel_margin": smallest_margin(problem, clarabel) if clarabel.values else None,
        }
    return row


def random_plants(count: int) -> dict[str, object]:
    """Solve pure H-infinity problems of random plants; compare with their Riccati levels."""
    statuses: dict[str, int] = {}
    above = []
    start = time.perf_counter()
    for seed in range(count):
        plant = osborne(random_plant(seed))
        solution = solve_structured(
            output_feedback_problem(plant, damping_ratio=None, radius=None, weight=0.0)
        )
        statuses[solution.status] = statuses.get(solution.status, 0) + 1
        level = riccati_level(plant)
        above.append((solution.scalars["gamma"] - level) / level if level > 1e-5 else 0.0)
    return {
        "plants": count,
        "statuses": statuses,
        "called infeasible": statuses.get("infeasible", 0),
        "solved": (statuses.get("optimal", 0) + statuses.get("almost optimal", 0)) / count,
        "lowest above Riccati": min(above),
        "share within 1e-4": float(np.mean(np.array(above) < 1e-4)),
        "share within 1e-3": float(np.mean(np.array(above) < 1e-3)),
        "seconds": time.perf_counter() - start,
    }


def ftc_half_steps() -> dict[str, object]:
    """Solve each half-step of the study's fault-tolerant design with both engines, default settings.

    The half-steps are those that the structured engine takes; Clarabel's own iteration takes others, and
    mostly none to its end: a half-step whose answer is not strictly feasible ends it. So the two are given
    the same problems, and every row says what each makes of it.
    """
    case, cache = load_case("two-area-thesis"), default_cache()
    plant = remove_reference(linear_plant(case, cache))
    recorded: list[tuple[Problem, Solution, float]] = []
    inner = synthesis_ftc.solve

    def recording(problem: Problem, engine: str = "structured") -> Solution:
        times = []
        for _ in range(3):
            start = time.process_time()
            solution = inner(problem, engine)
            times.append(time.process_time() - start)
        recorded.append((problem, solution, min(times)))
        return solution

    synthesis_ftc.solve = recording
    try:
        design_ftc(plant, omega_b=case.omega_b)
    finally:
        synthesis_ftc.solve = inner
    own = other = 0.0
    usable_ones = 0
    print("  #     m  structured (s)     objective   Clarabel (s)     objective  status             usable")
    for k, (problem, solution, seconds) in enumerate(recorded, start=1):
        start = time.process_time()
        answer = solve_clarabel(problem)
        taken = time.process_time() - start
        good = bool(answer.values) and usable(problem, answer)
        own, other, usable_ones = own + seconds, other + taken, usable_ones + good
        m = sum(v.size for v in problem.variables) + len(problem.scalars)
        print(
            f"{k:3d} {m:5d}  {seconds:14.3f}  {solution.objective:12.8f}  {taken:13.2f}  "
            f"{answer.objective:12.8f}  {answer.status:17s}  {'yes' if good else 'no'}",
            flush=True,
        )
    return {
        "half-steps": len(recorded),
        "structured seconds": own,
        "Clarabel seconds": other,
        "ratio": other / own,
        "usable answers of Clarabel": usable_ones,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--orders", type=int, nargs="*", default=list(ORDERS))
    parser.add_argument("--clarabel-up-to", type=int, default=16)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--random", type=int, default=0, metavar="COUNT")
    parser.add_argument("--ftc", action="store_true", help="half-steps of the fault-tolerant design")
    parser.add_argument("--out", type=Path, help="write the rows as JSON")
    arguments = parser.parse_args()
    if arguments.random:
        print(json.dumps(random_plants(arguments.random), indent=2))
        return
    if arguments.ftc:
        with threadpool_limits(1):
            print(json.dumps(ftc_half_steps(), indent=2))
        return
    rows = []
    print("   n     m  status   its  seconds   floor      gap   margin     objective  Clarabel (s)  times")
    with threadpool_limits(1):
        for order in arguments.orders:
            row = compare(order, arguments.repeats, order <= arguments.clarabel_up_to)
            rows.append(row)
            line = "{n:4d} {m:5d}  {status:8s}{iterations:4d} {seconds:8.3f} {floor:7.3f}".format(**row)
            line += "  {gap:.1e}  {margin:.1e}  {objective:12.8f}".format(**row)
            if "ratio" in row:
                line += "  {clarabel_status} {clarabel_seconds:.1f}".format(**row)
                line += "  {ratio:.0f}  objective {clarabel_objective:.8f}".format(**row)
            print(line, flush=True)
    seconds = {row["n"]: float(str(row["seconds"])) for row in rows}
    for order, limit in LIMITS_S.items():
        ratio = next((r.get("ratio") for r in rows if r["n"] == order), None)
        if ratio is not None:
            print(f"n = {order}: {ratio:.0f} times faster than Clarabel, wanted {limit:.0f}")
    for order, allowed in ALLOWED.items():
        if order in seconds and 11 in seconds:
            print(f"n = {order}: {seconds[order] / seconds[11]:.1f} times its n = 11, allowed {allowed:.0f}")
    if arguments.out:
        arguments.out.write_text(json.dumps(rows, indent=2), encoding="utf-8")


if __name__ == "__main__":
    main()
