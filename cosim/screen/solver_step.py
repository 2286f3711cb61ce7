"""The plant's step in a large screening: the longest that leaves the results as they are."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from interarea.fmu_build.open.own import open_own
from interarea.fmu_build.write.cache import default_cache
from interarea.models.blocks.variables import STEP_PARAMETER
from interarea.models.case.case import Case

from ..sweep.front import Progress
from ..sweep.live_instances import plant_of_sweep
from .screening import PLACE, Screening, run_screened

STEPS = "steps"  #: folder of the sweeps that are compared
FROM = 100  #: runs from which on the comparison costs less than it saves
LONGER_S = (0.01, 0.005, 0.0025)  #: steps that are tried; the first leaves RK4 stable from lags of 4 ms on
#: most by which a result may change, below the last digit that an engineer reads
LARGEST = {"angle_deg": 0.1, "voltage_pu": 0.001, "nadir_hz": 0.001, "zenith_hz": 0.001}


@dataclass(frozen=True)
class StepChoice:
    """A step of the plant and what it rests on.

    step_s : longest step. own_s : that of the plant itself. places : where both were compared. changes : the
        largest change of each result of `LARGEST` there, in its unit.
    """

    step_s: float
    own_s: float
    places: tuple[str, ...]
    changes: dict[str, float]

    def __str__(self) -> str:
        where = ", ".join(self.places)
        if not self.changes:
            return (
                f"solver step: the plant's own, {1000 * self.own_s:g} ms; no longer one left the results "
                f"at {where} as they were"
            )
        angle, voltage, *frequency = (self.changes[key] for key in LARGEST)
        return (
            f"solver step: {1000 * self.step_s:g} ms; at {where} results differ from those at the plant's "
            f"own {1000 * self.own_s:g} ms by at most {angle:.2g} deg, {voltage:.2g} pu and "
            f"{max(frequency):.2g} Hz"
        )


def choose_step(
    screening: Screening,
    folder: Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    cache: Path | None = None,
    progress: Callable[[Progress], object] | None = None,
    case: Case | None = None,
) -> StepChoice | None:
    """Compare steps at three places of a large screening; return the longest that is exact enough.

    None where the screening prescribes its step, has fewer than `FROM` runs or a grid without longer steps.
    Parameters and errors as of `run_screening`.
    """
    if screening.solver_step_s is not None:
        return None
    case = case or screening.load()
    if screening.sweep(case=case).size < FROM:
        return None
    if case.solver_step_s is not None and case.solver_step_s >= max(LONGER_S):
        return None
    every = screening.places(case)
    places = [every[k * len(every) // 6] for k in (1, 3, 5)]
    kind = PLACE[screening.kind]
    few = replace(screening.at(tuple(places)), controllers=(), outages=())
    options: dict[str, Any] = {
        "workers": workers,
        "scheduler": scheduler,
        "cache": cache,
        "progress": progress,
        "case": case,
    }

    def results(step_s: float | None) -> pd.DataFrame:
        part = folder / STEPS / ("own" if step_s is None else f"{1000 * step_s:g}_ms")
        return run_screened(replace(few, solver_step_s=step_s), part, **options).set_index(kind)

    names = tuple(f"{kind} {place}" for place in places)
    exact = results(None)
    own_s = _own_step_s(few, case, default_cache() if cache is None else cache)
    for step in LONGER_S:
        if not step > own_s:
            break
        changes = changes_of(exact, results(step))
        if changes is not None:
            return StepChoice(step, own_s, names, changes)
    return StepChoice(own_s, own_s, names, {})


def _own_step_s(screening: Screening, case: Case, cache: Path) -> float:
    """Return the step that the plant of the runs has by itself."""
    with contextlib.closing(open_own(plant_of_sweep(screening.sweep(case=case), case, cache), cache)) as file:
        return file.start_of(STEP_PARAMETER)


def changes_of(exact: pd.DataFrame, other: pd.DataFrame) -> dict[str, float] | None:
    """Return the largest change of each result of `LARGEST`; None for a failed run, another verdict or more.

    Rows of the same places, in any order. What a run shows after it has lost synchronism is not compared.
    """
    other = other.loc[exact.index]
    if not (exact["status"].eq("ok").all() and other["status"].eq("ok").all()):
        return None
    if not (
        exact["synchronous"].eq(other["synchronous"]).all() and exact["verdict"].eq(other["verdict"]).all()
    ):
        return None
    synchronous = exact["synchronous"].astype(bool)
    changes = {
        key: float(np.max(np.abs((exact[key] - other[key])[synchronous].to_numpy()), initial=0.0))
        for key in LARGEST
    }
    return changes if all(changes[key] <= LARGEST[key] for key in LARGEST) else None
