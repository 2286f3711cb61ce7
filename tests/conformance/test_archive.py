"""What lies in the archive: schema, validators, symbols, reproducible bytes."""

from __future__ import annotations

import io
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from fmu_blocks import blocks
from fmu_runner import Runner
from lxml import etree

from interarea.fmu_build.check.delegated import toolbox_rules
from interarea.fmu_build.finding import Report
from interarea.fmu_build.write.package import build_fmu

SCHEMA = Path(fmpy.__file__).parent / "schema" / "fmi2" / "fmi2ModelDescription.xsd"


@pytest.mark.slow
def test_fmpy_finds_nothing(fmu: Path) -> None:
    assert validate_fmu(str(fmu)) == []


def test_description_obeys_the_schema(fmu: Path) -> None:
    with zipfile.ZipFile(fmu) as archive:
        document = etree.parse(io.BytesIO(archive.read("modelDescription.xml")))
    schema = etree.XMLSchema(etree.parse(str(SCHEMA)))
    assert schema.validate(document), schema.error_log


@pytest.mark.slow
def test_fmutool_finds_nothing(fmu: Path) -> None:
    tool = Path(sys.executable).parent / "fmutool"
    done = subprocess.run([tool, "-input", fmu, "-check"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_toolbox_unpacks_below_a_folder_that_the_next_command_removes(
    fmu: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its own `tmp...` would stay where the process is killed."""
    from fmu_manipulation_toolbox.operations import FMU

    seen: list[Path] = []
    apply = FMU.apply_operation

    def noted(self: FMU, operation: object) -> object:
        seen.append(Path(self.tmp_directory))
        return apply(self, operation)

    monkeypatch.setattr(FMU, "apply_operation", noted)
    toolbox_rules(fmu, "model.fmu", Report(str(fmu)))
    assert len(seen) == 1
    assert any(part.startswith("interarea-") for part in seen[0].parts)
    assert not seen[0].exists()
    assert tempfile.tempdir is None or "interarea-" not in tempfile.tempdir


def test_archive_has_what_a_receiver_needs(fmu: Path) -> None:
    with zipfile.ZipFile(fmu) as archive:
        names = archive.namelist()
        assert names[0] == "modelDescription.xml"
        for expected in ("resources/model.bin", "documentation/index.html", "model.png"):
            assert expected in names
        assert "documentation/licenses/license.txt" in names
        assert all("\\" not in n and not n.startswith("/") and ".." not in n for n in names)
        assert archive.read("model.png").startswith(b"\x89PNG\r\n\x1a\n")
        listed = {e.get("name") for e in etree.fromstring(archive.read("modelDescription.xml")).iter("File")}
        assert listed == {
            n.removeprefix("sources/") for n in names if n.startswith("sources/") and n.endswith(".c")
        }


@pytest.mark.parametrize(
    "kind", ["decay", "controller", "channel", "concentrator", "detector", "pmu", "plant", "loop"]
)
def test_same_block_gives_same_bytes(kind: str, built: dict[str, Path], tmp_path: Path) -> None:
    again = build_fmu(blocks()[kind], tmp_path / "other_name.fmu")
    assert again.read_bytes() == built[kind].read_bytes()


def test_start_values_are_the_binarys_own(fmu: Path) -> None:
    """Nothing is set: every declared start value must be what the binary answers."""
    with Runner(fmu) as run:
        run.fmu.setupExperiment(startTime=0.0)
        run.fmu.enterInitializationMode()
        for v in run.variables.values():
            if v.start is None:
                continue
            got = run.get(v.name)
            expected = {"true": 1.0, "false": 0.0}.get(v.start)
            expected = float(v.start) if expected is None else expected
            # A plant solves its equilibrium again from its parameters: equal to rounding.
            assert np.isclose(got, expected, rtol=1e-12, atol=1e-12), v.name


@pytest.mark.slow
def test_sources_rebuild_to_the_same_behaviour(built: dict[str, Path], tmp_path: Path) -> None:
    """`fmpy compile` makes a binary from sources/ that gives the same bits."""
    if not (shutil.which("cmake") and shutil.which("cc")):
        pytest.skip("fmpy compiles sources/ with CMake and a system compiler, which this machine lacks")
    original, rebuilt = built["controller"], tmp_path / "rebuilt.fmu"
    shutil.copy(original, rebuilt)
    fmpy_command = Path(sys.executable).with_name("fmpy")
    subprocess.run([fmpy_command, "compile", rebuilt], check=True, capture_output=True, timeout=120)
    binary = next(n for n in zipfile.ZipFile(original).namelist() if n.endswith(".so"))
    assert zipfile.ZipFile(original).read(binary) != zipfile.ZipFile(rebuilt).read(binary)
    results = []
    for file in (original, rebuilt):
        with Runner(file) as run:
            run.start({"G2_dw": 0.1, "limit": 10.0})
            results.append(run.run(np.linspace(0.0, 1.0, 11), "G4_vs"))
    assert np.array_equal(*results)
