"""Binaries for the wheel, compiled when it is built: `python -m interarea.binaries FOLDER`.

An installed wheel needs no compiler for bundled content: it has every kind of block, the container, the
kernel and the library for batched plants for every platform, and the WebAssembly of the page for the controls
of each bundled grid and for those of the whole library.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from interarea.cosim.explorer.wasm import page_sources
from interarea.cosim.master.kernel.build import kernel_sources
from interarea.fmu_build.write.compile import (
    PLATFORMS,
    WEB_PAGE,
    Platform,
    compile_for,
    packed_for_travel,
    shipped_name,
)
from interarea.fmu_build.write.device_slopes import slope_sources
from interarea.fmu_build.write.lane_library import group_sources
from interarea.fmu_build.write.sources import gather_sources, record_source, source_files
from interarea.models.blocks import controller, supervisor
from interarea.models.blocks.channel import channel_block
from interarea.models.blocks.concentrator import concentrator_block
from interarea.models.blocks.container import container_sources
from interarea.models.blocks.detector import detector_block
from interarea.models.blocks.plant import plant_sources
from interarea.models.blocks.pmu import pmu_block
from interarea.models.case.case import case_names, load_case


def kinds() -> Iterator[tuple[str, dict[str, bytes]]]:
    """Yield name and sources of every library that an installed package loads or writes into an FMU."""
    blocks = {
        "plant": plant_sources(),
        "loop": container_sources(),
        "channel": channel_block().sources,
        "concentrator": concentrator_block(1).sources,
        "detector": detector_block(("signal",)).sources,
        "pmu": pmu_block().sources,
        "controller": (controller.SOURCE,),
        "supervisor": (supervisor.SOURCE,),
    }
    for kind, c_files in blocks.items():
        yield kind, source_files((*c_files, record_source()))
    yield "plant-group", gather_sources(group_sources())
    yield "plant-slopes", slope_sources(plant_sources())
    yield "kernel", kernel_sources()


def pages() -> Iterator[tuple[str, dict[str, bytes]]]:
    """Yield name and sources of the WebAssembly of each page of a bundled grid."""
    seen: list[dict[str, bytes]] = []
    for case in (None, *map(load_case, case_names())):
        sources = page_sources(case)
        if sources not in seen:
            seen.append(sources)
            yield "container", sources


def compile_into(folder: Path, platforms: Sequence[str]) -> list[Path]:
    """Compile the binaries for `platforms` and for pages into `folder`; return the files.

    Raises
    ------
    BuildError : an unknown platform, no zig, or the compiler's own message.
    """
    folder.mkdir(parents=True, exist_ok=True)
    todo = [(kind, sources, PLATFORMS[name]) for kind, sources in kinds() for name in platforms]
    todo += [(kind, sources, WEB_PAGE) for kind, sources in pages()]

    def one(job: tuple[str, dict[str, bytes], Platform]) -> Path:
        path = folder / shipped_name(*job)
        path.write_bytes(packed_for_travel(compile_for(*job).read_bytes()))
        return path

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(one, todo))


def main(words: Sequence[str] | None = None) -> int:
    """Compile into the folder of the command line."""
    parser = argparse.ArgumentParser(prog="python -m interarea.binaries", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--platforms", default=",".join(PLATFORMS), help="default: %(default)s")
    provided = parser.parse_args(words)
    unknown = set(provided.platforms.split(",")) - set(PLATFORMS)
    if unknown:
        parser.error(f"unknown platforms {sorted(unknown)}; allowed: {', '.join(PLATFORMS)}")
    if os.environ.pop("CC", ""):
        print("CC is set and not used: what travels is compiled by zig, for every platform", file=sys.stderr)
    files = compile_into(provided.folder, provided.platforms.split(","))
    print(f"{len(files)} binaries, {sum(p.stat().st_size for p in files) / 1e6:.1f} MB packed")
    return 0


if __name__ == "__main__":
    sys.exit(main())
