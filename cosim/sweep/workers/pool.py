"""Worker processes on this machine: they may die at any moment, no run is lost and none is done twice."""

from __future__ import annotations

import functools
import multiprocessing
import os
import shutil
import signal
import sys
import threading
import time
from collections import Counter, deque
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing import forkserver
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import ModuleType
from typing import Any

from interarea.models.files import new_folder, temporary_files_in, temporary_root

from ...errors import SweepError
from ..plan import SweepPlan
from ..rows import Outcome, failed_row
from .worker import STATUS_SIZE, InProgress, work

_KILLED, _CRASHED = 5, 2  # deaths with the same run under way before it counts as the cause
_MOST_IDLE_EXITS = 3  # workers that end before their first run
_PAUSES_S = (0.1, 0.2, 0.4, 0.8, 1.6)  # a process that is killed takes calls until it has its turn to end
_GRACE_S = 5.0  # beyond the time limit, for an FMU that does not come back from a call


class _Worker:
    """One process with what it was given and has not sent back."""

    def __init__(self, number: int, plan: dict[str, Any], cache: Path, scratch: Path) -> None:
        self.scratch = scratch / f"worker-{number}"
        context = _context()
        for pause_s in (*_PAUSES_S, None):
            self.pipe, theirs = context.Pipe()
            shared = context.RawArray("d", STATUS_SIZE)
            their_end, self._parent_pipe = context.Pipe(duplex=False)
            self.process: BaseProcess = context.Process(
                target=work, args=(theirs, their_end, shared, plan, cache, self.scratch), daemon=True
            )
            try:
                with _without_main():
                    self.process.start()
                break
            except (EOFError, ConnectionError):  # the server that forks was killed: there will be another
                if pause_s is None:
                    raise SweepError("no worker process can be started: its server exits each time") from None
                time.sleep(pause_s)
            finally:
                theirs.close()
                their_end.close()
        self.in_progress = InProgress(shared)
        self.todo: dict[int, None] = {}
        self.served = False
        self.overdue: list[int] = []  #: the runs that it was killed for

    def give(self, runs: list[int]) -> None:
        self.todo = dict.fromkeys(runs)
        with suppress(OSError):  # it died just now: noticed below
            self.pipe.send(runs)

    def kill(self) -> None:
        self.process.kill()

    def close(self) -> None:
        self.process.kill()
        self.process.join()
        self.pipe.close()
        self._parent_pipe.close()
        shutil.rmtree(self.scratch, ignore_errors=True)


def local_outcomes(
    plan: SweepPlan, runs: Iterable[int], *, cache: Path, scratch: Path, workers: int, task: int
) -> Iterator[list[Outcome]]:
    """Yield outcomes of all `runs` as they come (an empty list now and then).

    task : runs given to a worker at a time.

    Raises
    ------
    SweepError : workers that cannot start. OSError : a worker's disk is full.
    """
    pool = _Pool(plan, iter(runs), cache, scratch, task)
    try:
        pool.start(workers)
        while pool.workers:
            yield pool.turn()
    finally:
        pool.close()


