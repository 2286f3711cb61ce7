"""The container's C as WebAssembly: the bytes that every page carries."""

from __future__ import annotations

import re
from collections.abc import Collection
from pathlib import Path

from interarea.fmu_build.errors import NoCompilerError
from interarea.fmu_build.write.compile import (
    WEB_PAGE,
    compile_for,
    fmi_sources,
    gather_sources,
    record_source,
)
from interarea.models.blocks.container import container_sources
from interarea.models.case.case import Case
from interarea.models.grid.equilibrium import operating_point

#: The page's own calls; they take the place of the FMI layer's reading of a file.
PAGE_SOURCE = Path(__file__).resolve().parent / "web" / "page.c"
_READS_FILES = "resource.c"
_DEVICES = "devices.h"


def page_sources(case: Case | None = None) -> dict[str, bytes]:
    """Return the sources of the WebAssembly: those of a loop's FMU, and `PAGE_SOURCE`.

    case : with the controls of this grid alone, two thirds less; default: those of the whole library.
    """
    layer = tuple(path for path in fmi_sources() if path.name != _READS_FILES)
    sources = gather_sources((PAGE_SOURCE, *layer, *container_sources(), record_source()))
    if case is not None:
        keys = {device.key for device in operating_point(case).controls.devices}
        sources[_DEVICES] = with_devices(sources[_DEVICES], keys)
    return sources


def container_wasm(cache: Path | None = None, *, case: Case | None = None) -> bytes:
    """Return the WebAssembly module of a closed loop.

    What it simulates is a record (`models`). With the controls of the whole library it serves every grid;
    with those of `case` alone every grid with these. It imports nothing. Modules for bundled grids travel in
    the package's wheel; without a compiler any other grid gets the one of the whole library.
    cache : folder of compiled binaries; default `fmu_build.write.cache.default_cache()`.

    Raises
    ------
    BuildError : no compiler that can make WebAssembly, or the compiler's own message.
    """
    try:
        return compile_for("container", page_sources(case), WEB_PAGE, cache=cache).read_bytes()
    except NoCompilerError:
        if case is None:
            raise
        return container_wasm(cache)


def with_devices(header: bytes, keys: Collection[str]) -> bytes:
    """Return the generated header `devices.h` with the ways to devices other than `keys` taken out.

    Numbers and signature stay, so the same records fit; the functions that nobody calls any more are not
    compiled. A record that asks for another device is refused by its layout.
    """
    ways = re.compile(rb"^ *case DEVICE__(\w+): [^\n]*;\n", re.MULTILINE)
    kept = {key.upper().encode("ascii") for key in keys}
    missing = kept - set(ways.findall(header))
    if missing:
        raise ValueError(f"devices {sorted(missing)} are not in the generated header")
    return ways.sub(lambda way: way.group() if way.group(1) in kept else b"", header)
