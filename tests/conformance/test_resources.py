"""What lies in resources/ is wrong, or the machine is: which, and what to do, is said; nothing crashes."""

from __future__ import annotations

import os
import shutil
import stat
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmu_runner import Runner, decay_block

from interarea.fmu_build.errors import FmuFileError
from interarea.fmu_build.open.fmu_file import FmuFile
from interarea.fmu_build.open.plant import open_plant
from interarea.fmu_build.write.package import build_fmu


def refusal(fmu: Path, folder: Path) -> str:
    """Return what an FMU extracted to `folder` logs when it refuses to be instantiated."""
    run = Runner.__new__(Runner)
    with pytest.raises(Exception, match="instantiate"):
        Runner.__init__(run, fmu, folder=str(folder))
    assert len(run.log) == 1, run.log
    return run.log[0]


def test_every_length_of_a_resource_cut_short(decay: Path, tmp_path: Path) -> None:
    fmpy.extract(str(decay), str(tmp_path))
    file = tmp_path / "resources" / "model.bin"
    content = file.read_bytes()
    for size in (0, 1, 7, 8, 31, 32, 33, 100, len(content) // 2, len(content) - 1):
        file.write_bytes(content[:size])
        said = refusal(decay, tmp_path)
        assert "model.bin" in said and "truncated" in said and "extract the FMU again" in said, (size, said)


def test_resource_of_another_fmu(built: dict[str, Path], decay: Path, tmp_path: Path) -> None:
    for name, fmu in (("own", decay), ("other", built["controller"])):
        fmpy.extract(str(fmu), str(tmp_path / name))
    shutil.copy(tmp_path / "other" / "resources" / "model.bin", tmp_path / "own" / "resources")
    said = refusal(decay, tmp_path / "own")
    guids = [fmpy.read_model_description(str(f)).guid for f in (decay, built["controller"])]
    assert all(guid in said for guid in guids)
    assert "modelDescription.xml and resources come from different FMUs" in said


def test_missing_folder_file_and_a_folder_in_its_place(decay: Path, tmp_path: Path) -> None:
    for k, words in enumerate(("no such file", "no such file", "is a folder")):
        folder = tmp_path / str(k)
        fmpy.extract(str(decay), str(folder))
        if k == 0:
            shutil.rmtree(folder / "resources")
        else:
            (folder / "resources" / "model.bin").unlink()
        if k == 2:
            (folder / "resources" / "model.bin").mkdir()
        said = refusal(decay, folder)
        assert words in said and "extract" in said and str(folder) in said


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may read everything")
def test_file_that_may_not_be_read(decay: Path, tmp_path: Path) -> None:
    fmpy.extract(str(decay), str(tmp_path))
    (tmp_path / "resources" / "model.bin").chmod(0)
    assert "permission denied" in refusal(decay, tmp_path)


def test_read_only_folder_is_all_an_fmu_needs(fmu: Path, tmp_path: Path) -> None:
    """An FMU writes nothing beside itself: it runs from a read-only folder and leaves it as it was."""
    fmpy.extract(str(fmu), str(tmp_path / "ro"))
    everything = sorted(p for p in (tmp_path / "ro").rglob("*"))
    before = {p: p.stat().st_mtime_ns for p in everything}
    for path in everything:
        path.chmod(stat.S_IREAD | stat.S_IEXEC)
    try:
        with Runner(fmu, folder=str(tmp_path / "ro")) as run:
            run.start().step(0.0, 0.01)
            assert np.all(np.isfinite(run.every_real()))
        assert {p: p.stat().st_mtime_ns for p in sorted((tmp_path / "ro").rglob("*"))} == before
    finally:
        for path in everything:
            path.chmod(stat.S_IRWXU)


@pytest.mark.parametrize("name", ["two  spaces", "größe 大小 ß", "100%41", "a#b?c", "semi;colon&and=+"])
def test_uri_of_any_folder_name(name: str, decay: Path, tmp_path: Path) -> None:
    fmpy.extract(str(decay), str(tmp_path / name))
    with Runner(decay, folder=str(tmp_path / name)) as run:
        assert run.start().get("x") == 1.0


@pytest.mark.slow
def test_machine_without_a_binary(tmp_path: Path) -> None:
    platform = fmpy.platform
    other = "win64" if platform != "win64" else "linux64"
    fmu = build_fmu(decay_block(), tmp_path, platforms=[other])
    with pytest.raises(
        FmuFileError, match=rf"no binary for this platform \({platform}\); it has {other}.*--platforms"
    ):
        open_plant(fmu)
    with pytest.raises(FmuFileError, match=rf"no binary for this platform \({platform}\); it has {other}"):
        FmuFile(fmu)
