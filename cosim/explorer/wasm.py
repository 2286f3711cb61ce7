"""The container's C as WebAssembly: the bytes that every page carries."""

from __future__ import annotations

from pathlib import Path

from interarea.fmu_build.errors import NoCompilerError
from interarea.fmu_build.write.compile import WEB_PAGE, compile_for
from interarea.fmu_build.write.sources import fmi_sources, gather_sources, record_source
from interarea.models.blocks.container import container_sources
from interarea.models.blocks.plant import has_sparse_network, plant_sources
from interarea.models.case.case import Case
from interarea.models.devices.header import HEADER, with_devices
from interarea.models.grid.equilibrium import operating_point

#: The page's own calls; they take the place of the FMI layer's reading of a file.
PAGE_SOURCE = Path(__file__).resolve().parent / "web" / "page.c"
#: What these and the container need of a C library: no other is linked.
LIBRARY = PAGE_SOURCE.parent / "libc"
#: Steps of runs while a slider moves, which no FMU has.
DRAWN_STEP = PAGE_SOURCE.parent / "drawn_step.h"
#: Where the plant's C asks which kind of network a record has.
LAYOUT = "layout.h"
_READS_FILES = "resource.c"


def page_sources(case: Case | None = None) -> dict[str, bytes]:
    """Return the sources of the WebAssembly: those of a loop's FMU, and `PAGE_SOURCE`.

    case : with the controls and the kind of network of this grid alone, two thirds less; default: all of the
    library.
    """
    layer = tuple(path for path in fmi_sources() if path.name != _READS_FILES)
    plant = plant_sources(case)
    sources = gather_sources((PAGE_SOURCE, *layer, *container_sources(plant), record_source()))
    own = (DRAWN_STEP, *(path for path in sorted(LIBRARY.iterdir()) if path.suffix in (".c", ".h")))
    sources |= {path.name: path.read_bytes() for path in own}
    if case is not None:
        point = operating_point(case)
        keys = {device.key for device in point.controls.devices}
        sources[HEADER] = with_devices(sources[HEADER].decode("ascii"), keys).encode("ascii")
        left_out = b"" if has_sparse_network(point.case, point) else b"#define PLANT_DENSE\n"
        left_out += b"" if point.case.at_buses else b"#define PLANT_NO_BUS_DEVICES\n"
        sources[LAYOUT] = left_out + sources[LAYOUT]
    return sources


def container_wasm(cache: Path | None = None, *, case: Case | None = None) -> bytes:
    """Return the WebAssembly module of a closed loop.

    What it simulates is a record (`models`). With the whole library it serves every grid; with what `case`
    needs every grid that needs no more. It imports nothing. Modules for bundled grids travel in
    the package's wheel; without a compiler any other grid gets the one of the whole library, unless it has
    devices of its own.
    cache : folder of compiled binaries; default `fmu_build.write.cache.default_cache()`.

    Raises
    ------
    BuildError : no compiler that can make WebAssembly, or the compiler's own message.
    """
    try:
        return compile_for("container", page_sources(case), WEB_PAGE, cache=cache).read_bytes()
    except NoCompilerError:
        if case is None or case.devices:  # which no other module holds
            raise
        return container_wasm(cache)
