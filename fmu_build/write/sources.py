"""The C files and headers that a block's binary is made of, flat in one folder."""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Mapping
from functools import cache as forever
from pathlib import Path

from ..errors import BuildError

_C = Path(__file__).resolve().parents[1] / "c"


@forever
def fmi_sources() -> tuple[Path, ...]:
    """Return the C files of the FMI layer, which is the same for every block."""
    return tuple(sorted(_C.glob("*.c")))


def fmi_headers() -> Path:
    """Return the folder with the standard's headers, shipped by fmpy.

    Raises
    ------
    BuildError : fmpy is not installed.
    """
    spec = importlib.util.find_spec("fmpy")
    if spec is None or spec.origin is None:
        raise BuildError("the FMI 2.0 headers come with fmpy, which is not installed; run `pip install fmpy`")
    return Path(spec.origin).parent / "c-code"


def source_files(block_sources: tuple[Path, ...]) -> dict[str, bytes]:
    """Return every C file and header of a block's binary, flat, by file name.

    Quoted includes are followed and rewritten to bare names, so that the files
    compile from one folder (``sources/`` of the FMU) with no include path. A C
    file that another includes is named ``NAME_c.h`` there.

    Raises
    ------
    BuildError : an include that is not there, or two different files of one name.
    """
    return gather_sources((*fmi_sources(), *block_sources))


_Stamps = tuple[tuple[Path, tuple[int, int]], ...]
_READ: dict[tuple[Path, ...], tuple[_Stamps, dict[str, bytes]]] = {}


def gather_sources(c_files: tuple[Path, ...]) -> dict[str, bytes]:
    """Return `c_files` and the headers they include, flat, by file name (see `source_files`).

    The files are read again only when one of them has changed.
    """
    retained = _READ.get(c_files)
    if retained is None or any(_stamp(path) != stamp for path, stamp in retained[0]):
        files, read = _read_sources(c_files)
        retained = tuple((path, _stamp(path)) for path in read), files
        _READ[c_files] = retained
    return dict(retained[1])


def _stamp(path: Path) -> tuple[int, int]:
    try:
        status = path.stat()
    except OSError:
        return -1, -1
    return status.st_mtime_ns, status.st_size


def _read_sources(c_files: tuple[Path, ...]) -> tuple[dict[str, bytes], list[Path]]:
    """Contents by flat name, and the files they were read from."""
    files: dict[str, bytes] = {}
    origin: dict[str, Path] = {}
    parts: set[Path] = set()
    to_do = [p.resolve() for p in c_files]
    # a generated header lies in a folder of its own, and includes what lies beside the others
    folders = (_C, fmi_headers(), _block_folder(), *dict.fromkeys(p.parent for p in to_do))
    provided = {p.name: p for p in to_do if p.suffix == ".h"}
    while to_do:
        path = to_do.pop()
        name = _flat_name(path, parts)
        if name in origin:
            if origin[name] != path:
                raise BuildError(f"two C files are called {name}: {origin[name]} and {path}; rename one")
            continue
        origin[name] = path
        try:
            text = path.read_text(encoding="utf-8")
        except OSError as error:
            raise BuildError(f"cannot read the C file {path}: {error}") from error
        lines = []
        for line in text.splitlines():
            words = line.split('"')
            if line.startswith("#include") and len(words) >= 3:
                included = _included(path, words[1], folders, provided)
                to_do.append(included)
                if included.suffix == ".c":  # part of this file, not one to compile by itself
                    parts.add(included)
                line = f'#include "{_flat_name(included, parts)}"'
            lines.append(line)
        files[name] = ("\n".join(lines) + "\n").encode("utf-8")
    return dict(sorted(files.items())), list(origin.values())


def _included(path: Path, name: str, folders: tuple[Path, ...], provided: Mapping[str, Path]) -> Path:
    """The file that `path` includes: beside it, in one of the folders, or a generated header."""
    for folder in (path.parent, *folders):
        if (folder / name).is_file():
            return (folder / name).resolve()
    if name in provided:
        return provided[name].resolve()
    raise BuildError(f'{path}: #include "{name}" is neither beside it nor among the headers')


def _flat_name(path: Path, parts: set[Path]) -> str:
    """Name in the one folder; a C file that another includes becomes a header: no tool compiles it."""
    return f"{path.stem}_c.h" if path in parts else path.name


def record_source() -> Path:
    """Return the C file that reads ``resources/model.bin``; every binary has it."""
    return _block_folder() / "record.c"


@forever
def _block_folder() -> Path:
    """Folder of block.h and record.c."""
    spec = importlib.util.find_spec("interarea.models")
    assert spec is not None and spec.submodule_search_locations
    return Path(next(iter(spec.submodule_search_locations))).resolve() / "c" / "block"


def with_includes(name: str, sources: Mapping[str, bytes]) -> list[str]:
    """Return a C file and all of `sources` that it includes; every header where a macro names one."""
    includes: dict[str, None] = {}
    to_do = [name]
    while to_do:
        part = to_do.pop()
        if part in sources and part not in includes:
            includes[part] = None
            for included in re.findall(r"^#include\s+([\"\w]\S*)", sources[part].decode(), re.MULTILINE):
                quoted = included.startswith('"')
                to_do += [included.strip('"')] if quoted else [s for s in sources if s.endswith(".h")]
    return sorted(includes)
