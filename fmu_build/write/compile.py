"""Compile one generic FMI 2.0 binary per block kind and platform, cached by content.

The compiler is ``$CC`` if that is set, else zig from the ``ziglang`` wheel, which
also compiles for the platforms it does not run on. A binary is named in the
cache by a hash of everything that decides its bytes: sources, headers, flags,
targets and compiler version. What was compiled of the same when the package's
wheel was built travels in it, packed (`SHIPPED`), and needs no compiler.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.util
import os
import shlex
import shutil
import struct
import sys
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from interarea.models.files import one_at_a_time, temporary_folder
from interarea.models.processes import begun, run_guarded, side_by_side

from ..errors import BuildError, NoCompilerError
from .cache import COMPILERS_OWN, artefact, default_cache, host_machine
from .sources import record_source, source_files, with_includes

_CODE = ("-std=c99", "-O2", "-ffp-contract=off", "-fvisibility=hidden", "-fno-ident", "-g0")
#: Complex products without a call into the compiler's runtime: the same bits wherever they are finite.
_ZIG_CODE = ("-fcx-limited-range",)
_ZIG = [sys.executable, "-m", "ziglang"]
_GET_ZIG = "pip install 'interarea[build]'"
#: Functions copied in, in the plant's large files; bits are the same. Of a start all are called. Elsewhere
#: only those declared inline are copied in: 6 s of compiling less, runs of 2000 buses as fast. Calls alone
#: would save 2 s more in held.c and make those runs half as long again.
_HINTED = "-finline-hint-functions"
_INLINED = {"rest.c": "-fno-inline-functions"} | dict.fromkeys(("flow.c", "held.c", "tangent.c"), _HINTED)
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

#: Folder of the binaries that travel in the wheel, packed, named by `shipped_name`; a checkout has none.
SHIPPED = Path(__file__).resolve().parents[1] / "binaries"
_PACKED = ".z"


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
    return compile_for(kind, sources, platform_of(platform), cache=cache)


def platform_of(name: str, known: Mapping[str, Platform] = PLATFORMS) -> Platform:
    """Return a platform by name.

    Raises
    ------
    BuildError : a name that is not `known`.
    """
    if name not in known:
        raise BuildError(f"unknown platform {name!r}; allowed: {', '.join(known)}")
    return known[name]


def compile_for(kind: str, sources: dict[str, bytes], to: Platform, *, cache: Path | None = None) -> Path:
    """Return the cached binary of `sources` for a platform or `WEB_PAGE`, unpacked where it was shipped.

    Raises
    ------
    BuildError : as `compile_library`, a compiler that cannot make WebAssembly, or a damaged shipped binary.
    """
    chosen = os.environ.get("CC", "").strip()
    cache = cache or default_cache()
    packed = _shipped(kind, sources, to, chosen)
    if packed is None:
        return _compiled(kind, sources, to, cache, chosen)
    name = packed.name.removesuffix(_PACKED)
    return artefact(cache, _BINARIES, name, to.suffix, lambda result: result.write_bytes(_unpacked(packed)))


def _shipped(kind: str, sources: dict[str, bytes], to: Platform, chosen: str) -> Path | None:
    """Return the packed binary that came with the package; None where none did, or $CC is `chosen`."""
    if chosen or not SHIPPED.is_dir():
        return None
    packed = SHIPPED / shipped_name(kind, sources, to)
    return packed if packed.is_file() else None


def shipped_name(kind: str, sources: dict[str, bytes], to: Platform) -> str:
    """Return the name under which the binary of `sources`, compiled by zig, travels in the wheel."""
    digest = _digest(kind, tuple(sources.items()), _flags(kind, to, zig=True), to, "")
    return f"{kind}-{to.name}-{digest}{_PACKED}"


def packed_for_travel(binary: bytes) -> bytes:
    """Return what lies in the wheel of a binary: a zlib stream, half as large on disk as the libraries."""
    return zlib.compress(binary, 9)


def _unpacked(shipped: Path) -> bytes:
    try:
        return zlib.decompress(shipped.read_bytes())
    except zlib.error as error:
        raise BuildError(
            f"{shipped} came with the package and is damaged ({error}); install interarea again"
        ) from error


@contextlib.contextmanager
def objects_begun(kind: str, sources: dict[str, bytes], platform: str, cache: Path) -> Iterator[None]:
    """Compile C files of a library that is not there yet while the body runs: `compile_library` finds them.

    After the body no other file is begun. Errors are left to `compile_library`.
    """
    to, chosen = PLATFORMS[platform], os.environ.get("CC", "").strip()
    build = None
    if _shipped(kind, sources, to, chosen) is None:
        with contextlib.suppress(BuildError):
            build = _Build(kind, sources, to, cache, *_compiler_of(chosen))
    if build is None or not build.possible or (cache / _BINARIES / f"{build.key}{to.suffix}").exists():
        yield
        return
    with begun(partial(build.object_of, to.targets[0]), build.c_files):
        yield


_BINARIES = "binaries"  # folder of the cache


@dataclass(frozen=True)
class _Build:
    """What decides the bytes of a binary, and where its parts are kept."""

    kind: str
    sources: dict[str, bytes]
    to: Platform
    cache: Path
    command: list[str]
    version: str

    @property
    def zig(self) -> bool:
        return "ziglang" in self.command

    @property
    def possible(self) -> bool:
        """Whether the compiler compiles for the platform."""
        return self.zig or self.to.name == host_platform()

    @property
    def key(self) -> str:
        flags = _flags(self.kind, self.to, zig=self.zig)
        digest = _digest(self.kind, tuple(self.sources.items()), flags, self.to, self.version)
        return f"{self.kind}-{self.to.name}-{digest}"

    @property
    def c_files(self) -> list[str]:
        """Return the names, those with most text first: the last that is compiled is a short one."""

        def text(name: str) -> int:
            return sum(len(self.sources[part]) for part in with_includes(name, self.sources))

        return sorted(
            (name for name in self.sources if name.endswith(".c")), key=lambda name: (-text(name), name)
        )

    def aimed(self, target: str) -> list[str]:
        """Return the command of every file and of the linker."""
        at = ["-target", target] if self.zig else []
        return [*self.command, *at, *_code_flags(self.to, zig=self.zig)]

    def object_of(self, target: str, name: str) -> tuple[str, bytes]:
        """Return a C file's object and its name."""
        return _object(self.kind, self.sources, self.aimed(target), self.to, self.version, self.cache, name)

    def slice_of(self, target: str, folder: Path) -> bytes:
        """Return the library for one of zig's targets, linked in `folder`."""
        for name, content in side_by_side(partial(self.object_of, target), self.c_files):
            (folder / name).write_bytes(content)  # by one name everywhere: a linker may keep it
        objects = [f"{name.removesuffix('.c')}.o" for name in self.sources if name.endswith(".c")]
        output = folder / f"{self.kind}{self.to.suffix}"
        links = _link_flags(self.kind, self.to, zig=self.zig)
        words = [*self.aimed(target), *links, *objects, "-o", output.name]
        _run_compiler(words, folder, self.cache, self.kind, self.to.name)
        return output.read_bytes()


