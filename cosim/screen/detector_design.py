"""Design a detector's patterns from a grid: how right signals move together after its disturbances.

python -m interarea.cosim.screen.detector_design CASE CONTROLLER SIGNAL SIGNAL SIGNAL ... --out FILE.json

Runs without wrong signals at some operating points give the subspace of windows, runs of other lengths
at points between them the threshold: nothing is judged by what it was made of.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from interarea.design.controllers.detector_record import (
    FRAMES,
    SAMPLES,
    DetectorDesign,
    DetectorDesignError,
    basis_of,
    scores,
    shares,
)
from interarea.models.blocks.detector import Patterns
from interarea.models.case.case import Case, load_case
from interarea.models.case.variants import operating_variant
from interarea.models.errors import UserError

from ..run.run import run_scenario
from ..scenario.scenario import load_scenario

Array = npt.NDArray[np.float64]
MOST_BUSES = 12  #: that faults are tried at
MARGIN = 1.3  #: of the threshold over the largest score of a right signal
_SEEN, _BETWEEN = (0.95, 1.05), (0.975, 1.025)  # factors on every load
_LENGTHS, _LENGTH_BETWEEN = (4, 8), (6,)  # cycles
_START_S, _STOP_S = 2.0, 10.0


def design_detector(
    case: str | Path | Case,
    controller: str,
    signals: Sequence[str],
    *,
    cache: Path | None = None,
    interval_s: float = 0.02,
    noise_pu: float = 1e-3 / 60.0,
    progress: Callable[[float], object] = lambda _: None,
) -> DetectorDesign:
    """Return a detector for outputs of a plant that are frequencies (pu), three of them or more.

    noise_pu : standard deviation of each frame, which is added to what the runs give.

    Raises
    ------
    DetectorDesignError : fewer than three signals, or one that the plant does not have.
    """
    grid = case if isinstance(case, Case) else load_case(case)
    if len(set(signals)) < 3:
        raise DetectorDesignError(
            f"detector: signals are {list(signals)}, allowed: three or more that differ"
        )
    made, judged = list(_runs(grid, _SEEN, _LENGTHS)), list(_runs(grid, _BETWEEN, _LENGTH_BETWEEN))
    random = np.random.default_rng(1)
    seen: list[Array] = []
    noisy: list[Array] = []
    for k, (scale, event) in enumerate([*made, *judged]):
        curves = _curves(grid, controller, signals, scale, event, interval_s, cache)
        if curves is not None and k < len(made):
            seen.append(curves)
        elif curves is not None:
            noisy.append(curves + noise_pu * random.standard_normal(curves.shape))
        progress((k + 1) / (len(made) + len(judged)))
    floor = 3.0 * noise_pu * (SAMPLES / FRAMES) ** 0.5
    basis = basis_of(seen, floor)
    alone = MARGIN * max(float(shares(c, floor).max()) for c in noisy)
    patterns = Patterns(basis, FRAMES, 1.0, floor, alone)
    largest = max(float(scores(c, patterns).max()) for c in noisy)
    patterns = replace(patterns, threshold=MARGIN * largest)
    numbers = (largest, len(seen), len(noisy))
    return DetectorDesign(grid.name, controller, tuple(signals), interval_s, noise_pu, patterns, *numbers)


def _runs(
    case: Case, scales: Sequence[float], lengths: Sequence[int]
) -> Iterator[tuple[float, dict[str, Any]]]:
    """Yield load scale and event: a fault at each of some buses, a pulse on each machine's controls."""
    buses = [b.number for b in case.buses]
    chosen = buses[:: -(-len(buses) // MOST_BUSES)]
    for scale, cycles in itertools.product(scales, lengths):
        pulse = {"size_pu": 0.05, "start_s": _START_S, "end_s": _START_S + 0.05 * cycles}
        for bus in chosen:
            end = f"start + {cycles} cycles"
            yield scale, {"kind": "bus_fault", "bus": bus, "start_s": _START_S, "end_s": end}
        for machine in case.machines:
            for kind in ("vref_pulse", "pm_pulse"):
                yield scale, {"kind": kind, "machine": machine.name, **pulse}


def _curves(
    case: Case,
    controller: str,
    signals: Sequence[str],
    load_scale: float,
    event: dict[str, Any],
    interval_s: float,
    cache: Path | None,
) -> Array | None:
    """Return the signals (signals, stamps) of one run, without noise; None where synchronism is lost."""
    table = {
        "case": case.name,
        "controller": controller,
        "stop_s": _STOP_S,
        "operating_point": {"load_scale": load_scale},
        "event": [event],
    }
    scenario = load_scenario(table, frequency_hz=case.frequency_hz)
    grid = case
    if load_scale != 1.0:
        grid = operating_variant(case, load_scale=load_scale)
    run = run_scenario(scenario, case=grid, cache=cache)
    missing = [s for s in signals if f"plant.{s}" not in run.trajectory.units]
    if missing:
        raise DetectorDesignError(f"detector: {', '.join(missing)} is no output of the plant {case.name}")
    if run.metrics.verdict is not None and not run.metrics.verdict.synchronous:
        return None
    stamps = np.arange(0.0, _STOP_S, interval_s)
    time = np.asarray(run.trajectory.time_s)
    return np.stack([np.interp(stamps, time, run.trajectory[f"plant.{s}"]) for s in signals])


def main(words: Sequence[str] | None = None) -> int:
    """Design a detector and write its file; 2 for a user's mistake."""
    parser = argparse.ArgumentParser(description="design a detector of wrong signals from runs of a grid")
    parser.add_argument("case", help="bundled case or case file")
    parser.add_argument("controller", help="that acts in the runs")
    parser.add_argument("signals", nargs="+", help="outputs of the plant that are frequencies, three or more")
    parser.add_argument("--out", type=Path, required=True, help="JSON file that [detector] file names")
    options = parser.parse_args(words)
    try:
        design = design_detector(options.case, options.controller, options.signals)
    except UserError as error:
        print(*error.args, sep="\n", file=sys.stderr)
        return 2
    print(
        f"{design.save(options.out)}: made of {design.made_of} runs; largest score of right signals in "
        f"{design.judged_by} others {design.largest:.2f}, threshold {design.patterns.threshold:.2f}; a "
        f"signal may span {design.patterns.alone:.2f} times as much as the others"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
