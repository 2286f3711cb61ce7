"""FMUs of this package from the cache: checked once when they are first opened, afterwards by their SHA-256.

What is known of such an FMU then lies beside it in the cache: the description that was read, and the files
that are unpacked. It is trusted as its binary is: both come from the cache, each with its digest.
"""

from __future__ import annotations

import contextlib
import pickle
import shutil
from pathlib import Path
from typing import Any

from interarea.models.files import new_folder

from ..write.cache import artefact, content_hash, host_machine, source_hash
from .fmu_file import FmuFile

_KIND = "opened"


class OwnFmu(FmuFile):
    """An FMU that lies in the cache under the hash of what it was made of; see `open_own`."""

    def __init__(self, path: Path, known: dict[str, Any], files: dict[str, bytes]) -> None:
        vars(self).update(known)
        self.path, self._files = path, files
        self._folder, self._known = None, set()

    def _unpacked(self) -> Path:
        folder = new_folder()
        try:
            for name, content in self._files.items():
                file = folder / name
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_bytes(content)
        except BaseException:
            shutil.rmtree(folder, ignore_errors=True)
            raise
        self._known.add(folder / self._library)
        return folder


def open_own(path: Path, cache: Path, interface: str = "CoSimulation") -> FmuFile:
    """Return an FMU that `artefact` has just returned: its content is what its name and digest say.

    Raises
    ------
    FmuFileError : it was built for other machines only, or its binary is none.
    """
    key = content_hash(path.name, interface, host_machine(), source_hash("fmu_build/open"))

    def make(place: Path) -> None:
        place.write_bytes(_known_of(FmuFile(path, interface)))

    try:
        opened = artefact(cache, _KIND, f"{path.stem}-{key}", ".pickle", make)
    except OSError:  # a cache that only others write, a full disk
        return FmuFile(path, interface)
    known, files = pickle.loads(opened.read_bytes())
    return OwnFmu(path, known, files)


def _known_of(file: FmuFile) -> bytes:
    """Return what is known of an FMU and the files that it unpacks to."""
    with contextlib.closing(file):
        _ = file.binary, file._library, file.variables, file.enumerations, file.description
        names = sorted(p for p in file.folder.rglob("*") if p.is_file())
        files = {p.relative_to(file.folder).as_posix(): p.read_bytes() for p in names}
        known = {k: v for k, v in vars(file).items() if k not in ("path", "_folder", "_known")}
        return pickle.dumps((known, files))
