"""How well ambient motion gives the damping of a grid's modes: bias, deviation, and what the intervals hold.

Records are those of the linear plant with noise at every rotor, by the exact discrete system; the mode meter
names what it sees by the modes of the case, and each is compared with the damping ratio of that mode. What
has no name, because its shape is not clear, counts for the mode next to its frequency where only one is near:
beside two modes it may be a mixture of both, which has the damping of neither.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Sequence

import control
import numpy as np
import scipy.linalg
from threadpoolctl import threadpool_limits

import interarea as ia
from interarea.cosim.records.ambient import SUBSPACE, YULE_WALKER, Estimate
from interarea.cosim.records.meter import Swing, meter
from interarea.cosim.records.record import Channel, Record, RecordError
from interarea.design.modes.modes import Mode

STEP_S = 0.1
NOISE_RATE = 0.3  # 1/s, of the noise at each rotor
SETTLE_S = 60.0  # left out at the start of a record
METHODS = (SUBSPACE, YULE_WALKER)
NEAR = 0.05  # of a mode's frequency: a swing without a name may be of it


class LinearRecords:
    """Speeds of the machines of a linear plant, every rotor driven by noise; a record for each seed."""

    def __init__(self, plant: control.StateSpace) -> None:
        A, labels = np.asarray(plant.A), list(plant.state_labels)
        rotors = [k for k, name in enumerate(labels) if name.endswith(".slip")]
        n, m = len(A), len(rotors)
        whole = np.zeros((n + m, n + m))
        whole[:n, :n], whole[rotors, range(n, n + m)] = A, 1.0
        whole[n:, n:] = -NOISE_RATE * np.eye(m)
        enters = np.vstack([np.zeros((n, m)), np.eye(m)])
        N = n + m
        both = np.block([[-whole, enters @ enters.T], [np.zeros((N, N)), whole.T]])  # Van Loan 1978
        block = scipy.linalg.expm(both * STEP_S)
        self._moves = block[N:, N:].T
        values, vectors = np.linalg.eigh(self._moves @ block[:N, N:])
        self._noise = vectors * np.sqrt(np.maximum(values, 0.0))
        outputs = [k for k, name in enumerate(plant.output_labels) if name.endswith("_dw")]
        self._C = np.hstack([np.asarray(plant.C)[outputs], np.zeros((len(outputs), m))])
        names = [plant.output_labels[k].removesuffix("_dw") for k in outputs]
        self._channels = tuple(Channel(f"plant.{name}_dw", "speed", "pu", name) for name in names)

    def record(self, seed: int, length_s: float) -> Record:
        """Return a record, a point each `STEP_S`."""
        skip = round(SETTLE_S / STEP_S)
        rng, x = np.random.default_rng(seed), np.zeros(len(self._moves))
        rows = np.empty((skip + round(length_s / STEP_S), len(self._C)))
        for k in range(len(rows)):
            rows[k] = self._C @ x
            x = self._moves @ x + self._noise @ rng.standard_normal(len(x))
        return Record(
            "ambient", STEP_S * np.arange(len(rows) - skip, dtype=float), rows[skip:], self._channels
        )


def rows_of(case: str, seeds: int, minutes: float, dampings: tuple[float, float]) -> list[str]:
    """Return a row of the page for each mode with such a damping ratio that a tenth of the records show."""
    every = list(ia.modes(case).values())
    modes = [m for m in every if dampings[0] <= m.damping_ratio <= dampings[1]]
    records = LinearRecords(ia.linearise(case))
    #: mode and method -> of each record that shows it: error in percent points, whether the interval holds it
    errors: dict[tuple[str, str], list[tuple[float, bool]]] = defaultdict(list)
    for seed in range(seeds):
        try:
            swings = meter(records.record(seed, 60.0 * minutes), modes=every).swings
        except RecordError:
            continue
        for mode in modes:
            for estimate in _estimates_of(mode, every, swings):
                low, high = estimate.damping_interval
                off = 100.0 * (estimate.damping_ratio - mode.damping_ratio)
                errors[mode.name, estimate.method].append((off, low <= mode.damping_ratio <= high))
    rows = []
    for mode in modes:
        seen = [errors[mode.name, method] for method in METHODS]
        if max(map(len, seen)) >= 0.1 * seeds:
            head = f"`{case}`, {mode.name}, {mode.frequency_hz:.2f} Hz | {100.0 * mode.damping_ratio:.1f} %"
            rows.append(f"| {head} | {' | '.join(map(_cell, seen))} |")
    return rows


def _estimates_of(mode: Mode, modes: Sequence[Mode], swings: Sequence[Swing]) -> Sequence[Estimate]:
    """Return what was estimated of a mode: of the swing of its name, else of one without a name beside it and
    no other mode."""
    near = [s for s in swings if not s.mode and [m for m in modes if _beside(s, m)] == [mode]]
    same = [s for s in swings if s.mode == mode.name] or near
    nearest = min(same, key=lambda s: abs(s.frequency_hz - mode.frequency_hz), default=None)
    return () if nearest is None else nearest.estimates


def _beside(swing: Swing, mode: Mode) -> bool:
    return abs(swing.frequency_hz / mode.frequency_hz - 1.0) <= NEAR


def _cell(errors: Sequence[tuple[float, bool]]) -> str:
    """Return how many records, bias, deviation, and the share of intervals that hold the truth."""
    if len(errors) < 2:
        return f"{len(errors)}"
    offs, holds = np.array(errors).T
    return f"{len(offs)}: {offs.mean():.2f}, {offs.std(ddof=1):.2f}, {100.0 * holds.mean():.1f} %"


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a table for the page of records."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*", default=["kundur-manual", "two-area-thesis", "nets-nyps"])
    parser.add_argument("--seeds", type=int, default=500)
    parser.add_argument("--minutes", type=float, default=10.0)
    options = parser.parse_args(arguments)
    print(
        "| case, mode | damping ratio | subspace: records, bias, deviation, share | Yule-Walker: the same |"
    )
    print("|---|---|---|---|")
    with threadpool_limits(1):
        for case in options.cases:
            for line in rows_of(case, options.seeds, options.minutes, (0.03, 0.12)):
                print(line, flush=True)


if __name__ == "__main__":
    main()
