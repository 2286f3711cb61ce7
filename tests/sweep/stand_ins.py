"""Workers that do what no honest FMU of ours does: end the process, never come back, never start."""

from __future__ import annotations

import os
import signal
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from interarea.cosim.sweep.rows import Outcome, start_row
from interarea.cosim.sweep.workers.worker import InProgress


def crashing_work(
    pipe: Connection, parent_pipe: Connection, shared: Any, document: Any, cache: Path, scratch: Path
) -> None:
    """Stand in for a worker whose run 2 ends the process, and whose run 4 never comes back."""
    del parent_pipe, document, cache, scratch
    in_progress = InProgress(shared)
    while (runs := pipe.recv()) is not None:
        for run in runs:
            in_progress.build(run)
            in_progress.start()
            if run == 2:
                os.kill(os.getpid(), signal.SIGSEGV)
            if run == 4:
                signal.pause()
            pipe.send(("rows", [Outcome(start_row(run, {}))]))
        pipe.send(("done",))


def together_work(
    pipe: Connection, parent_pipe: Connection, shared: Any, document: Any, cache: Path, scratch: Path
) -> None:
    """Stand in for a worker that has three runs under way at once; run 4 ends its process each time."""
    del parent_pipe, document, cache, scratch
    in_progress = InProgress(shared)
    while (runs := pipe.recv()) is not None:
        for k in range(0, len(runs), 3):
            group = runs[k : k + 3]
            in_progress.build(*group)
            in_progress.start()
            if 4 in group:
                os.kill(os.getpid(), signal.SIGSEGV)
            pipe.send(("rows", [Outcome(start_row(run, {})) for run in group]))
        in_progress.build()
        pipe.send(("done",))


def idle_work(
    pipe: Connection, parent_pipe: Connection, shared: Any, document: Any, cache: Path, scratch: Path
) -> None:
    """Stand in for a worker that cannot start."""
    del pipe, parent_pipe, shared, document, cache, scratch
