"""Compiling generic binaries: exports, needed libraries, cache, and errors that say what to do."""

from __future__ import annotations

import importlib.util
import re
import struct
import sys
import time
from pathlib import Path

import pytest
from fmu_blocks import blocks
from fmu_runner import DECAY_C
from plant_shim import FLAGS, compiler

from interarea.cosim.explorer.wasm import page_sources
from interarea.fmu_build.errors import BuildError, NoCompilerError
from interarea.fmu_build.write import compile as compiling
from interarea.fmu_build.write.cache import COMPILERS_OWN
from interarea.fmu_build.write.compile import compile_binary
from interarea.fmu_build.write.sources import fmi_headers, record_source, source_files, with_includes
from interarea.models.case.case import load_case
from interarea.models.processes import run_guarded


class Elf:
    """Just enough of ELF 64 to list dynamic symbols and needed libraries."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        table, size, count = struct.unpack_from("<Q", data, 40)[0], *struct.unpack_from("<HH", data, 58)
        self.sections = [struct.unpack_from("<IIQQQQIIQQ", data, table + size * k) for k in range(count)]

    def _of_type(self, kind: int) -> tuple[bytes, bytes]:
        s = next(s for s in self.sections if s[1] == kind)
        strings = self.sections[s[6]]
        return self.data[s[4] : s[4] + s[5]], self.data[strings[4] : strings[4] + strings[5]]

    @staticmethod
    def _text(strings: bytes, at: int) -> str:
        return strings[at : strings.index(b"\0", at)].decode()

    def exported(self) -> set[str]:
        symbols, strings = self._of_type(11)
        entries = [struct.unpack_from("<IBBHQQ", symbols, k) for k in range(0, len(symbols), 24)]
        return {self._text(strings, e[0]) for e in entries if e[3] != 0}

    def needed(self) -> set[str]:
        dynamic, strings = self._of_type(6)
        entries = [struct.unpack_from("<qQ", dynamic, k) for k in range(0, len(dynamic), 16)]
        return {self._text(strings, value) for tag, value in entries if tag == 1}


@pytest.fixture(scope="module")
def binaries(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("binaries")


@pytest.mark.slow
def test_binary_exports_the_standard_and_nothing_else(binaries: Path) -> None:
    elf = Elf(compile_binary("decay", (DECAY_C,), "linux64", cache=binaries).read_bytes())
    header = (fmi_headers() / "fmi2Functions.h").read_text()
    declared = set(re.findall(r"FMI2_Export\s+fmi2\w+TYPE\s+(fmi2\w+);", header))
    assert elf.exported() == declared
    assert elf.needed() <= {"libc.so.6", "libm.so.6"}


def test_second_time_needs_no_compiler(binaries: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = compile_binary("decay", (DECAY_C,), "linux64", cache=binaries)

    def forbidden(*_: object, **__: object) -> None:
        raise AssertionError("the compiler ran")

    monkeypatch.setattr(compiling, "_run_compiler", forbidden)
    assert compile_binary("decay", (DECAY_C,), "linux64", cache=binaries) == first


@pytest.mark.slow
def test_a_binary_that_came_with_the_package_needs_no_compiler(
    binaries: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is found by what it was compiled from: another source, or a compiler of one's own, is compiled."""
    sources = source_files((DECAY_C, record_source()))
    to = compiling.PLATFORMS["linux64"]
    travels = tmp_path / compiling.shipped_name("decay", sources, to)
    travels.write_bytes(compiling.packed_for_travel(b"of the wheel"))
    monkeypatch.setattr(compiling, "SHIPPED", tmp_path)
    unpacked = compile_binary("decay", (DECAY_C,), "linux64", cache=tmp_path / "first")
    assert unpacked.read_bytes() == b"of the wheel" and unpacked.suffix == ".so"
    changed = {**sources, "decay.c": sources["decay.c"] + b"/* changed */\n"}
    assert compiling.compile_library("decay", changed, "linux64", cache=binaries).is_relative_to(binaries)
    monkeypatch.setenv("CC", f"{sys.executable} -m ziglang cc")
    assert compile_binary("decay", (DECAY_C,), "linux64", cache=binaries).stat().st_size > 1000


def test_a_damaged_binary_of_the_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sources = source_files((DECAY_C, record_source()))
    travels = tmp_path / compiling.shipped_name("decay", sources, compiling.PLATFORMS["linux64"])
    travels.write_bytes(compiling.packed_for_travel(b"of the wheel")[:-1] + b"?")
    monkeypatch.setattr(compiling, "SHIPPED", tmp_path)
    with pytest.raises(BuildError, match=rf"{travels.name} .* damaged .* install interarea again"):
        compile_binary("decay", (DECAY_C,), "linux64", cache=tmp_path / "cache")


def test_a_changed_source_is_another_binary(binaries: Path, tmp_path: Path) -> None:
    changed = tmp_path / "decay.c"
    text = DECAY_C.read_text().replace("../../../models/c/block/block.h", "block.h")
    changed.write_text(text + "/* changed */\n")
    names = {compile_binary("decay", (c,), "linux64", cache=binaries).name for c in (DECAY_C, changed)}
    assert len(names) == 2


