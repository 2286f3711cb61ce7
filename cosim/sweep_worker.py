"""A worker process of a sweep: takes lists of runs from a pipe, sends back what they gave.

Messages to the main process: ("build", run) and ("start", run) before a run, ("rows", outcomes), ("done",)
after a list, ("error", errno, text) when the disk is full. When the main process is gone the worker ends.
"""

from __future__ import annotations

import os
import signal
import tempfile
import threading
import time
from collections.abc import Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

_SEND_ROWS, _SEND_S = 50, 1.0


def work(
    pipe: Connection, lifeline: Connection, document: dict[str, Any], cache: Path, scratch: Path
) -> None:
    """Serve `pipe` until it says None; temporary files go into `scratch` (the main process removes it)."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the main process's business
    threading.Thread(target=_end_with, args=(lifeline,), daemon=True).start()
    scratch.mkdir(parents=True, exist_ok=True)
    tempfile.tempdir = str(scratch)
    from threadpoolctl import threadpool_limits

    from .heap import keep_freed_memory
    from .sweep_plan import plan_of_document
    from .sweep_run import Runner

    keep_freed_memory()
    with threadpool_limits(1), Runner(plan_of_document(document), cache, scratch) as runner:
        try:
            while (runs := pipe.recv()) is not None:
                _serve(pipe, runner, runs)
                pipe.send(("done",))
        except EOFError:
            return
        except OSError as error:
            pipe.send(("error", error.errno, f"{error.filename or scratch}: {error.strerror or error}"))


def _serve(pipe: Connection, runner: Any, runs: Sequence[int]) -> None:
    rows: list[Any] = []
    sent = time.monotonic()
    runner.on_build = lambda run: pipe.send(("build", run))
    runner.on_start = lambda run: pipe.send(("start", run))
    for outcome in runner.outcomes(runs):
        rows.append(outcome)
        if len(rows) >= _SEND_ROWS or time.monotonic() - sent > _SEND_S:
            pipe.send(("rows", rows))
            rows, sent = [], time.monotonic()
    if rows:
        pipe.send(("rows", rows))


def _end_with(lifeline: Connection) -> None:
    """End this process when the other end of `lifeline` is gone, whatever the main thread is doing."""
    try:
        lifeline.recv()
    except (EOFError, OSError):
        os._exit(1)
