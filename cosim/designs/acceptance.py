"""Whether a controller keeps a grid together that stays together without it, and for how long a fault.

Eigenvalues do not show it: a controller with good ones can add to the first swing after a fault and lose a
grid that holds without it, most of all where exciters have ceilings. So every combination of operating
point, exciter ceiling, kind of loads, fault, lost signal and latency is run through the non-linear plant,
beside the same without control; and for each point, ceiling, kind and fault the clearing time that is just
survived is searched for both.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import numpy as np
from pydantic import Field

from interarea.design.controllers.controller import Controller
from interarea.models.case.case import Case, load_case
from interarea.models.table import Table

from ..scenario.names import CONTROLLER_NAMES
from .fault_runs import FaultRun, FaultRuns, longest_kept
from .first_swing import Positive, after_clearing

Exponent = Annotated[float, Field(ge=0.0)]


class FaultPlace(Table):
    """A three-phase fault at a bus, cleared by itself or by the trip of a branch."""

    bus: int  #: number of the faulted bus
    trip: str | None = None  #: branch whose trip clears the fault; without it the fault clears itself

    def __str__(self) -> str:
        return f"bus {self.bus}" + ("" if self.trip is None else f", {self.trip} tripped")


class AcceptanceTable(Table):
    """What a controller must survive: every combination is run.

    ceilings : (least, most) field voltage of every exciter that has limits, pu; as the case has them too.
    loads : exponents of P and Q of every load; as the case has them too.
    latency_s : of every signal. Each signal is lost in turn at `lost_s`, and none.
    clear_cycles : of the fault, periods of the case's frequency.
    """

    fault: tuple[FaultPlace, ...] = Field(min_length=1)  #: the faults, each tried at every operating point
    #: (least, most) field voltage of every exciter that has limits, pu; as the case has them too
    ceilings: tuple[tuple[float, float], ...] = ()
    #: exponents of P and Q of every load, such as 1 and 2: P of constant current, Q of constant impedance; as
    #: the case has them too
    loads: tuple[tuple[Exponent, Exponent], ...] = ()
    #: of every signal, one run for each value
    latency_s: tuple[Annotated[float, Field(ge=0.0)], ...] = Field((0.1,), min_length=1)
    clear_cycles: Positive = 8.0  #: how long the fault lasts, periods of the case's frequency
    start_s: Positive = 1.0  #: when the fault begins
    lost_s: Positive = 1.5  #: from when on the lost signal is lost
    stop_s: Positive = 10.0  #: end of each run
    x_pu: Positive = 1e-4  #: reactance of the fault to earth
    longest_cycles: Positive = 30.0  #: clearing times are searched from 1 cycle to this
    resolution_cycles: Positive = 0.15  #: how finely a clearing time is searched


@dataclass(frozen=True)
class Setting:
    """One case of the acceptance: where, under which ceiling, after which fault, with what missing."""

    point: str
    ceiling: tuple[float, float] | None
    fault: FaultPlace
    lost: tuple[str, ...] = ()
    latency_s: float = 0.0
    loads: tuple[float, float] | None = None

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
        missing = f", {' and '.join(self.lost)} lost" if self.lost else ""
        return f"{self.point}{limits}, fault at {self.fault}{missing}, {1e3 * self.latency_s:g} ms"


@dataclass(frozen=True)
class ClearingRow:
    """Longest fault that keeps synchronism, cycles; None: as long as was tried."""

    point: str
    ceilings: str
    fault: str
    without: float | None
    with_control: float | None
    loads: str = "of the case"


@dataclass(frozen=True)
class Acceptance:
    """What came out. lost: kept without control only; gained: kept with control only."""

    cases: int
    lost: tuple[str, ...]
    gained: tuple[str, ...]
    largest_angle_deg: float  #: of the kept runs, between any two machines
    clearing: tuple[ClearingRow, ...]

    @property
    def changes_cycles(self) -> tuple[float, ...]:
        """Change of the clearing time where both have one, cycles."""
        both = [(r.without, r.with_control) for r in self.clearing]
        return tuple(b - a for a, b in both if a is not None and b is not None)

    def as_dict(self) -> dict[str, Any]:
        """Return the record as JSON values."""
        changes = self.changes_cycles
        summary = {
            "clearing_shorter": sum(change < -0.2 for change in changes),
            "clearing_mean_change_cycles": float(np.mean(changes)) if changes else None,
            "clearing_worst_change_cycles": min(changes, default=None),
        }
        return {**asdict(self), **summary}


#: a setting, and whether the controller is there
Try: TypeAlias = tuple[Setting, bool]


def settings_of(
    table: AcceptanceTable,
    point: str,
    ceiling: tuple[float, float] | None,
    signals: Sequence[str],
    loads: tuple[float, float] | None = None,
) -> Iterator[tuple[Setting, list[Setting]]]:
    """Give each setting of an operating point without control and those with control that belong to it."""
    losses: list[tuple[str, ...]] = [(), *((name,) for name in signals)] if len(signals) > 1 else [()]
    for fault in table.fault:
        yield (
            Setting(point, ceiling, fault, loads=loads),
            [Setting(point, ceiling, fault, lost, s, loads) for lost in losses for s in table.latency_s],
        )


class Trial:
    """Runs the settings of an acceptance in one grid, side by side: an operating point, ceilings, loads."""

    def __init__(
        self,
        case: Case,
        controller: Controller,
        table: AcceptanceTable,
        cache: Path,
        ceiling: tuple[float, float] | None = None,
        loads: tuple[float, float] | None = None,
    ) -> None:
        self.controller, self.table = controller, table
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

    def kept(self, cycles: Mapping[Try, float]) -> dict[Try, bool]:
        """Whether no two machines come more than half a turn apart."""
        return {setting: angle < np.pi for setting, angle in self.angles(cycles).items()}

    def clearing_cycles(self, tries: Sequence[Try]) -> dict[Try, float | None]:
        """Return the longest fault that keeps synchronism (0: not one cycle; None: the longest tried)."""
        t = self.table
        clearing = longest_kept(tries, self.kept, 1.0, t.longest_cycles, t.resolution_cycles)
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
        )


def with_ceilings(case: Case, least: float, most: float) -> Case:
    """Return `case` with these limits on the field voltage of every exciter that can have them, pu."""
    change = {
        m.name: {"exciter": {"Efd_min": least, "Efd_max": most}}
        for m in case.machines
        if hasattr(m.exciter, "Efd_max")
    }
    return case.with_changes({"machines": change}, name=f"{case.name}-ceilings-{least:g}-{most:g}")


def with_loads(case: Case, of_p: float, of_q: float) -> Case:
    """Return `case` with these exponents of active and reactive power for every load."""
    kind = {"P_exponent": of_p, "Q_exponent": of_q, "P_zip": None, "Q_zip": None}
    return case.with_changes({"loads": {load.name: kind for load in case.loads}})


def judge_acceptance(
    controller: Controller,
    cases: Mapping[str, Case],
    table: AcceptanceTable,
    cache: Path,
    *,
    clearing: bool = True,
    progress: Callable[[float], object] = lambda share: None,
) -> Acceptance:
    """Run every setting of `table` at every operating point, with the controller and without.

    clearing : search the clearing times too, at the first latency with the first signal lost.
    progress : called with the share of the operating points and ceilings that is done.
    """
    places = list(product(cases, (None, *table.ceilings), (None, *table.loads)))
    lost: list[str] = []
    gained: list[str] = []
    rows: list[ClearingRow] = []
    largest, count = 0.0, 0
    for done, (point, ceiling, loads) in enumerate(places):
        progress(done / len(places))
        groups = list(settings_of(table, point, ceiling, controller.inputs, loads))
        with Trial(cases[point], controller, table, cache, ceiling, loads) as trial:
            angles = _angles(trial, groups, table.clear_cycles)
            for alone, settings in groups:
                holds = angles[alone, False] < np.pi
                count += len(settings)
                retained = {s: angles[s, True] for s in settings if angles[s, True] < np.pi}
                largest = max([largest, *retained.values()])
                different = [str(s) for s in settings if holds != (s in retained)]
                (lost if holds else gained).extend(different)
            if clearing:
                rows += _clearing_rows(trial, groups)
    progress(1.0)
    return Acceptance(count, tuple(lost), tuple(gained), float(np.degrees(largest)), tuple(rows))


def _angles(trial: Trial, groups: Sequence[tuple[Setting, list[Setting]]], cycles: float) -> dict[Try, float]:
    """Run every setting without control and with it, all side by side."""
    tries = [(s, s is not alone) for alone, settings in groups for s in (alone, *settings)]
    return trial.angles(dict.fromkeys(tries, cycles))


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


def in_words(result: Mapping[str, Any] | None) -> str:
    """Return the acceptance of a certificate in a line: what is lost first, or that nothing is.

    result : as `Acceptance.as_dict` gives it; None: never judged.
    """
    if result is None:
        return "non-linear faults: not judged"
    text = f"non-linear faults: {len(result['lost'])} of {result['cases']} lost that hold without it"
    if result["lost"]:
        text += f" (first: {result['lost'][0]})"
    text += f", {len(result['gained'])} gained"
    if result["clearing_mean_change_cycles"] is not None:
        text += (
            f"; clearing times {result['clearing_mean_change_cycles']:+.1f} cycles on average, "
            f"{result['clearing_worst_change_cycles']:+.1f} at worst"
        )
    return text


def first_failures(certificate: Mapping[str, Any] | None) -> str:
    """Return in a line the first conditions in which a controller fails by its certificate for a family.

    Linear: the first operating point and condition that is unstable; then its acceptance, as `in_words`.
    """
    rows = (certificate or {}).get("rows", ())
    unstable = [row for row in rows if not row["stable"]]
    text = in_words((certificate or {}).get("acceptance"))
    if not unstable:
        return text
    first = f"{unstable[0]['point']}, {unstable[0]['condition']}"
    return f"unstable in {len(unstable)} of {len(rows)} linear conditions (first: {first}); {text}"


def kept_certificate(name: str, case_hash: str) -> dict[str, Any] | None:
    """Return what a controller of the study holds at two points of `robust_latency`; None of any other.

    Found by ``benchmarks/control/study_certificates.py`` for the case of that design: nothing is known of
    another.
    """
    path = Path(__file__).parent / f"certificate_{name}.json"
    if name not in CONTROLLER_NAMES or not path.exists() or case_hash != load_case("two-area-thesis").hash:
        return None
    return dict(json.loads(path.read_text(encoding="utf-8")))
