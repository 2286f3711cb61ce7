"""Acceptance: whether a controller keeps synchronism and damps the grid after faults, and up to which
duration.

Eigenvalues do not show it: a controller with good ones can add to the first swing after a fault and lose
synchronism where the grid without control keeps it, above all where exciters have ceilings. Every combination
of operating point, exciter ceiling, kind of loads, fault, lost signal and latency is therefore run on the
non-linear plant, with and without control. The slowest root of the linear loop after the fault determines the
duration (`fault_loops`), and `results.verdict` the verdict. A run that keeps synchronism but does not decay
is continued, up to four minutes, before it counts against the controller. For each point, ceiling, kind and
fault the longest survived clearing time is searched with and without control.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from interarea.design.delay.signal_conditions import Condition
from interarea.models.case.case import Case
from interarea.models.case.named_changes import load_kind

from ..errors import ScenarioError
from .design_tables import AcceptanceTable, FaultPlace, wrong_condition
from .fault_loops import ControllerOrBank, FaultLoops, LoopEnd
from .fault_runs import FaultRun, FaultRuns, Outcome, longest_stable
from .first_swing import after_clearing


@dataclass(frozen=True)
class Setting:
    """One case of the acceptance: operating point, ceiling, loads, fault and lost signals."""

    point: str
    ceiling: tuple[float, float] | None
    fault: FaultPlace
    lost: tuple[str, ...] = ()
    latency_s: float = 0.0
    loads: tuple[float, float] | None = None
    wrong: tuple[str, str] | None = None  #: how, as in the table, and which signal

    @property
    def condition(self) -> Condition:
        """Lost and wrong signals, without the common latency."""
        return Condition("lost", self.lost) if self.wrong is None else wrong_condition(*self.wrong)

    def in_all(self, signals: Sequence[str]) -> Condition:
        """Return that condition with the common latency of these signals added."""
        more = self.condition.latency_s_of
        late = {name: self.latency_s + more.get(name, 0.0) for name in signals}
        return replace(self.condition, latency_s_of=late)

    @property
    def ceilings(self) -> str:
        """The exciters' ceilings in words."""
        return "of the case" if self.ceiling is None else f"{self.ceiling[0]:g}/{self.ceiling[1]:g} pu"

    @property
    def load_kind(self) -> str:
        """The loads in words."""
        return "of the case" if self.loads is None else "P ~ V^{:g}, Q ~ V^{:g}".format(*self.loads)

    def __str__(self) -> str:
        limits = "" if self.ceiling is None else f", ceilings {self.ceilings}"
        limits += "" if self.loads is None else f", loads {self.load_kind}"
        missing = f", {self.condition.in_words}" if self.lost or self.wrong else ""
        return f"{self.point}{limits}, fault at {self.fault}{missing}, {1e3 * self.latency_s:g} ms"


@dataclass(frozen=True)
class ClearingRow:
    """Longest fault that keeps synchronism, cycles; None: the longest tried."""

    point: str
    ceilings: str
    fault: str
    without: float | None
    with_control: float | None
    loads: str = "of the case"


