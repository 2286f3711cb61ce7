"""A worker process of a sweep: takes lists of runs from a pipe, sends back what they gave.

Messages to the main process: ("rows", outcomes), ("done",) after a list, ("error", errno, text) when the disk
is full. Which runs are under way stands in memory that both share. When the main process is gone the worker
ends.
"""

from __future__ import annotations

import errno
import gc
import os
import signal
import tempfile
import threading
import time
from collections.abc import Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from interarea.models.processes import end_at_once

_SEND_ROWS, _SEND_S = 50, 1.0
_TOGETHER = 64  # runs under way at once
STATUS_SIZE = 2 + _TOGETHER


class InProgress:
    """The runs under way and since when they compute, in `STATUS_SIZE` doubles that two processes share."""

    def __init__(self, shared: Any) -> None:
        self._shared = shared

    def build(self, *runs: int) -> None:
        """Note that runs are being prepared, which has no time limit; none: nothing is under way."""
        self._shared[1] = 0.0
        self._shared[0] = 0.0
        self._shared[2 : 2 + len(runs)] = [float(run) for run in runs]
        self._shared[0] = float(len(runs))

    def start(self) -> None:
        """Note that these runs now compute."""
        self._shared[1] = time.monotonic()

    @property
    def runs(self) -> list[int]:
        """The runs under way."""
        return [int(run) for run in self._shared[2 : 2 + int(self._shared[0])]]

    @property
    def seconds(self) -> float:
        """How long they have been computing; 0 before."""
        since = self._shared[1]
        return time.monotonic() - since if since else 0.0


def work(
    pipe: Connection,
    parent_pipe: Connection,
    shared: Any,
    document: dict[str, Any],
    cache: Path,
    scratch: Path,
) -> None:
    """Serve `pipe` until it says None; temporary files go into `scratch` (the main process removes it)."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the main process's business
    threading.Thread(target=_end_with, args=(parent_pipe,), daemon=True).start()
    scratch.mkdir(parents=True, exist_ok=True)
    tempfile.tempdir = str(scratch)
    from interarea.models.threads import one_thread

    from ..plan import plan_of_document
    from ..runner import Runner
    from .malloc_tuning import keep_freed_memory

    keep_freed_memory()
    with one_thread(), Runner(plan_of_document(document), cache, scratch) as runner:
        gc.collect()
        gc.freeze()  # what is loaded stays: the collector need not look through it again and again
        try:
            while (runs := pipe.recv()) is not None:
                _serve(pipe, runner, runs, InProgress(shared))
                pipe.send(("done",))
        except EOFError:
            return
        except MemoryError:
            pipe.send(("error", errno.ENOMEM, f"{scratch}: {os.strerror(errno.ENOMEM)}"))
        except OSError as error:
            pipe.send(("error", error.errno, f"{error.filename or scratch}: {error.strerror or error}"))


def _serve(pipe: Connection, runner: Any, runs: Sequence[int], in_progress: InProgress) -> None:
    rows: list[Any] = []
    sent = time.monotonic()
    runner.on_build = in_progress.build
    runner.on_start = in_progress.start
    for outcome in runner.outcomes(runs):
        rows.append(outcome)
        if len(rows) >= _SEND_ROWS or time.monotonic() - sent > _SEND_S:
            pipe.send(("rows", rows))
            rows, sent = [], time.monotonic()
    in_progress.build()
    if rows:
        pipe.send(("rows", rows))


def _end_with(parent_pipe: Connection) -> None:
    """End this process when the other end of `parent_pipe` is gone, whatever the main thread is doing."""
    try:
        parent_pipe.recv()
    except (EOFError, OSError):
        end_at_once()