def _compiled(kind: str, sources: dict[str, bytes], to: Platform, cache: Path, chosen: str) -> Path:
    build = _Build(kind, sources, to, cache, *_compiler_of(chosen))
    if not build.possible:
        raise BuildError(
            f"$CC ({shlex.join(build.command)}) compiles for {host_platform()}, not for {to.name}; "
            f"unset CC and `{_GET_ZIG}` to build for other platforms"
        )

    def make(result: Path) -> None:
        slices = [
            build.slice_of(target, result.parent) for target in (to.targets if build.zig else to.targets[:1])
        ]
        result.write_bytes(slices[0] if len(slices) == 1 else universal(slices))

    return artefact(cache, _BINARIES, build.key, to.suffix, make)


def _object(
    kind: str, sources: dict[str, bytes], aimed: list[str], to: Platform, version: str, cache: Path, name: str
) -> tuple[str, bytes]:
    """Return a C file's object and its name; binaries of all kinds share those of the same text."""
    parts = with_includes(name, sources)
    command = [*aimed, *_STRICT, *_inlined(name, to, zig="ziglang" in aimed)]

    def make(result: Path) -> None:
        for part in parts:
            (result.parent / part).write_bytes(sources[part])
        _run_compiler([*command, "-c", name, "-I.", "-o", result.name], result.parent, cache, kind, to.name)

    key_parts = (name, [sources[part] for part in parts], command, version)
    digest = hashlib.sha256(repr(key_parts).encode()).hexdigest()[:24]
    stem = name.removesuffix(".c")
    key = f"{stem}-{to.name}-{digest}"
    with one_at_a_time(cache / f"{key}.lock"):  # a plant takes a compiler 25 s: another process may be at it
        object_file = artefact(cache, "objects", key, ".o", make)
    return f"{stem}.o", object_file.read_bytes()


def _flags(kind: str, to: Platform, *, zig: bool) -> tuple[str, ...]:
    inlined = [word for name in _INLINED for word in (name, *_inlined(name, to, zig=zig))]
    return (*_code_flags(to, zig=zig), *_STRICT, *inlined, *_link_flags(kind, to, zig=zig))


def _inlined(name: str, to: Platform, *, zig: bool) -> tuple[str, ...]:
    # zig's compiler is clang, whose words these are; -Oz calls as it is
    return (_INLINED[name],) if zig and to is not WEB_PAGE and name in _INLINED else ()


def _code_flags(to: Platform, *, zig: bool) -> list[str]:
    return [*_CODE, *(_ZIG_CODE if zig else ()), *to.compile_flags]


