"""Compile one generic FMI 2.0 binary per block kind and platform, cached by content.

The compiler is ``$CC`` if that is set, else zig from the ``ziglang`` wheel, which
also compiles for the platforms it does not run on. A binary is named in the
cache by a hash of everything that decides its bytes: sources, headers, flags,
targets and compiler version. What was compiled of the same when the package's
wheel was built travels in it (`SHIPPED`) and needs no compiler.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.util
import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ..errors import BuildError, NoCompilerError
from .cache import COMPILERS_OWN, artefact, default_cache, host_machine
from .universal import universal

_C = Path(__file__).resolve().parents[1] / "c"
_CODE = ("-std=c99", "-O2", "-ffp-contract=off", "-fvisibility=hidden", "-fno-ident", "-g0")
_GET_ZIG = "pip install 'interarea[build]'"
_STRICT = ("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror")


@dataclass(frozen=True)
class Platform:
    """Where a binary runs: its folder under ``binaries/``, zig's targets, its suffix."""

    name: str
    folder: str
    targets: tuple[str, ...]  #: more than one: a universal library
    suffix: str
    compile_flags: tuple[str, ...] = ()
    link_flags: tuple[str, ...] = ()
    library: str = "-shared"  #: what makes the linker's output a library


#: Platforms by name; `folder` is FMI 2.0's where the standard has one.
PLATFORMS: dict[str, Platform] = {
    p.name: p
    for p in (
        Platform("linux64", "linux64", ("x86_64-linux-gnu.2.17",), ".so", ("-fPIC",), ("-lm", "-Wl,-s")),
        Platform("win64", "win64", ("x86_64-windows-gnu",), ".dll", (), ("-Wl,-s",)),
        # most tools on a Mac look into darwin64 only, whatever its processor
        Platform("darwin64", "darwin64", ("x86_64-macos.11.0", "aarch64-macos.11.0"), ".dylib", ("-fPIC",)),
        Platform("darwin-arm64", "aarch64-darwin", ("aarch64-macos.11.0",), ".dylib", ("-fPIC",)),
        Platform(
            "linux-arm64", "aarch64-linux", ("aarch64-linux-gnu.2.17",), ".so", ("-fPIC",), ("-lm", "-Wl,-s")
        ),
    )
}

#: What a web page runs; no FMU holds it. It has no system below it: the sources bring what they need of a C
#: library. 256 KiB of stack: zig's own 16 MiB would be memory of every page.
WEB_PAGE = Platform(
    "wasm32",
    "",
    ("wasm32-wasi",),
    ".wasm",
    ("-Oz", "-msimd128", "-flto", '-DLOOP_DRAWN="drawn_step.h"'),
    ("-s", "-Wl,-z,stack-size=262144", "-Wl,--no-entry"),
    "-nostdlib",
)

#: of the compiler's own folder: what it made of libc and the like, apart from what it made of our files
SYSTEM_LIBRARIES = "system"

#: Folder of the binaries that travel in the wheel, named by `shipped_name`; a checkout has none.
SHIPPED = Path(__file__).resolve().parents[1] / "binaries"


def host_platform() -> str:
    """Return the name of the platform this Python runs on; a Mac's is "darwin64", whatever its processor.

    Raises
    ------
    BuildError : a platform that no binary is made for.
    """
    names = {
        "linux-x86_64": "linux64",
        "linux-aarch64": "linux-arm64",
        "win32-x86_64": "win64",
        "darwin-x86_64": "darwin64",
        "darwin-aarch64": "darwin64",
    }
    name = names.get(host_machine())
    if name is None:
        raise BuildError(
            f"no FMU binary is made for {host_machine()}; allowed: {', '.join(PLATFORMS)}; "
            "set CC to a compiler of this machine and build from the FMU's sources/"
        )
    return name


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
    kept = _READ.get(c_files)
    if kept is None or any(_stamp(path) != stamp for path, stamp in kept[0]):
        files, read = _read_sources(c_files)
        kept = tuple((path, _stamp(path)) for path in read), files
        _READ[c_files] = kept
    return dict(kept[1])


def _stamp(path: Path) -> tuple[int, int]:
    try:
        found = path.stat()
    except OSError:
        return -1, -1
    return found.st_mtime_ns, found.st_size


