"""The generated header on disk, where compilers find it."""

from __future__ import annotations

import functools
import hashlib
import re
from collections.abc import Collection, Iterable
from pathlib import Path

from ..files import at_once, default_cache, write_whole
from .emit import devices_header
from .language.structure import Model
from .library import library

HEADER = "devices.h"
FOLDER = "devices"  #: of the cache


@functools.lru_cache(maxsize=32)
def _text(own: tuple[Model, ...]) -> str:
    return devices_header([*library().values(), *own])


def devices_file(own: Iterable[Model] = (), keys: Collection[str] | None = None) -> Path:
    """Return `devices.h` of the package's devices and a user's `own`, in the cache folder.

    It is written when it is not there. keys : only these can be run (`with_devices`); a third of the time to
    compile, or less.
    """
    text = _text(tuple(own)) if keys is None else with_devices(_text(tuple(own)), keys)
    path = default_cache() / FOLDER / _digest(text.encode("ascii")) / HEADER
    with at_once():
        return path if path.is_file() else write_whole(path, text)


def is_named_by_content(path: Path) -> bool:
    """Whether the name of a header's folder in the cache is that of its content: it has no other proof."""
    try:
        return _digest(path.read_bytes()) == path.parent.name
    except OSError:
        return False


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:24]


def with_devices(header: str, keys: Collection[str]) -> str:
    """Return the generated `header` with the ways to devices other than `keys` taken out.

    Numbers and signature stay, so the same records fit; the functions that nobody calls any more are not
    compiled. A record that asks for another device is refused by its layout.
    """
    branches = re.compile(r"^ *case DEVICE_NUMBER_(\w+): [^\n]*;\n", re.MULTILINE)
    retained = {key.upper() for key in keys}
    missing = retained - set(branches.findall(header))
    if missing:
        raise ValueError(f"devices {sorted(missing)} are not in the generated header")
    return branches.sub(lambda match: match.group() if match.group(1) in retained else "", header)


def signature(own: Iterable[Model] = ()) -> int:
    """Return the number by which a record and a binary know that they were made for the same devices."""
    match = re.search(r"#define DEVICE_SIGNATURE (\d+)u", _text(tuple(own)))
    assert match is not None
    value = int(match.group(1))
    return value - (1 << 32) if value >= 1 << 31 else value  # as the int32 of the record
