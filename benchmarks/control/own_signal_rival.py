"""The best own-signal rival of a design, by a longer search than that of `certify --worth`.

Run `python benchmarks/control/own_signal_rival.py [NAME] [--starts 3] [--minutes 20] [--wired] [--out
FILE.json]`: every actuator sees its own machine alone; order, effort, points and what they ask are those of
the design, and so are the latencies of all signals, unless they are `--wired`: neither late nor lost. The
search is that of the package, with more steps, from the design's controller with its own signals alone and
from first guesses. At the end the best, on the full models, also with all signals late, with each lost and
with each twice as large: what a link would have to add.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from interarea.cosim.designs.design_file import DesignTable, judge, load_design
from interarea.cosim.designs.design_tables import StageTable
from interarea.cosim.designs.worth import clearing_change, design_rival, rival_table
from interarea.design.controllers.bundled import shipped_controller
from interarea.design.controllers.controller import Controller
from interarea.fmu_build.write.cache import default_cache
from interarea.models.threads import one_thread

RHO = (100.0, 300.0, 900.0)  #: how closely the smoothed worst follows the worst, one after the other
#: first letter of a condition -> what it is; the others have all signals late
_KINDS = {"N": "nothing", "L": "one lost", "x": "one doubled"}


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
    parser.add_argument("--starts", type=int, default=3, help="first guesses")
    parser.add_argument("--minutes", type=float, default=20.0, help="of processor time for the search")
    parser.add_argument("--wired", action="store_true", help="no latency in the search")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    design = load_design(options.name)
    prompt = tuple(code for code in design.conditions if not code.startswith("s"))
    conditions = prompt if options.wired else design.conditions
    searched = design.model_copy(update={"conditions": conditions, "starts": options.starts})
    each_s = 60.0 * options.minutes / (1 + rival_table(searched).starts)
    stage = StageTable(rho=RHO, longest_s=each_s)
    searched = searched.model_copy(update={"stage": (stage,)})
    table, late = rival_table(searched), rival_table(design).conditions

    def tell(step: str, share: float, text: str) -> None:
        print(f"{time.process_time():6.0f} s {step} {100.0 * share:3.0f} % {text}", flush=True)

    with one_thread():
        rival = design_rival(searched, shipped_controller(options.name), default_cache(), progress=tell)
        own = [f"{kind}:{signal}" for kind in ("L", "x2") for signal in table.signals]
        for row in judged(table, rival, (*late, *own)):
            print(row)
        if table.acceptance is not None:
            change = clearing_change(table, rival, default_cache())
            print("mean change of clearing times: " + ("none" if change is None else f"{change:+.2f} cycles"))
    if options.out is not None:
        rival.save(options.out)


if __name__ == "__main__":
    main()
