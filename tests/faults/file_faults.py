"""Errors of the machine at one operation of many: on a file, counted as they come, or at an allocation.

`make fuzz` sets `INTERAREA_EVERY_FAULT`: then every one of them is tried, else those of a stated grid.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

EVERY = bool(os.environ.get("INTERAREA_EVERY_FAULT"))
LONG = pytest.mark.timeout(0 if EVERY else 900)  #: all of them take hours

#: each of this many tests takes its share, so that processes can have them side by side
SHARES = 4 if EVERY else 1
SHARED = pytest.mark.parametrize("share", range(SHARES))


def grid(ratio: float = 1.0, step: int = 1) -> Iterator[int]:
    """Yield 1, 2 .. without end, each at least `step` and `ratio` times the one before; with `EVERY` all."""
    n = 1
    while True:
        yield n
        n = n + 1 if EVERY else max(n + step, int(n * ratio))


class Fault:
    """An error of the machine at operation number `at` on a file, and at no other; `count` of all of them."""

    def __init__(self, at: int, number: int) -> None:
        self.at, self.number, self.count = at, number, 0

    @contextlib.contextmanager
    def injected(self) -> Iterator[None]:
        with pytest.MonkeyPatch.context() as patch:
            for owner, name in (
                (pq, "write_table"), (pq.ParquetWriter, "write_table"), (pq.ParquetWriter, "close"),
                (tempfile, "mkstemp"), (tempfile, "mkdtemp"), (os, "fsync"), (os, "fdopen"),
                (Path, "open"), (Path, "replace"), (Path, "unlink"), (Path, "mkdir"), (Path, "chmod"),
            ):  # fmt: skip
                patch.setattr(owner, name, self._failing(getattr(owner, name)))
            yield

    def _failing(self, real: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            self.count += 1
            if self.count == self.at:
                raise OSError(self.number, os.strerror(self.number))
            return real(*arguments, **options)

        return call


@contextlib.contextmanager
def no_memory(at: int) -> Iterator[None]:
    """Let allocation number `at` of the interpreter fail, and no other; numpy's arrays are not its."""
    memory = pytest.importorskip("_testcapi", reason="this Python comes without what lets allocations fail")
    try:
        memory.set_nomemory(at, at + 1)
        yield
    finally:
        memory.remove_mem_hooks()