@dataclass(frozen=True)
class Acceptance:
    """Result of the acceptance.

    lost : synchronism kept only without control. gained : kept only with control, and decaying. standing :
    kept but not decaying, with the verdict, where the run without control decays or loses synchronism. loops
    : number of linear loops after the faults; unstable : those that are unstable but stable without control,
    with their root.
    """

    cases: int
    lost: tuple[str, ...]
    gained: tuple[str, ...]
    largest_angle_deg: float  #: of the kept runs, between any two machines
    clearing: tuple[ClearingRow, ...]
    standing: tuple[str, ...] = ()
    loops: int = 0
    unstable: tuple[str, ...] = ()
    longest_s: float = 0.0  #: the longest run that the linear loops, or a verdict, asked for
    #: operating points and branches without which no power flow is found: there the loop with them is judged
    unsolved: tuple[str, ...] = ()
    #: settings in which a line-commutated dc link fails to commutate, which the model does not have: the runs
    #: are optimistic
    commutation: tuple[str, ...] = ()

    @property
    def violations(self) -> tuple[str, ...]:
        """The violations of the controller, each as a sentence."""
        return (
            *(f"{case}: synchronism lost; kept without the controller" for case in self.lost),
            *self.standing,
            *(f"linear loop {loop}; stable without the controller" for loop in self.unstable),
        )

    @property
    def changes_cycles(self) -> tuple[float, ...]:
        """Change of the clearing time where both have one, cycles."""
        both = [(r.without, r.with_control) for r in self.clearing]
        return tuple(b - a for a, b in both if a is not None and b is not None)

    def as_dict(self) -> dict[str, Any]:
        """Return the record as JSON values; `commutation` only where a link fails to."""
        changes = self.changes_cycles
        summary = {
            "clearing_shorter": sum(change < -0.2 for change in changes),
            "clearing_mean_change_cycles": float(np.mean(changes)) if changes else None,
            "clearing_worst_change_cycles": min(changes, default=None),
        }
        fields = {key: value for key, value in asdict(self).items() if value or key != "commutation"}
        return {**fields, **summary}


#: a setting, and whether the controller is there
Try: TypeAlias = tuple[Setting, bool]


def settings_of(
    table: AcceptanceTable,
    point: str,
    ceiling: tuple[float, float] | None,
    signals: Sequence[str],
    loads: tuple[float, float] | None = None,
) -> Iterator[tuple[Setting, list[Setting]]]:
    """Yield each setting of an operating point without control, with its settings with control.

    Raises
    ------
    ScenarioError : `never_lost` has a name that is not a signal of the controller.
    """
    try:
        table.check_signals(signals)
    except ValueError as error:
        raise ScenarioError(str(error)) from None
    sure = [name for name in signals if name not in table.never_lost]
    kinds: list[tuple[tuple[str, ...], tuple[str, str] | None]] = [((), None)]
    kinds += [((name,), None) for name in sure]
    kinds += [((), (code, name)) for code in table.wrong for name in sure]
    for fault in table.fault:
        yield (
            Setting(point, ceiling, fault, loads=loads),
            [Setting(point, ceiling, fault, lost, s, loads, w) for lost, w in kinds for s in table.latency_s],
        )


class Trial:
    """Runs the settings of an acceptance in one grid as batches: one operating point, ceilings and loads."""

    def __init__(
        self,
        case: Case,
        controller: ControllerOrBank,
        table: AcceptanceTable,
        cache: Path,
        ceiling: tuple[float, float] | None = None,
        loads: tuple[float, float] | None = None,
    ) -> None:
        self.controller, self.table = controller, table
        self.longest_s = 0.0  #: of the runs that `outcomes` made
        case = case if ceiling is None else with_ceilings(case, *ceiling)
        self._runs = FaultRuns(case if loads is None else with_loads(case, *loads), cache)

    def __enter__(self) -> Trial:
        return self

    def __exit__(self, *_: object) -> None:
        self._runs.__exit__()

    def angles(self, cycles: Mapping[Try, float]) -> dict[Try, float]:
        """Return the largest angle between two machines after each fault of so many cycles, rad."""
        largest_angles = self._runs.largest_angles([self._run(setting, n) for setting, n in cycles.items()])
        return dict(zip(cycles, largest_angles, strict=True))

    def outcomes(self, ends: Mapping[Try, LoopEnd]) -> dict[Try, Outcome]:
        """Return the outcome of each fault of `clear_cycles`; the linear loop determines the duration of the
        run."""
        t = self.table
        runs = [self._run(each, t.clear_cycles) for each in ends]
        outcomes, longest_s = self._runs.outcomes_to_end(runs, list(ends.values()), t.lost_s)
        self.longest_s = max(self.longest_s, longest_s)
        return dict(zip(ends, outcomes, strict=True))

    def stable_at(self, cycles: Mapping[Try, float]) -> dict[Try, bool]:
        """Whether no two machines come more than half a turn apart."""
        return {setting: angle < np.pi for setting, angle in self.angles(cycles).items()}

    def clearing_cycles(self, tries: Sequence[Try]) -> dict[Try, float | None]:
        """Return the longest fault that keeps synchronism (0: not one cycle; None: the longest tried)."""
        t = self.table
        clearing = longest_stable(tries, self.stable_at, 1.0, t.longest_cycles, t.resolution_cycles)
        return {each: None if n >= t.longest_cycles else n for each, n in clearing.items()}

    def _run(self, each: Try, cycles: float) -> FaultRun:
        t, (setting, controlled) = self.table, each
        clear_s = t.start_s + cycles / self._runs.case.frequency_hz
        fault = setting.fault
        return FaultRun(
            after_clearing(self._runs.case, fault.bus, fault.trip, t.start_s, clear_s, x_pu=t.x_pu),
            t.stop_s,
            self.controller if controlled else None,
            setting.latency_s,
            dict.fromkeys(setting.lost, t.lost_s),
            _signal_faults(setting.condition, t.lost_s),
        )


