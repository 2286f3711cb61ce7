"""The best own-signal rival of a design, by a longer search than that of `certify --worth`.

Run `python benchmarks/control/own_signal_rival.py [NAME] [--starts 7] [--perturbed 5] [--wired] [--out
FILE.json]`: every actuator sees its own machine alone; order, effort, points and what they ask are those of
the design, and so are the latencies of all signals, unless they are `--wired`: neither late nor lost. Random
starts are searched to their ends by L-BFGS, then by Newton steps on an ever sharper worst damping. Then the
best is perturbed and searched again, because most random starts end with an eigenvalue on the imaginary
axis. A row each. At the end the best, on the full models, also with all signals late, with each lost and
with each twice as large: what a link would have to add.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from interarea.cosim.designs.design_file import DesignTable, judge, load_design
from interarea.cosim.designs.family import family_plants
from interarea.cosim.designs.worth import clearing_change, rival_table
from interarea.design.controllers.controller import Controller
from interarea.design.linear.linearise import with_input
from interarea.design.robust.design import (
    _descend,
    _descend_briefly,
    _stable_start,
    _with_washout,
    balanced_parameters,
)
from interarea.design.robust.design_models import build_objective
from interarea.design.robust.newton import newton_descent
from interarea.design.robust.smoothed_objective import Array, Objective
from interarea.design.robust.stages import stabilised
from interarea.fmu_build.write.cache import default_cache
from interarea.models.threads import one_thread

RHO = (30.0, 100.0, 300.0, 900.0)  #: how closely the smoothed worst follows the worst, one after the other
ROUNDS, STEPS = 8, 6  #: of Newton steps at each
GAINED = 2e-4  #: by a round, or the next value of `RHO` follows
#: first letter of a condition -> what it is; the others have all signals late
_KINDS = {"N": "nothing", "L": "one lost", "x": "one doubled"}


def searched(objective: Objective, start: Array, rounds: int) -> Array:
    """Return where a start ends: L-BFGS of so many rounds, then Newton steps at each of `RHO`."""
    smooth = replace(objective, rho=100.0)
    theta, _ = stabilised(smooth, start, _descend_briefly)
    theta, _ = _descend(smooth, theta, rounds)
    for rho in RHO:
        sharp = replace(objective, rho=rho)
        for _ in range(ROUNDS):
            stepped, _ = newton_descent(sharp, theta, STEPS, balanced=balanced_parameters)
            gained = sharp.value(theta) - sharp.value(stepped)
            theta = stepped if gained > 0.0 else theta
            if not gained > GAINED:
                break
    return theta


def perturbed(objective: Objective, theta: Array, seed: int) -> Array:
    """Return a controller near another, stable in every model, with somewhat other gains and poles."""
    rng = np.random.default_rng(seed)
    A, B, C, D = (M.copy() for M in objective.unpack(theta))
    size = 0.3 if seed % 2 else 0.7
    for states in objective.parts:
        C[:, states] *= np.exp(size * rng.normal() - 0.3)
        A[np.ix_(states, states)] *= np.exp(0.3 * size * rng.normal(size=(len(states), len(states))))
    start = objective.pack(A, B, C, D)
    for _ in range(40):
        if objective.worst(start)[0] < 1e-6:
            break
        A, B, C, D = objective.unpack(start)
        start = objective.pack(A, B, 0.7 * C, 0.7 * D)
    return start


def ends(objective: Objective, starts: int, again: int) -> Iterator[tuple[str, Array]]:
    """Yield what each start was and where it ended; perturbed ones begin at the best so far."""
    sharp = replace(objective, rho=RHO[-1])
    best: Array | None = None
    for seed in range(1, starts + 1):
        theta = searched(objective, _stable_start(objective, np.random.default_rng(seed)), 4)
        best = theta if best is None or sharp.value(theta) < sharp.value(best) else best
        yield f"random {seed}", theta
    if best is None:
        return
    for seed in range(again):
        yield f"perturbed {seed}", searched(objective, perturbed(objective, best, seed), 1)


def judged(table: DesignTable, rival: Controller, conditions: tuple[str, ...]) -> Iterator[str]:
    """Yield a row for each kind of condition, on points that ask what the design does and on the others."""
    whole = table.model_copy(update={"conditions": conditions})
    full = {point.name for point in table.point if point.ask is None}
    least: dict[tuple[str, str], list[tuple[float, float, bool]]] = defaultdict(list)
    for row in judge(whole, rival.system, default_cache()).rows:
        points = "the design's points" if row.point in full else "points that ask less"
        kind = _KINDS.get(row.condition[0], row.condition)
        least[points, kind].append((row.inter_area, row.worst_swing, row.stable))
    for (points, kind), rows in least.items():
        inter_area, swing, _ = np.min(rows, axis=0)
        unstable = sum(not stable for _, _, stable in rows)
        yield f"{points:22s} {kind:12s} {inter_area:8.4f} {swing:8.4f} {unstable:4d} of {len(rows)} unstable"


def main() -> None:
    """Search from every start, then judge the best."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("name", nargs="?", default="new_england")
    parser.add_argument("--starts", type=int, default=7)
    parser.add_argument("--perturbed", type=int, default=5)
    parser.add_argument("--wired", action="store_true", help="no latency in the search")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    table = rival_table(load_design(options.name))
    late = tuple(code for code in table.conditions if code != "N")
    table = table.model_copy(update={"conditions": ("N",)}) if options.wired else table
    with one_thread():
        plants, spec = family_plants(table, default_cache()), table.spec()
        objective = build_objective(
            {name: plant.searched for name, plant in plants.items()}, spec, table.grid.omega_b
        )
        sharp, rows = replace(objective, rho=RHO[-1]), []
        for what, theta in ends(objective, options.starts, options.perturbed):
            rows.append((sharp.value(theta), theta))
            print(f"{what:14s} {rows[-1][0]:8.4f} {time.process_time():6.0f} s", flush=True)
        theta = balanced_parameters(objective, min(rows, key=lambda row: row[0])[1])
        guard = None if table.guard is None else table.guard.guard()
        system = with_input(_with_washout(objective.unpack(theta), spec), guard.follows if guard else None)
        rival = Controller(table.name, system, table.limit_pu, {}, guard=guard)
        own = [f"{kind}:{signal}" for kind in ("L", "x2") for signal in spec.signals]
        for row in judged(table, rival, ("N", *late, *own)):
            print(row)
        if table.acceptance is not None:
            change = clearing_change(table, rival, default_cache())
            print("mean change of clearing times: " + ("none" if change is None else f"{change:+.2f} cycles"))
    if options.out is not None:
        rival.save(options.out)


if __name__ == "__main__":
    main()