def _link_flags(kind: str, to: Platform, *, zig: bool) -> list[str]:
    more = []
    if zig and to.name.startswith("darwin"):
        more = [f"-Wl,-install_name,@rpath/{kind}.dylib"]
    elif zig and to.name.startswith("linux"):
        # zig would make its own runtime first, 6 s in a new cache, of which no line is ours to need:
        # a name that nobody defines ends the linking
        more = ["-rtlib=none", "-Wl,-z,defs"]
    return [to.library, *to.link_flags, *more]


@functools.lru_cache(maxsize=64)
def _digest(
    kind: str, sources: tuple[tuple[str, bytes], ...], flags: tuple[str, ...], to: Platform, version: str
) -> str:
    """Hash of what decides the bytes of a binary; known for a kind that was exported before."""
    key_parts = (kind, sources, list(flags), to.targets, to.name, version)
    return hashlib.sha256(repr(key_parts).encode()).hexdigest()[:24]


def _run_compiler(command: list[str], folder: Path, cache: Path, kind: str, platform: str) -> None:
    cached = (cache / COMPILERS_OWN).absolute()
    before = cached.is_dir()
    if not str(cached).isprintable():  # zig cannot read back the name of a folder with a newline
        with temporary_folder() as own:
            _compile(command, folder, own, kind, platform)
        return
    try:
        _compile(command, folder, cached, kind, platform)
    except BuildError:
        if "ziglang" not in command or not before:
            raise
        # nothing proves what the compiler keeps for itself; if that was damaged it compiles without it
        _compile(command, folder, folder / COMPILERS_OWN, kind, platform)
        shutil.rmtree(cached, ignore_errors=True)


def _compile(command: list[str], folder: Path, zig_cache: Path, kind: str, platform: str) -> None:
    environment = {
        **os.environ,
        "ZIG_GLOBAL_CACHE_DIR": str(zig_cache / SYSTEM_LIBRARIES),  # a minute to make for each target
        "ZIG_LOCAL_CACHE_DIR": str(zig_cache / "objects"),
        "LC_ALL": "C",
    }
    try:
        done = run_guarded(_direct(command), cwd=folder, env=environment)
    except OSError as error:
        raise BuildError(f"cannot run the C compiler {command[0]!r}: {error}") from error
    if done.returncode != 0:
        message = done.stderr.strip()[-4000:]
        raise BuildError(f"compiling {kind} for {platform} failed with code {done.returncode}:\n{message}")


@functools.lru_cache(maxsize=8)
def _compiler_of(chosen: str) -> tuple[list[str], str]:
    """Command of the C compiler, $CC's or zig's, and its version."""
    if chosen:
        command = shlex.split(chosen)
        if shutil.which(command[0]) is None:
            raise BuildError(
                f"the C compiler {command[0]!r} that $CC names is not there; unset CC to use zig"
            )
        done = run_guarded([*command, "--version"])
        return command, f"{chosen}\n{done.stdout}"
    if importlib.util.find_spec("ziglang") is None:
        raise NoCompilerError(
            "no binary of this came with the package, and there is no C compiler to make one; "
            f"run `{_GET_ZIG}` or set CC, e.g. CC=gcc"
        )
    from importlib.metadata import version

    return [*_ZIG, "cc"], f"ziglang {version('ziglang')}"


def _direct(command: list[str]) -> list[str]:
    """Return a command of zig without the Python that only starts it."""
    spec = importlib.util.find_spec("ziglang") if command[: len(_ZIG)] == _ZIG else None
    if spec is None or spec.origin is None:
        return command
    return [str(Path(spec.origin).with_name("zig")), *command[len(_ZIG) :]]


_FAT, _THIN = 0xCAFEBABE, 0xFEEDFACF  #: first words of <mach-o/fat.h> and of a 64-bit Mach-O file
_PAGE = 14  #: log2 of the largest page of memory, 16 KiB on arm64: a slice begins on one


def universal(slices: Sequence[bytes]) -> bytes:
    """Return one library that holds `slices`, thin 64-bit Mach-O libraries, in that order.

    Raises
    ------
    BuildError : a slice that is no such library, or two for one processor.
    """
    machines = []
    for content in slices:
        if len(content) < 12 or struct.unpack_from("<I", content)[0] != _THIN:
            raise BuildError("a slice of a universal library is no 64-bit Mach-O file; compile it again")
        machines.append(struct.unpack_from("<II", content, 4))
    if len({machine for machine, _ in machines}) != len(machines):
        raise BuildError("a universal library holds one slice for each processor; two are for the same")
    header = struct.pack(">II", _FAT, len(slices))
    content, body = b"", b""
    start = _aligned(len(header) + 20 * len(slices))
    for (machine, kind), slice_ in zip(machines, slices, strict=True):
        header += struct.pack(">IIIII", machine, kind, start + len(body), len(slice_), _PAGE)
        body += slice_
        body += bytes(_aligned(len(body)) - len(body))
    return header + bytes(start - len(header)) + body


def _aligned(size: int) -> int:
    return -(-size >> _PAGE) << _PAGE
