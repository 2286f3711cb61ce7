"""An FMU of the cache is opened by its digest: the same facts, without reading the archive again."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from interarea.cosim.run.artefacts import channel_fmu
from interarea.fmu_build.errors import FmuFileError
from interarea.fmu_build.open import fmu_file
from interarea.fmu_build.open.fmu_file import FmuFile
from interarea.fmu_build.open.own import OwnFmu, open_own
from interarea.models.files import default_cache


@pytest.fixture
def channel(tmp_path: Path) -> Path:
    """Return the channel's FMU in a cache where nothing was opened before."""
    source = channel_fmu(default_cache())
    path = tmp_path / "channel" / source.name
    path.parent.mkdir()
    path.write_bytes(source.read_bytes())
    return path


def _facts(file: FmuFile) -> list[object]:
    files = {p.relative_to(file.folder): p.read_bytes() for p in file.folder.rglob("*") if p.is_file()}
    return [
        *(getattr(file.model, f.name) for f in dataclasses.fields(file.model)),
        *(file.description, file.variables, file.enumerations, file.deviations, file.warning),
        *(files, file.binary.relative_to(file.folder), file.path),
    ]


def test_what_is_kept_equals_what_the_archive_says(channel: Path, tmp_path: Path) -> None:
    read, first, second = FmuFile(channel), open_own(channel, tmp_path), open_own(channel, tmp_path)
    try:
        assert isinstance(second, OwnFmu)
        assert _facts(read) == _facts(first) == _facts(second)
        assert first.folder != second.folder
    finally:
        for file in (read, first, second):
            file.close()
    assert not first.folder.samefile(second.folder)  # unpacked anew after `close`
    first.close()
    second.close()


def test_the_archive_is_not_read_twice(
    channel: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    open_own(channel, tmp_path).close()

    def fail(*_: object, **__: object) -> None:
        raise AssertionError("read again")

    monkeypatch.setattr(fmu_file, "read_checked", fail)
    monkeypatch.setattr(fmu_file, "unpack_checked", fail)
    with pytest.raises(AssertionError):
        FmuFile(channel)
    file = open_own(channel, tmp_path)
    assert file.binary.is_file()
    file.close()


@pytest.mark.parametrize("damage", [b"", b"\x80\x04}."])
def test_a_damaged_record_is_made_again(channel: Path, tmp_path: Path, damage: bytes) -> None:
    open_own(channel, tmp_path).close()
    (record,) = (tmp_path / "opened").glob("*.pickle")
    whole = record.read_bytes()
    record.write_bytes(damage)
    file = open_own(channel, tmp_path)
    assert file.description.input_of.keys() == {"u"}
    assert record.read_bytes() == whole
    file.close()


def test_a_cache_that_cannot_be_written_is_done_without(channel: Path, tmp_path: Path) -> None:
    (tmp_path / "opened").write_text("a file where the folder would be")
    file = open_own(channel, tmp_path)
    assert type(file) is FmuFile
    assert file.binary.is_file()
    file.close()


def test_what_is_no_fmu_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "text.fmu"
    path.write_text("no archive")
    with pytest.raises(FmuFileError, match="not an FMU"):
        open_own(path, tmp_path)
    assert not list((tmp_path / "opened").glob("*.pickle"))
