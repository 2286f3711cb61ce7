"""Effect of wrong signals on a loop with and without a detector: every kind, signal, disturbance and point.

Each run has a verdict (`results.verdict`). The certificate fails if a run with the detector loses synchronism
or keeps a swing that does not decay, where the grid without control does better.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from scipy.stats import qmc

from interarea.design.controllers.bank import ControllerBank
from interarea.design.delay.signal_conditions import Condition
from interarea.design.robust.operating_points import family_row, inter_area_band
from interarea.models.blocks.detector import REASONS
from interarea.models.case.case import Case
from interarea.models.case.variants import operating_variant

from ..designs.design_tables import FaultPlace
from ..designs.family import FamilyPlant
from ..designs.fault_runs import TOGETHER, FaultRuns, Outcome
from ..results.verdict import LOST, STABLE
from ..scenario.signal_faults import SWAP, wrong_kinds
from ..trajectory import Trajectory
from .wrong_runs import (
    LONG_S,
    STOP_S,
    WRONG_S,
    Judged,
    Signals,
    WrongRun,
    disturbances_of,
    signals_of,
    to_the_end,
)

RIGHT = "nothing wrong"
_STANDING = REASONS.index("standing")
NAMED_SHARE = 0.99  #: of the isolations, of the right signal
LOAD_SHARE, TIE_MW = 0.03, 75.0  #: largest changes of a point: detectors are designed at loads +-5 %


@dataclass(frozen=True)
class WrongRow:
    """One run to `stop_s`. verdict : its first words; left_pu : span of the deciding signal in the last
    window.

    detected_s : time from the start of the fault to the isolation of the signal; None: never. others :
    correct signals isolated. stopped_s : time until a sustained swing withheld all signals; None: never.
    without : verdict of the grid without control after the same disturbance.
    """

    kind: str
    signal: str
    disturbance: str
    point: str
    detector: bool
    verdict: str
    why: str
    left_pu: float
    detected_s: float | None
    others: tuple[str, ...]
    without: str
    stop_s: float = STOP_S
    stopped_s: float | None = None

    @property
    def stable(self) -> bool:
        """Whether synchronism is kept and the remaining swing decays."""
        return self.verdict in STABLE

    @property
    def worse(self) -> bool:
        """Whether the grid without control does better."""
        if self.verdict == LOST:
            return self.without != LOST
        return not self.stable and self.without in STABLE

    def __str__(self) -> str:
        what = self.kind if self.kind == RIGHT else f"{self.signal}, {self.kind}"
        return f"{what}, {self.disturbance} at {self.point}: {self.verdict}"


@dataclass(frozen=True)
class SignalOut:
    """Damping of the linear loop with one signal isolated."""

    point: str
    signal: str
    stable: bool
    worst_swing: float
    inter_area: float


@dataclass(frozen=True)
class WrongCertificate:
    """The result. detector : its table in the scenario."""

    controller: str
    case: str
    signals: Mapping[str, float]
    witnesses: tuple[str, ...]
    detector: Mapping[str, Any]
    rows: tuple[WrongRow, ...]
    out: tuple[SignalOut, ...]

    @property
    def isolations(self) -> tuple[int, int]:
        """Number of isolated signals, and how many of these were the wrong one."""
        right = sum(r.detected_s is not None for r in self.rows)
        return right + sum(len(r.others) for r in self.rows), right

    @property
    def stops(self) -> int:
        """Number of runs with a sustained swing that no test identified, in which all signals were
        withheld."""
        return sum(r.stopped_s is not None for r in self.rows)

    @property
    def violations(self) -> tuple[str, ...]:
        """Violations of the certificate, a line each."""
        lines = [str(r) for r in self.rows if r.worse and (r.detector or r.kind == RIGHT)]
        lines += [
            f"{r}: false alarm, {' and '.join(r.others) or 'all signals'} isolated"
            for r in self.rows
            if r.kind == RIGHT and (r.others or r.stopped_s is not None)
        ]
        every, right = self.isolations
        if every and not right / every >= NAMED_SHARE:
            lines.append(f"{every - right} of {every} isolated signals were correct ones, allowed: 1 of 100")
        lines += [f"{o.point}, {o.signal} isolated: unstable" for o in self.out if not o.stable]
        return tuple(lines)

    @property
    def passed(self) -> bool:
        """Whether nothing is violated."""
        return not self.violations

    def as_dict(self) -> dict[str, Any]:
        """Return the result as plain types."""
        every, right = self.isolations
        return {
            "controller": self.controller,
            "case": self.case,
            "signals": dict(self.signals),
            "witnesses": list(self.witnesses),
            "detector": dict(self.detector),
            "runs": len(self.rows),
            "isolated": every,
            "rightly": right,
            "stops": self.stops,
            "summary": [dict(zip(HEADER, cells, strict=True)) for cells in self.table()],
            "rows": [asdict(r) for r in self.rows],
            "out": [asdict(o) for o in self.out],
            "violations": list(self.violations),
            "passed": self.passed,
        }

    def table(self) -> list[tuple[str, ...]]:
        """Return a row for each kind and signal under `HEADER`."""
        groups: dict[tuple[str, str], list[WrongRow]] = {}
        for row in self.rows:
            groups.setdefault((row.kind, row.signal), []).append(row)
        return [(*names, *_cells(rows)) for names, rows in groups.items()]


HEADER = (
    "what is wrong",
    "signal",
    "runs",
    "lost, swinging without detector",
    "with detector",
    "seen",
    "median (s)",
    "longest (s)",
    "others isolated",
    "all out",
)


def _cells(rows: Sequence[WrongRow]) -> Iterator[str]:
    alone, watched = ([r for r in rows if r.detector is with_it] for with_it in (False, True))
    yield str(len(alone))
    for part in (alone, watched):
        lost = sum(r.verdict == LOST for r in part)
        yield f"{lost}, {sum(not r.stable for r in part) - lost}"
    times = [r.detected_s for r in watched if r.detected_s is not None]
    yield str(len(times)) if rows[0].kind != RIGHT else ""
    yield f"{median(times):.2f}" if times else ""
    yield f"{max(times):.2f}" if times else ""
    yield str(sum(len(r.others) for r in watched))
    yield str(sum(r.stopped_s is not None for r in watched))


def points_of(case: Case, count: int = 2) -> dict[str, Case]:
    """Return `count` operating points: the case, then others outside every design.

    First 2 % more load and 50 MW more on a tie, then loads up to `LOAD_SHARE` and flows up to `TIE_MW` from
    the case by the sequence of Halton in bases 2 and 3 [Halton1960], so that the first N points are those of
    any longer list.
    """
    others = 2.0 * qmc.Halton(2, scramble=False).fast_forward(1).random(max(count - 2, 0)) - 1.0
    changes = np.vstack([[0.02, 50.0], others * (LOAD_SHARE, TIE_MW)]).tolist()
    points = {"base": case}
    for load, tie in changes[: count - 1]:
        share, tie_mw = round(load, 4), 0.0 if case.tie is None else round(tie, 1)
        words = f"load {100.0 * share:+.3g} %" + (f", tie {tie_mw:+g} MW" if tie_mw else "")
        points[words] = operating_variant(case, load_scale=1.0 + share, tie_flow_mw=tie_mw)
    return points


def certify_wrong_signals(
    case: Case,
    controller: Judged,
    place: FaultPlace,
    cache: Path,
    *,
    detector: Mapping[str, Any] | None = None,
    compared: Sequence[str] = (),
    kinds: Sequence[str] | None = None,
    disturbances: Sequence[str] | None = None,
    points: Mapping[str, Case] | None = None,
    progress: Callable[[float], object] = lambda share: None,
) -> WrongCertificate:
    """Return the effect of each kind of wrong signal on a loop.

    Runs end as `to_the_end` says. One in which the detector trusts every signal to its end is also the one
    without a detector.

    place : of the fault, and of the trip. detector : table of a scenario; default: its tests that need no
    design. compared : signals of the detector's file. kinds, disturbances : names of those to run; default
    all. points : operating point -> case; default `points_of`.

    Raises
    ------
    ScenarioError : see `signals_of`; a fault that does not fit.
    """
    signals = signals_of(case, controller, compared)
    plant = FamilyPlant.of(case, tuple(controller.inputs), tuple(controller.outputs), cache)
    low, high = inter_area_band(plant.modes)
    every = wrong_kinds(case.frequency_hz, (low * high) ** 0.5)
    chosen = {k: t for k, t in every.items() if kinds is None or k in kinds}
    grids = points_of(case) if points is None else dict(points)
    table = {} if detector is None else dict(detector)
    rows: list[WrongRow] = []
    for number, (point, grid) in enumerate(grids.items()):
        events = disturbances_of(grid, place)
        selection = (case, controller, signals, chosen, events, disturbances)
        with_it, without = (list(_jobs(*selection, t)) for t in (table, None))
        ended = 0

        def count_ended(count: int, before: int = number, every: int = len(with_it) + len(without)) -> None:
            nonlocal ended
            ended += count
            progress((before + ended / every) / len(grids))

        with FaultRuns(grid, cache) as runs:
            none = {
                d: WrongRun(case.name, None, {}, events[d], stop_s=LONG_S)
                for d in dict.fromkeys(j[0][1] for j in with_it)
            }
            bare = dict(zip(none, runs.outcomes(list(none.values()), [None] * len(none)), strict=True))
            watched = _rows(runs, with_it, point, bare, count_ended)
            same = [_as_without(row, signals, chosen) for row in watched]
            count_ended(sum(same))
            again = [job for job, known in zip(without, same, strict=True) if not known]
            fresh = iter(_rows(runs, again, point, bare, count_ended))
            rows += [
                replace(row, detector=False) if known else next(fresh)
                for row, known in zip(watched, same, strict=True)
            ]
            rows += watched
    out = tuple(_with_signal_out(grids, controller, signals, cache))
    return WrongCertificate(
        controller.name, case.name, signals.latency_s_of, tuple(signals.witnesses), table, tuple(rows), out
    )


def _as_without(row: WrongRow, signals: Signals, kinds: Mapping[str, Mapping[str, Any]]) -> bool:
    """Return whether a run with a detector is also the one without: all signals stayed trusted.

    The packets of witnesses only add communication steps (two areas: 1e-11 pu after 20 s); but swapped
    signals arrive when the latest of their concentrator does, which may be a witness.
    """
    if row.detected_s is not None or row.others or row.stopped_s is not None:
        return False
    swapped = row.kind != RIGHT and kinds[row.kind]["kind"] == SWAP
    return not swapped or max(signals.latency_s_of.values()) >= max(signals.all.values())


def _rows(
    runs: FaultRuns,
    jobs: Sequence[tuple[tuple[str, str, str], WrongRun]],
    point: str,
    bare: Mapping[str, Outcome],
    ended: Callable[[int], object],
) -> list[WrongRow]:
    """Return the row of each run; ended : called with the number of runs that have ended since the last."""
    rows: list[WrongRow] = []
    for first in range(0, len(jobs), TOGETHER):  # lanes step together runs of the same structure
        part = jobs[first : first + TOGETHER]
        of_part: dict[int, WrongRow] = {}
        for k, run, outcome, data in to_the_end(runs, [run for _, run in part]):
            kind, d, signal = part[k][0]
            of_part[k] = _row((kind, signal, d, point), run, outcome, data, bare[d])
        rows += [of_part[k] for k in range(len(part))]
        ended(len(part))
    return rows


def _jobs(
    case: Case,
    controller: Judged,
    signals: Signals,
    kinds: Mapping[str, Mapping[str, Any]],
    events: Mapping[str, Sequence[Mapping[str, Any]]],
    disturbances: Sequence[str] | None,
    detector: Mapping[str, Any] | None,
) -> Iterator[tuple[tuple[str, str, str], WrongRun]]:
    """Yield (kind, disturbance, signal) and run, those of the same structure in a row."""
    chosen = [d for d in events if disturbances is None or d in disturbances]
    latency_s_of = signals.latency_s_of if detector is None else signals.all
    for d in chosen:
        yield (RIGHT, d, ""), WrongRun(case.name, controller, latency_s_of, events[d], None, detector)
    for kind, signal, d in product(kinds, signals.latency_s_of, chosen):
        wrong = dict(kinds[kind])
        if wrong["kind"] == SWAP:
            order = list(signals.latency_s_of)
            if len(order) < 2:
                continue  # the controller sees no other
            wrong["other"] = order[(order.index(signal) + 1) % len(order)]
        run = WrongRun(case.name, controller, latency_s_of, events[d], (signal, wrong), detector)
        yield (kind, d, signal), run


def _row(
    names: tuple[str, str, str, str],
    run: WrongRun,
    outcome: Outcome,
    data: Trajectory,
    bare: Outcome,
) -> WrongRow:
    isolated: dict[str, float] = {}
    stopped: list[float] = []
    if run.detector is not None:
        for s in run.latency_s_of:
            reason = data[f"detector.{s}_reason"]
            own, of_all = (reason > 0) & (reason != _STANDING), reason == _STANDING
            if own.any():
                isolated[s] = float(data.time_s[own.argmax()]) - WRONG_S
            if of_all.any():
                stopped.append(float(data.time_s[of_all.argmax()]) - WRONG_S)
    right = isolated.pop(names[1], None)
    v = outcome.verdict
    verdict, why, left = (LOST, "the run ended early", 0.0) if v is None else (v.name, v.why, v.last)
    without = LOST if bare.verdict is None else bare.verdict.name
    watched = run.detector is not None
    return WrongRow(
        *names,
        watched,
        verdict,
        why,
        left,
        right,
        tuple(isolated),
        without,
        run.stop_s,
        min(stopped, default=None),
    )


def _with_signal_out(
    grids: Mapping[str, Case], controller: Judged, signals: Signals, cache: Path
) -> Iterator[SignalOut]:
    """Yield the damping that is left while a signal is isolated, the others as late as in the runs."""
    plants = {
        p: FamilyPlant.of(c, tuple(controller.inputs), tuple(controller.outputs), cache)
        for p, c in grids.items()
    }
    for signal in signals.latency_s_of:
        K = controller.acting((signal,)) if isinstance(controller, ControllerBank) else controller
        lost = (signal,) if signal in K.inputs else ()
        late = {s: t for s, t in signals.latency_s_of.items() if s in K.inputs and s not in lost}
        condition = Condition(f"{signal} isolated", lost, late)
        for point, plant in plants.items():
            row = family_row(point, plant.judged, K.system, condition, inter_area_band(plant.modes))
            yield SignalOut(row.point, signal, row.stable, row.worst_swing, row.inter_area)
