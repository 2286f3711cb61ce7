"""trajectory.csv and trajectory.parquet, written in parts while a run goes on: whole, or not there."""

from __future__ import annotations

import contextlib
import io
import os
from collections.abc import Iterator, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, cast

from interarea.models.files import Partial

from ..errors import DestinationError, ScenarioError, nearest
from ..trajectory import TIME, Trajectory

if TYPE_CHECKING:
    import pyarrow.parquet as pq


def chosen(columns: Sequence[str], record: Sequence[str]) -> list[str]:
    """Return the columns that names or patterns (``plant.*``) in `record` choose, in their order; () = all.

    Raises
    ------
    ScenarioError : a name or pattern that chooses nothing.
    """
    for pattern in record:
        if not any(fnmatchcase(name, pattern) for name in columns):
            raise ScenarioError(f"record = {pattern!r}: no signal has this name; {nearest(pattern, columns)}")
    return [n for n in columns if n == TIME or not record or any(fnmatchcase(n, p) for p in record)]


class TrajectoryFiles:
    """Both files of a run in `folder`; a context manager that ends with both, or with what was there before.

    record : columns as `chosen` takes them. every : every n-th point is written, and the last.

    Raises
    ------
    DestinationError : a file that cannot be written; names it.
    """

    def __init__(self, folder: Path, record: Sequence[str] = (), every: int = 1) -> None:
        self.files = [folder / "trajectory.csv", folder / "trajectory.parquet"]
        self._record, self._every = record, every
        self._points = 0
        self.last: Trajectory | None = None  #: part that was taken last
        self._partial: list[Partial] = []
        self._csv: io.TextIOWrapper | None = None
        self._parquet: pq.ParquetWriter | None = None

    def __enter__(self) -> TrajectoryFiles:
        try:
            self._begin()
        except BaseException:
            self._discard()
            raise
        return self

    def _begin(self) -> None:
        """Make the two partial files."""
        with self._named(self.files[0].parent):
            self.files[0].parent.mkdir(parents=True, exist_ok=True)
        for file in self.files:
            with self._named(file):
                self._partial.append(Partial(file))
        raw = cast("io.BufferedRandom", self._partial[0].file)
        self._csv = io.TextIOWrapper(raw, encoding="utf-8", newline="")

    def add(self, part: Trajectory) -> None:
        """Write the points of a part."""
        retained = part.thinned(
            chosen(list(part.units), self._record), -self._points % self._every, self._every
        )
        self._points += len(part.time_s)
        self.last = part
        self._write(retained)

    def _write(self, points: Trajectory) -> None:
        first = self._parquet is None
        table = points.table()
        with self._named(self.files[0]):
            assert self._csv is not None
            points.write_rows(self._csv, header=first)
        with self._named(self.files[1]):
            if self._parquet is None:
                import pyarrow.parquet as pq

                self._parquet = pq.ParquetWriter(
                    self._partial[1].file, table.schema, write_page_checksum=True
                )
            self._parquet.write_table(table)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self._end()
        finally:
            self._discard()

    def _end(self) -> None:
        """Write the last point if it is still missing, and give both files their names."""
        if self.last is not None and (self._points - 1) % self._every:
            self._write(self.last.thinned(chosen(list(self.last.units), self._record), -1, 1))
        for ended, partial, file in zip((self._csv, self._parquet), self._partial, self.files, strict=True):
            with self._named(file):
                if isinstance(ended, io.TextIOWrapper):
                    ended.detach()  # closed, it would close what is yet to be named
                elif ended is not None:
                    ended.close()
                partial.settle()

    def _discard(self) -> None:
        """Close what is open and remove what has no name of its own yet."""
        open_: tuple[Any, ...] = (self._csv, self._parquet)
        for file in (f for f in open_ if f is not None):
            with contextlib.suppress(OSError, ValueError):  # detached
                file.close()
        for partial in self._partial:
            partial.close()

    @staticmethod
    @contextlib.contextmanager
    def _named(file: Path) -> Iterator[None]:
        """Name the file in what the system says."""
        try:
            yield
        except OSError as error:
            reason = str(error) if error.errno is None else os.strerror(error.errno)
            raise DestinationError(
                f"{file}: {reason}: not written, the previous file is unchanged; free disk space, or "
                "write less "
                "(record, every)"
            ) from error
