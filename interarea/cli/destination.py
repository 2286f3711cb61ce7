"""Where results go, looked at before anything is computed: minutes of work must not end at its door."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from interarea.cosim.errors import DestinationError


def folder_for(path: Path, option: str = "--out", *, files: Iterable[str] = ()) -> Path:
    """Return `path` if it is a folder, or can be made one, in which files can be written; nothing is made.

    files : names in it that must not be folders.

    Raises DestinationError, naming `option`.
    """
    if path.exists() and not path.is_dir():
        raise DestinationError(f"{option} {path}: is a file, wanted: a folder (made if not there)")
    _require_room(path, path, option)
    for name in files:
        if (path / name).is_dir():
            raise DestinationError(f"{option} {path}: {name} in it is a folder, wanted: a file or nothing")
        _require_room(path / name, (path / name).parent, option)
    return path


def file_for(path: Path, option: str = "--out", *, suffix: str = "") -> Path:
    """Return `path` if it is a file, or can be made one; nothing is made.

    suffix : what its name must end in; default anything.

    Raises DestinationError, naming `option`.
    """
    if path.is_dir():
        raise DestinationError(f"{option} {path}: is a folder, wanted: the name of a file")
    if path.exists() and not path.is_file():
        raise DestinationError(f"{option} {path}: is no ordinary file, wanted: the name of a file")
    _require_room(path, path.parent, option)
    if suffix and path.suffix.lower() != suffix:
        raise DestinationError(f"{option} {path}: suffix {path.suffix!r}, allowed: {suffix}")
    return path


def _require_room(path: Path, folder: Path, option: str) -> None:
    """Require that `folder`, or the nearest one above it that is there, is a folder that can be written."""
    there = folder.absolute()
    while not there.exists():
        there = there.parent
    if not there.is_dir():
        raise DestinationError(f"{option} {path}: {there} is a file, wanted: a folder")
    if not os.access(there, os.W_OK | os.X_OK):
        raise DestinationError(
            f"{option} {path}: no permission to write in {there}, wanted: a place that you may write to"
        )
