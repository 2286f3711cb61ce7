"""Which actuator damps a mode best? The study `actuators`: kinds, signals, latencies, losses, faults."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from interarea.design.controllers.controller import plain
from interarea.models.case.case import Case
from interarea.models.files import write_rows, write_whole
from interarea.models.threads import one_thread

from ..errors import ScenarioError, nearest
from ..grid_study.automatic import Report
from ..grid_study.choices import Choices
from ..grid_study.clock import Clock
from ..grid_study.link_study import link_designs
from ..grid_study.weak_modes import modes_of_grid, weak_modes
from .cells import CLEAR_MS, LATENCIES_MS, REMOTE, ActuatorCells, Cell, started_from, without_matrices
from .installed import FULL_AT, KINDS, SHARE, Installed, installed
from .page import write_actuator_page
from .words import conclusion

GRID = "two-area-actuators"  #: by default
MINUTES = 40.0
POINTS = 2  #: operating points: the grid as it is, and that which is damped least without control
PLACES = 2  #: of faults, each cleared by a trip and by itself, after each of `CLEAR_MS`
STAGES = ("grid", "cells", "page")
FILES = ("actuators.json", "actuators.html", "actuators.parquet", "actuators.csv", "controllers.json")


def study_actuators(
    case: Case,
    out: Path,
    cache: Path,
    *,
    kinds: Sequence[str] = tuple(KINDS),
    latencies_ms: Sequence[int] = LATENCIES_MS,
    places: int = PLACES,
    mva: float | None = None,
    minutes: float = MINUTES,
    command: str = "",
    report: Report = lambda stage, share: None,
) -> dict[str, Any]:
    """Design and judge a controller for each kind, signals and latency; return what actuators.json holds.

    kinds : of `KINDS`. latencies_ms : of remote signals, in the order in which they are designed. places : of
    faults. mva : installed power at which devices are compared; None: the smallest there. Every cell is found
    again in `cache`; those for which the time is over are named.

    Raises
    ------
    ScenarioError : no weak inter-area mode, a kind that the grid does not have, or less than `mva` of it.
    OSError, or what it caused : the machine cannot do it.
    """
    clock = Clock(minutes)
    with one_thread():
        report(STAGES[0], 0.0)
        grid = modes_of_grid(case, cache)
        exciters = tuple(name for name in grid.plant.inputs if name.endswith("_vs"))
        weak = weak_modes(grid, Choices(grid=case.name, most_actuators=1, actuators=exciters))
        compared, power = installed(weak, kinds, mva, cache)
        designs = link_designs(weak, cache, clock, points=POINTS, faults=places)
        actuator_cells = ActuatorCells(designs, cache)
        study: dict[str, Any] = {
            "title": "Which actuator damps an inter-area mode best?",
            "command": command,
            "minutes": minutes,
            "grid": case.name,
            "buses": len(case.buses),
            "machines": len(case.machines),
            "mode": {
                "frequency_hz": weak.weakest.frequency_hz,
                "damping_ratio": weak.weakest.damping_ratio,
            },
            "mva": power,
            "share": SHARE,
            "full_at_rad_s": FULL_AT,
            "points": list(designs.plants),
            "faults": [str(fault) for fault in actuator_cells.places],
            "clear_ms": list(CLEAR_MS),
            "latencies_ms": sorted(latencies_ms),
            "survived_without": actuator_cells.without_control(),
            "actuators": [_actuator(one) for one in compared.values()],
            "no_time_for": clock.left_out,
            "versions": {"interarea": version("interarea")},
        }
        report(STAGES[0], 1.0)
        cells: list[Cell] = []
        todo = [(kind, "own", 0) for kind in compared]
        todo += [(kind, REMOTE, ms) for ms in latencies_ms for kind in compared]
        for k, (kind, signals, ms) in enumerate(todo):
            report(STAGES[1], k / len(todo))
            if clock.over("links"):
                clock.leave(f"{KINDS[kind]}, {signals} signals, {ms} ms")
                continue
            near_to = started_from(cells, kind, ms) if signals == REMOTE else None
            cells.append(actuator_cells.cell(compared[kind], signals, ms, near_to))
            _write(_with(study, cells), cells, out)
        cells = _best_of_all(actuator_cells, compared, cells)
        report(STAGES[1], 1.0)
    report(STAGES[2], 0.0)
    result = _with(study, cells)
    _write(result, cells, out)
    report(STAGES[2], 1.0)
    return result


def _best_of_all(
    actuator_cells: ActuatorCells, compared: Mapping[str, Installed], cells: Sequence[Cell]
) -> list[Cell]:
    """Return the cells, each judged anew by the best controller that was designed for any.

    Own signals: by what remote controllers use of the same signals; remote ones: by those for other
    latencies. A search may end better for another cell.
    """
    remote = {kind: [c for c in cells if c.kind == kind and c.signals == REMOTE] for kind in compared}
    again = []
    for cell in cells:
        one, others = compared[cell.kind], [c for c in remote[cell.kind] if c is not cell]
        judged_again = actuator_cells.remote_again if cell.signals == REMOTE else actuator_cells.own_again
        again.append(judged_again(one, cell, others))
    return again


def kinds_of(names: Sequence[str]) -> tuple[str, ...]:
    """Return the kinds of these names, all where there is none.

    >>> kinds_of([])[:2], kinds_of(["svc", "exciter"])
    (('exciter', 'lcc'), ('exciter', 'svc'))

    Raises ScenarioError for a name that is no kind.
    """
    for name in names:
        if name not in KINDS:
            raise ScenarioError(f"--actuator {name}: not a kind of actuator; {nearest(name, KINDS)}")
    return tuple(kind for kind in KINDS if not names or kind in names)


def _actuator(one: Installed) -> dict[str, Any]:
    return {
        "kind": one.kind,
        "name": KINDS[one.kind],
        "actuator": one.actuator,
        "mva": one.mva,
        "full": one.full,
        "sees": {signals: list(names) for signals, names in one.sees.items()},
    }


def _with(study: Mapping[str, Any], cells: Sequence[Cell]) -> dict[str, Any]:
    places = list(KINDS)
    ordered = sorted(cells, key=lambda c: (places.index(c.kind), c.signals, c.latency_ms))
    rows = [without_matrices(cell) for cell in ordered]
    return {**study, "conclusion": conclusion(ordered, study["survived_without"]), "cells": rows}


def _write(study: Mapping[str, Any], cells: Sequence[Cell], out: Path) -> None:
    """Write page, JSON, tables and controllers."""
    text = json.dumps(plain(study), indent=1, allow_nan=False)
    write_whole(out / FILES[0], f"{text}\n".encode())
    write_actuator_page(study, out / FILES[1])
    write_rows(actuator_rows(study), out / FILES[2], out / FILES[3], _schema())
    controllers = [
        {"kind": c.kind, "signals": c.signals, "latency_ms": c.latency_ms, "controller": c.controller}
        for c in cells
    ]
    text = json.dumps(plain({"controllers": controllers}), indent=1, allow_nan=False)
    write_whole(out / FILES[4], f"{text}\n".encode())


def _schema() -> Any:
    import pyarrow as pa

    texts = [(name, pa.string()) for name in ("kind", "actuator", "signals", "sees", "worst_lost")]
    counts = [(name, pa.int64()) for name in ("latency_ms", "faults", "survived", "survived_lost")]
    numbers = [
        (name, pa.float64())
        for name in (
            *("there", "late", "lost", "worst_swing", "effort", "effort_share"),
            *("delay_margin_ms", "clearing_cycles"),
        )
    ]
    return pa.schema([*texts, *counts, ("lost_stable", pa.bool_()), *numbers])


def actuator_rows(study: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the cells as a flat table; names of signals are joined by blanks."""
    return [{**row, "sees": " ".join(row["sees"])} for row in study["cells"]]
