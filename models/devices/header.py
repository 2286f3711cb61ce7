"""The generated header on disk, where compilers find it."""

from __future__ import annotations

import functools
import hashlib
import re
from collections.abc import Iterable
from pathlib import Path

from ..cache_folder import default_cache
from ..files import write_whole
from .emit import devices_header
from .language.structure import Model
from .library import library


@functools.cache
def _library_text() -> str:
    return devices_header(library().values())


def library_header() -> Path:
    """Return `devices.h` of the package's devices, written into the cache folder when it is not there."""
    return _header(_library_text())


def header_of(models: Iterable[Model]) -> Path:
    """Return `devices.h` of `models`, as `library_header`."""
    return _header(devices_header(models))


def _header(text: str) -> Path:
    digest = hashlib.sha256(text.encode("ascii")).hexdigest()[:24]
    path = default_cache() / "devices" / digest / "devices.h"  # content names the folder
    return path if path.is_file() else write_whole(path, text)


def signature() -> int:
    """Return the number by which a record and a binary know that they were made for the same devices."""
    found = re.search(r"#define DEVICE_SIGNATURE (\d+)u", _library_text())
    assert found is not None
    value = int(found.group(1))
    return value - (1 << 32) if value >= 1 << 31 else value  # as the int32 of the record