def _signal_faults(condition: Condition, start_s: float) -> dict[str, dict[str, Any]]:
    """Return the table of `signal_faults` of each signal that is wrong from `start_s` on."""
    scaled = {n: {"kind": "scale", "factor": k} for n, k in condition.scale_of.items()}
    late = {n: {"kind": "time_error", "offset_s": s} for n, s in condition.latency_s_of.items()}
    return {name: {**table, "start_s": start_s} for name, table in (scaled | late).items()}


def with_ceilings(case: Case, least: float, most: float) -> Case:
    """Return `case` with these limits on the field voltage (pu) of every exciter that has limits."""
    change = {
        m.name: {"exciter": {"Efd_min": least, "Efd_max": most}}
        for m in case.machines
        if hasattr(m.exciter, "Efd_max")
    }
    return case.with_changes({"machines": change}, name=f"{case.name}-ceilings-{least:g}-{most:g}")


def with_loads(case: Case, of_p: float, of_q: float) -> Case:
    """Return `case` with these exponents of active and reactive power for every load."""
    return case.with_changes(load_kind(case, of_p, of_q))


def judge_acceptance(
    controller: ControllerOrBank,
    cases: Mapping[str, Case],
    table: AcceptanceTable,
    cache: Path,
    *,
    clearing: bool = True,
    progress: Callable[[float], object] = lambda share: None,
) -> Acceptance:
    """Run every setting of `table` at its operating points, with the controller and without.

    clearing : search the clearing times too, at the first latency with the first signal lost.
    progress : called with the completed share of the operating points and ceilings.
    """
    cases = table.looked_at(cases)
    places = list(product(cases, (None, *table.ceilings), (None, *table.loads)))
    loops: dict[tuple[str, tuple[float, float] | None], FaultLoops] = {}
    collected = _Collected()
    rows: list[ClearingRow] = []
    for done, (point, ceiling, loads) in enumerate(places):
        progress(done / len(places))
        if (point, loads) not in loops:
            case = cases[point] if loads is None else with_loads(cases[point], *loads)
            loops[point, loads] = FaultLoops(case, controller, cache)
        groups = list(settings_of(table, point, ceiling, controller.inputs, loads))
        with Trial(cases[point], controller, table, cache, ceiling, loads) as trial:
            ends = _ends(loops[point, loads], groups)
            if ceiling is None:  # the exciters' ceilings are no part of a linear loop
                collected.take_loops(groups, ends)
            collected.take_runs(groups, trial.outcomes(ends))
            if clearing:
                rows += _clearing_rows(trial, groups)
            collected.longest_s = max(collected.longest_s, trial.longest_s)
    progress(1.0)
    unsolved = dict.fromkeys(f"{p} without {b}" for (p, _), each in loops.items() for b in each.unsolved)
    return collected.acceptance(tuple(rows), tuple(unsolved))


def clearing_times(
    controller: ControllerOrBank, point: str, case: Case, table: AcceptanceTable, cache: Path
) -> tuple[ClearingRow, ...]:
    """Search the clearing times at one operating point, ceilings and loads of the case, as an acceptance."""
    with Trial(case, controller, table, cache) as trial:
        return tuple(_clearing_rows(trial, list(settings_of(table, point, None, controller.inputs))))


