"""Put a block together as an FMU: one archive, the same bytes for the same block."""

from __future__ import annotations

import functools
import io
import os
import re
import struct
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from interarea.models.blocks.variables import Block
from interarea.models.files import write_whole

from ..errors import BuildError
from .cache import artefact, content_hash, default_cache, host_machine, source_hash
from .compile import PLATFORMS, compile_library, host_platform, objects_begun, platform_of
from .description_xml import render
from .documentation import documentation
from .sources import record_source, source_files

_TEMPLATES = Path(__file__).resolve().parent / "templates"
_EPOCH = (1980, 1, 1, 0, 0, 0)


def build_fmu(
    block: Block, path: Path | str, *, platforms: Sequence[str] | None = None, cache: Path | None = None
) -> Path:
    """Write `block` as an FMU for model exchange and co-simulation; return its path.

    Parameters
    ----------
    path : the file to write, or an existing folder to write ``NAME.fmu`` into.
    platforms : keys of `compile.PLATFORMS`; None = the one this Python runs on.
    cache : folder of compiled binaries; default ``$INTERAREA_CACHE``, else the user's cache folder.

    Raises
    ------
    BuildError : no compiler, an unknown platform, or a name that is no C identifier.
    """
    if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", block.name):
        raise BuildError(
            f"block name {block.name!r} is no C identifier; use letters, digits and _ (it names the binary)"
        )
    path, cache = Path(path), cache or default_cache()
    if path.is_dir():
        path = path / f"{block.name}.fmu"
    names = [host_platform()] if platforms is None else list(dict.fromkeys(platforms))
    if not names:
        raise BuildError(f"no platform was asked for; allowed: {', '.join(PLATFORMS)}")
    sources = source_files((*block.sources, record_source()))
    for name in names:
        platform_of(name)
    with objects_begun(block.kind, sources, names[0], cache):
        description, record = render(block, sources)
    libraries = {name: compile_library(block.kind, sources, name, cache=cache) for name in names}
    binaries = {name: file.read_bytes() for name, file in libraries.items()}
    return write_whole(path, _archive(block, description, record, sources, binaries))


def block_fmu(block: Block, cache: Path, *, platforms: Sequence[str] | None = None) -> Path:
    """Build the FMU of a block once; the key is everything the block holds and the FMU builder's sources.

    platforms : see `build_fmu`.
    """
    variables = [repr(v) for v in block.table]
    data = [part for name, value in block.data.items() for part in (name, _raw(value))]
    key = content_hash(
        block.kind,
        block.name,
        block.description,
        [block.step_s, block.stop_s, block.longest_step_s, block.model_exchange],
        dict(block.documentation),
        dict(block.provenance),
        variables,
        *data,
        *(p.read_bytes() for p in block.sources),
        source_hash("models", "*.h"),
        source_hash("fmu_build/write"),
        source_hash("fmu_build", "*.[ch]"),
        os.environ.get("CC", ""),
        host_machine(),  # binaries where no platform is named, and the rounding of the record
        *([] if platforms is None else [list(platforms)]),
    )

    def make(path: Path) -> None:
        build_fmu(block, path, platforms=platforms, cache=cache)

    return artefact(cache, block.kind, f"{block.name}-{key}", ".fmu", make)


def _raw(value: object) -> bytes | np.ndarray[Any, Any]:
    return value if isinstance(value, bytes) else np.asarray(value)


def _archive(
    block: Block, description: str, record: bytes, sources: Mapping[str, bytes], binaries: dict[str, bytes]
) -> bytes:
    """Bytes of the FMU; entries sorted, one fixed date, so nothing depends on when or where."""
    entries: dict[str, bytes] = {
        "modelDescription.xml": description.encode("utf-8"),
        "model.png": _picture(),
        "resources/model.bin": record,
        "documentation/index.html": documentation(block, sources, binaries).encode("utf-8"),
        "documentation/licenses/license.txt": (_TEMPLATES / "license.txt").read_bytes(),
        "documentation/licenses/fmi_headers.txt": _headers_license(sources),
    }
    for name, content in sources.items():
        entries[f"sources/{name}"] = content
    for name, content in binaries.items():
        platform = PLATFORMS[name]
        entries[f"binaries/{platform.folder}/{block.name}{platform.suffix}"] = content
    return archive_bytes(entries, first="modelDescription.xml")


def archive_bytes(entries: Mapping[str, bytes], *, first: str, stored: tuple[str, ...] = ()) -> bytes:
    """Return a zip of `entries` whose bytes depend on nothing but them.

    first : the entry to put first, so that tools that stream find it at once.
    stored : endings of names that are compressed already.
    """
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as archive:
        for name in sorted(entries, key=lambda n: (n != first, n)):
            info = zipfile.ZipInfo(name, date_time=_EPOCH)
            info.compress_type = (
                zipfile.ZIP_STORED if stored and name.endswith(stored) else zipfile.ZIP_DEFLATED
            )
            info.create_system = 3
            info.external_attr = 0o100644 << 16
            archive.writestr(info, entries[name])
    return buffer.getvalue()


def _headers_license(sources: Mapping[str, bytes]) -> bytes:
    """Licence of the standard's headers, as they carry it themselves."""
    text = sources["fmi2Functions.h"].decode("utf-8")
    match = re.search(r"Copyright .*?(?=\*/)", text, re.DOTALL)
    if match is None:
        raise BuildError("fmi2Functions.h carries no licence; reinstall fmpy")
    lines = [line.strip() for line in match.group().splitlines()]
    return ("FMI 2.0 standard headers\n\n" + "\n".join(lines).strip() + "\n").encode("utf-8")


@functools.cache
def _picture() -> bytes:
    """PNG of a decaying oscillation, 128 by 128 pixels."""
    size = 128
    image = np.full((size, size), 255, dtype=np.uint8)
    image[size // 2, 8 : size - 8] = 190
    s = np.linspace(0.0, 1.0, 40 * size)
    columns = (8 + s * (size - 17)).round().astype(int)
    rows = size / 2 - 48 * np.exp(-3.0 * s) * np.cos(2 * np.pi * 4 * s)
    for offset in (-1, 0, 1):
        image[np.clip(rows.round().astype(int) + offset, 0, size - 1), columns] = 40

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", size, size, 8, 0, 0, 0, 0)
    rows_bytes = b"".join(b"\0" + row.tobytes() for row in image)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(rows_bytes, 9))
        + chunk(b"IEND", b"")
    )
