"""Archives where memory runs out."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path

import pytest

from interarea.fmu_build.finding import Report
from interarea.fmu_build.open.archive import read_checked


def test_memory_that_runs_out_in_zlib_is_no_damage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The module zlib tells it as an error of its own, by the number Z_MEM_ERROR."""
    archive = tmp_path / "x.fmu"
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as packed:
        packed.writestr("modelDescription.xml", "<a/>" * 100)

    def refused(*_: object) -> bytes:
        raise zlib.error("Error -4 while decompressing data")

    monkeypatch.setattr(zipfile.ZipExtFile, "read", refused)
    with pytest.raises(MemoryError):
        read_checked(archive, "modelDescription.xml", 1000, Report(archive.name))
