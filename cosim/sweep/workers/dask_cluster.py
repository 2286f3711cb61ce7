"""Workers on other machines: the runs of a sweep as tasks of a dask.distributed cluster.

FMUs and compiled code travel as tasks of their own, named by content: each worker fetches each file once. A
scheduler that is restarted, workers that come and go: what is not back yet is submitted again.
"""

from __future__ import annotations

import errno
import hashlib
import os
import shutil
import socket
import tempfile
import threading
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from interarea.fmu_build.write.cache import is_whole, keep

from ...errors import SweepError
from ..plan import SweepPlan, code_version, plan_of_document
from ..rows import Outcome, failed_row
from ..runner import Runner
from .malloc_tuning import keep_freed_memory

TASK = 200
_CONNECT_S = 10.0  # for the first connection
_WORKERS_S = 60.0  # until a scheduler must have workers
_PATIENCE_S = 300.0  # for a scheduler that went away to come back
_LOOK_S = 0.1
_AHEAD = 2  # tasks in flight for each thread of the cluster
_local = threading.local()
_files = threading.Lock()


def cluster_outcomes(
    plan: SweepPlan,
    runs: Iterable[int],
    *,
    cache: Path,
    files: Iterable[Path],
    address: str,
    task: int = TASK,
    patience_s: float = _PATIENCE_S,
) -> Iterator[list[Outcome]]:
    """Yield outcomes of all `runs` as they come (an empty list now and then), computed by the cluster.

    files : artefacts in `cache` that the workers need. address : of the scheduler, such as tcp://host:8786.
    patience_s : how long to wait for a scheduler or workers that went away.

    Raises
    ------
    SweepError : no dask installed, no scheduler, no workers, workers of another version.
    """
    shipped = {p.resolve().relative_to(cache.resolve()).as_posix(): p.read_bytes() for p in files}
    cluster = _Cluster(plan, iter(runs), shipped, address, task, patience_s)
    try:
        cluster.connect(_CONNECT_S, _WORKERS_S)
        while cluster.more():
            yield cluster.turn()
    finally:
        cluster.close()


