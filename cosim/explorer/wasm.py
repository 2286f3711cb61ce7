"""The container's C as WebAssembly: the bytes that every page carries."""

from __future__ import annotations

from pathlib import Path

from interarea.fmu_build.write.compile import compile_web_page, fmi_sources, gather_sources, record_source
from interarea.models.blocks.container import container_sources

#: The page's own calls; they take the place of the FMI layer's reading of a file.
PAGE_SOURCE = Path(__file__).resolve().parent / "web" / "page.c"
_READS_FILES = "resource.c"


def container_wasm(cache: Path | None = None) -> bytes:
    """Return the WebAssembly module of a closed loop: the sources of its FMU, unchanged, and `PAGE_SOURCE`.

    One module serves every case and scenario; what it simulates is a record (`models`). It imports
    nothing. cache : folder of compiled binaries; default `fmu_build.write.cache.default_cache()`.

    Raises
    ------
    BuildError : no compiler that can make WebAssembly, or the compiler's own message.
    """
    layer = tuple(path for path in fmi_sources() if path.name != _READS_FILES)
    sources = gather_sources((PAGE_SOURCE, *layer, *container_sources(), record_source()))
    return compile_web_page("container", sources, cache=cache).read_bytes()
