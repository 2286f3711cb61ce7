"""Processes that this one starts: none of them outlives it, whatever ends it (SIGKILL included).

Three kinds: a command of others (`run_guarded`), a process of this package that is started as a command and
calls `end_with_parent`, and the processes of a pool (`process_pool`). On Windows the first two
end by themselves.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

from .files import remove_own_folders, sweep, temporary_root

_POSIX = os.name == "posix"
_GUARD = Path(__file__).with_name("guard.py")
_LOOK_S = 0.25  # between two looks at the parent: soon enough, and 4 looks a second cost nothing

_guarded: dict[subprocess.Popen[bytes], int] = {}  # with the thread that waits for it
_interrupted: set[subprocess.Popen[bytes]] = set()
_begun: list[Future[Any]] = []  # calls that have not ended
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


def run_guarded(
    command: Sequence[str],
    *,
    cwd: Path | None = None,
    env: Mapping[str, str] | None = None,
    timeout_s: float | None = None,
) -> subprocess.CompletedProcess[str]:
    """Run a command of others to its end; return its exit code and what it printed.

    It and what it starts are killed when this process ends, and when this call or `side_by_side`
    is interrupted.

    Raises
    ------
    OSError : it cannot be started. subprocess.TimeoutExpired : it took longer than `timeout_s`.
    """
    words = [sys.executable, "-I", "-S", str(_GUARD), *command] if _POSIX else list(command)
    process = subprocess.Popen(
        words,
        cwd=cwd,
        env=env,
        stdin=subprocess.PIPE if _POSIX else subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=_POSIX,
    )
    _guarded[process] = threading.get_ident()
    parent_pipe, process.stdin = process.stdin, None  # `communicate` would close it
    try:
        out, err = process.communicate(timeout=timeout_s)
    except BaseException:
        _kill(process)
        process.wait()
        raise
    finally:
        _guarded.pop(process, None)
        if parent_pipe is not None:
            parent_pipe.close()
    if process in _interrupted:  # its failure is none of the command's: nobody may try again
        _interrupted.discard(process)
        raise KeyboardInterrupt
    texts = (part.decode("utf-8", "replace") for part in (out, err))
    return subprocess.CompletedProcess(list(command), process.returncode, *texts)


def side_by_side(call: Callable[[_Item], _Result], items: Iterable[_Item]) -> list[_Result]:
    """Return what `call`, which waits for `run_guarded`, gives for each item; one thread for each processor.

    Interrupted, it ends the commands under way, and no other begins.
    """
    with begun(call, items) as waiting:
        return [one.result() for one in waiting]


@contextlib.contextmanager
def begun(call: Callable[[_Item], _Result], items: Iterable[_Item]) -> Iterator[list[Future[_Result]]]:
    """Call as `side_by_side` does while the body runs; after it no other call begins.

    A body that fails ends the commands under way, one that is interrupted all commands (`end_commands`).
    After any other body they go on.
    """
    threads: set[int] = set()

    def one(item: _Item) -> _Result:
        threads.add(threading.get_ident())
        return call(item)

    pool, waiting = ThreadPoolExecutor(os.cpu_count()), []
    try:
        for item in items:
            waiting.append(pool.submit(one, item))
            _begun.append(waiting[-1])
        yield waiting
    except Exception:
        _end(waiting, lambda: [process for process, thread in list(_guarded.items()) if thread in threads])
        raise
    except BaseException:
        end_commands()
        raise
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        _begun[:] = [each for each in _begun if not each.done()]


def end_commands() -> None:
    """End all commands under way and every call that has begun; a program that stops does it last."""
    _end(list(_begun), lambda: list(_guarded))


def _end(calls: Sequence[Future[Any]], commands: Callable[[], list[subprocess.Popen[bytes]]]) -> None:
    for one in calls:
        one.cancel()
    while not all(one.done() for one in calls):
        for process in commands():
            _interrupted.add(process)
            _kill(process)
        time.sleep(_LOOK_S / 5)


def processor_s() -> float:
    """Return the processor time of this process and of its ended children, s.

    Work measured by it does not depend on what else the machine does.
    """
    spent = os.times()  # in hundredths: enough for children, not for what has just begun
    return time.process_time() + spent.children_user + spent.children_system


def _kill(process: subprocess.Popen[bytes]) -> None:
    with contextlib.suppress(OSError):  # it has ended
        if _POSIX:
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()


def end_with_parent(parent: int) -> None:
    """End this process soon after the process `parent`, which started it, has ended; temporary folders go.

    Nothing is done where `parent` lives and has not started this process, and on Windows, where an id says
    nothing on who lives.
    """
    if not _POSIX or (os.getppid() != parent and _lives(parent)):
        return

    def look() -> None:
        while os.getppid() == parent:
            time.sleep(_LOOK_S)
        end_at_once()

    threading.Thread(target=look, daemon=True).start()


def _lives(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass
    return True


def end_at_once() -> None:
    """End this process, wherever its main thread is; its temporary folders and its parent's, if dead, go."""
    remove_own_folders()
    own = temporary_root()
    for folder in (own, *own.parents):  # a worker's own lies in the parent's
        sweep(folder)
    os._exit(1)


def _end_with_pool() -> None:
    """What a process of a pool does first: interrupts are the main process's business, so is its end."""
    from .threads import one_thread

    for name in ("SIGINT", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    one_thread()
    parent = multiprocessing.parent_process()
    assert parent is not None

    def wait() -> None:
        parent.join()
        end_at_once()

    threading.Thread(target=wait, daemon=True).start()


@contextlib.contextmanager
def process_pool(count: int) -> Iterator[ProcessPoolExecutor]:
    """Give a pool of processes, of one thread for linear algebra each; left by an error, they are killed."""
    pool = ProcessPoolExecutor(count, initializer=_end_with_pool)
    try:
        yield pool
        pool.shutdown()
    except BaseException:
        for process in list((pool._processes or {}).values()):
            process.kill()
        pool.shutdown(cancel_futures=True)
        sweep(temporary_root())
        raise