class _Cluster:
    def __init__(
        self,
        plan: SweepPlan,
        runs: Iterator[int],
        shipped: Mapping[str, bytes],
        address: str,
        task: int,
        patience_s: float,
    ) -> None:
        self.plan, self.runs, self.shipped, self.address = plan, runs, shipped, address
        self.task, self.patience_s = task, patience_s
        self.document = plan.document()
        self.client: Any = None
        self.active: dict[Any, list[int]] = {}
        self.again: list[list[int]] = []
        self.blobs: dict[str, Any] = {}
        self.submitted = self.threads = 0
        self.known: set[str] = set()  # workers whose version was asked
        self.looked = 0.0

    # -- connection -----------------------------------------------------------------------

    def connect(self, timeout_s: float, workers_s: float) -> None:
        """Connect, wait for a worker and ask the workers for their version."""
        try:
            from distributed import Client
        except ImportError:
            raise SweepError(
                "--scheduler needs dask.distributed, which is not installed: pip install 'interarea[cluster]'"
            ) from None
        try:
            self.client = Client(self.address, timeout=timeout_s, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise SweepError(
                f"scheduler {self.address}: cannot be reached ({_line(error)}); "
                "start one with `dask scheduler`, and allow its port"
            ) from None
        end = time.monotonic() + workers_s
        while not self._look():
            if time.monotonic() > end:
                raise SweepError(
                    f"scheduler {self.address}: has no workers after {workers_s:g} s; "
                    f"start some with `dask worker {self.address}`"
                )
            time.sleep(_LOOK_S)
        make = self.client.submit
        self.blobs = {
            name: make(_same, raw, key=f"interarea-file-{hashlib.sha256(raw).hexdigest()[:20]}")
            for name, raw in self.shipped.items()
        }
        self.blobs[""] = make(
            _same, self.document, key=f"interarea-plan-{self.plan.hash}-{self.plan.version}"
        )

    def _look(self) -> int:
        """Return the number of threads of the cluster; new workers tell their version first."""
        threads: dict[str, int] = self.client.nthreads()
        fresh = sorted(set(threads) - self.known)
        if fresh:
            for worker, version in self.client.run(_version, workers=fresh, on_error="return").items():
                if isinstance(version, Exception):
                    raise SweepError(
                        f"worker {worker}: cannot load interarea ({_line(version)}); "
                        "install the same packages there"
                    )
                if version != self.plan.version:
                    raise SweepError(
                        f"worker {worker}: has another version of interarea or its libraries "
                        f"({version}, here {self.plan.version}); install the same there, or stop that worker"
                    )
            self.known |= set(fresh)
        self.threads, self.looked = sum(threads.values()), time.monotonic()
        return self.threads

    def _reconnect(self) -> None:
        """Wait for the scheduler to come back; everything that was in flight is to be done again."""
        self.again += self.active.values()
        self.active.clear()
        self.known.clear()
        self._drop()
        end = time.monotonic() + self.patience_s
        while True:
            try:
                return self.connect(_CONNECT_S, self.patience_s)
            except SweepError as error:
                self._drop()
                if "cannot be reached" not in str(error):
                    raise
                if time.monotonic() > end:
                    raise SweepError(
                        f"{error}; it was connected before and has been away for {self.patience_s:g} s"
                    ) from None
                time.sleep(1.0)

    def _forgotten(self) -> bool:
        """Whether the scheduler is another one: dask reconnects by itself, and what it was given is gone."""
        return any(blob.status not in ("pending", "finished") for blob in self.blobs.values())

    def _drop(self) -> None:
        if self.client is not None:
            with suppress(Exception):
                self.client.close(timeout=2.0)
            self.client = None

    def close(self) -> None:
        if self.client is not None:
            with suppress(Exception):
                self.client.cancel([*self.active, *self.blobs.values()], force=True)
        self._drop()

    # -- work -----------------------------------------------------------------------------

    def more(self) -> bool:
        """Whether anything is left, and hand out what the cluster can take."""
        try:
            if self.client.status != "running" or self._forgotten():
                self._reconnect()
            if time.monotonic() - self.looked > 2.0:
                self._look()
            while len(self.active) < max(2, _AHEAD * self.threads) and (runs := self._next()):
                self._submit(runs)
        except (OSError, TimeoutError):  # the connection went between two calls
            self._reconnect()
        return bool(self.active or self.again)

    def turn(self) -> list[Outcome]:
        """Wait a moment; return what has come back."""
        time.sleep(_LOOK_S)
        result: list[Outcome] = []
        for future in [f for f in self.active if f.status != "pending"]:
            runs = self.active.pop(future)
            if future.status == "finished":
                try:
                    result += future.result(timeout=60.0)
                except Exception:  # lost on the way: the runs are done again
                    self.again.append(runs)
            elif future.status == "error":
                result += self._judge(future, runs)
            else:
                self.again.append(runs)  # cancelled: the scheduler or what it had is gone
        return result

    def _judge(self, future: Any, runs: list[int]) -> list[Outcome]:
        """Take a task that ended with an error: it killed workers, or the cluster cannot do it."""
        error = future.exception(timeout=60.0)
        if isinstance(error, SweepError):
            raise error
        name = type(error).__name__
        if name == "KilledWorker":
            if len(runs) == 1:
                return [
                    Outcome(
                        failed_row(
                            self.plan.sweep, runs[0], "worker died", f"it ended each time: {_line(error)}"
                        )
                    )
                ]
            half = len(runs) // 2
            self.again += [runs[:half], runs[half:]]
            return []
        if name in ("CommClosedError", "CancelledError", "FutureCancelledError", "TimeoutError"):
            self.again.append(runs)
            return []
        raise SweepError(f"a worker of {self.address} cannot compute: {name}: {_line(error)}")

    def _next(self) -> list[int]:
        if self.again:
            return self.again.pop()
        return [run for _, run in zip(range(self.task), self.runs, strict=False)]

    def _submit(self, runs: list[int]) -> None:
        names = list(self.blobs)
        future = self.client.submit(
            compute,
            runs,
            names,
            *self.blobs.values(),
            key=f"interarea-runs-{self.plan.hash[:8]}-{id(self)}-{self.submitted}",
            pure=False,
        )
        self.submitted += 1
        self.active[future] = runs


def compute(runs: list[int], names: list[str], *blobs: Any) -> list[Outcome]:
    """Return the outcomes of `runs`; called on a worker, with the files and (named "") the plan.

    Raises
    ------
    SweepError : this worker has another version, or its machine fails: disk, quota, open files, memory.
    """
    provided = dict(zip(names, blobs, strict=True))
    document = provided.pop("")
    plan = plan_of_document(document)
    if plan.version != code_version():
        raise SweepError(
            "a worker has another version of interarea or its libraries "
            f"({code_version()}, here {plan.version}); install the same there, or stop that worker"
        )
    try:
        return list(_runner(plan, provided).outcomes(runs))
    except MemoryError:
        raise SweepError(f"a worker on {socket.gethostname()}: {os.strerror(errno.ENOMEM)}") from None
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        raise SweepError(f"a worker on {socket.gethostname()}: {where}{error.strerror or error}") from None


def _runner(plan: SweepPlan, files: Mapping[str, bytes]) -> Runner:
    """Return this thread's runner for a plan; FMU instances live on from task to task."""
    retained = getattr(_local, "runner", None)
    if retained is not None and (retained.plan.hash, retained.plan.version) == (plan.hash, plan.version):
        return retained  # type: ignore[no-any-return]
    if retained is not None:
        retained.close()
        shutil.rmtree(retained.scratch, ignore_errors=True)
    root = _folder()
    cache = root / "cache"
    with _files:
        for name, raw in files.items():
            path = cache / name
            if not is_whole(path):
                keep(path, raw)
        os.environ.setdefault("INTERAREA_CACHE", str(cache))  # where the kernel's binary is found too
    keep_freed_memory()
    scratch = Path(tempfile.mkdtemp(prefix="runs-", dir=root))
    _local.runner = Runner(plan, cache, scratch)
    return _local.runner  # type: ignore[no-any-return]


def _folder() -> Path:
    """Return this worker's folder, which dask removes when the worker ends."""
    from distributed import get_worker

    folder = Path(get_worker().local_directory) / "interarea"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _version() -> str:
    return code_version()


def _same(value: Any) -> Any:
    return value


def _line(error: BaseException) -> str:
    return " ".join(str(error).split())[:300] or type(error).__name__
