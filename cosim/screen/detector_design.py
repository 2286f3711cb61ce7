"""Design a detector's patterns from a grid: the common motion of correct signals after disturbances.

python -m interarea.cosim.screen.detector_design CASE CONTROLLER SIGNAL SIGNAL SIGNAL ... --out FILE.json

Runs without wrong signals at some operating points give the subspace of windows; runs of other lengths at
intermediate points give the threshold. No run serves for both.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from interarea.design.controllers.bank import ControllerBank
from interarea.design.controllers.controller import Controller
from interarea.design.controllers.detector_record import (
    FRAMES,
    SAMPLES,
    DetectorDesign,
    DetectorDesignError,
    shares,
)
from interarea.fmu_build.write.cache import default_cache
from interarea.models.case.case import Case, load_case
from interarea.models.case.checks import connected_parts, islands_of
from interarea.models.case.schema import Machine
from interarea.models.case.variants import operating_variant
from interarea.models.detector_defaults import INTERVAL_S
from interarea.models.errors import UserError

from ..designs.fault_runs import TOGETHER, FaultRuns
from ..run.controllers import controller_of
from .detector_size import LEAST_ALONE, MARGIN, patterns_of

Array = npt.NDArray[np.float64]
MOST_BUSES = 12  #: that faults are tried at, besides those near the machines whose speeds are compared
MOST_MACHINES = 16  #: that are pulsed, unless more of them are compared
MOST_TRIPS = 12  #: of branches, besides those of the tie
_SEEN, _BETWEEN = (0.95, 1.05), (0.975, 1.025)  # factors on every load
_LENGTHS, _LENGTH_BETWEEN = (4, 8), (6,)  # cycles
_START_S, _STOP_S = 2.0, 10.0
#: Of pulses and steps: what moves one machine alone looks most like a wrong signal of it. With pulses of .05
#: for at most .4 s alone, 3 of 93 random disturbances of New England isolated a correct signal.
_OWN_PU = 0.1


def design_detector(
    case: str | Path | Case,
    controller: str,
    signals: Sequence[str],
    *,
    cache: Path | None = None,
    interval_s: float = INTERVAL_S,
    noise_pu: float = 1e-3 / 60.0,
    progress: Callable[[float], object] = lambda _: None,
) -> DetectorDesign:
    """Return a detector for outputs of a plant that are frequencies (pu), three of them or more.

    noise_pu : standard deviation of the noise that is added to each frame of the runs. progress : called with
    the share of the runs that have ended.

    Raises
    ------
    DetectorDesignError : fewer than three signals, or one that the plant does not have.
    """
    grid = case if isinstance(case, Case) else load_case(case)
    if len(set(signals)) < 3:
        raise DetectorDesignError(
            f"detector: signals are {list(signals)}, allowed: three or more that differ"
        )
    random = np.random.default_rng(1)
    chosen = _machines(grid, signals)
    seen: list[Array] = []
    noisy: list[Array] = []
    kinds = ((seen, _SEEN, _LENGTHS), (noisy, _BETWEEN, _LENGTH_BETWEEN))
    near = _near(grid, signals)
    events = {lengths: list(_events(grid, chosen, lengths, near)) for _, _, lengths in kinds}
    parts = [(into, scale, events[lengths]) for into, scales, lengths in kinds for scale in scales]
    every, ended = sum(len(of_part) for _, _, of_part in parts), 0
    for into, scale, of_part in parts:
        varied = grid if scale == 1.0 else operating_variant(grid, load_scale=scale)
        of_scale = controller_of(controller, varied, cache or default_cache())
        for together in _curves(varied, of_scale, signals, of_part, interval_s, cache):
            into += [curves for curves in together if curves is not None]
            ended += len(together)
            progress(ended / every)
    noisy = [curves + noise_pu * random.standard_normal(curves.shape) for curves in noisy]
    floor = 3.0 * noise_pu * (SAMPLES / FRAMES) ** 0.5
    alone = MARGIN * max(LEAST_ALONE, *(float(shares(c, floor).max()) for c in noisy))
    patterns = replace(patterns_of(seen, noisy, floor, round(_START_S / interval_s)), alone=alone)
    largest = patterns.threshold / MARGIN
    numbers = (largest, len(seen), len(noisy))
    return DetectorDesign(grid.name, controller, tuple(signals), interval_s, noise_pu, patterns, *numbers)


@dataclass(frozen=True)
class _RightRun:
    """A disturbance of a grid whose controller sees every signal at once, and rightly."""

    case: str
    controller: Controller | ControllerBank | None
    event: Mapping[str, Any]
    stop_s: float = _STOP_S

    def document(self) -> dict[str, Any]:
        """Return the run as a scenario, without case and controller, which are passed as objects."""
        return {"case": self.case, "stop_s": self.stop_s, "event": [self.event]}


def _machines(case: Case, signals: Sequence[str]) -> list[Machine]:
    """Return the machines with pulsed set-points: the signals' machines, and every so many others."""
    seen = [m for m in case.machines if f"{m.name}_dw" in signals]
    others = [m for m in case.machines if m not in seen]
    room = max(MOST_MACHINES - len(seen), 1)
    return [*seen, *others[:: max(1, -(-len(others) // room))]]


def _near(case: Case, signals: Sequence[str]) -> set[int]:
    """Return the buses of the signals' machines, and those a branch away: a fault there moves one alone."""
    own = {m.bus for m in case.machines if f"{m.name}_dw" in signals}
    ends = [{b.from_bus, b.to_bus} for b in case.branches]
    return own.union(*(pair for pair in ends if pair & own))


def _events(
    case: Case, machines: Sequence[Machine], lengths: Sequence[int], near: Collection[int]
) -> Iterator[dict[str, Any]]:
    """Yield faults at some buses, also at those `near`, pulses and steps of set-points, and trips.

    lengths : cycles.
    """
    buses = [b.number for b in case.buses]
    every = -(-len(buses) // MOST_BUSES)
    chosen = [number for k, number in enumerate(buses) if k % every == 0 or number in near]
    for cycles in lengths:
        end_s = round(_START_S + cycles / case.frequency_hz, 9)
        pulse = {"size_pu": _OWN_PU, "start_s": _START_S, "end_s": _START_S + 0.0625 * cycles}
        for bus in chosen:
            yield {"kind": "bus_fault", "bus": bus, "start_s": _START_S, "end_s": end_s}
        for machine in machines:
            if machine.exciter.kind != "constant":  # else it has no voltage set-point
                yield {"kind": "vref_pulse", "machine": machine.name, **pulse}
            yield {"kind": "pm_pulse", "machine": machine.name, **pulse}
    for machine, size in itertools.product(machines, (-_OWN_PU, _OWN_PU)):
        yield {"kind": "pm_step", "machine": machine.name, "size_pu": size, "start_s": _START_S}
    for branch in _trips(case):
        yield {"kind": "branch_trip", "branch": branch, "start_s": _START_S}


def _trips(case: Case) -> list[str]:
    """Return the branches of the tie and every so many others, of those whose loss cuts off no bus."""
    links = {b.name: (b.from_bus, b.to_bus) for b in case.branches if b.in_service}
    buses, parts = [bus.number for bus in case.buses], len(islands_of(case))
    spare = [
        name
        for name in links
        if len(connected_parts(buses, (ends for other, ends in links.items() if other != name))) == parts
    ]
    of_tie = [] if case.tie is None else [name for name in case.tie.branches if name in spare]
    return list(dict.fromkeys([*of_tie, *spare[:: max(1, -(-len(spare) // MOST_TRIPS))]]))


def _curves(
    case: Case,
    controller: Controller | ControllerBank | None,
    signals: Sequence[str],
    events: Sequence[dict[str, Any]],
    interval_s: float,
    cache: Path | None,
) -> Iterator[list[Array | None]]:
    """Yield of each event the signals (signals, stamps), without noise; None where synchronism is lost.

    Those of the events whose runs are stepped together are one list.
    """
    stamps = np.arange(0.0, _STOP_S, interval_s)
    with FaultRuns(case, cache or default_cache()) as runs:
        for first in range(0, len(events), TOGETHER):
            part = [_RightRun(case.name, controller, event) for event in events[first : first + TOGETHER]]
            together: list[Array | None] = []
            for outcome, data in runs.judged(part, [None] * len(part)):
                missing = [s for s in signals if f"plant.{s}" not in data.units]
                if missing:
                    raise DetectorDesignError(
                        f"detector: {', '.join(missing)} is not an output of the plant {case.name}"
                    )
                time = np.asarray(data.time_s)
                curves = [np.interp(stamps, time, data[f"plant.{s}"]) for s in signals]
                together.append(np.stack(curves) if outcome.synchronous else None)
            yield together


def main(words: Sequence[str] | None = None) -> int:
    """Design a detector and write its file; returns 2 for a user error."""
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
        f"{design.save(options.out)}: {design.patterns.basis.shape[2]} directions, computed from "
        f"{design.made_of} runs; largest score of correct signals in {design.judged_by} others "
        f"{design.largest:.2f}, threshold {design.patterns.threshold:.2f}; a signal may span "
        f"{design.patterns.alone:.2f} times as much as the others"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