@pytest.mark.slow
@pytest.mark.parametrize(
    "platform", ["linux64", "win64", "darwin64", "darwin-arm64", "linux-arm64", "wasm32"]
)
def test_two_machines_make_the_same_bytes(platform: str, cache: Path, tmp_path: Path) -> None:
    """Two caches in two folders, one of them empty but for the compiler's libc, stand for two machines."""
    to = compiling.PLATFORMS.get(platform, compiling.WEB_PAGE)
    sources = source_files((DECAY_C, record_source()))
    if to is compiling.WEB_PAGE:  # which has no libc but what a page's own sources bring
        sources = page_sources(load_case("two-area-thesis"))
    first = compiling.compile_for("decay", sources, to, cache=cache)
    own, libraries = tmp_path / COMPILERS_OWN, cache / COMPILERS_OWN / compiling.SYSTEM_LIBRARIES
    if libraries.is_dir():  # not where the first came from a wheel
        own.mkdir()
        (own / compiling.SYSTEM_LIBRARIES).symlink_to(libraries.absolute())
    binaries = [first, compiling.compile_for("decay", sources, to, cache=tmp_path)]
    assert binaries[0].read_bytes() == binaries[1].read_bytes()


def test_compiler_errors_are_passed_on(binaries: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken.c"
    broken.write_text("int f(void) { return undeclared; }\n")
    with pytest.raises(BuildError, match=r"(?s)compiling broken for linux64 failed.*undeclared"):
        compile_binary("broken", (broken,), "linux64", cache=binaries)


def test_missing_compilers(binaries: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compiling._compiler_of.cache_clear()
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(BuildError, match=r"no-such-compiler.*unset CC"):
        compile_binary("decay", (DECAY_C,), "linux64", cache=binaries)
    monkeypatch.delenv("CC")
    real = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *a: None if name == "ziglang" else real(name, *a)
    )
    compiling._compiler_of.cache_clear()
    with pytest.raises(NoCompilerError, match=r"pip install 'interarea\[build\]'"):
        compile_binary("decay", (DECAY_C,), "linux64", cache=binaries)
    monkeypatch.undo()
    compiling._compiler_of.cache_clear()


def test_a_c_file_inside_another_becomes_a_header(tmp_path: Path) -> None:
    """So no tool that compiles every .c of sources/ compiles it a second time."""
    (tmp_path / "inner.c").write_text("int inner(void);\n")
    (tmp_path / "outer.c").write_text('#include "inner.c"\n')
    files = source_files((tmp_path / "outer.c",))
    assert files["inner_c.h"] == b"int inner(void);\n"
    assert files["outer.c"] == b'#include "inner_c.h"\n'
    assert "inner.c" not in files


def test_unknown_platform_and_missing_include(binaries: Path, tmp_path: Path) -> None:
    with pytest.raises(BuildError, match="unknown platform 'amiga'; allowed: linux64"):
        compile_binary("decay", (DECAY_C,), "amiga", cache=binaries)
    lonely = tmp_path / "lonely.c"
    lonely.write_text('#include "nowhere.h"\n')
    with pytest.raises(BuildError, match=r"nowhere\.h"):
        source_files((lonely,))


def test_two_files_of_one_name_are_refused(tmp_path: Path) -> None:
    other = tmp_path / "solver.c"
    other.write_text("int x;\n")
    with pytest.raises(BuildError, match=r"two C files are called solver\.c"):
        source_files((other,))


def test_an_object_is_made_of_what_its_file_includes() -> None:
    """So two binaries share it; a macro may name any header."""
    sources = {"a.c": b'#include <math.h>\n#include "b.h"\n', "b.h": b"int b;\n", "c.h": b"", "d.c": b""}
    assert with_includes("a.c", sources) == ["a.c", "b.h"]
    assert with_includes("a.c", sources | {"b.h": b"#include NAME\n"}) == ["a.c", "b.h", "c.h"]


def test_binaries_share_objects(binaries: Path, tmp_path: Path) -> None:
    compile_binary("decay", (DECAY_C,), "linux64", cache=binaries)
    before = set((binaries / "objects").iterdir())
    other = tmp_path / "other.c"
    other.write_text(DECAY_C.read_text().replace("../../../models/c/block/block.h", "block.h"))
    compile_binary("other", (other,), "linux64", cache=binaries)
    objects = {p.name.split("-")[0] for p in set((binaries / "objects").iterdir()) - before}
    assert objects == {"other"}


def test_objects_begun_early_are_those_of_the_library(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A broken file is left to `compile_library`; a library that is there begins none."""
    sources = source_files((DECAY_C, record_source()))
    with compiling.objects_begun("decay", sources, "linux64", tmp_path):
        while not any(p.name.startswith("fmi2_cs-") for p in (tmp_path / "objects").glob("*.o")):
            time.sleep(0.05)
    early = set((tmp_path / "objects").glob("*.o"))
    compiling.compile_library("decay", sources, "linux64", cache=tmp_path)
    late = set((tmp_path / "objects").glob("*.o"))
    assert early <= late and len(late) == sum(name.endswith(".c") for name in sources)
    with compiling.objects_begun("decay", sources | {"x.c": b"?"}, "linux64", tmp_path):
        pass
    monkeypatch.setattr(compiling, "begun", None)
    with compiling.objects_begun("decay", sources, "linux64", tmp_path):
        pass


@pytest.mark.parametrize(
    "kind", ["plant", "channel", "concentrator", "controller", "detector", "pmu", "supervisor"]
)
def test_the_compiler_of_this_machine_reads_an_fmus_sources_without_a_warning(
    kind: str, tmp_path: Path
) -> None:
    """All else here is compiled by zig; `sources/` is for others."""
    files = source_files((*blocks()[kind].sources, record_source()))
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    done = run_guarded(
        [*compiler(), *FLAGS, "-fsyntax-only", "-I.", *(n for n in files if n.endswith(".c"))], cwd=tmp_path
    )
    assert (done.returncode, done.stderr) == (0, "")
