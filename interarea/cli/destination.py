"""Where results go, looked at before anything is computed: minutes of work must not end at its door."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable
from contextlib import suppress
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
            raise DestinationError(f"{option} {path}: {name} in it is a folder, wanted: a file or no entry")
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
        raise DestinationError(f"{option} {path}: is not a regular file, wanted: the name of a file")
    _require_room(path, path.parent, option)
    if suffix and path.suffix.lower() != suffix:
        raise DestinationError(f"{option} {path}: suffix {path.suffix!r}, allowed: {suffix}")
    return path


def _require_room(path: Path, folder: Path, option: str) -> None:
    """Require that `folder`, or the nearest one above it that is there, is a folder that can be written."""
    if path.parts[:1] == ("~",):
        raise DestinationError(
            f"{option} {path}: the shell did not expand the ~ (in quotes or after =), wanted: the full path"
        )
    there = folder.absolute()
    while not there.exists():
        if there.is_symlink():
            raise DestinationError(f"{option} {path}: {there} is a broken link, wanted: a folder")
        there = there.parent
    if not there.is_dir():
        raise DestinationError(f"{option} {path}: {there} is a file, wanted: a folder")
    try:
        _try_to_write(there)
    except PermissionError:
        raise DestinationError(
            f"{option} {path}: no permission to write in {there}, wanted: a folder with write permission"
        ) from None
    except OSError as error:
        raise DestinationError(
            f"{option} {path}: nothing can be written in {there} ({error.strerror}), wanted: another folder"
        ) from None


def _try_to_write(folder: Path) -> None:
    """Make a file without a name in a folder, or where there is no such thing a folder that goes at once.

    What a folder's mode says is not asked: the administrator's is not obeyed, that of /proc is not meant.
    Raises OSError where neither can be made.
    """
    with suppress(OSError, AttributeError):  # not on Windows, macOS or some file systems
        os.close(os.open(folder, os.O_TMPFILE | os.O_WRONLY, 0o600))
        return
    Path(tempfile.mkdtemp(prefix=".", dir=folder)).rmdir()
