"""What the engine of a sweep takes beside its runs, and its resident memory, measured in the same processes.

A worker counts the processor time inside its runs and before the first of them; what the worker and the main
process take beyond that is the engine. Both come from one sweep, so that a busy machine cannot part them.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import resource
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from interarea.cosim.sweep.front import Progress, run_sweep
from interarea.cosim.sweep.workers import pool as sweep_local
from interarea.cosim.sweep.workers.worker import work


@dataclass(frozen=True)
class Cost:
    """Of one sweep: seconds by the clock, then of processor time in runs, in starting workers, in all."""

    clock_s: float
    runs_s: float
    start_s: float
    all_s: float

    @property
    def overhead(self) -> float:
        """The engine's share over the runs, workers' start apart."""
        return (self.all_s - self.start_s) / self.runs_s - 1.0


def measured_work(
    pipe: Connection,
    parent_pipe: Connection,
    shared: Any,
    document: dict[str, Any],
    cache: Path,
    scratch: Path,
) -> None:
    """Work as a worker does, and keep what runs take in a file beside the results."""
    from interarea.cosim.sweep.runner import Runner

    outcomes = Runner.outcomes
    notes = scratch.parent.parent.parent / f"cost-{os.getpid()}.json"
    spent = {"start": 0.0, "runs": 0.0}

    def timed(runner: Runner, runs: Any) -> Iterator[Any]:
        spent["start"] = spent["start"] or time.process_time()
        begin = time.process_time()
        for outcome in outcomes(runner, runs):
            spent["runs"] += time.process_time() - begin
            yield outcome
            begin = time.process_time()
        notes.write_text(json.dumps(spent), encoding="utf-8")

    Runner.outcomes = timed  # type: ignore[method-assign]
    work(pipe, parent_pipe, shared, document, cache, scratch)


@contextmanager
def children_counted() -> Iterator[None]:
    """Begin workers as children of this process while it holds, with `measured_work`."""
    originals = sweep_local._context, sweep_local.work
    spawned = multiprocessing.get_context("spawn")
    sweep_local._context, sweep_local.work = (lambda: spawned), measured_work
    try:
        yield
    finally:
        sweep_local._context, sweep_local.work = originals


def cost_of(document: dict[str, Any], workers: int, progress: Callable[[Progress], object] | None) -> Cost:
    """Return what a sweep takes."""
    with tempfile.TemporaryDirectory() as folder, children_counted():
        before, begin = _processor_s(), time.perf_counter()
        run_sweep(document, Path(folder) / "out", workers=workers, progress=progress)
        clock, spent = time.perf_counter() - begin, _processor_s() - before
        notes = [json.loads(p.read_text(encoding="utf-8")) for p in Path(folder).glob("cost-*.json")]
    return Cost(clock, sum(n["runs"] for n in notes), sum(n["start"] for n in notes), spent)


def _processor_s() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in used)


def memory_of(document: dict[str, Any], runs: int, workers: int) -> list[tuple[int, float, list[float]]]:
    """Return (runs made, resident MB of the main process, of each worker) at ten moments of a sweep."""
    outcomes: list[tuple[int, float, list[float]]] = []

    def look(p: Progress) -> None:
        if p.done >= (len(outcomes) + 1) * runs // 10 and (p.done < runs or len(outcomes) < 10):
            children = [c.pid for c in multiprocessing.active_children() if c.pid is not None]
            outcomes.append((p.done, resident_mb(os.getpid()), sorted(map(resident_mb, children))))

    cost_of(document, workers, look)
    return outcomes


def resident_mb(process: int) -> float:
    """Return the resident memory of a process that is not a file's, MB; 0 when it is gone."""
    try:
        lines = Path(f"/proc/{process}/status").read_text(encoding="utf-8").splitlines()
    except OSError:
        return 0.0
    return sum(float(line.split()[1]) for line in lines if line.startswith("RssAnon")) / 1000.0
