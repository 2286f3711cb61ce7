"""Of forced oscillations on a grid, how many sources and kinds `locate --case` names.

    python benchmarks/records/locate_sources.py --case wecc-240 --records 20
    python benchmarks/records/locate_sources.py --contest

Each record is a run of the full nonlinear plant with one source (mechanical power, voltage reference, load),
every fifth record with two, at .15 to 1.2 Hz. Half of the buses with a machine or load and a tenth of the
branches are seen for 80 s, at 30 frames a second with white noise (`NOISE`; `--see frequency` takes
the frequency of a bus with `NOISE_HZ` in place of its angle), one sample of twenty lost. Printed: named with
place and kind; named as one of several units of that kind at that bus; one of two sources named alone, with
what it leaves unexplained; not named; wrong: a place that is no source. Then of how many the source, or a
unit of its kind at its bus, is among the first two places; of two sources named as one the stronger.

`--contest` takes the 13 oscillations of `contest.py` instead, of the kinds of the contest of 2021.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import pandas as pd
from contest import Wave, contest

import interarea as ia
from interarea.cosim.records.model_source import LOAD, MECHANICAL, REFERENCE, source_by_model
from interarea.cosim.records.playback import Playback
from interarea.cosim.records.record import Channel, Record
from interarea.cosim.run.artefacts import sparse_linear_plant
from interarea.fmu_build.write.cache import default_cache

NOISE = 1e-4  # pu and rad, white
NOISE_HZ = 1e-3
APART_S = 0.005  # of two angles that make a frequency
LOST = 0.05
START_S, STOP_S = 30.0, 110.0
ON = {MECHANICAL: "mechanical_power", REFERENCE: "voltage_reference", LOAD: "load"}
SIZE = {MECHANICAL: 0.02, REFERENCE: 0.01, LOAD: 0.05}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--case", default="wecc-240")
    parser.add_argument("--records", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--see", choices=("angle", "frequency"), default="angle")
    parser.add_argument("--contest", action="store_true")
    options = parser.parse_args()
    case, tasks = contest() if options.contest else (ia.load_case(options.case), None)
    plant = sparse_linear_plant(case, default_cache())
    counts = dict.fromkeys(("right", "one of several", "one of two", "not named", "wrong"), 0)
    first_two, total = 0, 0
    for number in range(options.records if tasks is None else len(tasks)):
        rng = np.random.default_rng((options.seed, number))
        if tasks is None:
            f = round(float(np.exp(rng.uniform(np.log(0.15), np.log(1.2)))), 4)
            events, truth = sources(case, plant, rng, f, 2 if number % 5 == 4 else 1)
            name, waves, lines = "", (), {f: truth}
        else:
            name, events, waves, lines = tasks[number]
        events = [{**event, "kind": "oscillation", "start_s": 0.0, "end_s": STOP_S} for event in events]
        record = recorded(case, events, rng, waves, options.see)
        for f, truth in lines.items():
            began = time.perf_counter()
            answer = source_by_model(record, case, plant, frequency_hz=f)
            took = time.perf_counter() - began
            kind = verdict(answer, truth)
            counts[kind] += 1
            total += 1
            first_two += among_first_two(case, answer, truth, alone=kind == "one of two")
            print(
                f"{number:3d} {name} {f:.3f} Hz {sorted(truth)}: {kind}; {answer.why} ({took:.2f} s)",
                flush=True,
            )
    print(f"{case.name}, {total} lines: " + ", ".join(f"{k} {v}" for k, v in counts.items()))
    print(f"the source among the first two candidates: {first_two}")


def verdict(answer, truth):
    """Return what an answer is beside the true {(place, kind)}."""
    if answer.source is None:
        return "not named"
    if truth in [pairs(each) for each in (answer.source, *answer.others)]:
        return "one of several" if answer.others else "right"
    return "one of two" if pairs(answer.source) < truth else "wrong"


def among_first_two(case, answer, truth, *, alone):
    """Whether the true places, or units of their kinds at their buses, are among the first two.

    alone : of two sources one was named, which is judged as a source alone.
    """
    bus = {each.name: f"bus{each.bus}" for each in (*case.machines, *case.loads)}
    true = {frozenset((bus.get(place, place), kind) for place, kind in truth)}
    if alone:
        true = {frozenset([one]) for each in true for one in each}
    size = 1 if alone else len(truth)
    ranked = [frozenset(zip(c.at, c.kinds, strict=True)) for c in answer.candidates if len(c.places) == size]
    return bool(true & set(list(dict.fromkeys(ranked))[:2]))


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
                "on": ON[kind],
                key: place,
                "frequency_hz": f,
                "size_pu": SIZE[kind],
            }
        )
        truth.add((place, kind))
    return events, truth


def recorded(case, events, rng, waves, see):
    """Return what PMUs at half of the buses see of a run."""
    buses = sorted({m.bus for m in case.machines} | {load.bus for load in case.loads})
    seen = rng.permutation(buses)[: max(len(buses) // 2, 2)]
    branches = [b.name for b in case.branches if b.in_service]
    lines = rng.permutation(branches)[: max(len(branches) // 10, 2)]
    of_bus = ("v", "angle") if see == "angle" else ("v", "re", "im")
    show = [f"bus{b}.{q}" for b in seen for q in of_bus]
    show += [f"branch[{b}].{q}" for b in lines for q in ("p", "q")]
    frame = run(case, events, waves, show)
    time_s = np.arange(START_S, STOP_S, 1.0 / 30.0)
    columns = {}
    for name in frame.columns:
        if name.removeprefix("plant.") in show and not name.endswith((".re", ".im")):
            values = np.interp(time_s, frame.index, frame[name])
            columns[name] = values + NOISE * rng.standard_normal(len(values))
    for bus in seen if see == "frequency" else ():
        V = frame[f"plant.bus{bus}.re"] + 1j * frame[f"plant.bus{bus}.im"]
        angle = np.unwrap(np.angle(V))
        early, late = (np.interp(time_s + side, frame.index, angle) for side in (-APART_S, APART_S))
        f = case.frequency_hz + (late - early) / (4.0 * np.pi * APART_S)
        columns[f"bus{bus} F [Hz]"] = f + NOISE_HZ * rng.standard_normal(len(f))
    noisy = pd.DataFrame(columns, index=pd.Index(time_s, name="time_s"))
    noisy[rng.random(noisy.shape) < LOST] = np.nan
    return ia.read_record(noisy)


def run(case, events, waves, show):
    """Return the table of a run with oscillations, and with waves on inputs of the plant."""
    system = ia.System(stop_s=STOP_S, step_s=Wave.step_s if waves else None).plant(case, show=show)
    for event in events:
        system.event(**event)
    for wave in waves:
        time_s = np.arange(0.0, STOP_S, wave.step_s)
        swing = wave.size_pu * np.sin(2.0 * np.pi * wave.frequency_hz * time_s)
        sent = Record(wave.input, time_s, swing[:, None], (Channel("wave", "other", "pu", ""),))
        system.add(Playback(wave.input, sent, "wave", start_s=0.0)).connect(
            f"{wave.input}.y", f"plant.{wave.input}"
        )
    return system.run().to_frame()


def pairs(candidate):
    return set(zip(candidate.places, candidate.kinds, strict=True))


if __name__ == "__main__":
    main()
