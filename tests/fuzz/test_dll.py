"""Random calls of our IEEE/CIGRE DLLs under sanitizers: INTERAREA_DLL_CALLS of each kind."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from fmu_blocks import blocks
from fuzz_build import FOLDER, sanitizing_compiler

from interarea.fmu_build.write.real_code import Chain, completed, dll_sources, entries_of
from interarea.models.blocks.binary_table import pack_record
from interarea.models.blocks.container import chain_sources
from interarea.models.blocks.variables import Block

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(3600),
    pytest.mark.skipif(sys.platform != "linux", reason="the driver loads the library with dlopen"),
]
CALLS = int(os.environ.get("INTERAREA_DLL_CALLS", "20000"))


def block_of(kind: str) -> Block | Chain:
    """Return a block of a kind, or the chain of a PMU, a channel and a controller."""
    if kind != "chain":
        return blocks()[kind]
    members = {name: blocks()[name] for name in ("pmu", "channel", "controller")}
    (first, *_) = members["controller"].table.of_role("input")
    return Chain("wide", members, [("pmu.deviation", "channel.u"), ("channel.y", f"controller.{first.name}")])


@pytest.mark.parametrize("kind", ["controller", "supervisor", "channel", "pmu", "chain"])
def test_random_calls_find_nothing(kind: str, tmp_path: Path) -> None:
    compiler = sanitizing_compiler()
    if compiler is None:
        pytest.skip("no compiler here has the runtime of a sanitizer")
    block = block_of(kind)
    record = pack_record(entries_of(block, 0.001))
    sources = dll_sources(chain_sources() if isinstance(block, Chain) else block.sources, len(record))
    for name, content in sources.items():
        (tmp_path / name).write_bytes(content)
    shutil.copy(FOLDER / "fuzz_dll.c", tmp_path)
    own = [name for name in sources if name.endswith(".c")]
    command = [*compiler.command, "-std=gnu99", "-g", "-O1", "-ffp-contract=off", "-w", *compiler.flags]
    for words in (
        ["-shared", "-fPIC", *own, "-o", "x.so", "-lm"],
        ["fuzz_dll.c", "-o", "fuzz", "-ldl", "-lm"],
    ):
        subprocess.run([*command, *words], cwd=tmp_path, check=True)
    library = tmp_path / "x.so"
    library.write_bytes(completed(library.read_bytes(), record))
    done = subprocess.run(
        ["./fuzz", "./x.so", str(CALLS), "1"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-3000:]
    assert int(done.stdout) > CALLS / 4  # most calls are those of a tool in order
