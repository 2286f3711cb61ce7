"""Archives made to harm whoever opens them are refused before anything is written or expanded."""

from __future__ import annotations

import io
import stat
import struct
import time
import zipfile
from pathlib import Path

import pytest
from fmu_mutation import Entries, mutated
from typer.testing import CliRunner

from interarea.cli.app import app
from interarea.fmu_build.check.check import CheckError, check_file
from interarea.fmu_build.open import archive as check_archive
from interarea.fmu_build.open.images import ImageError, read_image


def archive_of(path: Path, name: str, content: bytes = b"x", mode: int = 0) -> Path:
    """Write an archive with one entry."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        info = zipfile.ZipInfo("x")
        info.filename = name
        info.compress_type = zipfile.ZIP_DEFLATED
        info.create_system = 3
        info.external_attr = mode << 16
        archive.writestr(info, content)
    return path


@pytest.mark.parametrize(
    "name",
    ["../evil", "a/../../evil", "/etc/evil", "C:/evil", "..\\evil", "a\\..\\..\\evil", "\\\\host\\evil"],
)
def test_entries_that_leave_the_folder(name: str, tmp_path: Path) -> None:
    folder = tmp_path / "inside"
    folder.mkdir()
    report = check_file(archive_of(folder / "x.fmu", name))
    assert any("leaves the folder" in f.message for f in report.findings)
    assert [p.name for p in tmp_path.rglob("*")] == ["inside", "x.fmu"]


def test_links_and_devices(tmp_path: Path) -> None:
    for mode, word in ((stat.S_IFLNK | 0o777, "a link"), (stat.S_IFIFO | 0o644, "a device or pipe")):
        report = check_file(archive_of(tmp_path / "x.fmu", "resources", b"/etc", mode))
        assert any(word in f.message for f in report.findings)


def test_a_bomb_is_refused_by_its_ratio(tmp_path: Path) -> None:
    start = time.process_time()
    report = check_file(archive_of(tmp_path / "x.fmu", "resources/zeros", bytes(64 << 20)))
    assert any("bomb" in f.fix for f in report.findings)
    assert time.process_time() - start < 5.0


def test_a_bomb_that_lies_about_its_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The directory says 10 bytes; unpacking stops when there are more, and writes no more than a piece."""
    file = archive_of(tmp_path / "x.fmu", "resources/zeros", bytes(4 << 20))
    content = bytearray(file.read_bytes())
    for magic, offset in ((b"PK\x03\x04", 22), (b"PK\x01\x02", 24)):
        struct.pack_into("<I", content, content.find(magic) + offset, 10)
    file.write_bytes(content)
    monkeypatch.setattr(check_archive, "_PIECE", 1 << 16)
    report = check_file(file)
    assert any(
        "damaged" in f.message or "more bytes" in f.message or "unpacked" in f.message
        for f in report.findings
    )


@pytest.mark.slow
def test_too_many_entries(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "x.fmu", "w") as archive:
        for k in range(check_archive.MOST_ENTRIES + 1):
            archive.writestr(f"{k}", b"")
    assert any("entries, at most" in f.message for f in check_file(tmp_path / "x.fmu").findings)


def test_total_of_many_large_entries(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(check_archive, "MOST_BYTES", 1000)
    file = archive_of(tmp_path / "x.fmu", "a", bytes(range(256)) * 8)
    assert any("at most 1000 are taken" in f.message for f in check_file(file).findings)


LAUGHS = """<?xml version="1.0"?>
<!DOCTYPE lolz [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">]>
<fmiModelDescription fmiVersion="2.0" modelName="&b;" guid="1"/>"""
OUTSIDE = """<?xml version="1.0"?>
<!DOCTYPE x [<!ENTITY secret SYSTEM "file:///etc/hostname">]>
<fmiModelDescription fmiVersion="2.0" modelName="m" guid="1">&secret;</fmiModelDescription>"""


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
@pytest.mark.parametrize("text", [LAUGHS, OUTSIDE], ids=["expansion", "external"])
def test_entities_are_refused_in_every_encoding(
    text: str, encoding: str, decay: Path, tmp_path: Path
) -> None:
    def edit(entries: Entries) -> None:
        entries["modelDescription.xml"] = text.encode(encoding)

    report = check_file(mutated(decay, tmp_path / "x.fmu", edit))
    assert [f.rule for f in report.findings] == ["XML"]
    assert "DOCTYPE" in report.findings[0].message


def test_encrypted_damaged_and_foreign_entries(decay: Path, tmp_path: Path) -> None:
    content = bytearray(archive_of(tmp_path / "e.fmu", "modelDescription.xml", b"<a/>").read_bytes())
    for magic, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        content[content.find(magic) + offset] |= 1
    (tmp_path / "e.fmu").write_bytes(content)
    assert any("encrypted" in f.message for f in check_file(tmp_path / "e.fmu").findings)

    damaged = bytearray(decay.read_bytes())
    damaged[200:260] = bytes(60)
    (tmp_path / "d.fmu").write_bytes(damaged)
    assert not check_file(tmp_path / "d.fmu").clean

    with zipfile.ZipFile(tmp_path / "l.fmu", "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("modelDescription.xml", "<fmiModelDescription/>")
    assert any("deflate" in f.fix for f in check_file(tmp_path / "l.fmu").findings)


def test_every_cut_of_an_archive_gives_a_verdict(decay: Path, tmp_path: Path) -> None:
    """Truncated files are refused in words; nothing is raised but `CheckError`."""
    content = decay.read_bytes()
    for size in range(0, len(content), max(1, len(content) // 23)):
        file = tmp_path / "x.fmu"
        file.write_bytes(content[:size])
        try:
            assert not check_file(file, run=False).clean
        except CheckError as error:
            assert "no zip archive" in str(error)


def test_every_cut_of_a_library_gives_a_verdict(decay: Path) -> None:
    with zipfile.ZipFile(decay) as archive:
        name = next(n for n in archive.namelist() if n.startswith("binaries/"))
        content = archive.read(name)
    assert "fmi2DoStep" in read_image(content).exports
    for size in range(0, len(content), max(1, len(content) // 97)):
        try:
            read_image(content[:size])
        except ImageError as error:
            assert str(error)


def test_exit_codes_and_json(decay: Path, tmp_path: Path) -> None:
    run = CliRunner()
    clean = run.invoke(app, ["check", str(decay), "--json", "--no-run"])
    assert clean.exit_code == 0
    assert '"verdict": "not run"' in clean.stdout
    completed = run.invoke(app, ["check", str(archive_of(tmp_path / "x.fmu", "../evil"))])
    assert completed.exit_code == 1
    assert "../evil: the entry leaves the folder" in completed.stdout
    for wrong in (tmp_path / "missing.fmu", Path(__file__)):
        done = run.invoke(app, ["check", str(wrong)])
        assert isinstance(done.exception, CheckError)  # `main` turns it into one line and exit code 2
    assert io.StringIO(completed.stdout).readline().count("->") == 1
