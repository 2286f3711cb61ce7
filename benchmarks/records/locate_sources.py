"""Of random forced oscillations on a grid, how many sources and kinds `locate --case` names.

    python benchmarks/records/locate_sources.py --case wecc-240 --records 20

Each record is a run of the full nonlinear plant with one source (mechanical power, voltage reference, load),
every fifth record with two, at .15 to 1.2 Hz. Half of the buses with a machine or load and a tenth of the
branches are seen for 80 s, at 30 frames a second with white noise (`NOISE`), one sample of twenty lost.
Printed: named with place and kind; named as one of several units of that kind at that bus; not named; wrong.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import pandas as pd

import interarea as ia
from interarea.cosim.records.model_source import LOAD, MECHANICAL, REFERENCE, source_by_model
from interarea.cosim.run.artefacts import sparse_linear_plant
from interarea.fmu_build.write.cache import default_cache

NOISE = 1e-4  # pu and rad, white
LOST = 0.05
START_S, STOP_S = 30.0, 110.0
ON = {MECHANICAL: "mechanical_power", REFERENCE: "voltage_reference", LOAD: "load"}
SIZE = {MECHANICAL: 0.02, REFERENCE: 0.01, LOAD: 0.05}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--case", default="wecc-240")
    parser.add_argument("--records", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    case = ia.load_case(options.case)
    plant = sparse_linear_plant(case, default_cache())
    counts = dict.fromkeys(("right", "one of several", "not named", "wrong"), 0)
    first_two = 0
    for number in range(options.records):
        rng = np.random.default_rng((options.seed, number))
        f = round(float(np.exp(rng.uniform(np.log(0.15), np.log(1.2)))), 4)
        events, truth = sources(case, plant, rng, f, 2 if number % 5 == 4 else 1)
        record = recorded(case, events, rng)
        began = time.perf_counter()
        answer = source_by_model(record, case, plant, frequency_hz=f)
        took = time.perf_counter() - began
        named = answer.source
        if named is None:
            kind = "not named"
        elif truth in [pairs(each) for each in (named, *answer.others)]:
            kind = "one of several" if answer.others else "right"
        else:
            kind = "wrong"
        counts[kind] += 1
        first_two += truth in [pairs(c) for c in answer.candidates if len(c.places) == len(truth)][:2]
        print(f"{number:3d} {f:.3f} Hz {sorted(truth)}: {kind}; {answer.why} ({took:.2f} s)", flush=True)
    print(f"{options.case}, {options.records} records: " + ", ".join(f"{k} {v}" for k, v in counts.items()))
    print(f"the source among the first two candidates: {first_two}")


def sources(case, plant, rng, f, count):
    """Return events and {(place, kind)} of random sources."""
    events, truth = [], set()
    excited = [m for m in case.machines if f"{m.name}_vs" in plant.inputs]
    loads = [load for load in case.loads if load.in_service and load.P_mw > 1e-4 * case.base_mva]
    while len(truth) < count:
        kind = str(rng.choice([MECHANICAL, REFERENCE, LOAD]))
        places = {MECHANICAL: case.machines, REFERENCE: excited, LOAD: loads}[kind]
        if not places:
            continue
        place = places[rng.integers(len(places))].name
        key = "load" if kind == LOAD else "machine"
        events.append(
            {
                "kind": "oscillation",
                "on": ON[kind],
                key: place,
                "frequency_hz": f,
                "size_pu": SIZE[kind],
                "start_s": 0.0,
                "end_s": STOP_S,
            }
        )
        truth.add((place, kind))
    return events, truth


def recorded(case, events, rng):
    """Return what PMUs at half of the buses see of a run."""
    buses = sorted({m.bus for m in case.machines} | {load.bus for load in case.loads})
    seen = rng.permutation(buses)[: max(len(buses) // 2, 2)]
    branches = [b.name for b in case.branches if b.in_service]
    lines = rng.permutation(branches)[: max(len(branches) // 10, 2)]
    show = [f"bus{b}.{q}" for b in seen for q in ("v", "angle")]
    show += [f"branch[{b}].{q}" for b in lines for q in ("p", "q")]
    scenario = {"case": case.name, "controller": "none", "stop_s": STOP_S, "event": events, "show": show}
    frame = ia.simulate(scenario).to_frame()
    time_s = np.arange(START_S, STOP_S, 1.0 / 30.0)
    columns = {}
    for name in frame.columns:
        if name.removeprefix("plant.") not in show:
            continue
        values = np.interp(time_s, frame.index, frame[name])
        values = values + NOISE * rng.standard_normal(len(values))
        columns[name] = values
    noisy = pd.DataFrame(columns, index=pd.Index(time_s, name="time_s"))
    noisy[rng.random(noisy.shape) < LOST] = np.nan
    return ia.read_record(noisy)


def pairs(candidate):
    return set(zip(candidate.places, candidate.kinds, strict=True))


if __name__ == "__main__":
    main()
