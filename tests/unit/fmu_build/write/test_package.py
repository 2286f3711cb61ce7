"""The archive around a block: names, GUID, platforms, and atomic writing."""

from __future__ import annotations

import struct
import subprocess
import xml.etree.ElementTree as ET
import zipfile
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fmu_runner import decay_block

from interarea.fmu_build.errors import BuildError, FmuError, FmuFileError
from interarea.fmu_build.open.plant import open_plant
from interarea.fmu_build.write.package import build_fmu


def parts(file: Path) -> tuple[ET.Element, bytes]:
    with zipfile.ZipFile(file) as archive:
        return ET.fromstring(archive.read("modelDescription.xml")), archive.read("resources/model.bin")


def test_guid_is_in_both_parts_and_follows_the_content(tmp_path: Path) -> None:
    guids = set()
    for k, step in enumerate((0.01, 0.02, 0.01)):
        description, record = parts(build_fmu(decay_block(internal_step_s=step), tmp_path / f"{k}.fmu"))
        guid = description.attrib["guid"]
        assert guid.encode() + b"\0" in record
        guids.add(guid)
    assert len(guids) == 2


def test_a_folder_gets_the_models_name(tmp_path: Path) -> None:
    assert build_fmu(decay_block(), tmp_path) == tmp_path / "decay.fmu"
    assert [f.name for f in tmp_path.iterdir()] == ["decay.fmu"]


def test_names_and_data_that_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BuildError, match="no C identifier"):
        build_fmu(decay_block(name="two area"), tmp_path)
    with pytest.raises(BuildError, match="no platform was asked for"):
        build_fmu(decay_block(), tmp_path, platforms=[])
    with pytest.raises(ValueError, match="written by the builder"):
        build_fmu(decay_block(data={"layout": np.zeros(1)}), tmp_path)


def test_picture_is_a_png_that_decodes(tmp_path: Path) -> None:
    with zipfile.ZipFile(build_fmu(decay_block(), tmp_path)) as archive:
        png = archive.read("model.png")
    at, pixels, size = 8, b"", (0, 0)
    while at < len(png):
        length, kind = struct.unpack_from(">I4s", png, at)
        data = png[at + 8 : at + 8 + length]
        assert struct.unpack_from(">I", png, at + 8 + length)[0] == zlib.crc32(kind + data)
        if kind == b"IHDR":
            size = struct.unpack_from(">II", data)
        if kind == b"IDAT":
            pixels += data
        at += 12 + length
    assert len(zlib.decompress(pixels)) == size[1] * (size[0] + 1)


def test_documentation_escapes_what_it_is_given(tmp_path: Path) -> None:
    block = replace(
        decay_block(), provenance={"case": "<script>"}, documentation={"Equations": "<p>x&lt;1</p>"}
    )
    with zipfile.ZipFile(build_fmu(block, tmp_path)) as archive:
        page = archive.read("documentation/index.html").decode()
    assert "&lt;script&gt;" in page
    assert "<p>x&lt;1</p>" in page
    assert all(v.name in page for v in block.table)


def test_open_plant_gives_exact_matrices(tmp_path: Path) -> None:
    """dx/dt = -x + u, y = x."""
    with open_plant(build_fmu(decay_block(), tmp_path)) as plant:
        assert (plant.state_names, plant.input_names, plant.output_names) == (("x",), ("u",), ("y",))
        A, B, C, D = plant.jacobians()
        assert (A[0, 0], B[0, 0], C[0, 0], D[0, 0]) == (-1.0, 1.0, 1.0, 0.0)
        dx, y = plant.derivatives([3.0], [0.5])
        assert (dx[0], y[0]) == (-2.5, 3.0)
        with pytest.raises(FmuError, match=r"x has shape \(2,\), wanted \(1,\)"):
            plant.derivatives([1.0, 2.0], [0.0])


def test_open_plant_says_what_is_wrong(tmp_path: Path) -> None:
    file = tmp_path / "not.fmu"
    file.write_bytes(b"no archive")
    with pytest.raises(FmuFileError, match="not an FMU"):
        open_plant(file)
    only_cs = build_fmu(decay_block(model_exchange=False), tmp_path / "cs.fmu")
    with pytest.raises(FmuFileError, match="has no model-exchange part"):
        open_plant(only_cs)


@pytest.mark.slow
def test_all_platforms_in_one_archive(tmp_path: Path) -> None:
    names = ["linux64", "win64", "darwin64", "linux-arm64"]
    with zipfile.ZipFile(build_fmu(decay_block(), tmp_path, platforms=names)) as archive:
        binaries = sorted(n for n in archive.namelist() if n.startswith("binaries/"))
    assert binaries == [
        "binaries/aarch64-linux/decay.so",
        "binaries/darwin64/decay.dylib",
        "binaries/linux64/decay.so",
        "binaries/win64/decay.dll",
    ]


def test_a_new_design_needs_no_compiler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Binaries are generic and cached: new numbers cost a description, a record and a zip."""
    from fmu_blocks import A, B, C

    from interarea.models.blocks.controller import controller_block

    def export(k: int) -> bytes:
        block = controller_block(
            "controller", A - k * np.eye(3), B, C, np.zeros((1, 2)), ["G2_dw", "G4_dw"], ["G4_vs"]
        )
        return build_fmu(block, tmp_path).read_bytes()

    first = export(0)

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("a program was started")

    monkeypatch.setattr(subprocess, "Popen", refuse)
    assert export(1) != first