class _Pool:
    def __init__(self, plan: SweepPlan, runs: Iterator[int], cache: Path, scratch: Path, task: int) -> None:
        self.plan, self.runs, self.cache, self.scratch, self.task = plan, runs, cache, scratch, task
        self.document = plan.document()
        self.workers: list[_Worker] = []
        self.again: deque[int] = deque()  # of workers that died
        self.alone: deque[int] = deque()  # of those that were under way together
        self.deaths: Counter[tuple[int, bool]] = Counter()
        self.started = self.idle_exits = 0
        self.limit_s = plan.sweep.time_limit_s + max(_GRACE_S, 0.5 * plan.sweep.time_limit_s)

    def start(self, count: int) -> None:
        for _ in range(count):
            if (runs := self._next()) is None:
                break
            self._start_worker(runs)

    def close(self) -> None:
        for worker in self.workers:
            worker.kill()
        for worker in self.workers:
            worker.close()

    def turn(self) -> list[Outcome]:
        """Wait a moment for messages; return the outcomes among them."""
        result: list[Outcome] = []
        pipes: dict[Any, _Worker] = {w.pipe: w for w in self.workers}
        for pipe in wait(list(pipes), timeout=0.5):
            self._listen(pipes[pipe], result)
        for worker in self.workers:
            if worker.in_progress.seconds > self.limit_s and not worker.overdue:
                worker.overdue = worker.in_progress.runs
                worker.kill()
        return result

    def _listen(self, worker: _Worker, result: list[Outcome]) -> None:
        pipe: Connection = worker.pipe
        try:
            while pipe.poll():
                message = pipe.recv()
                if message[0] == "rows":
                    worker.served = True
                    for outcome in message[1]:
                        if outcome.row["run"] in worker.todo:
                            del worker.todo[outcome.row["run"]]
                            result.append(outcome)
                elif message[0] == "error":
                    raise OSError(
                        message[1], os.strerror(message[1]) if message[1] else message[2], message[2]
                    )
                else:
                    if (runs := self._next()) is None:
                        self._stop_worker(worker)
                        return
                    worker.give(runs)
        except (EOFError, ConnectionError):
            self._handle_exit(worker, result)

    def _handle_exit(self, worker: _Worker, result: list[Outcome]) -> None:
        """A worker died: its runs are done again, but for one that keeps killing workers.

        Of several runs under way together each is done alone then, which shows which of them it is.
        """
        worker.process.join()
        code = worker.process.exitcode
        in_progress = [run for run in worker.in_progress.runs if run in worker.todo]
        if len(in_progress) > 1:
            self.alone.extend(in_progress)
            for run in in_progress:
                del worker.todo[run]
        elif in_progress and worker.overdue == in_progress:
            del worker.todo[in_progress[0]]
            result.append(self._failed(in_progress[0], "time limit", "did not return from a call of an FMU"))
        elif in_progress:
            run = in_progress[0]
            killed = code == -signal.SIGKILL if hasattr(signal, "SIGKILL") else False
            self.deaths[run, killed] += 1
            if self.deaths[run, killed] >= (_KILLED if killed else _CRASHED):
                del worker.todo[run]
                result.append(
                    self._failed(run, "worker died", f"the process ended each time: {_ending(code)}")
                )
        elif not worker.served:
            self.idle_exits += 1
            if self.idle_exits >= _MOST_IDLE_EXITS:
                raise SweepError(
                    f"{self.plan.sweep.name}: worker processes end before any run: {_ending(code)}"
                )
        self.again.extendleft(reversed(worker.todo))
        self._stop_worker(worker)
        if (runs := self._next()) is not None:
            self._start_worker(runs)

    def _stop_worker(self, worker: _Worker) -> None:
        with suppress(OSError):
            worker.pipe.send(None)
        self.workers.remove(worker)
        worker.close()

    def _start_worker(self, runs: list[int]) -> None:
        worker = _Worker(self.started, self.document, self.cache, self.scratch)
        self.started += 1
        self.workers.append(worker)
        worker.give(runs)

    def _next(self) -> list[int] | None:
        if self.alone:
            return [self.alone.popleft()]
        runs: list[int] = []
        while len(runs) < self.task:
            run = self.again.popleft() if self.again else next(self.runs, None)
            if run is None:
                break
            runs.append(run)
        return runs or None

    def _failed(self, run: int, kind: str, reason: str) -> Outcome:
        return Outcome(failed_row(self.plan.sweep, run, kind, reason))


def _context() -> Any:
    """Return how processes begin: forked from a server that has loaded the program, where there is one.

    The server loads the libraries once (seconds); a worker that died is then replaced within milliseconds.
    """
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    ours = "interarea.cosim.sweep"
    loaded = ("workers.fork_server", "workers.worker", "runner")
    context.set_forkserver_preload([f"{ours}.{name}" for name in loaded])
    # inherited: Ctrl-C while the server loads must not print its traceback
    with _deaf_to_interrupts(), temporary_files_in(_sockets()):
        forkserver.ensure_running()
    return context


@functools.cache
def _sockets() -> Path:
    """Folder for the server's socket; ours go even if this process is killed, multiprocessing's do not.

    The name of a socket has at most 107 bytes, of which multiprocessing adds 32.
    """
    own = new_folder()
    return own if len(os.fsencode(own)) <= 107 - 32 else temporary_root()


@contextmanager
def _without_main() -> Iterator[None]:
    """Keep the main module from a process that begins: a worker needs nothing of it.

    It would be run there again, and with it a sweep that stands in a script, or nothing could be found of
    one that was read from a pipe.
    """
    main = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():  # only that one may change a signal
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _ending(code: int | None) -> str:
    if code is None or code >= 0:
        return f"exit code {code}"
    try:
        return f"signal {signal.Signals(-code).name}"
    except ValueError:
        return f"signal {-code}"
