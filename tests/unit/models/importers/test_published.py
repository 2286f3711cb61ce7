"""Published grids: the bundled one is what its files say, the others come from the right wheel."""

from __future__ import annotations

import hashlib
import subprocess
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from interarea.models.case.case import load_case
from interarea.models.errors import CaseError
from interarea.models.importers import published as module
from interarea.models.importers.file import import_grid
from interarea.models.importers.imported import ImportOptions
from interarea.models.importers.psse import import_psse

RECORDS = Path(__file__).parents[1] / "devices" / "psse_records"
RAW, DYR = RECORDS / "ThreeBusMulti.raw", RECORDS / "ThreeBus_SEXS.dyr"
WECC_240 = Path(__file__).parent / "wecc_240"


def _leaves(value: Any, key: tuple[str, ...] = ()) -> dict[tuple[str, ...], Any]:
    """Return path -> each number and text of a JSON value."""
    if isinstance(value, dict | list):
        inside = value.items() if isinstance(value, dict) else enumerate(value)
        return {k: leaf for name, one in inside for k, leaf in _leaves(one, (*key, str(name))).items()}
    return {key: value}


def test_the_bundled_grid_is_what_the_import_makes_of_the_published_files():
    files = (f"240busWECC_2018_{end}.xz" for end in ("PSS32_fixed_shunts.raw", "PSS.dyr"))
    imported = import_psse(
        *(WECC_240 / name for name in files), name="wecc-240", options=ImportOptions(converters="current")
    )
    bundled, ours = (_leaves(c.model_dump(mode="json")) for c in (load_case("wecc-240"), imported.case))
    words = ("title", "source", "sources", "swing")
    assert {key for key in bundled if key[0] not in words} == {key for key in ours if key[0] not in words}
    for key, value in bundled.items():
        if key[0] not in words:  # another processor's BLAS rounds the power flow another way
            same = ours[key] == value
            assert same or ours[key] == pytest.approx(value, rel=1e-9, abs=1e-11), key
    assert imported.report.assumed["converter modelled as a constant current"] == 37


@pytest.fixture
def wheel(tmp_path, monkeypatch):
    """A small wheel in place of the registry's."""
    grid = module.PUBLISHED["npcc"]
    path = tmp_path / "andes-2.0.0-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as archive:
        archive.write(RAW, grid.raw)
        archive.write(DYR, grid.dyr)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    own = replace(grid, wheel=replace(grid.wheel, sha256=digest))
    monkeypatch.setitem(module.PUBLISHED, "npcc", own)
    monkeypatch.setattr(module, "fetched", lambda wheel, folder: path)
    return path


def test_a_published_grid_is_read_like_its_files(wheel, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    imported = import_grid("npcc")
    expected = import_psse(RAW, DYR, name="npcc").case
    assert imported.case.hash == expected.hash and imported.case.name == "npcc"
    assert "GPL-3.0" in imported.report.text() and "andes/cases/npcc" in imported.case.source
    assert [p.name for p in tmp_path.iterdir()] == [wheel.name]  # nothing is left behind


def test_another_wheel_is_not_read(wheel):
    wheel.write_bytes(wheel.read_bytes() + b" ")
    with pytest.raises(CaseError, match=r"npcc: andes-2.* has the SHA-256 .*, allowed: .*; not read"):
        import_grid("npcc")


def test_its_own_dynamic_data_and_a_file_of_that_name_come_first(wheel, tmp_path, monkeypatch):
    with pytest.raises(CaseError, match="npcc has its own dynamic data"):
        import_grid("npcc", dyr=DYR)
    monkeypatch.chdir(tmp_path)
    Path("npcc").write_text("")
    with pytest.raises(CaseError, match="npcc: suffix ''"):
        import_grid("npcc")


def test_what_pip_leaves_when_it_is_killed_goes_with_the_folder(tmp_path, monkeypatch):
    own = []

    def killed(command, env, timeout_s):
        own.append([Path(env[name]) for name in ("TMPDIR", "TEMP", "TMP")])
        return subprocess.CompletedProcess(command, -9, "", "killed\n")

    monkeypatch.setattr(module, "run_guarded", killed)
    with pytest.raises(CaseError, match="pip cannot download it: killed"):
        module.fetched(module.ANDES, tmp_path)
    assert own == [[tmp_path / "pip"] * 3] and own[0][0].is_dir()


def test_a_registry_that_does_not_answer_is_one_line(tmp_path, monkeypatch):
    refused = subprocess.CompletedProcess([], 1, "", "WARNING: retrying\nERROR: No matching distribution\n")
    monkeypatch.setattr(module, "run_guarded", lambda *_, **__: refused)
    with pytest.raises(
        CaseError, match=r"andes==2\.0\.0: pip cannot download it: ERROR: No matching"
    ) as caught:
        module.fetched(module.ANDES, tmp_path)
    assert "\n" not in str(caught.value)
