"""Whether more starts of the search would change what a controller's link is worth.

Run `python benchmarks/control/link_starts.py [NAME] [--starts 40] [--side both|link|rival]`: the design of a
bundled controller (default `wide_area`) from so many random starts, each taken to its end by itself, and as
many of its own-signal rival of equal order, effort and points. A line each; at the end the best of both by
the least inter-area damping while nothing is lost.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass

from threadpoolctl import threadpool_limits

from interarea.cosim.designs.design_file import DesignTable, judge, load_design
from interarea.cosim.designs.family import family_plants
from interarea.cosim.designs.worth import rival_table
from interarea.design.errors import InfeasibleDesign
from interarea.design.robust.design import design_robust
from interarea.fmu_build.write.cache import default_cache


@dataclass(frozen=True)
class Reached:
    """Where the search from one random start ended."""

    seed: int
    inter_area: float  #: least damping ratio while nothing is lost
    worst_swing: float  #: over all conditions
    effort: float
    s: float  #: time of the search

    def row(self) -> str:
        """Return it as a line."""
        reached = f"{self.inter_area:11.4f} {self.worst_swing:12.4f} {self.effort:7.4f}"
        return f"{self.seed:5d} {reached} {self.s:6.0f} s"


def reached_from(table: DesignTable, seed: int) -> Reached | None:
    """Search from one random start to the end; None where no start of that seed keeps every model stable."""
    alone = table.model_copy(update={"seed": seed, "starts": 1, "start_from": None})
    cache, began = default_cache(), time.monotonic()
    plants = {name: each.searched for name, each in family_plants(alone, cache).items()}
    try:
        design = design_robust(plants, alone.spec(), alone.grid.omega_b)
    except InfeasibleDesign:
        return None
    judged = judge(alone, design.system, cache)
    lossless = {condition.name for condition in alone.family() if not condition.lost}
    inter_area = min(row.inter_area for row in judged.rows if row.condition in lossless)
    return Reached(seed, inter_area, judged.worst_swing, judged.effort, time.monotonic() - began)


def best_of(side: str, table: DesignTable, starts: int) -> Reached | None:
    """Print where each start of a design ends; return the best by inter-area damping."""
    print(f"{side} ({table.name})\n seed  inter-area  worst swing  effort   search", flush=True)
    rows: list[Reached] = []
    for seed in range(1, starts + 1):
        row = reached_from(table, seed)
        print(f"{seed:5d} no start keeps every model stable" if row is None else row.row(), flush=True)
        rows += [] if row is None else [row]
    return max(rows, key=lambda row: row.inter_area, default=None)


def main() -> None:
    """Search for both sides from every start, and compare the best of each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("name", nargs="?", default="wide_area")
    parser.add_argument("--starts", type=int, default=40)
    parser.add_argument("--side", choices=("both", "link", "rival"), default="both")
    options = parser.parse_args()
    table = load_design(options.name)
    sides = {"link": table, "rival": rival_table(table)}
    chosen_sides = list(sides) if options.side == "both" else [options.side]
    with threadpool_limits(1):
        best = {side: best_of(side, sides[side], options.starts) for side in chosen_sides}
    for side, row in best.items():
        print(f"best, {side}: " + ("none" if row is None else row.row()))


if __name__ == "__main__":
    main()
