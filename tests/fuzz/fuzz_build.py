"""Compile the C drivers of this folder together with a block's own sources, as its FMU would be."""

from __future__ import annotations

import functools
import hashlib
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from interarea.fmu_build.write.description_xml import render
from interarea.fmu_build.write.sources import gather_sources, record_source, source_files
from interarea.models.blocks.variables import Block

FOLDER = Path(__file__).resolve().parent
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
        process = subprocess.run(
            [*command, *flags, "t.c", "-o", "t"], cwd=folder, capture_output=True, check=False
        )
        if process.returncode != 0:
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


def _object(name: str, folder: Path, compiler: Compiler, level: str) -> Path:
    """Return the object of a C file, one for all drivers in which its preprocessed text is the same.

    The line in which gcc, with `-g`, names the folder it compiles in does not count.
    """
    command = [*compiler.command, "-std=gnu99", "-g", level, "-ffp-contract=off", *compiler.flags, "-I."]
    text = _compiled([*command, "-E", name], folder)
    assert text.returncode == 0, text.stderr[-4000:]
    store = Path(os.environ["INTERAREA_CACHE"], "fuzz-objects") if "INTERAREA_CACHE" in os.environ else folder
    anywhere = re.sub(r'(?m)^# \d+ ".*//"$', "", text.stdout)
    target = store / f"{hashlib.sha256(repr(command).encode() + anywhere.encode()).hexdigest()}.o"
    if not target.exists():
        store.mkdir(parents=True, exist_ok=True)
        done = _compiled([*command, "-c", name, "-o", f"{name}.o"], folder)
        assert done.returncode == 0, done.stderr[-4000:]
        # whole or not at all: another worker may look at the same time
        unfinished = target.with_suffix(f".{os.getpid()}")
        shutil.copy(folder / f"{name}.o", unfinished)
        unfinished.replace(target)
    return target


def _compiled(command: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


def build_driver(
    block: Block,
    sources: tuple[str, ...],
    compiler: Compiler,
    folder: Path,
    *,
    of_binary: tuple[Path, ...] = (),
    optimised: bool = False,
) -> Driver:
    """Compile `sources` of this folder with the block; prepare a sound and a damaged resources folder.

    of_binary : C files of the block's binary, when it is another one than that of its FMU.
    optimised : steps take half the time; sanitizers take a minute and a half to compile a plant then, not ten
        seconds.
    """
    files = source_files((*block.sources, record_source()))
    description, record = render(block, files)
    if of_binary:
        files = gather_sources(of_binary)
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        (folder / name).write_bytes(content)
    for name in (*sources, "fuzz.h"):
        shutil.copy(FOLDER / name, folder / name)
    c_files = sorted({n for n in files if n.endswith(".c")} | set(sources))
    level = "-O1" if optimised else "-O0"
    objects = [str(_object(name, folder, compiler, level)) for name in c_files]
    done = _compiled([*compiler.command, *compiler.flags, *objects, "-o", "driver", "-lm"], folder)
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
