"""Files of ours: on disk whole or not at all, and temporary ones that are gone when their process is.

Temporary files lie in one folder per process, ``interarea-PID-XXXXXXXX``, with a lock that the operating
system frees when the process ends, however it ends. Whoever needs a temporary folder first removes those
whose lock is free. A file that has no name of its own yet, ``.NAME-PID-XXXXXXXX.partial``, has such a lock
too; whoever writes beside it first removes it if that is free. The files of one result get their names
together, at its end (`together`).
"""

from __future__ import annotations

import contextlib
import errno
import lzma
import os
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextvars import ContextVar
from pathlib import Path
from typing import IO, Any

try:
    import fcntl
except ImportError:  # Windows, where a file that a process holds open cannot be removed
    fcntl = None  # type: ignore[assignment]

_PREFIX = "interarea-"
_LOCK = ".lock"
_PARTIAL = ".partial"
_LAST = -100  #: at a process's end: after its own children, and what holds files open
_YOUNG_S = 60.0
_AGAIN_S = 0.05  #: between two looks at a lock, short beside what is made behind it


def read_text(path: Path) -> str:
    """Return the text of a file in UTF-8, unpacked if its name ends in .xz."""
    if path.suffix == ".xz":
        with lzma.open(path, "rt", encoding="utf-8") as packed:
            return packed.read()
    return path.read_text(encoding="utf-8")


def toml_files(folder: Path) -> dict[str, Path]:
    """Return name -> file of the files NAME.toml and NAME.toml.xz in `folder`, sorted by name."""
    return dict(sorted((path.name.partition(".toml")[0], path) for path in folder.glob("*.toml*")))


def write_whole(path: Path | str, content: bytes | str) -> Path:
    """Write a file beside `path`, force it to disk and rename it; return `path`.

    Nobody ever opens half of it. Text is encoded as UTF-8. Within `together` it gets its name at the end.
    """
    path, raw = Path(path), content.encode("utf-8") if isinstance(content, str) else content
    refuse_folder(path)
    if path.exists() and not path.is_file():  # /dev/stdout, a pipe: nothing to rename to
        path.write_bytes(raw)
        return path
    path.parent.mkdir(parents=True, exist_ok=True)
    with Partial(path) as partial:
        partial.file.write(raw)
        return partial.settle()


def refuse_folder(path: Path) -> None:
    """Raise IsADirectoryError where a folder stands in the place of a file that is to be written."""
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))


#: files that wait for their names; None where each gets its own at once
_waiting: ContextVar[list[Partial] | None] = ContextVar("waiting", default=None)


@contextlib.contextmanager
def together() -> Iterator[None]:
    """Give the files that are written meanwhile their names at the end: all of them, or after an error none.

    Within another one, that one ends both. Files of other threads, and those `at_once`, do not wait.

    Raises
    ------
    IsADirectoryError : a folder stands in the place of one of them.
    """
    if _waiting.get() is not None:
        yield
        return
    waiting: list[Partial] = []
    token = _waiting.set(waiting)
    try:
        yield
        for partial in waiting:
            refuse_folder(partial.path)
        for partial in waiting:
            partial.take_name()
    finally:
        _waiting.reset(token)
        for partial in waiting:
            partial.remove()


@contextlib.contextmanager
def at_once() -> Iterator[None]:
    """Let files have their names at once even within `together`: they are read again before it ends."""
    token = _waiting.set(None)
    try:
        yield
    finally:
        _waiting.reset(token)


