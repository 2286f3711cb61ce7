"""Other machines: keys of the cache, folders of an FMU, one library for both processors of a Mac."""

from __future__ import annotations

import platform
import sys
import zipfile
from pathlib import Path

import pytest
from fmu_runner import decay_block

from interarea.cosim.run.artefacts import channel_fmu, linear_plant, plant_fmu
from interarea.fmu_build.errors import BuildError, FmuFileError
from interarea.fmu_build.open.fmu_file import FmuFile, host_folders
from interarea.fmu_build.open.images import read_image
from interarea.fmu_build.write.cache import artefacts_in, host_machine
from interarea.fmu_build.write.compile import host_platform, universal
from interarea.fmu_build.write.package import build_fmu
from interarea.models.case.case import Case

#: system and processor as Python names them -> platform, folders in their order
MACHINES = {
    ("linux", "x86_64"): ("linux64", ("linux64", "x86_64-linux")),
    ("linux", "aarch64"): ("linux-arm64", ("aarch64-linux",)),
    ("win32", "AMD64"): ("win64", ("win64", "x86_64-windows")),
    ("darwin", "x86_64"): ("darwin64", ("darwin64", "x86_64-darwin")),
    ("darwin", "arm64"): ("darwin64", ("aarch64-darwin", "darwin64")),
}


def become(monkeypatch: pytest.MonkeyPatch, system: str, processor: str) -> None:
    """Let Python name another machine."""
    monkeypatch.setattr(sys, "platform", system)
    monkeypatch.setattr(platform, "machine", lambda: processor)


@pytest.mark.parametrize("machine", MACHINES, ids="-".join)
def test_each_machine_has_its_platform_and_looks_into_its_folders(
    machine: tuple[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    become(monkeypatch, *machine)
    assert (host_platform(), host_folders()) == MACHINES[machine]


def test_a_machine_without_binaries_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    become(monkeypatch, "freebsd14", "riscv64")
    with pytest.raises(BuildError, match="for freebsd14-riscv64; allowed: linux64, win64"):
        host_platform()
    with pytest.raises(FmuFileError, match="freebsd14-riscv64"):
        host_folders()


@pytest.mark.slow
def test_no_machine_finds_what_another_one_kept(
    cache: Path, two_area: Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """FMUs hold the binary and the rounding of a machine, linear models its rounding."""
    artefacts = {str(f(cache)) for f in (channel_fmu, lambda c: plant_fmu(two_area, c))}
    linear_plant(two_area, cache)
    kinds = ("channel", "plant", "linear")
    before = {k.path for k in artefacts_in(cache) if k.kind in kinds}
    assert artefacts <= set(map(str, before)) and {p.parent.name for p in before} == set(kinds)
    monkeypatch.setattr("interarea.fmu_build.write.cache.host_machine", lambda: "linux-another")
    monkeypatch.setattr("interarea.fmu_build.write.package.host_machine", lambda: "linux-another")
    for again in (lambda: channel_fmu(cache), lambda: linear_plant(two_area, cache)):
        known = {k.path for k in artefacts_in(cache)}
        again()
        new = {k.path for k in artefacts_in(cache)} - known
        assert new and not new & before


def thin(machine: int, body: bytes) -> bytes:
    """Return what begins like a 64-bit Mach-O file of a processor."""
    return b"\xcf\xfa\xed\xfe" + machine.to_bytes(4, "little") + bytes(4) + body


def test_a_universal_library_holds_its_slices_on_pages() -> None:
    intel, arm = thin(0x01000007, b"i" * 20_000), thin(0x0100000C, b"a" * 5)
    whole = universal([intel, arm])
    assert whole[:8] == bytes.fromhex("cafebabe00000002")
    rows = [[int.from_bytes(whole[8 + 20 * k + 4 * j :][:4], "big") for j in range(5)] for k in range(2)]
    for (machine, _, offset, size, align), slice_ in zip(rows, (intel, arm), strict=True):
        assert machine.to_bytes(4, "little") == slice_[4:8] and align == 14
        assert offset % 2**14 == 0 and whole[offset : offset + size] == slice_
    assert rows[1][2] >= rows[0][2] + rows[0][3]
    for wrong, said in (([b"\x7fELF" + bytes(20)], "no 64-bit Mach-O"), ([arm, arm], "two are for the same")):
        with pytest.raises(BuildError, match=said):
            universal(wrong)


@pytest.mark.slow
def test_a_mac_of_either_kind_finds_its_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fmu = build_fmu(decay_block(), tmp_path, platforms=["darwin64"])
    with zipfile.ZipFile(fmu) as archive:
        image = read_image(archive.read("binaries/darwin64/decay.dylib"))
    assert (image.format, image.machine) == ("Mach-O", "x86_64+arm64")
    both = build_fmu(decay_block(), tmp_path / "both.fmu", platforms=["darwin64", "darwin-arm64"])
    for file, processor, folder in (
        (fmu, "x86_64", "darwin64"),
        (fmu, "arm64", "darwin64"),
        (both, "x86_64", "darwin64"),
        (both, "arm64", "aarch64-darwin"),
    ):
        with monkeypatch.context() as there:
            become(there, "darwin", processor)
            opened = FmuFile(file)
            assert opened.binary.parent.name == folder
            opened.close()
    assert host_machine().startswith(sys.platform)
