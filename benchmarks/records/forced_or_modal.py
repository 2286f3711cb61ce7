"""Of records of a minute, in how many a sine is called forced, and in how many without one nothing is.

    python benchmarks/records/forced_or_modal.py --records 200

Records are those of the linear plant with noise at every rotor (`ambient_coverage.py`). Every second one
has a sine on the speeds of all machines, each with its own share: at .15 to 1.5 Hz, its amplitude 3 to 6
times the rms of what swings in the band without it, at the machine where that is largest. A sine is called
forced if the largest swing is forced, has no damping ratio and its frequency within 1 %. Printed is each
record that was judged otherwise, then a row for each case.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np
from ambient_coverage import LinearRecords
from threadpoolctl import threadpool_limits

import interarea as ia
from interarea.cosim.records.forced import FORCED, UNDECIDED
from interarea.cosim.records.meter import Swing, meter
from interarea.cosim.records.record import Record, RecordError
from interarea.cosim.records.signals import swings_of

LENGTH_S = 60.0
HZ, TIMES = (0.15, 1.5), (3.0, 6.0)


def with_sine(record: Record, rng: np.random.Generator) -> tuple[Record, float]:
    """Return a record with a sine, and its frequency in Hz."""
    ambient = swings_of(record).values.std(axis=0).max()
    f = float(np.exp(rng.uniform(*np.log(HZ))))
    share = rng.uniform(-1.0, 1.0, record.values.shape[1])
    size = rng.uniform(*TIMES) * ambient * share / np.abs(share).max()
    sine = np.cos(2.0 * np.pi * (f * record.time_s + rng.uniform()))
    return Record("sine", record.time_s, record.values + np.outer(sine, size), record.channels), f


def swings_in(record: Record) -> Sequence[Swing]:
    """Return what swings; nothing where the record is refused as too short."""
    try:
        return meter(record).swings
    except RecordError:
        return ()


def counts_of(case: str, records: int, seed: int) -> tuple[int, int, int, int, int]:
    """Return with a sine: how many, forced, undecided; without: how many, in which nothing is forced."""
    source = LinearRecords(ia.linearise(case))
    sines = forced = undecided = others = none = 0
    for number in range(records):
        record = source.record(1000 * seed + number, LENGTH_S)
        if number % 2:
            seen = [s.kind for s in swings_in(record)]
            others, none = others + 1, none + (FORCED not in seen)
            if FORCED in seen:
                print(f"{case} {number}: no sine, {', '.join(seen)}", flush=True)
            continue
        record, f = with_sine(record, np.random.default_rng((seed, number)))
        swings = swings_in(record)
        right = bool(swings) and swings[0].kind == FORCED and not swings[0].estimates
        right = right and abs(swings[0].frequency_hz / f - 1.0) <= 0.01
        sines, forced = sines + 1, forced + right
        undecided += bool(swings) and swings[0].kind == UNDECIDED
        if not right:
            seen = [f"{s.kind} {s.frequency_hz:.3f} Hz" for s in swings]
            print(f"{case} {number}: sine at {f:.3f} Hz, {', '.join(seen) or 'refused'}", flush=True)
    return sines, forced, undecided, others, none


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a table for the page of records."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("cases", nargs="*", default=["kundur-manual", "two-area-thesis", "nets-nyps"])
    parser.add_argument("--records", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    wanted = parser.parse_args(arguments)
    with threadpool_limits(1):
        rows = [(case, *counts_of(case, wanted.records, wanted.seed)) for case in wanted.cases]
    print("| case | with a sine | forced | undecided | without | nothing forced |\n|---|---|---|---|---|---|")
    for case, *counts in rows:
        print(f"| `{case}` | {' | '.join(map(str, counts))} |")


if __name__ == "__main__":
    main()