class Partial:
    """A hidden file beside `path`, open as `file` and locked; a context manager that ends without it.

    The first of a process in a folder removes what killed processes have left there.
    """

    def __init__(self, path: Path) -> None:
        refuse_folder(path)
        if path.parent not in _looked:
            _looked.add(path.parent)
            remove_left(path.parent)
        file = None
        while file is None:  # another process may take it for a left one before it is locked
            prefix = f".{path.name[:40]}-{os.getpid()}-"
            handle, name = tempfile.mkstemp(dir=path.parent, prefix=prefix, suffix=_PARTIAL)
            try:
                os.close(handle)
                self._partial, self.path = Path(name), path
                file = locked(self._partial, make=True)
            except BaseException:
                os.unlink(name)  # noqa: PTH108 - a path needs memory, of which there may be none
                raise
        self.file: IO[bytes] = file
        self._waits = False

    def settle(self) -> Path:
        """Give the file its name (`settle`), within `together` at the end of that; return `path`."""
        self.file.flush()
        waiting = _waiting.get()
        if waiting is None:
            return self.take_name()
        waiting.append(self)
        self._waits = True  # open, and so locked
        return self.path

    def take_name(self) -> Path:
        """Force the file to disk and rename it; return `path`."""
        if fcntl is None:  # such a system renames no open file
            self.file.close()
        self._partial.chmod(0o644)
        return settle(self._partial, self.path)

    def close(self) -> None:
        """Close the file, and remove it if it has not been given its name and does not wait for it."""
        if not self._waits:
            self.remove()

    def remove(self) -> None:
        """Close the file, and remove it if it has not been given its name."""
        with contextlib.suppress(OSError, ValueError):  # a full disk; a file that others closed
            self.file.close()
        with contextlib.suppress(OSError):
            self._partial.unlink(missing_ok=True)

    def __enter__(self) -> Partial:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def remove_left(folder: Path) -> None:
    """Remove the files in `folder` that processes which have ended have left without a name of their own."""
    with contextlib.suppress(OSError):
        for partial in list(folder.glob(f".*-[0-9]*-*{_PARTIAL}")):
            with contextlib.suppress(OSError):
                if fcntl is None:  # such a system removes no open file
                    partial.unlink()
                elif (file := locked(partial)) is not None:
                    with file:
                        partial.unlink()


def settle(partial: Path, path: Path) -> Path:
    """Force the file `partial` to disk, name it `path`, and force the name to disk; return `path`."""
    with partial.open("rb+") as file:
        os.fsync(file.fileno())
    partial.replace(path)
    with contextlib.suppress(OSError):  # some systems cannot open a folder
        handle = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
    return path


@contextlib.contextmanager
def temporary_folder(parent: Path | None = None) -> Iterator[Path]:
    """Give a new folder below `parent` (default: the system's folder for temporary files) for a while.

    What is written meanwhile is read again: it does not wait for a result to end (`at_once`).
    """
    folder = new_folder(parent)
    try:
        with at_once():
            yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@contextlib.contextmanager
def temporary_files_in(folder: Path) -> Iterator[None]:
    """Let the folders and files that others ask `tempfile` for meanwhile lie below one of ours.

    Ours go even if this process is killed; those of a library with a name of its own do not.
    """
    before, tempfile.tempdir = tempfile.tempdir, str(folder)
    try:
        yield
    finally:
        tempfile.tempdir = before


def temporary_root() -> Path:
    """Return the folder for temporary files, absolute.

    Python tries it by a file when it is first asked for it; a signal must not leave that there.
    """
    if not hasattr(signal, "pthread_sigmask"):
        return Path(tempfile.gettempdir()).absolute()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM, signal.SIGHUP))
    try:
        return Path(tempfile.gettempdir()).absolute()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def new_folder(parent: Path | None = None) -> Path:
    """Return a new folder below `parent`, absolute; it is removed when the process ends, if not before."""
    root = temporary_root() if parent is None else parent.absolute()
    own = _own.get((os.getpid(), root))
    if own is None or not own.folder.is_dir():
        sweep(root)
        own = _own[os.getpid(), root] = _Own(root)
    return Path(tempfile.mkdtemp(dir=own.folder))


def sweep(parent: Path) -> int:
    """Remove the folders that processes left in `parent` which have ended; return how many."""
    removed = 0
    with contextlib.suppress(OSError):
        for folder in list(parent.glob(f"{_PREFIX}[0-9]*-*")):
            with contextlib.suppress(OSError):
                removed += _remove_if_left(folder)
    return removed