def _read_sources(c_files: tuple[Path, ...]) -> tuple[dict[str, bytes], list[Path]]:
    """Contents by flat name, and the files they were read from."""
    files: dict[str, bytes] = {}
    origin: dict[str, Path] = {}
    parts: set[Path] = set()
    to_do = [p.resolve() for p in c_files]
    # a generated header lies in a folder of its own, and includes what lies beside the others
    folders = (_C, fmi_headers(), _block_folder(), *dict.fromkeys(p.parent for p in to_do))
    given = {p.name: p for p in to_do if p.suffix == ".h"}
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
                included = _included(path, words[1], folders, given)
                to_do.append(included)
                if included.suffix == ".c":  # part of this file, not one to compile by itself
                    parts.add(included)
                line = f'#include "{_flat_name(included, parts)}"'
            lines.append(line)
        files[name] = ("\n".join(lines) + "\n").encode("utf-8")
    return dict(sorted(files.items())), list(origin.values())


def _included(path: Path, name: str, folders: tuple[Path, ...], given: Mapping[str, Path]) -> Path:
    """The file that `path` includes: beside it, in one of the folders, or a generated header."""
    for folder in (path.parent, *folders):
        if (folder / name).is_file():
            return (folder / name).resolve()
    if name in given:
        return given[name].resolve()
    raise BuildError(f'{path}: #include "{name}" is neither beside it nor among the headers')


def _flat_name(path: Path, parts: set[Path]) -> str:
    """Name in the one folder; a C file that another includes becomes a header: no tool compiles it."""
    return f"{path.stem}_c.h" if path in parts else path.name


def record_source() -> Path:
    """Return the C file that reads ``resources/model.bin``; every binary has it."""
    return _block_folder() / "record.c"


def _block_folder() -> Path:
    """Folder of block.h and record.c."""
    spec = importlib.util.find_spec("interarea.models")
    assert spec is not None and spec.submodule_search_locations
    return Path(next(iter(spec.submodule_search_locations))).resolve() / "c" / "block"


def compile_binary(
    kind: str, block_sources: tuple[Path, ...], platform: str, *, cache: Path | None = None
) -> Path:
    """Return the cached binary of a block kind for a platform, compiling it if need be.

    Parameters
    ----------
    kind : name of the block kind; only for messages and the file name.
    block_sources : C files of the block; headers are found beside them.
    platform : a key of `PLATFORMS`.
    cache : folder of compiled binaries; default ``$INTERAREA_CACHE``, else the user's cache folder.

    Raises
    ------
    BuildError : unknown platform, no compiler, or the compiler's own message.
    """
    return compile_library(kind, source_files((*block_sources, record_source())), platform, cache=cache)


def compile_library(
    kind: str, sources: dict[str, bytes], platform: str, *, cache: Path | None = None
) -> Path:
    """Return the cached shared library of `sources` (`gather_sources`), compiled with an FMU's flags.

    Raises
    ------
    BuildError : unknown platform, no compiler, or the compiler's own message.
    """
    if platform not in PLATFORMS:
        raise BuildError(f"unknown platform {platform!r}; allowed: {', '.join(PLATFORMS)}")
    return compile_for(kind, sources, PLATFORMS[platform], cache=cache)


def compile_for(kind: str, sources: dict[str, bytes], to: Platform, *, cache: Path | None = None) -> Path:
    """Return the shipped or cached binary of `sources` for a platform or `WEB_PAGE`; see `compile_library`.

    Raises
    ------
    BuildError : as `compile_library`, or a compiler that cannot make WebAssembly.
    """
    chosen = os.environ.get("CC", "").strip()
    if not chosen and SHIPPED.is_dir():
        travelled = SHIPPED / shipped_name(kind, sources, to)
        if travelled.is_file():
            return travelled
    return _compiled(kind, sources, to, cache or default_cache(), chosen)


def shipped_name(kind: str, sources: dict[str, bytes], to: Platform) -> str:
    """Return the name under which the binary of `sources`, compiled by zig, travels in the wheel."""
    return f"{kind}-{to.name}-{_digest(kind, sources, _flags(kind, to, zig=True), to, '')}{to.suffix}"


