"""Files made once and found again: FMUs, linear models, controllers, named by content hash.

A key holds the bytes of the inputs and of the sources that turn them into the
artefact, so a changed case, design or C file gives a new file and an unchanged
one is never computed twice. Files appear by an atomic rename: a killed run
leaves no half-written artefact behind. A digest beside each file says whether
it still is what was written.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import logging
import os
import platform
import re
import shutil
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache as forever
from importlib.metadata import PackageNotFoundError, version
from importlib.util import resolve_name
from pathlib import Path
from typing import Any

import numpy as np

from interarea.models.files import at_once, settle, temporary_folder, write_whole
from interarea.models.files import default_cache as default_cache

_log = logging.getLogger("interarea")
_PROOF = ".sha256"
COMPILERS_OWN = "zig"  #: folder in which the compiler keeps what it compiled before
ROOMS = Path(__file__).resolve().parents[2]
_IMPORT = re.compile(
    r"^[ \t]*(?:from +([\w.]+) +import +(?:\(((?:[^)#]|#.*)*)\)|(.*))|import +(.*))", re.MULTILINE
)
_NAME = re.compile(r"(\w[\w.]*)(?: +as +\w+)?")


def content_hash(*parts: object) -> str:
    """Return 16 hexadecimal digits of SHA-256 over `parts` (bytes, arrays, or anything JSON can hold)."""
    digest = hashlib.sha256()
    for part in parts:
        if isinstance(part, bytes):
            raw = part
        elif isinstance(part, np.ndarray):
            raw = str((part.dtype.str, part.shape)).encode() + np.ascontiguousarray(part).tobytes()
        else:
            raw = json.dumps(part, sort_keys=True, default=str).encode()
        digest.update(len(raw).to_bytes(8, "little") + raw)
    return digest.hexdigest()[:16]


def file_hash(path: Path) -> str:
    """Return 16 hexadecimal digits of SHA-256 over the bytes of a file."""
    return content_hash(path.read_bytes())


@forever
def source_hash(room: str, pattern: str = "*.py") -> str:
    """Return the hash of those files of a room (folders below included) that match `pattern`."""
    folder = ROOMS / room
    files = sorted(folder.rglob(pattern))
    return content_hash(*(part for p in files for part in (p.relative_to(folder).as_posix(), p.read_bytes())))


def device_hash() -> str:
    """Return the hash of the bundled device files, from which C and records of plants are made."""
    return source_hash("models/devices", "*.toml")


@forever
def code_hash(module: str) -> str:
    """Return the hash of the Python source of a module of this package and of all it imports from it.

    Device files count where one of these is a module of `models.devices`.

    module : full name; a module's own `__name__`, or the `__module__` of what it defines.

    Raises
    ------
    ValueError : no such module; a wrong name must not end in a key that never changes.
    """
    sources: dict[str, bytes] = {}
    todo = [module]
    while todo:
        name = todo.pop()
        if name not in sources and (source := _source(name)) is not None:
            package, sources[name] = source
            todo += _imports(package, sources[name])
    if module not in sources:
        raise ValueError(f"{module!r} is no module of this package")
    devices = any(name.startswith("interarea.models.devices") for name in sources)
    parts = (part for name in sorted(sources) for part in (name, sources[name]))
    return content_hash(*parts, *([device_hash()] if devices else []))


@forever
def _source(name: str) -> tuple[str, bytes] | None:
    """Return the package of a module and its bytes, read once for all keys; None where there is none."""
    first, *parts = name.split(".")
    if first != "interarea" or not parts:
        return None
    path = ROOMS.joinpath(*parts)
    for package, file in (
        (name.rpartition(".")[0], path.with_name(f"{path.name}.py")),
        (name, path / "__init__.py"),
    ):
        if file.is_file():
            return package, file.read_bytes()
    return None


@forever
def _imports(package: str, source: bytes) -> list[str]:
    """Return what those lines of a source name that begin as imports do: parsing it all takes .2 s of a run.

    A line of text that begins so does no harm: it names no module, or one whose changes count too.
    """
    imports: list[str] = []
    for start, several, one, plain in _IMPORT.findall(source.decode("utf-8")):
        names = _NAME.findall(re.sub("#.*", "", several or one or plain))
        if start:
            origin = resolve_name(start, package)
            names = [origin, *(f"{origin}.{name}" for name in names)]
        imports += names
    return imports


def host_machine() -> str:
    """Return system and processor of this machine, as "linux-x86_64": binaries and rounding follow them."""
    processor = {"AMD64": "x86_64", "arm64": "aarch64", "ARM64": "aarch64"}
    return f"{sys.platform}-{processor.get(platform.machine(), platform.machine())}"


def numerics_versions() -> dict[str, str]:
    """Return the machine and the versions of the libraries whose rounding can reach a result."""
    return {"machine": host_machine(), **_library_versions()}


@forever
def _library_versions() -> dict[str, str]:
    return {name: _version(name) for name in ("numpy", "scipy", "control", "cvxpy", "clarabel", "fmpy")}


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


def artefact(cache: Path, kind: str, key: str, suffix: str, make: Callable[[Path], object]) -> Path:
    """Return the file `cache/KIND/KEYSUFFIX`, calling `make(temporary path)` when it is not there yet.

    Beside it lies its SHA-256, as sha256sum writes it. A file that is not what was written is made again.
    """
    path = cache / kind / f"{key}{suffix}"
    if path.exists():
        if is_whole(path):
            with contextlib.suppress(OSError):  # a cache that only others write
                os.utime(_proof(path))  # when it was last used
            _log.info("cache: %s", path)
            return path
        _log.warning("%s is not what was written there (SHA-256): it is made again", path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with temporary_folder(cache) as folder:
        result, begin_s = folder / path.name, time.monotonic()
        make(result)
        _log.info("made in %.1f s: %s", time.monotonic() - begin_s, path)
        # the proof first: a file without one is no artefact, a proof without its file is nothing
        _prove(path, result.read_bytes())
        return settle(result, path)


def keep(path: Path, content: bytes) -> Path:
    """Write an artefact that was made elsewhere, with its proof; return `path`."""
    with at_once():
        _prove(path, content)
        return write_whole(path, content)


def is_whole(path: Path) -> bool:
    """Whether the file of an artefact is what was written there."""
    try:
        return _proof(path).read_bytes() == _said(path, path.read_bytes())
    except OSError:
        return False


def _prove(path: Path, content: bytes) -> None:
    write_whole(_proof(path), _said(path, content))


def _said(path: Path, content: bytes) -> bytes:
    return f"{hashlib.sha256(content).hexdigest()}  {path.name}\n".encode()


def _proof(path: Path) -> Path:
    return path.with_name(f"{path.name}{_PROOF}")


@dataclass(frozen=True)
class Artefact:
    """An artefact in the cache."""

    kind: str  #: name of its folder
    path: Path
    size: int  #: bytes
    used_s: float  #: when it was last asked for, seconds since the epoch


def artefacts_in(cache: Path) -> list[Artefact]:
    """Return what the cache holds, the longest unused first; what the compiler keeps is one of them."""
    artefacts = []
    for folder in cache.iterdir() if cache.is_dir() else ():
        if folder.name.startswith("interarea-") or not folder.is_dir():
            continue
        files = [(p, p.stat()) for p in folder.rglob("*") if p.is_file() and p.suffix != _PROOF]
        rows = [Artefact(folder.name, p, s.st_size, _used(p, s.st_mtime)) for p, s in files]
        if folder.name == COMPILERS_OWN and rows:
            rows = [Artefact(COMPILERS_OWN, folder, sum(r.size for r in rows), max(r.used_s for r in rows))]
        artefacts += rows
    return sorted(artefacts, key=lambda k: k.used_s)


def _used(path: Path, written_s: float) -> float:
    try:
        return _proof(path).stat().st_mtime
    except OSError:
        return written_s


def damaged(cache: Path) -> list[Artefact]:
    """Return the artefacts that are not what was written; nothing proves what the compiler keeps."""
    from interarea.models.devices.header import FOLDER, is_named_by_content  # no more than this needs them

    whole = {COMPILERS_OWN: lambda path: True, FOLDER: is_named_by_content}
    return [k for k in artefacts_in(cache) if not whole.get(k.kind, is_whole)(k.path)]


def remove(removed: Iterable[Artefact]) -> int:
    """Remove artefacts with their proofs; return how many bytes they had. What is needed is made again."""
    freed = 0
    for k in removed:
        if k.path.is_dir():
            shutil.rmtree(k.path, ignore_errors=True)
        else:
            k.path.unlink(missing_ok=True)
            _proof(k.path).unlink(missing_ok=True)
        freed += k.size
    return freed


def cached_json(cache: Path, kind: str, key: str, make: Callable[[], Any]) -> Any:
    """Return the JSON value `cache/KIND/KEY.json`, calling `make()` when it is not there yet."""

    def write(path: Path) -> None:
        path.write_text(json.dumps(make(), allow_nan=False), encoding="utf-8")

    return json.loads(artefact(cache, kind, key, ".json", write).read_text(encoding="utf-8"))


def place(artefact: Path, path: Path) -> Path:
    """Copy an artefact to where the user wants it, as one finished file; return that path."""
    return write_whole(path, artefact.read_bytes())