class _Own:
    """The folder of this process in `root`, locked."""

    def __init__(self, root: Path) -> None:
        from multiprocessing.util import Finalize

        self._lock: IO[bytes] | None = None
        self._take_a_name(root)
        # first, as an interrupt may come before the folder is locked; children of multiprocessing end without
        # atexit, but not without this
        Finalize(None, self.close, exitpriority=_LAST)
        while self._lock is None:
            self.folder.mkdir(mode=0o700)
            self._lock = locked(self.folder / _LOCK, make=True)
            if self._lock is None:  # a sweep has taken the folder for a left one before it was locked
                self._take_a_name(root)

    def _take_a_name(self, root: Path) -> None:
        self.folder = root / f"{_PREFIX}{os.getpid()}-{os.urandom(4).hex()}"

    def close(self) -> None:
        """Free the lock and remove the folder."""
        if self._lock is not None:
            self._lock.close()
        shutil.rmtree(self.folder, ignore_errors=True)


_own: dict[tuple[int, Path], _Own] = {}


def remove_own_folders() -> None:
    """Remove the temporary folders of this process, which is about to end without Python's own order."""
    for (pid, _), own in list(_own.items()):
        if pid == os.getpid():
            own.close()


_looked: set[Path] = set()  #: folders in which this process has removed what was left


def locked(path: Path, *, make: bool = False) -> IO[bytes] | None:
    """Return the file opened and locked; None when another process has it or has removed it.

    On a file system without locks nothing is taken for left: OSError, or with `make` the file without one.
    """
    file = path.open("a+b")
    if fcntl is not None:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.close()
            return None
        except OSError:
            if not make:
                file.close()
                raise
        if not _is_at(file, path):
            file.close()
            return None
    return file


def _is_at(file: IO[bytes], path: Path) -> bool:
    """Whether `path` is still this open file: another process may have removed it, a third made it anew."""
    try:
        return os.path.samestat(os.fstat(file.fileno()), path.stat())
    except FileNotFoundError:
        return False


@contextlib.contextmanager
def one_at_a_time(path: Path) -> Iterator[None]:
    """Wait until no other process is in here with the same `path`; it is a file only while one is.

    Nobody waits on a file system without locks, on Windows, or in a folder that cannot be written.
    """
    if fcntl is None:
        yield
        return
    try:
        while (file := locked(path, make=True)) is None:
            time.sleep(_AGAIN_S)
    except OSError:
        yield
        return
    with file:
        try:
            yield
        finally:
            path.unlink(missing_ok=True)


def _remove_if_left(folder: Path) -> bool:
    """Remove `folder` if the process that made it has ended; return whether it had.

    Of another user's folders this is never known: the lock cannot be opened.
    """
    lock = folder / _LOCK
    if not lock.exists():  # about to be locked, or killed just there
        left = time.time() - folder.stat().st_mtime > _YOUNG_S
        if left:
            shutil.rmtree(folder, ignore_errors=True)
        return left
    if fcntl is None:
        lock.unlink()
        shutil.rmtree(folder, ignore_errors=True)
        return True
    file = locked(lock)
    if file is None:
        return False
    with file:
        shutil.rmtree(folder, ignore_errors=True)
    return True


def default_cache() -> Path:
    """Return ``$INTERAREA_CACHE``, else the user's cache folder."""
    if os.environ.get("INTERAREA_CACHE"):
        return Path(os.environ["INTERAREA_CACHE"])
    if sys.platform == "win32" and os.environ.get("LOCALAPPDATA"):
        return Path(os.environ["LOCALAPPDATA"]) / "interarea"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "interarea"


def write_rows(rows: Sequence[Mapping[str, Any]], parquet: Path, csv: Path, schema: Any = None) -> None:
    """Write rows as both files, each whole. schema : of pyarrow; None: as the values are."""
    import pyarrow as pa
    import pyarrow.csv
    import pyarrow.parquet

    table = pa.Table.from_pylist(rows, schema=schema)
    with temporary_folder() as folder:
        pa.parquet.write_table(table, folder / "rows.parquet")
        pa.csv.write_csv(table, folder / "rows.csv")
        write_whole(parquet, (folder / "rows.parquet").read_bytes())
        write_whole(csv, (folder / "rows.csv").read_bytes())
