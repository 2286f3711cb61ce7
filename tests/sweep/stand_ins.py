"""Workers that do what no honest FMU of ours does: end the process, never come back, never start."""

from __future__ import annotations

import os
import signal
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from interarea.cosim.sweep_rows import Outcome, start_row


def crashing_work(pipe: Connection, lifeline: Connection, document: Any, cache: Path, scratch: Path) -> None:
    """Stand in for a worker whose run 2 ends the process, and whose run 4 never comes back."""
    del lifeline, document, cache, scratch
    while (runs := pipe.recv()) is not None:
        for run in runs:
            pipe.send(("build", run))
            pipe.send(("start", run))
            if run == 2:
                os.kill(os.getpid(), signal.SIGSEGV)
            if run == 4:
                signal.pause()
            pipe.send(("rows", [Outcome(start_row(run, {}))]))
        pipe.send(("done",))


def idle_work(pipe: Connection, lifeline: Connection, document: Any, cache: Path, scratch: Path) -> None:
    """Stand in for a worker that cannot start."""
    del pipe, lifeline, document, cache, scratch
