"""Runs of a screening: a disturbance at each place of a grid, as a sweep; and their results."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import pandas as pd

from interarea.models.case.case import Case, load_case
from interarea.models.case.tables import SOLVER_STEP_S

from ..errors import SweepError, nearest
from ..scenario.scenario import load_scenario
from ..sweep.front import Progress, run_sweep
from ..sweep.parts import read_rows
from ..sweep.spec import Sweep, sweep_of

START_S = 0.1  #: of the disturbance; before it the grid is at rest
LONG_STEP_S = 0.04  #: between points at which a grid without controller is looked at
FAULTS, CLEARING = "faults", "clearing"  #: folders of the two sweeps
REPEATED = "_repeated"  #: after those names: folders of runs that failed and were repeated
#: between the places of a run in the results
PLACE = {"fault": "bus", "trip": "branch"}


@dataclass(frozen=True)
class Screening:
    """A screening of the grid `case` (a bundled name or a case file).

    kind : "fault": at each of `buses` in turn (default: all) through 0.0001j pu, for `clearing_s`, nothing
        opened; "trip": each of `branches` (default: all in service) opens for good.
    outages : branches that are out before the disturbance, one at a time, besides the unchanged grid.
    controllers : besides none. longest_s : of the clearing times that are searched, to `tolerance_s`.
    step_s : communication step; None: 40 ms, with a controller the step that its loop needs. solver_step_s :
        longest step of the plant; None: its own. step_reason : why that step, for the page. repeat_step_s :
        step for repeating failed runs, where a chosen step is too long for some; None: no repetition.

    Raises SweepError for a solver step that no plant takes.
    """

    case: str
    kind: Literal["fault", "trip"] = "fault"
    buses: tuple[int, ...] = ()
    branches: tuple[str, ...] = ()
    outages: tuple[str, ...] = ()
    controllers: tuple[str, ...] = ()
    clearing_s: float = 0.1
    stop_s: float = 10.0
    step_s: float | None = None
    solver_step_s: float | None = None
    step_reason: str = ""
    repeat_step_s: float | None = None
    longest_s: float = 1.0
    tolerance_s: float = 0.005

    def __post_init__(self) -> None:
        shortest, longest = SOLVER_STEP_S
        if self.solver_step_s is not None and not shortest <= self.solver_step_s <= longest:
            raise SweepError(
                f"solver step = {self.solver_step_s:g}, allowed: {shortest:g} to {longest:g} s, the longest "
                "step of the plant"
            )

    @property
    def case_path(self) -> str:
        """Name of the bundled grid, or the path of its file."""
        return str(load_scenario({"case": self.case, "stop_s": 1.0}).case_path)

    def load(self) -> Case:
        """Return the grid.

        Raises
        ------
        ScenarioError, CaseError : no such grid, or one that breaks a rule.
        """
        return load_case(self.case_path)

    def places(self, case: Case) -> list[Any]:
        """Return the numbers of the buses, or names of the branches, that are disturbed in turn.

        Raises
        ------
        SweepError : a place that does not exist, with the nearest.
        """
        known: list[Any] = [b.number for b in case.buses]
        requested: Sequence[Any] = self.buses
        if self.kind == "trip":
            known, requested = [b.name for b in case.branches if b.in_service], self.branches
        for place in requested:
            if place not in known:
                raise SweepError(
                    f"{case.name}: no {PLACE[self.kind]} {place}; {nearest(str(place), map(str, known))}"
                )
        return list(dict.fromkeys(requested)) or known

    def at(self, places: tuple[Any, ...]) -> Screening:
        """Return the same screening of these places alone."""
        return replace(self, buses=places) if self.kind == "fault" else replace(self, branches=places)

    def event(self, place: Any) -> dict[str, Any]:
        """Return the disturbance at a place, as in a scenario file."""
        if self.kind == "trip":
            return {"kind": "branch_trip", "branch": place, "start_s": START_S}
        end = round(START_S + self.clearing_s, 9)
        return {"kind": "bus_fault", "bus": place, "start_s": START_S, "end_s": end}

    def sweep(self, *, clearing: bool = False, case: Case | None = None) -> Sweep:
        """Return the sweep over all places, outages and controllers; `clearing`: that of the clearing times.

        case : the grid where it is already loaded.

        Raises
        ------
        SweepError, ScenarioError, CaseError : a place, an outage or a value that does not fit.
        """
        path, case = self.case_path, case or self.load()
        if not self.stop_s > START_S + self.clearing_s:
            least = START_S + self.clearing_s
            raise SweepError(f"the run ends at {self.stop_s:g} s, allowed: after the fault, {least:g} s")
        places = self.places(case)
        for name in self.outages:
            case.branch(name)  # refuses an unknown one
        kind = PLACE[self.kind]
        parameters: dict[str, Any] = {kind: {"path": f"event.1.{kind}", "values": places}}
        if self.outages:
            parameters["outage"] = {"path": "case.out", "values": ["", *self.outages]}
        if self.controllers:
            parameters["controller"] = {"values": ["none", *self.controllers]}
        if clearing:
            least, most = START_S + 1.0 / case.frequency_hz, START_S + self.longest_s
            search = {"low": least, "high": most, "tolerance": self.tolerance_s, "scan": 3}
            parameters["cleared"] = {"path": "event.1.end_s", "bisect": search, "unit": "s"}
        scenario: dict[str, Any] = {
            "case": path if Path(path).is_absolute() else self.case,
            "stop_s": self.stop_s,
            "event": [self.event(places[0])],
            "plant": {} if self.solver_step_s is None else {"solver.step": self.solver_step_s},
        }
        step_s = self.step_s or (None if self.controllers else LONG_STEP_S)
        if step_s is not None:
            scenario["step_s"] = step_s
        if len(case.machines) > 1 and case.swing is None:  # nothing asks for it: no search for a mode
            scenario["swing"] = [case.machines[0].name, case.machines[-1].name]
        table = {
            "name": "screening",
            "title": f"Screening of {case.name}",
            "scenario": scenario,
            "parameters": parameters,
            "metrics": ["synchronism"] if clearing else ["stable", "synchronism"],
            "time_limit_s": 3600.0,
        }
        return sweep_of(table, "screening", Path())


@dataclass(frozen=True)
class Screened:
    """Result of one disturbance with one controller; numbers are None if the run failed.

    verdict : whether synchronism was kept. came_to : verdict of the run (`results.verdict`), "" if it failed.
    """

    place: str
    outage: str
    controller: str
    verdict: Literal["kept", "lost", "failed"]
    angle_deg: float | None
    voltage_pu: float | None
    voltage_at: str
    nadir_hz: float | None
    zenith_hz: float | None
    reason: str
    #: longest fault that keeps synchronism, s: 0 not one cycle, inf as long as was tried; None: not searched
    critical_s: float | None = None
    came_to: str = ""


def run_screening(
    screening: Screening,
    folder: Path,
    *,
    clearing: bool = False,
    workers: int | None = None,
    scheduler: str | None = None,
    cache: Path | None = None,
    progress: Callable[[Progress], object] | None = None,
    case: Case | None = None,
) -> list[Screened]:
    """Run the missing runs of a screening into `folder`; return the result of each disturbance, worst first.

    clearing : search the clearing times too. case : the grid where it is already loaded. Other parameters as
        of `run_sweep`.

    Raises
    ------
    SweepError, ScenarioError, CaseError : see `Screening.sweep`; clearing times of trips.
    """
    if clearing and screening.kind == "trip":
        raise SweepError("clearing times need faults; not allowed with a screening of trips")
    options: dict[str, Any] = {
        "workers": workers,
        "scheduler": scheduler,
        "cache": cache,
        "progress": progress,
        "case": case or screening.load(),
    }
    rows = _rows_of(screening, folder / FAULTS, options, clearing=False)
    critical: Mapping[tuple[str, str, str], float | None] = {}
    if clearing:
        critical = _critical(_rows_of(screening, folder / CLEARING, options, clearing=True), screening)
    return worst_first(rows, screening, critical)


def run_screened(
    screening: Screening, folder: Path, *, case: Case, clearing: bool = False, **options: Any
) -> pd.DataFrame:
    """Run the missing runs of a screening, or of its clearing times, into `folder`; return the rows of all.

    case : its grid. options : of `run_sweep`.
    """
    sweep = screening.sweep(clearing=clearing, case=case)
    run_sweep(sweep, folder, loaded={str(sweep.base.case): case}, **options)
    return read_rows(folder)


def _rows_of(
    screening: Screening, folder: Path, options: Mapping[str, Any], *, clearing: bool
) -> pd.DataFrame:
    """Return the rows of a sweep, those of places with a failed run from runs with `repeat_step_s`."""
    rows, kind = run_screened(screening, folder, clearing=clearing, **options), PLACE[screening.kind]
    failed = tuple(dict.fromkeys(rows[kind][rows["status"] != "ok"].tolist()))
    if screening.repeat_step_s is None or not failed:
        return rows
    again = replace(screening.at(failed), solver_step_s=screening.repeat_step_s)
    part = folder.with_name(folder.name + REPEATED)
    repeated = run_screened(again, part, clearing=clearing, **options)
    return pd.concat([rows[~rows[kind].isin(failed)], repeated], ignore_index=True)


def _key(row: Mapping[Any, Any], screening: Screening) -> tuple[str, str, str]:
    place = row[PLACE[screening.kind]]
    return str(place), str(row.get("outage", "")), str(row.get("controller", "none"))


def _critical(rows: pd.DataFrame, screening: Screening) -> dict[tuple[str, str, str], float | None]:
    """Return the critical clearing time of each run; None where its search failed."""
    result: dict[tuple[str, str, str], float | None] = {}
    for row in rows.to_dict("records"):
        good, bad = row["cleared"], row["cleared_unstable"]
        if row["status"] != "ok":
            value = None
        elif pd.isna(good):
            value = 0.0
        else:
            value = math.inf if pd.isna(bad) else float(good) - START_S
        result[_key(row, screening)] = value
    return result


def worst_first(
    rows: pd.DataFrame, screening: Screening, critical: Mapping[tuple[str, str, str], float | None]
) -> list[Screened]:
    """Return the results in order: runs that lost synchronism, failed runs, then the others by angle.

    The run without controller decides; the other runs of its place follow it.
    """
    result = [_screened(row, screening, critical) for row in rows.to_dict("records")]
    groups: dict[tuple[str, str], list[Screened]] = {}
    for one in result:
        groups.setdefault((one.place, one.outage), []).append(one)
    for group in groups.values():
        group.sort(key=lambda one: one.controller != "none")
    return [one for group in sorted(groups.values(), key=lambda g: _badness(g[0])) for one in group]


def _badness(one: Screened) -> tuple[int, float, float]:
    critical = math.inf if one.critical_s is None else one.critical_s
    return {"lost": 0, "failed": 1, "kept": 2}[one.verdict], critical, -(one.angle_deg or 0.0)


def _screened(
    row: Mapping[Any, Any], screening: Screening, critical: Mapping[tuple[str, str, str], float | None]
) -> Screened:
    key = _key(row, screening)
    if row["status"] != "ok":
        verdict: Literal["lost", "failed"] = "lost" if row["failure"] == "no solution" else "failed"
        return Screened(*key, verdict, None, None, "", None, None, str(row["reason"]), critical.get(key))
    return Screened(
        *key,
        "kept" if row["synchronous"] else "lost",
        float(row["angle_deg"]),
        float(row["voltage_pu"]),
        str(row["voltage_at"]),
        float(row["nadir_hz"]),
        float(row["zenith_hz"]),
        "",
        critical.get(key),
        str(row.get("verdict") or ""),
    )
