"""The linear loops in which the faults of an acceptance end: which of them a controller makes unstable.

    python benchmarks/control/fault_loops.py new_england nets_nyps

A part of `interarea certify NAME --acceptance` that takes minutes where the faults take hours: nothing is
lost, every signal has the acceptance's first latency. Exit code 1 where a loop is unstable that is stable
without control.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from interarea.cosim.designs.design_file import load_design
from interarea.cosim.designs.family import family_cases
from interarea.cosim.designs.fault_loops import FaultLoops
from interarea.design.controllers.bundled import shipped_controller
from interarea.design.delay.signal_conditions import Condition
from interarea.fmu_build.write.cache import default_cache


def main(names: Sequence[str]) -> int:
    failed = False
    for name in names:
        table, controller = load_design(name), shipped_controller(name)
        if table.acceptance is None:
            print(f"{name}: its design names no faults", file=sys.stderr)
            return 2
        latency_s = table.acceptance.latency_s[0]
        loops, unstable = 0, 0
        for point, case in table.acceptance.looked_at(family_cases(table)).items():
            late = Condition("late", (), dict.fromkeys(controller.inputs, latency_s))
            study = FaultLoops(case, controller, default_cache())
            for fault in table.acceptance.fault:
                alone = study.end(fault.trip, controlled=False)
                end = study.end(fault.trip, late)
                loops += 1
                if alone.stable and not end.stable:
                    unstable += 1
                    print(f"{name}: {point}, {fault}: rightmost root {end.root:.3g} 1/s", flush=True)
            for trip in study.unsolved:
                print(f"{name}: {point}: no power flow without {trip}", flush=True)
        print(f"{name}: {unstable} of {loops} loops unstable that are stable without control")
        failed = failed or unstable > 0
    return int(failed)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
