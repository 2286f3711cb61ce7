"""How well the score of a set of loops foretells the damping that a design with it reaches.

    python benchmarks/bench_loop_sets.py KEPT.json [--case NAME] [--sets 46] [--first 10] [--together 4]

Sets of actuators ranked by `choose_loops` for all inter-area modes: the first ones, and others evenly spread
over the rest of the list. For each a controller is designed shortly, as `interarea loops --try` does it, and
the least damping ratio of any inter-area root found. Designs are kept in KEPT.json as they are done; a run
that was interrupted goes on there. Exit code 1 where the rank correlation is below 0.8 or the best set is not
among the first.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from scipy.stats import spearmanr

from interarea.cosim.designs.short_designs import short_designs
from interarea.cosim.run.artefacts import sparse_linear_plant
from interarea.design.modes.all_modes import all_modes
from interarea.design.modes.loop_choice import choose_loops
from interarea.design.modes.loop_points import LoopSet
from interarea.fmu_build.write.cache import default_cache
from interarea.models.case.case import Case, load_case

LEAST = 0.8


def ranked(case: Case, together: int) -> tuple[LoopSet, ...]:
    """Return every set of `together` actuators, the best score first."""
    plant = sparse_linear_plant(case, default_cache())
    result = all_modes(plant, case.areas, band_hz=(0.1, 2.5), below=0.3)
    return choose_loops(
        plant, result.modes, case.areas, kinds=["speed"], together=together, most=100_000
    ).sets


def picked(sets: tuple[LoopSet, ...], count: int, first: int) -> list[int]:
    """Return the places of the first sets and of others spread evenly over the rest."""
    rest = max(count - first, 0)
    step = max((len(sets) - first) // max(rest, 1), 1)
    return [*range(min(first, len(sets))), *range(first + step - 1, len(sets), step)][:count]


def summary(rows: Mapping[str, Mapping[str, Any]], first: int) -> dict[str, Any]:
    """Return the rank correlation of score and damping, and the place of the best set."""
    by_place = sorted(rows.values(), key=lambda row: row["place"])
    best = max(by_place, key=lambda row: row["damping"])
    scores, dampings = ([row[key] for row in by_place] for key in ("score", "damping"))
    result = {
        "sets": len(by_place),
        "rank_correlation": float(spearmanr(scores, dampings).statistic),
        "best": best["actuators"],
        "best_place": best["place"] + 1,
    }
    return result | {"passed": bool(result["rank_correlation"] >= LEAST and result["best_place"] <= first)}


def main() -> None:
    """Design what is not kept yet, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("kept", type=Path)
    parser.add_argument("--case", default="nets-nyps")
    parser.add_argument("--sets", type=int, default=46)
    parser.add_argument("--first", type=int, default=10)
    parser.add_argument("--together", type=int, default=4)
    options = parser.parse_args()
    case = load_case(options.case)
    sets = ranked(case, options.together)
    rows = json.loads(options.kept.read_text()) if options.kept.exists() else {}
    for place in picked(sets, options.sets, options.first):
        name = " ".join(a.removesuffix("_vs") for a in sets[place].actuators)
        if name not in rows:
            begin = time.process_time()
            damping = short_designs(case, [sets[place]], default_cache())[0].damping
            rows[name] = {"actuators": name, "score": sets[place].score, "left": sets[place].left}
            rows[name] |= {"place": place, "damping": damping, "cpu_s": time.process_time() - begin}
            options.kept.write_text(json.dumps(rows, indent=1) + "\n")
        row = rows[name]
        print(
            f"{row['place'] + 1:5d} of {len(sets)}  {name:18} score {row['score']:.3f} "
            f"damping {row['damping']:.3f}  {row['cpu_s']:.1f} CPU s",
            flush=True,
        )
    result = summary(rows, options.first)
    print(
        f"{result['sets']} sets: rank correlation {result['rank_correlation']:.2f} (wanted {LEAST}), "
        f"best {result['best']} at place {result['best_place']} (wanted: among the first {options.first})"
    )
    sys.exit(0 if result["passed"] else 1)


if __name__ == "__main__":
    main()