def _compiled(kind: str, sources: dict[str, bytes], to: Platform, cache: Path, chosen: str) -> Path:
    command, version = _compiler_of(chosen)
    zig = "ziglang" in command
    if not zig and to.name != host_platform():
        raise BuildError(
            f"$CC ({shlex.join(command)}) compiles for {host_platform()}, not for {to.name}; "
            f"unset CC and `{_GET_ZIG}` to build for other platforms"
        )
    flags = _flags(kind, to, zig=zig)

    def make(result: Path) -> None:
        for name, content in sources.items():
            (result.parent / name).write_bytes(content)
        c_files = [name for name in sources if name.endswith(".c")]
        slices = []
        for target in to.targets if zig else ("",):
            aimed = ["-target", target] if target else []
            output = result.parent / f"{kind}{to.suffix}"
            words = [*command, *flags, *aimed, *c_files, "-I.", "-o", output.name]
            _run_compiler(words, result.parent, cache, kind, to.name)
            slices.append(output.read_bytes())
        result.write_bytes(slices[0] if len(slices) == 1 else universal(slices))

    name = f"{kind}-{to.name}-{_digest(kind, sources, flags, to, version)}"
    return artefact(cache, "binaries", name, to.suffix, make)


def _flags(kind: str, to: Platform, *, zig: bool) -> list[str]:
    named = [f"-Wl,-install_name,@rpath/{kind}.dylib"] if zig and to.name.startswith("darwin") else []
    return [*_CODE, *_STRICT, *to.compile_flags, to.library, *to.link_flags, *named]


def _digest(kind: str, sources: dict[str, bytes], flags: list[str], to: Platform, version: str) -> str:
    """Hash of what decides the bytes of a binary."""
    made_of = (kind, tuple(sources.items()), flags, to.targets, to.name, version)
    return hashlib.sha256(repr(made_of).encode()).hexdigest()[:24]


def _run_compiler(command: list[str], folder: Path, cache: Path, kind: str, platform: str) -> None:
    kept = (cache / COMPILERS_OWN).absolute()
    try:
        _compile(command, folder, kept, kind, platform)
    except BuildError:
        if "ziglang" not in command or not kept.is_dir():
            raise
        # nothing proves what the compiler keeps for itself; if that was damaged it compiles without it
        _compile(command, folder, folder / COMPILERS_OWN, kind, platform)
        shutil.rmtree(kept, ignore_errors=True)


def _compile(command: list[str], folder: Path, zig_cache: Path, kind: str, platform: str) -> None:
    environment = {
        **os.environ,
        "ZIG_GLOBAL_CACHE_DIR": str(zig_cache / SYSTEM_LIBRARIES),  # a minute to make for each target
        "ZIG_LOCAL_CACHE_DIR": str(zig_cache / "objects"),
        "LC_ALL": "C",
    }
    try:
        done = subprocess.run(
            command,
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
            errors="replace",
            check=False,
        )
    except OSError as error:
        raise BuildError(f"cannot run the C compiler {command[0]!r}: {error}") from error
    if done.returncode != 0:
        said = done.stderr.strip()[-4000:]
        raise BuildError(f"compiling {kind} for {platform} failed with code {done.returncode}:\n{said}")


@functools.lru_cache(maxsize=8)
def _compiler_of(chosen: str) -> tuple[list[str], str]:
    """Command of the C compiler, $CC's or zig's, and its version."""
    if chosen:
        command = shlex.split(chosen)
        if shutil.which(command[0]) is None:
            raise BuildError(
                f"the C compiler {command[0]!r} that $CC names is not there; unset CC to use zig"
            )
        done = subprocess.run([*command, "--version"], capture_output=True, text=True, check=False)
        return command, f"{chosen}\n{done.stdout}"
    if importlib.util.find_spec("ziglang") is None:
        raise NoCompilerError(
            "no binary of this came with the package, and there is no C compiler to make one; "
            f"run `{_GET_ZIG}` or set CC, e.g. CC=gcc"
        )
    from importlib.metadata import version

    return [sys.executable, "-m", "ziglang", "cc"], f"ziglang {version('ziglang')}"
