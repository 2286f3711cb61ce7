"""Compile the C drivers of this folder together with a block's own sources, as its FMU would be."""

from __future__ import annotations

import functools
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from interarea.fmu_build.write.compile import gather_sources, record_source, source_files
from interarea.fmu_build.write.description_xml import render
from interarea.models.blocks.variables import Block

HERE = Path(__file__).resolve().parent
_PROGRAM = "#include <stdlib.h>\nint main(void) { int *p = malloc(4); *p = 1; free(p); return 0; }\n"
_BOTH = (
    "-fsanitize=address,undefined,float-cast-overflow",
    "-fno-sanitize-recover=all",
    "-fno-omit-frame-pointer",
)
_TRAP = ("-fsanitize=undefined", "-fsanitize-trap=undefined")
ZIG = (sys.executable, "-m", "ziglang", "cc")


@dataclass(frozen=True)
class Compiler:
    """A compiler and the flags of the sanitizers whose runtimes it has."""

    command: tuple[str, ...]
    flags: tuple[str, ...]
    sanitizers: str


def _works(command: tuple[str, ...], flags: tuple[str, ...]) -> bool:
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "t.c").write_text(_PROGRAM)
        made = subprocess.run(
            [*command, *flags, "t.c", "-o", "t"], cwd=folder, capture_output=True, check=False
        )
        if made.returncode != 0:
            return False
        return subprocess.run([f"{folder}/t"], capture_output=True, check=False).returncode == 0


@functools.cache
def sanitizing_compiler() -> Compiler | None:
    """Return a compiler with both sanitizers, else one that traps on undefined behaviour, else None."""
    chosen = os.environ.get("CC", "").strip()
    candidates = [tuple(shlex.split(chosen))] if chosen else []
    candidates += [(name,) for name in ("gcc", "clang", "cc") if shutil.which(name)]
    for command in candidates:
        if _works(command, _BOTH):
            return Compiler(command, _BOTH, "address and undefined behaviour")
    for command in [*candidates, ZIG]:
        if _works(command, _TRAP):
            return Compiler(command, _TRAP, "undefined behaviour (traps)")
    return None


@functools.cache
def plain_compiler() -> Compiler:
    """Return a compiler without sanitizers; zig is always there."""
    for name in ("gcc", "clang"):
        if shutil.which(name) and _works((name,), ()):
            return Compiler((name,), (), "none")
    return Compiler(ZIG, (), "none")


@dataclass(frozen=True)
class Driver:
    """A compiled driver with the arguments that describe its block."""

    program: Path
    arguments: tuple[str, ...]

    def run(self, *more: object, before: tuple[str, ...] = (), timeout_s: float = 600.0) -> str:
        """Run it; return what it printed.

        Raises
        ------
        AssertionError : it ended with another code than 0; the text is what it said.
        """
        environment = {**os.environ, "ASAN_OPTIONS": "detect_leaks=1:allocator_may_return_null=1"}
        done = subprocess.run(
            [*before, str(self.program), *self.arguments, *map(str, more)],
            capture_output=True,
            text=True,
            errors="replace",
            timeout=timeout_s,
            env=environment,
            check=False,
        )
        assert done.returncode == 0, f"code {done.returncode}:\n{done.stdout}{done.stderr[-6000:]}"
        return done.stdout + (done.stderr if before else "")


def build_driver(
    block: Block,
    sources: tuple[str, ...],
    compiler: Compiler,
    folder: Path,
    *,
    of_binary: tuple[Path, ...] = (),
) -> Driver:
    """Compile `sources` of this folder with the block; prepare a sound and a damaged resources folder.

    of_binary : C files of the block's binary, when it is another one than that of its FMU.
    """
    files = source_files((*block.sources, record_source()))
    description, record = render(block, files)
    if of_binary:
        files = gather_sources(of_binary)
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        (folder / name).write_bytes(content)
    for name in (*sources, "fuzz.h"):
        shutil.copy(HERE / name, folder / name)
    c_files = sorted({n for n in files if n.endswith(".c")} | set(sources))
    flags = ["-std=gnu99", "-g", "-O1", "-ffp-contract=off", *compiler.flags, "-I."]
    done = subprocess.run(
        [*compiler.command, *flags, *c_files, "-o", "driver", "-lm"],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-4000:]
    for name in ("good", "bad"):
        (folder / name).mkdir(exist_ok=True)
        (folder / name / "model.bin").write_bytes(record)
    layout = [int(n) for n in np.asarray(block.table.layout())]
    n_x, n_u, n_y, n_w = layout[:4]
    guid = description.split('guid="')[1].split('"')[0]
    arguments = (
        guid,
        (folder / "good").resolve().as_uri(),
        (folder / "bad").resolve().as_uri(),
        str(folder / "good" / "model.bin"),
        str(folder / "bad" / "model.bin"),
        *map(str, (len(block.table.reals), len(block.table.integers), n_x, n_u, n_y, n_w)),
    )
    return Driver(folder / "driver", arguments)
