"""Whether a controller keeps a grid together that stays together without it, and for how long a fault.

Eigenvalues do not show it: a controller with good ones can add to the first swing after a fault and lose a
grid that holds without it, most of all where exciters have ceilings. So every combination of operating point,
exciter ceiling, fault, lost signal and latency is run through the non-linear plant, beside the same without
control; and for each point, ceiling and fault the clearing time that is just survived is searched for both.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from interarea.design.controllers.controller import Controller
from interarea.models.case.case import Case
from interarea.models.case.write_toml import export_toml
from interarea.models.files import new_folder
from interarea.models.table import Table

from ..run.run import system_of
from ..scenario.scenario import load_scenario
from .first_swing import Positive, after_clearing

Progress = Callable[[int, int], object]


class FaultPlace(Table):
    """A three-phase fault at a bus, cleared by itself or by the trip of a branch."""

    bus: int  #: number of the faulted bus
    trip: str | None = None  #: branch whose trip clears the fault; without it the fault clears itself

    def __str__(self) -> str:
        return f"bus {self.bus}" + ("" if self.trip is None else f", {self.trip} tripped")


class AcceptanceTable(Table):
    """What a controller must survive: every combination is run.

    ceilings : (least, most) field voltage of every exciter that has limits, pu; as the case has them too.
    latency_s : of every signal. Each signal is lost in turn at `lost_s`, and none.
    clear_cycles : of the fault, periods of the case's frequency.
    """

    fault: tuple[FaultPlace, ...] = Field(min_length=1)  #: the faults, each tried at every operating point
    #: (least, most) field voltage of every exciter that has limits, pu; as the case has them too
    ceilings: tuple[tuple[float, float], ...] = ()
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

    @property
    def ceilings(self) -> str:
        """The exciters' ceilings in words."""
        return "of the case" if self.ceiling is None else f"{self.ceiling[0]:g}/{self.ceiling[1]:g} pu"

    def __str__(self) -> str:
        limits = "" if self.ceiling is None else f", ceilings {self.ceilings}"
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


def settings_of(
    table: AcceptanceTable, points: Sequence[str], signals: Sequence[str]
) -> Iterator[tuple[Setting, list[Setting]]]:
    """Give each setting without control and those with control that belong to it."""
    losses: list[tuple[str, ...]] = [(), *((name,) for name in signals)] if len(signals) > 1 else [()]
    for point in points:
        for ceiling in (None, *table.ceilings):
            for fault in table.fault:
                alone = Setting(point, ceiling, fault)
                yield (
                    alone,
                    [Setting(point, ceiling, fault, lost, s) for lost in losses for s in table.latency_s],
                )


class Trial:
    """Runs settings of an acceptance; case and controller files live as long as it does."""

    def __init__(
        self, cases: Mapping[str, Case], controller: Controller, table: AcceptanceTable, cache: Path
    ) -> None:
        self.cases, self.controller, self.table, self.cache = cases, controller, table, cache
        self._files: dict[tuple[str, tuple[float, float] | None], Path] = {}

    def __enter__(self) -> Trial:
        self._folder = new_folder()
        self._controller = self.controller.save(self._folder / "controller.json")
        return self

    def __exit__(self, *_: object) -> None:
        shutil.rmtree(self._folder, ignore_errors=True)

    def angle(self, setting: Setting, *, control: bool, cycles: float | None = None) -> float:
        """Return the largest angle between two machines after the fault, rad."""
        t, case = self.table, self.cases[setting.point]
        fault = setting.fault
        clear_s = t.start_s + (t.clear_cycles if cycles is None else cycles) / case.frequency_hz
        document = after_clearing(
            self._case_file(setting), case, fault.bus, fault.trip, t.start_s, clear_s, x_pu=t.x_pu
        )
        document |= {"controller": str(self._controller) if control else "none", "stop_s": t.stop_s}
        if control:
            document["channels"] = {
                f"from_{signal}": {
                    "signal": signal,
                    "latency_s": setting.latency_s,
                    "outages_s": [[t.lost_s, t.stop_s]] if signal in setting.lost else [],
                }
                for signal in self.controller.inputs
            }
        with system_of(load_scenario(document), cache=self.cache).master() as master:
            data = master.run()
        angles = np.array([data[f"plant.{m.name}_delta"] for m in case.machines])
        return float(np.ptp(angles, axis=0).max())

    def kept(self, setting: Setting, *, control: bool, cycles: float | None = None) -> bool:
        """Whether no two machines come more than half a turn apart."""
        return self.angle(setting, control=control, cycles=cycles) < np.pi

    def clearing_cycles(self, setting: Setting, *, control: bool) -> float | None:
        """Return the longest fault that keeps synchronism (0: not one cycle; None: the longest tried)."""
        low, high = 1.0, self.table.longest_cycles
        if self.kept(setting, control=control, cycles=high):
            return None
        if not self.kept(setting, control=control, cycles=low):
            return 0.0
        while high - low > self.table.resolution_cycles:
            middle = 0.5 * (low + high)
            if self.kept(setting, control=control, cycles=middle):
                low = middle
            else:
                high = middle
        return low

    def _case_file(self, setting: Setting) -> Path:
        key = (setting.point, setting.ceiling)
        if key not in self._files:
            case = self.cases[setting.point]
            if setting.ceiling is not None:
                case = with_ceilings(case, *setting.ceiling)
            self._files[key] = self._folder / f"case-{len(self._files)}.toml"
            export_toml(case, self._files[key])
        return self._files[key]


