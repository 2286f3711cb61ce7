"""Does a wide-area signal pay? The study `worth`: grids, sets of loops, signals and latencies, one page."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

from interarea.design.controllers.controller import Controller, plain
from interarea.design.modes.loop_points import LoopSet
from interarea.design.robust.smoothed_objective import BandOffsets
from interarea.models.case.case import Case
from interarea.models.errors import InterareaError
from interarea.models.files import write_rows, write_whole
from interarea.models.threads import one_thread

from ..designs.family import at_point
from ..errors import machine_error
from .automatic import Report
from .choices import ENOUGH, Choices
from .clock import Clock
from .link_page import write_link_page
from .link_sets import LinkSet, conclusion
from .link_worth import (
    AFAR,
    LATENCIES_MS,
    OWN,
    SIGNALS,
    LinkDesigns,
    LinkRow,
    signals_of_set,
)
from .operating_points import chosen_points, tried_points
from .proposal import acceptance_of, offset_of
from .weak_modes import WeakModes, modes_of_grid, weak_modes

GRIDS = ("two-area-thesis", "kundur-pss", "new-england")  #: by default
MOST_LOOPS = 4  #: of a set
MINUTES = 30.0
POINTS = 4  #: operating points: the grid as it is, and those that are damped least without control
#: pu per rad/s, of every loop: 50 pu per pu of speed at 60 Hz, what field stabilizers are set to at most
EFFORT = 0.13
#: damping asked of roots below so many rad/s beside the inter-area modes': slow poles of governors that no
#: loop moves must not end the search (two areas: -.056 1/s)
SLOW, SLOW_TO = -0.3, 0.6
FAULTS = 2  #: places, after which the answer to the common rise and the clearing times are looked at
FILES = ("worth.json", "worth.html", "worth.parquet", "worth.csv")


def stages(grids: Sequence[str]) -> tuple[str, ...]:
    """Return the stages of the study: small sets of all grids first."""
    return (*(_stage(grid, size) for size in range(1, MOST_LOOPS + 1) for grid in grids), "page")


def _stage(grid: str, size: int) -> str:
    return f"{grid}, {size} loop{'s' if size > 1 else ''}"


def study_links(
    grids: Mapping[str, Case],
    out: Path,
    cache: Path,
    *,
    minutes: float = MINUTES,
    command: str = "",
    report: Report = lambda stage, share: None,
) -> dict[str, Any]:
    """Design and evaluate the links of each grid in the folder `out`; return the content of worth.json.

    `cache` stores every row; sets that the time did not allow are named. For a grid without a weak inter-area
    mode `problem` has the reason.

    Raises
    ------
    OSError, or an error caused by one : of the machine. CaseError : a grid without an operating point.
    """
    clock = Clock(minutes)
    studies = {name: _GridLinks(name, case, cache, clock) for name, case in grids.items()}

    def written() -> dict[str, Any]:
        study = {
            "title": "Does a wide-area signal pay?",
            "command": command,
            "minutes": minutes,
            "latencies_ms": list(LATENCIES_MS),
            "no_time_for": clock.left_out,
            "grids": [one.as_dict() for one in studies.values()],
            "versions": {"interarea": version("interarea")},
        }
        _write(plain(study), out)
        return study

    with one_thread():
        for size in range(1, MOST_LOOPS + 1):
            for name, one in studies.items():
                stage = _stage(name, size)
                report(stage, 0.0)
                one.add(size, lambda share, stage=stage: report(stage, share))
                written()
                report(stage, 1.0)
    report("page", 0.0)
    study = written()
    report("page", 1.0)
    return study


def link_designs(
    weak: WeakModes, cache: Path, clock: Clock, *, points: int = POINTS, faults: int = FAULTS
) -> LinkDesigns:
    """Return the `LinkDesigns` of a grid at so many operating points, with faults at so many places."""
    candidates = tried_points(weak, cache, clock)
    least = {row.point.name: row.least for row in candidates}
    base, *others = chosen_points(candidates)
    chosen = [base, *sorted(others, key=lambda point: least[point.name])[: points - 1]]
    cases = {point.name: at_point(weak.case, point) for point in chosen}
    places = acceptance_of(weak, candidates, chosen[:1], faults).fault
    nodes = offset_of(weak, candidates, set(cases), ENOUGH)
    targets = [(at, SLOW if at < SLOW_TO else value) for at, value in nodes]
    offsets = BandOffsets(*(tuple(column) for column in zip(*targets, strict=True)))
    return LinkDesigns(weak, cases, offsets, places, cache)


class _GridLinks:
    """The sets of loops of one grid as they come."""

    def __init__(self, name: str, case: Case, cache: Path, clock: Clock) -> None:
        self.name, self.case, self.cache, self.clock = name, case, cache, clock
        self.problem = ""
        self.weak: WeakModes | None = None
        self.designs: LinkDesigns | None = None
        self.sets: list[LinkSet] = []

    def add(self, size: int, progress: Any) -> None:
        """Design the best set of so many loops, if there is one and time for it."""
        try:
            designs = self._begun()
        except InterareaError as error:
            if machine_error(error) is not None:
                raise
            self.problem = str(error)
            return
        chosen = next((one for one in designs.weak.sets if len(one.actuators) == size), None)
        if chosen is None:
            return
        if self.clock.over("links"):
            self.clock.leave(f"{self.name}: loops at {', '.join(chosen.actuators)}")
            return
        self.sets.append(self._designed(designs, chosen, progress))

    def _begun(self) -> LinkDesigns:
        if self.designs is None:
            choices = Choices(grid=self.name, most_actuators=MOST_LOOPS, effort=EFFORT)
            self.weak = weak_modes(modes_of_grid(self.case, self.cache), choices)
            self.designs = link_designs(self.weak, self.cache, self.clock)
        return self.designs

    def _designed(self, designs: LinkDesigns, chosen: LoopSet, progress: Any) -> LinkSet:
        sees, missing = signals_of_set(designs.weak, chosen)
        if AFAR in missing:
            return LinkSet(chosen, (), {AFAR: missing[AFAR]})
        own = designs.designed(sees[OWN]) if OWN in sees else None
        todo = [(name, ms) for ms in LATENCIES_MS for name in SIGNALS if name != OWN and name in sees]
        controllers: dict[tuple[str, int], Controller] = {}
        for k, (name, ms) in enumerate(todo):
            progress((k + 1) / (len(todo) + 2))
            if self.clock.over("links"):
                self.clock.leave(f"{self.name}: {ms} ms and more at {', '.join(chosen.actuators)}")
                break
            controllers[name, ms] = designs.designed(sees[name], ms, own)
        rows: list[LinkRow] = []
        if own is not None:
            own = designs.best_own(sees[OWN], [own, *controllers.values()])
            rows.append(designs.row(OWN, sees[OWN], 0, own))
        for name, ms in controllers:
            # a search may end better for another latency: each row is that of the best of all
            others = [K for (seen, at), K in controllers.items() if seen == name and at != ms]
            best = designs.best(sees[name], ms, [controllers[name, ms], *others])
            rows.append(designs.row(name, sees[name], ms, best, own))
        return LinkSet(chosen, tuple(rows), missing)

    def as_dict(self) -> dict[str, Any]:
        """Return it as JSON values."""
        weakest = None if self.weak is None else self.weak.weakest
        return {
            "grid": self.name,
            "buses": len(self.case.buses),
            "machines": len(self.case.machines),
            "problem": self.problem,
            "mode": None
            if weakest is None
            else {"frequency_hz": weakest.frequency_hz, "damping_ratio": weakest.damping_ratio},
            "effort": None if self.weak is None else self.weak.choices.effort,
            "points": [] if self.designs is None else list(self.designs.plants),
            "faults": [] if self.designs is None else [str(fault) for fault in self.designs.faults],
            "conclusion": self.problem or conclusion(self.sets),
            "sets": [
                {
                    "actuators": list(one.chosen.actuators),
                    "missing": dict(one.missing),
                    "rows": [asdict(row) for row in one.rows],
                }
                for one in self.sets
            ],
        }


def _write(study: Mapping[str, Any], out: Path) -> None:
    """Write page, JSON and tables."""
    text = json.dumps(study, indent=1, allow_nan=False)
    write_whole(out / FILES[0], f"{text}\n".encode())
    write_link_page(study, out / FILES[1])
    write_rows(link_rows(study), out / FILES[2], out / FILES[3], _schema())


def _schema() -> Any:
    import pyarrow as pa

    texts = [(name, pa.string()) for name in ("grid", "actuators", "signals", "sees")]
    numbers = [
        (name, pa.float64())
        for name in (
            "there",
            "late",
            "lost",
            "worst_swing",
            "effort",
            "common_rise_pu",
            "clearing_cycles",
        )
    ]
    return pa.schema([*texts, ("latency_ms", pa.int64()), ("lost_stable", pa.bool_()), *numbers])


def link_rows(study: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the rows of all grids as a flat table; names are joined by blanks."""
    rows = []
    for grid in study["grids"]:
        for row in (row for one in grid["sets"] for row in one["rows"]):
            sees = "; ".join(f"{a}: {' '.join(seen)}" for a, seen in row["sees"].items())
            rows.append({**row, "grid": grid["grid"], "actuators": " ".join(row["actuators"]), "sees": sees})
    return rows