def joined(parts: Sequence[Acceptance]) -> Acceptance:
    """Return the common acceptance of several operating points that were run separately."""
    values: dict[str, Any] = {name: sum(getattr(part, name) for part in parts) for name in ("cases", "loops")}
    for name in ("largest_angle_deg", "longest_s"):
        values[name] = max(getattr(part, name) for part in parts)
    for name in ("lost", "gained", "clearing", "standing", "unstable", "unsolved", "commutation"):
        values[name] = tuple(each for part in parts for each in getattr(part, name))
    return Acceptance(**values)


Groups: TypeAlias = Sequence[tuple[Setting, list[Setting]]]


@dataclass
class _Collected:
    """Results of the runs and loops of an acceptance, in the order of completion."""

    lost: list[str] = field(default_factory=list)
    gained: list[str] = field(default_factory=list)
    standing: list[str] = field(default_factory=list)
    unstable: list[str] = field(default_factory=list)
    commutation: list[str] = field(default_factory=list)
    largest: float = 0.0
    cases: int = 0
    loops: int = 0
    longest_s: float = 0.0

    def take_runs(self, groups: Groups, outcomes: Mapping[Try, Outcome]) -> None:
        """Compare each run with that without control."""
        for alone, settings in groups:
            without = outcomes[alone, False]
            self.cases += len(settings)
            for s in settings:
                run = outcomes[s, True]
                if run.failed_links:
                    self.commutation.append(f"{s}: {', '.join(run.failed_links)}")
                if run.synchronous:
                    self.largest = max(self.largest, run.angle_rad)
                if without.synchronous and not run.synchronous:
                    self.lost.append(str(s))
                elif run.stable and not without.synchronous:
                    self.gained.append(str(s))
                elif run.synchronous and not run.stable and (without.stable or not without.synchronous):
                    alone_does = "decays" if without.stable else "synchronism lost"
                    self.standing.append(f"{s}: {run.verdict}; without the controller {alone_does}")

    def take_loops(self, groups: Groups, ends: Mapping[Try, LoopEnd]) -> None:
        """Compare each linear loop with that without control."""
        for alone, settings in groups:
            self.loops += len(settings)
            for s in settings:
                end = ends[s, True]
                if ends[alone, False].stable and not end.stable:
                    root = f"{end.root.real:+.3g} +- {end.root.imag:.3g}j"
                    self.unstable.append(f"after {s}: unstable (rightmost root {root} 1/s)")

    def acceptance(self, rows: tuple[ClearingRow, ...], unsolved: tuple[str, ...]) -> Acceptance:
        """Return it as a whole."""
        return Acceptance(
            self.cases,
            tuple(self.lost),
            tuple(self.gained),
            float(np.degrees(self.largest)),
            rows,
            tuple(self.standing),
            self.loops,
            tuple(self.unstable),
            self.longest_s,
            unsolved,
            tuple(self.commutation),
        )


def _ends(loops: FaultLoops, groups: Groups) -> dict[Try, LoopEnd]:
    """Return the linear loop that each setting ends in, without control and with it."""
    return {
        (s, s is not alone): loops.end(
            s.fault.trip, s.in_all(loops.controller.inputs), controlled=s is not alone
        )
        for alone, settings in groups
        for s in (alone, *settings)
    }


def _clearing_rows(trial: Trial, groups: Sequence[tuple[Setting, list[Setting]]]) -> list[ClearingRow]:
    """Search each fault's clearing time without control and with it, the first signal lost."""
    hardest = {alone: next((s for s in settings if s.lost), settings[0]) for alone, settings in groups}
    clearing = trial.clearing_cycles(
        [each for alone, hard in hardest.items() for each in ((alone, False), (hard, True))]
    )
    return [
        ClearingRow(
            alone.point,
            alone.ceilings,
            str(alone.fault),
            clearing[alone, False],
            clearing[hard, True],
            alone.load_kind,
        )
        for alone, hard in hardest.items()
    ]
