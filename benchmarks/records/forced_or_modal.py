"""Of records of a minute, in how many a sine is called forced, and in how many without one nothing is.

    python benchmarks/records/forced_or_modal.py --records 300

Records are those of the linear plant with noise at every rotor (`ambient_coverage.py`). The first of three
has a sine on the speeds of all machines, each with its own share, the mean of the shares 0 (the meter
subtracts what all machines do): at .15 to 1.5 Hz, its amplitude 3 to 6 times the rms of what swings in the
band without it, at the machine where that is largest. A sine is called
forced if the largest swing is forced, has no damping ratio and its frequency within 1 %. The second has in
its place a mode damped by .5 to 2 %, which noise excites to the same power, the third nothing. Printed is
each record that was judged otherwise, then a row for each case.

    python benchmarks/records/forced_or_modal.py --least-damped 2000

This prints what the likelihood of a line over that of a mode comes to for envelopes of modes that are damped
by .5 %, with white noise, for the limits of `forced.py`.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from ambient_coverage import LinearRecords
from scipy.signal import lfilter
from threadpoolctl import threadpool_limits

import interarea as ia
from interarea.cosim.records.forced import (
    _LIMITS,
    FORCED,
    LEAST_DAMPING,
    UNDECIDED,
    _likelihood,
    side_hz,
)
from interarea.cosim.records.meter import meter
from interarea.cosim.records.record import Record, RecordError
from interarea.cosim.records.signals import swings_of

LENGTH_S = 60.0
HZ, TIMES, DAMPED = (0.15, 1.5), (3.0, 6.0), (0.005, 0.02)
NOISE_DB = (5.0, 40.0)  # below the mode, in its band
SINE, MODE, NOTHING = "sine", "mode", "nothing"


def with_swing(record: Record, kind: str, rng: np.random.Generator) -> tuple[Record, float]:
    """Return a record with a sine, or with a mode that has the power of one, and its frequency in Hz."""
    ambient = swings_of(record).values.std(axis=0).max()
    f = float(np.exp(rng.uniform(*np.log(HZ))))
    share = rng.uniform(-1.0, 1.0, record.values.shape[1])
    share -= share.mean()
    size = rng.uniform(*TIMES) * ambient * share / np.abs(share).max()
    envelope = np.full(len(record.time_s), np.exp(2j * np.pi * rng.uniform()))
    if kind == MODE:
        envelope = wandering(
            np.exp(rng.uniform(*np.log(DAMPED))) * 2.0 * np.pi * f * record.step_s, envelope, rng
        )
    swing = np.real(envelope * np.exp(2j * np.pi * f * record.time_s))
    return Record(kind, record.time_s, record.values + np.outer(swing, size), record.channels), f


def wandering(
    decay: float, envelope: npt.NDArray[np.complex128], rng: np.random.Generator
) -> npt.NDArray[np.complex128]:
    """Return the envelope of a mode that noise excites, of the power of another. decay : in a step."""
    noise = rng.standard_normal((2, len(envelope)))
    moved = (noise[0] + 1j * noise[1]) * np.sqrt(0.5 * -np.expm1(-2.0 * decay))
    moved[0] = (noise[0, 0] + 1j * noise[1, 0]) * np.sqrt(0.5)
    wanders = lfilter([1.0], [1.0, -np.exp(-decay)], moved)
    return np.asarray(wanders * np.sqrt(np.mean(np.abs(envelope) ** 2) / np.mean(np.abs(wanders) ** 2)))


def of_least_damped(count: int, rng: np.random.Generator) -> list[float]:
    """Return 2 log of the ratio of each of so many least damped modes."""
    ratios = []
    for _ in range(count):
        w = 2.0 * np.pi * float(np.exp(rng.uniform(*np.log(HZ))))
        points = round(2.0 * side_hz(w / (2.0 * np.pi), LENGTH_S) * LENGTH_S)
        spacing = LENGTH_S / points
        z = wandering(LEAST_DAMPING * w * spacing, np.ones(points, complex), rng)
        noise = rng.standard_normal((2, points))
        z = z + 10.0 ** (-rng.uniform(*NOISE_DB) / 20.0) * (noise[0] + 1j * noise[1]) / np.sqrt(2.0)
        near = np.linspace(-0.5, 0.5, 401) / LENGTH_S
        turns = np.exp(-2j * np.pi * np.outer(near, spacing * np.arange(points)))
        z = z * turns[int(np.argmax(np.abs(turns @ z)))]
        ratios.append(_likelihood(z / np.abs(z.mean()), spacing, w))
    return ratios


def counts_of(case: str, records: int, seed: int) -> list[int]:
    """Return with a sine, with a mode, with nothing: how many, called forced, called undecided."""
    source = LinearRecords(ia.linearise(case))
    counts = {kind: np.zeros(3, int) for kind in (SINE, MODE, NOTHING)}
    for number in range(records):
        record, f = source.record(1000 * seed + number, LENGTH_S), 0.0
        kind = (SINE, MODE, NOTHING)[number % 3]
        if kind != NOTHING:
            record, f = with_swing(record, kind, np.random.default_rng((seed, number)))
        try:
            swings = meter(record).swings
        except RecordError:  # too short for a damping ratio
            swings = ()
        seen = [s.kind for s in swings]
        forced = FORCED in seen
        if kind == SINE:
            forced = seen[:1] == [FORCED] and not swings[0].estimates
            forced = forced and abs(swings[0].frequency_hz / f - 1.0) <= 0.01
        counts[kind] += (1, forced, not forced and UNDECIDED in seen)
        if forced != (kind == SINE):
            what = ", ".join(f"{s.kind} {s.frequency_hz:.3f} Hz, {s.why}" for s in swings)
            print(f"{case} {number}: {kind} at {f:.3f} Hz; {what or 'refused'}", flush=True)
    return [int(n) for kind in counts for n in counts[kind]]


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a table for the page of records."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("cases", nargs="*", default=["kundur-manual", "two-area-thesis", "nets-nyps"])
    parser.add_argument("--records", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--least-damped", type=int, metavar="COUNT")
    options = parser.parse_args(arguments)
    if options.least_damped:
        with threadpool_limits(1):
            ratios = of_least_damped(options.least_damped, np.random.default_rng(options.seed))
        below = ", ".join(f"{x:.1f}" for x in np.quantile(ratios, [0.5, 0.9, 0.99, 0.995]))
        above = " and ".join(
            f"{100.0 * np.mean(np.array(ratios) >= x):.1f} % at least {x:g}" for x in _LIMITS[0][1:]
        )
        print(f"2 log(L forced / L modal): 50, 90, 99, 99.5 % are below {below}; {above}")
        return
    with threadpool_limits(1):
        rows = [(case, *counts_of(case, options.records, options.seed)) for case in options.cases]
    print("| case | with a sine | forced | undecided | with a mode | forced | undecided | neither | forced |")
    print("|---|---|---|---|---|---|---|---|---|")
    for case, *counts in rows:
        print(f"| `{case}` | {' | '.join(map(str, counts[:8]))} |")


if __name__ == "__main__":
    main()