def with_ceilings(case: Case, least: float, most: float) -> Case:
    """Return `case` with these limits on the field voltage of every exciter that can have them, pu."""
    change = {
        m.name: {"exciter": {"Efd_min": least, "Efd_max": most}}
        for m in case.machines
        if hasattr(m.exciter, "Efd_max")
    }
    return case.with_changes({"machines": change}, name=f"{case.name}-ceilings-{least:g}-{most:g}")


def judge_acceptance(
    controller: Controller,
    cases: Mapping[str, Case],
    table: AcceptanceTable,
    cache: Path,
    *,
    clearing: bool = True,
    progress: Progress | None = None,
) -> Acceptance:
    """Run every setting of `table` at every operating point, with the controller and without.

    clearing : search the clearing times too, at the first latency with the first signal lost.
    progress : called with settings done and all.
    """
    groups = list(settings_of(table, list(cases), controller.inputs))
    lost, gained, largest, rows, count = [], [], 0.0, [], 0
    with Trial(cases, controller, table, cache) as trial:
        for done, (alone, settings) in enumerate(groups):
            if progress is not None:
                progress(done, len(groups))
            holds = trial.kept(alone, control=False)
            for setting in settings:
                angle = trial.angle(setting, control=True)
                count += 1
                if angle < np.pi:
                    largest = max(largest, angle)
                if holds and not angle < np.pi:
                    lost.append(str(setting))
                elif not holds and angle < np.pi:
                    gained.append(str(setting))
            if clearing:
                hardest = next((s for s in settings if s.lost), settings[0])
                rows.append(
                    ClearingRow(
                        alone.point,
                        alone.ceilings,
                        str(alone.fault),
                        trial.clearing_cycles(alone, control=False),
                        trial.clearing_cycles(hardest, control=True),
                    )
                )
    return Acceptance(count, tuple(lost), tuple(gained), float(np.degrees(largest)), tuple(rows))


def in_words(found: Mapping[str, Any] | None) -> str:
    """Return the acceptance of a certificate in a line: what is lost first, or that nothing is.

    found : as `Acceptance.as_dict` gives it; None: never judged.
    """
    if found is None:
        return "non-linear faults: not judged"
    text = f"non-linear faults: {len(found['lost'])} of {found['cases']} lost that hold without it"
    if found["lost"]:
        text += f" (first: {found['lost'][0]})"
    text += f", {len(found['gained'])} gained"
    if found["clearing_mean_change_cycles"] is not None:
        text += (
            f"; clearing times {found['clearing_mean_change_cycles']:+.1f} cycles on average, "
            f"{found['clearing_worst_change_cycles']:+.1f} at worst"
        )
    return text
