"""FMUs that are damaged or made to harm: each opens or is refused in one line, and nothing of it stays."""

from __future__ import annotations

import copy
import re
import stat
import tempfile
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from fmu_runner import decay_block
from lxml import etree

from interarea.cosim.run.run import run_system
from interarea.cosim.run.system import System
from interarea.fmu_build.errors import FmuFileError
from interarea.fmu_build.open.fmu_file import FmuFile
from interarea.fmu_build.write.package import block_fmu

Entries = dict[str, bytes]
XML = "modelDescription.xml"


@pytest.fixture(scope="module")
def fmu(cache: Path) -> Path:
    return block_fmu(decay_block(), cache)


@pytest.fixture(scope="module")
def entries(fmu: Path) -> Entries:
    with zipfile.ZipFile(fmu) as archive:
        return {n: archive.read(n) for n in archive.namelist()}


@pytest.fixture
def scratch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder in which FMUs are unpacked; beside it nothing may appear."""
    folder = tmp_path / "scratch"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


def opened(path: Path, scratch: Path, *, strict: bool = False) -> str:
    """Open an FMU up to where its library would be loaded; return how it was refused, "" if it was not."""
    before = {p for p in path.parent.rglob("*") if scratch not in p.parents}
    try:
        file = FmuFile(path)
        try:
            if strict:
                file.require_conforming()
            assert file.binary.is_file() and file.description.title and file.enumerations is not None
        finally:
            file.close()
        said = ""
    except FmuFileError as error:
        said = str(error)
        assert said and "\n" not in said and len(said) < 1000 and path.name in said
    left = [p for p in scratch.rglob("*") if p.is_file() and p.name != ".lock"]
    assert left == []
    assert {p for p in path.parent.rglob("*") if scratch not in p.parents} == before
    return said


def packed(path: Path, entries: Entries) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in entries.items():
            archive.writestr(name, content)
    return path


def test_the_fmu_itself_opens(fmu: Path, tmp_path: Path, scratch: Path) -> None:
    copy = tmp_path / "x.fmu"
    copy.write_bytes(fmu.read_bytes())
    assert opened(copy, scratch) == ""


@pytest.mark.parametrize("part", range(8))
def test_a_cut_or_flipped_archive(part: int, fmu: Path, tmp_path: Path, scratch: Path) -> None:
    """120 places in the file: cut there, one bit changed there, zeros from there."""
    whole, path, refused = fmu.read_bytes(), tmp_path / "x.fmu", 0
    for k in range(part, 120, 8):
        at = k * len(whole) // 120
        flipped = bytearray(whole)
        flipped[at] ^= 0x10
        zeros = whole[:at] + bytes(64) + whole[at + 64 :]
        for content in (whole[:at], bytes(flipped), zeros):
            path.write_bytes(content)
            refused += bool(opened(path, scratch))
    assert refused >= 15  # every cut; what hits a file that is not unpacked does no harm


NAMES = {
    "above": "../evil",
    "far above": "resources/../../evil",
    "absolute": "/tmp/interarea-evil",
    "drive": "C:/evil",
    "backslash": "..\\evil",
    "share": "\\\\host\\evil",
}


@pytest.mark.parametrize("name", NAMES)
def test_an_entry_that_leaves_the_folder(name: str, entries: Entries, tmp_path: Path, scratch: Path) -> None:
    path = packed(tmp_path / "x.fmu", entries | {NAMES[name]: b"x"})
    assert "leaves the folder" in opened(path, scratch)


@pytest.mark.parametrize("kind", [stat.S_IFLNK, stat.S_IFIFO, stat.S_IFCHR, stat.S_IFSOCK])
def test_an_entry_that_is_no_file(kind: int, entries: Entries, tmp_path: Path, scratch: Path) -> None:
    path = packed(tmp_path / "x.fmu", entries)
    with zipfile.ZipFile(path, "a") as archive:
        info = zipfile.ZipInfo("resources/link")
        info.create_system, info.external_attr = 3, (kind | 0o777) << 16
        archive.writestr(info, "/etc")
    assert "the entry is a" in opened(path, scratch)


@pytest.mark.slow
def test_bombs(entries: Entries, tmp_path: Path, scratch: Path) -> None:
    path = packed(tmp_path / "x.fmu", entries | {"resources/zeros": bytes(64 << 20)})
    assert "more than 500 times" in opened(path, scratch)
    path = packed(tmp_path / "x.fmu", entries | {XML: entries[XML] + b" " * (64 << 20)})
    assert "more than 500 times" in opened(path, scratch)
    path = packed(tmp_path / "x.fmu", entries | {f"resources/{k}": b"" for k in range(20_001)})
    assert "entries, at most" in opened(path, scratch)


def library(entries: Entries) -> str:
    return next(n for n in entries if n.startswith("binaries/"))


BINARIES: dict[str, tuple[Callable[[bytes], bytes], str]] = {
    "empty": (lambda b: b"", "no ELF, PE or Mach-O"),
    "text": (lambda b: b"#!/bin/sh\nrm -rf /\n", "no ELF, PE or Mach-O"),
    "32 bits": (lambda b: b[:18] + b"\x03\x00" + b[20:], "is ELF for x86,|does not lie"),
    "another machine": (lambda b: b[:18] + b"\xb7\x00" + b[20:], "for arm64, this machine loads"),
    "Windows": (lambda b: b"MZ" + b[2:], "begins like a DOS program"),
    "cut": (lambda b: b[:100], "does not lie|no section|no dynamic"),
}


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="edits the header of an ELF library")
@pytest.mark.parametrize("how", BINARIES)
def test_what_is_no_library_of_this_machine_is_never_loaded(
    how: str, entries: Entries, tmp_path: Path, scratch: Path
) -> None:
    change, says = BINARIES[how]
    name = library(entries)
    said = opened(packed(tmp_path / "x.fmu", entries | {name: change(entries[name])}), scratch)
    assert name in said and re.search(says, said), said


def described(text: str) -> Iterator[tuple[str, str]]:
    """Descriptions that break something, with what is said of them ("" where any refusal or none will do)."""
    start = text.index("<ScalarVariable")
    deep = "<a>" * 100_000 + "</a>" * 100_000
    yield text[: len(text) // 2], "not well-formed"
    yield "", "not well-formed"
    yield text.replace("?>", '?><!DOCTYPE x [<!ENTITY a "ha">]>', 1), "DOCTYPE"
    yield text.replace("</fmiModelDescription>", f"{deep}</fmiModelDescription>"), ""
    yield text.replace('fmiVersion="2.0"', 'fmiVersion="3.0"'), "is FMI 3.0"
    yield text.replace('fmiVersion="2.0"', ""), "is FMI None"
    yield text.replace("CoSimulation", "CoSimulator"), "co-simulation part"
    yield re.sub(r'(<CoSimulation[^>]*modelIdentifier=")[^"]*', r"\1../../evil", text), "names no library"
    yield re.sub(r'(<CoSimulation[^>]*modelIdentifier=")[^"]*', r"\1" + "x" * 5000, text), "names no library"
    for name in ("causality", "variability"):
        yield re.sub(f'{name}="[a-zA-Z]+"', f'{name}="odd"', text), f'{name} "odd"'
    for value in ("-1", "1e99", "99999999999", "x"):
        yield re.sub(r'valueReference="\d+"', f'valueReference="{value}"', text), "valueReference"
    for value in ("x", "1,5", "0x10", "1" * 400_000):
        yield (
            re.sub(r'(<Real[^>]* start=)"[^"]*"', rf'\1"{value}"', text),
            "start value" if len(value) < 9 else "",
        )
    for value in ("0", "-3", "99999", "x", ""):
        yield re.sub(r'<Unknown index="\d+"', f'<Unknown index="{value}"', text), "ModelStructure"
    for value in ("0", "99999"):
        yield re.sub(r'dependencies="[^"]+"', f'dependencies="{value}"', text), "ModelStructure"
    yield re.sub(r'unit="[^"]+"', 'unit="furlong"', text), '"furlong" is not defined'
    yield text[:start] + text[start:].replace("<Real", "<Ideal"), "type"
    yield re.sub(r'(<ScalarVariable[^>]*? name=)"[^"]*"', r'\1"same"', text), "name of its own"
    yield text.replace("modelName=", "title="), ""


@pytest.mark.slow
def test_descriptions(entries: Entries, tmp_path: Path, scratch: Path) -> None:
    text, count = entries[XML].decode(), 0
    for changed, says in described(text):
        path = packed(tmp_path / "x.fmu", entries | {XML: changed.encode()})
        said = opened(path, scratch, strict=True)
        assert says in said, (says, said)
        opened(path, scratch)
        count += 1
    assert count >= 25
    for encoding in ("utf-16", "latin-1", "utf-8-sig"):
        opened(packed(tmp_path / "x.fmu", entries | {XML: text.encode(encoding, "replace")}), scratch)


#: what does no harm: pattern, replacement, what the line on it says
HARMLESS = (
    (r'variability="[a-z]+"', 'variability="sometimes"', 'variability "sometimes", taken as'),
    (r'(causality="parameter"[^>]*variability=)"[a-z]+"', r'\1"constant"', '"constant", taken as fixed'),
    (r'unit="[^"]+"', 'unit="furlong"', 'unit "furlong" is not defined'),
    (r'dependencies="[^"]+"', 'dependencies="99999"', "taken as on all inputs"),
    (r'<Unknown index="\d+"', '<Unknown index="4000000000"', "names variable 0 of"),
    (r'<Unknown index="\d+"', '<Unknown index="²"', "names variable 0 of"),
    (r'(causality="local"[^>]*valueReference=)"\d+"', r'\1"³"', "left out"),
)


def stepped(path: Path) -> tuple[tuple[str, ...], bytes]:
    """Return what a run warns of, and its numbers."""
    system = System(stop_s=0.1, step_s=0.01).fmu("x", path)
    result = system.run()
    return result.warnings, result.to_frame().to_numpy().tobytes()


@pytest.mark.parametrize("pattern, to, says", HARMLESS, ids=[says for *_, says in HARMLESS])
def test_harmless_breaches_warn_and_strict_refuses(
    pattern: str, to: str, says: str, entries: Entries, fmu: Path, tmp_path: Path
) -> None:
    text = entries[XML].decode()
    changed, count = re.subn(pattern, to, text)
    if not count:  # the block has no such variable: one that has
        where = text.index("</ModelVariables>")
        more = (
            '<ScalarVariable name="more" valueReference="9" variability="tunable" causality="parameter">'
            '<Real start="1"/></ScalarVariable>'
            '<ScalarVariable name="own" causality="local" valueReference="9"><Real/></ScalarVariable>'
        )
        changed, count = re.subn(pattern, to, text[:where] + more + text[where:])
    assert count
    path = packed(tmp_path / "x.fmu", entries | {XML: changed.encode()})
    warnings, numbers = stepped(path)
    (line,) = warnings
    assert says in line and "breaks the standard" in line and "\n" not in line
    assert (warnings, numbers) == (warnings, stepped(fmu)[1])
    with pytest.raises(FmuFileError, match="breaks the standard") as refused:
        System(stop_s=0.1, step_s=0.01, strict=True).fmu("x", path)
    assert says in str(refused.value)


def test_strict_in_a_scenario(entries: Entries, tmp_path: Path) -> None:
    broken = entries[XML].decode().replace('variability="', 'variability="un')
    packed(tmp_path / "x.fmu", entries | {XML: broken.encode()})
    table = {"folder": tmp_path, "fmus": {"x": {"file": "x.fmu"}}, "stop_s": 0.1, "step_s": 0.01}
    with pytest.warns(UserWarning, match="breaks the standard"):
        assert len(run_system(table).warnings) == 1
    with pytest.raises(FmuFileError, match="breaks the standard"):
        run_system({**table, "strict": True})


VALUES = ("", " ", "x", "-1", "0", "²", "1e400", "nan", "-inf", "true", "9" * 25, "9" * 5000, "1 2", "☃")


@pytest.mark.parametrize("part", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 9))])
def test_any_attribute_with_any_value_opens_or_is_refused(
    part: int, entries: Entries, tmp_path: Path, scratch: Path
) -> None:
    """Each attribute of each kind of element: taken away, with odd values; each element gone."""
    tree = etree.fromstring(entries[XML])
    seen: set[tuple[str, str]] = set()
    count = 0
    for element in tree.iter():
        for name in ("", *element.attrib):
            kind = (f"{element.tag} {element.get('causality', '')}", name)
            if kind in seen:
                continue
            seen.add(kind)
            if len(seen) % 9 != part or (element is tree and not name):
                continue
            for value in (*VALUES, None) if name else (None,):
                changed = copy.deepcopy(tree)
                place = changed.getroottree().xpath(tree.getroottree().getpath(element))[0]
                if name and value is not None:
                    place.set(name, value)
                elif name:
                    del place.attrib[name]
                else:
                    place.getparent().remove(place)
                text = etree.tostring(changed)
                opened(packed(tmp_path / "x.fmu", entries | {XML: text}), scratch)
                count += 1
    assert count >= 50


def test_what_is_missing(entries: Entries, tmp_path: Path, scratch: Path) -> None:
    for gone, says in ((XML, "is not in the archive"), (library(entries), "no binary for this platform")):
        rest = {n: c for n, c in entries.items() if n != gone}
        assert says in opened(packed(tmp_path / "x.fmu", rest), scratch)
    assert "no such file, wanted: an FMU" in opened(tmp_path / "gone" / "x.fmu", scratch)
