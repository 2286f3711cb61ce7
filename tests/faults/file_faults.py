"""Errors of the machine at one file operation of many, counted as they come."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest


class Fault:
    """An error of the machine at operation number `at` on a file, and at no other; `count` of all of them."""

    def __init__(self, at: int, number: int) -> None:
        self.at, self.number, self.count = at, number, 0

    @contextlib.contextmanager
    def injected(self) -> Iterator[None]:
        with pytest.MonkeyPatch.context() as patch:
            for owner, name in (
                (pq, "write_table"), (pq.ParquetWriter, "write_table"), (pq.ParquetWriter, "close"),
                (tempfile, "mkstemp"), (os, "fsync"), (os, "fdopen"),
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
