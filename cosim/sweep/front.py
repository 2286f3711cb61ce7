"""Run a sweep: what is not there yet is computed, here or on a cluster, and stored part by part."""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from interarea.fmu_build.write.cache import default_cache
from interarea.models.blocks.plant_shown import shows_powers
from interarea.models.case.case import Case
from interarea.models.files import temporary_folder
from interarea.models.grid.memory import MIB, require_memory, run_bytes

from ..errors import MACHINE, SweepError
from ..run.controllers import ControllerLike
from .lane_batches import host_lanes
from .plan import SweepPlan, plan_sweep
from .prepare import prepare
from .rows import Outcome
from .runner import Runner
from .spec import Sweep, load_sweep
from .store import SweepStore, explained
from .workers.pool import local_outcomes

_PART_ROWS, _PART_S = 500, 5.0
_PART_SHARE, _PART_LONGEST_S = 0.01, 60.0  # of the time since the start: a week's sweep has few parts too
_RATE_S = 30.0
_TASK = 200


@dataclass(frozen=True)
class Progress:
    """Where a sweep stands: runs there, all, runs per second; of this command's runs failed and forked."""

    done: int
    size: int
    failed: int
    rate: float
    forked: int = 0


def run_sweep(
    source: Sweep | str | Path | Mapping[str, Any],
    folder: Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    cache: Path | None = None,
    large: bool = False,
    progress: Callable[[Progress], object] | None = None,
    controllers: Mapping[str, ControllerLike] | None = None,
    retry: Literal["failed"] | None = None,
    loaded: Mapping[str, Case] | None = None,
) -> dict[str, Any]:
    """Run what is missing of a sweep into `folder`; return the counts of its summary.

    workers : processes on this machine; default one for each core. scheduler : address of a dask scheduler
        whose workers compute instead. large : confirm more than `LARGEST` runs.
    controllers : user-defined, by the name that the scenario or a parameter on `controller` has for them.
    retry : "failed": runs that failed before are done again too. loaded : cases that need not be read, by the
        name that the scenario or a parameter on `case` has for them.

    Raises
    ------
    SweepError, ScenarioError, CaseError : the sweep cannot run as written, or `folder` is another sweep's.
    """
    store_in = default_cache() if cache is None else cache
    sweep = source if isinstance(source, Sweep) else load_sweep(source)
    plan = plan_sweep(sweep, store_in, large=large, controllers=controllers, loaded=loaded)
    _refuse_what_no_run_takes(plan, store_in)
    with SweepStore(folder, plan) as store:
        if retry == "failed":
            store.forget_failed()
        if store.count < sweep.size:
            left, count = sweep.size - store.count, workers or cores()
            if scheduler is None:
                _require_memory(plan, min(count, left), -(-left // count), store_in)
            files = prepare(plan, store_in)
            if scheduler is None:
                outcomes = local_outcomes(
                    plan,
                    store.todo(),
                    cache=store_in,
                    scratch=store.work,
                    workers=min(count, left),
                    task=task_size(left, count),
                )
            else:
                from .workers.dask_cluster import cluster_outcomes

                outcomes = cluster_outcomes(
                    plan, store.todo(), cache=store_in, files=files, address=scheduler
                )
            _collect(store, outcomes, progress)
        return store.finish()


def _refuse_what_no_run_takes(plan: SweepPlan, cache: Path) -> None:
    """Raise SweepError where the first and the last run cannot be made for the same reason: none can."""
    with temporary_folder() as scratch, Runner(plan, cache, scratch) as runner:
        reason = runner.refused(0)
        if reason and reason == runner.refused(plan.sweep.size - 1):
            raise SweepError(f"{plan.sweep.name}: no run can be made: {reason}")


def _require_memory(plan: SweepPlan, workers: int, runs: int, cache: Path) -> None:
    """Refuse workers whose live plants the memory of this machine would not hold; `runs`: of each."""
    case = max((plan.case(name) for name in plan.cases), key=run_bytes)
    beside = max(1, min(host_lanes(cache, case).count, runs))
    each = run_bytes(case, beside, powers=plan.sweep.show is None and shows_powers(case))
    require_memory(
        workers * each,
        f"{plan.sweep.name}: {workers} workers with up to {beside} plants of {case.name} at once "
        f"({len(case.buses)} buses)",
        f"use fewer workers: one needs {each / MIB:.0f} MiB",
    )


def cores() -> int:
    """Return the number of cores this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1


def task_size(left: int, workers: int) -> int:
    """Return how many runs a worker gets at a time: hundreds, fewer where all must have their share."""
    return max(1, min(_TASK, -(-left // (4 * workers))))


def _collect(
    store: SweepStore, outcomes: Iterator[list[Outcome]], progress: Callable[[Progress], object] | None
) -> None:
    """Store outcomes as they come, at the latest after some seconds, and also when interrupted."""
    waiting: list[Outcome] = []
    begin = last = time.monotonic()
    ticks: deque[tuple[float, int]] = deque([(last, store.count)])
    failed = forked = 0
    try:
        for selected in outcomes:
            waiting += selected
            failed += sum(o.row["status"] == "failed" for o in selected)
            forked += sum(o.forked for o in selected)
            now = time.monotonic()
            longest = min(_PART_LONGEST_S, max(_PART_S, _PART_SHARE * (now - begin)))
            if len(waiting) >= _PART_ROWS or (waiting and now - last > longest):
                store.append(waiting)
                waiting, last = [], now
            if progress is not None:
                done = store.count + len(waiting)
                ticks.append((now, done))
                while now - ticks[0][0] > _RATE_S and len(ticks) > 2:
                    ticks.popleft()
                span = now - ticks[0][0]
                rate = (done - ticks[0][1]) / span if span > 0.0 else 0.0
                progress(Progress(done, len(store.done), failed, rate, forked))
    except OSError as error:
        if error.errno in MACHINE:
            raise explained(error, store.folder, store.count, len(store.done)) from error
        raise
    finally:
        outcomes.close()  # type: ignore[attr-defined]
        if waiting:
            store.append(waiting)
