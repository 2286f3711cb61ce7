"""extra/: the reference belongs to the FMU, and another way to the same numbers agrees with it."""

from __future__ import annotations

import csv
import io
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import fmpy
import numpy as np
import numpy.typing as npt
import pytest
from fmpy.validation import validate_fmu
from fmu_blocks import A, B, C, blocks
from fmu_runner import Runner
from scipy.signal import lsim

from interarea.cli.app import main
from interarea.fmu_build.errors import FmuFileError
from interarea.fmu_build.open.cross_check import add_cross_check, complete_fmu
from interarea.fmu_build.write.package import build_fmu

Array = npt.NDArray[np.float64]


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return the FMU of each kind with its cross-check files, 2 s long."""
    folder = tmp_path_factory.mktemp("complete")
    built = {}
    for kind, block in blocks().items():
        plain = build_fmu(replace(block, stop_s=2.0), folder / f"{kind}_plain.fmu")
        built[kind] = add_cross_check(plain, folder / f"{kind}.fmu")
    return built


def table_of(fmu: Path, ending: str) -> tuple[list[str], Array]:
    with zipfile.ZipFile(fmu) as archive:
        (name,) = [n for n in archive.namelist() if n.endswith(ending)]
        rows = list(csv.reader(io.StringIO(archive.read(name).decode("utf-8"))))
    return rows[0], np.array(rows[1:], dtype=float)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["decay", "controller", "channel", "plant"])
def test_layout_is_the_cross_checks(kind: str, fmus: dict[str, Path]) -> None:
    model = fmpy.read_model_description(str(fmus[kind]))
    with zipfile.ZipFile(fmus[kind]) as archive:
        options = dict(
            line.split(", ")
            for line in archive.read(f"extra/{model.modelName}_ref.opt").decode("utf-8").splitlines()
        )
    assert list(options) == ["StartTime", "StopTime", "StepSize", "RelTol"]
    assert float(options["StopTime"]) == pytest.approx(2.0)
    inputs, signals = table_of(fmus[kind], "_in.csv")
    outputs, reference = table_of(fmus[kind], "_ref.csv")
    assert inputs == ["time", *(v.name for v in model.modelVariables if v.causality == "input")]
    assert set(outputs[1:]) <= {v.name for v in model.modelVariables if v.causality == "output"}
    assert np.all(np.diff(signals[:, 0]) > 0.0)
    assert np.allclose(reference[:, 0], np.arange(len(reference)) * float(options["StepSize"]))
    assert np.all(np.ptp(signals[:, 1:], axis=0) > 0.0)
    assert validate_fmu(str(fmus[kind])) == []


@pytest.mark.parametrize("kind", ["decay", "controller", "channel", "plant"])
def test_half_the_step_gives_the_reference(kind: str, fmus: dict[str, Path]) -> None:
    """The files are enough to repeat the run: straight lines between the rows of the input."""
    names, reference = table_of(fmus[kind], "_ref.csv")
    inputs, signals = table_of(fmus[kind], "_in.csv")
    half = float(reference[1, 0]) / 2.0
    rows = []
    with Runner(fmus[kind]) as run:
        run.start()
        for k in range(2 * (len(reference) - 1)):
            for j, name in enumerate(inputs[1:], start=1):
                now, then = np.interp([k * half, (k + 1) * half], signals[:, 0], signals[:, j])
                run.set_of({name: float(now)})
                run.slopes(name, float((then - now) / half))
            run.step(k * half, half)
            rows.append([run.get(n) for n in names[1:]])
    result = np.array(rows, dtype=float)[1::2]
    scale = np.maximum(np.ptp(reference[:, 1:], axis=0), 1e-3)
    assert np.all(np.max(np.abs(result - reference[1:, 1:]), axis=0) <= 1e-5 * scale)


def test_linear_controller_agrees_with_scipy(fmus: dict[str, Path]) -> None:
    inputs, signals = table_of(fmus["controller"], "_in.csv")
    _, reference = table_of(fmus["controller"], "_ref.csv")
    t = reference[:, 0]
    u = np.column_stack([np.interp(t, signals[:, 0], signals[:, j]) for j in range(1, len(inputs))])
    _, y, _ = lsim((A, B, C, np.zeros((1, 2))), u, t)
    assert np.max(np.abs(reference[:, 1] - y)) <= 1e-8 * np.ptp(y) + 1e-12


def test_the_rest_of_the_archive_stays_as_it_was_and_bytes_repeat(
    fmus: dict[str, Path], tmp_path: Path, cache: Path
) -> None:
    plain = fmus["controller"].with_name("controller_plain.fmu")
    again = add_cross_check(plain, tmp_path / "again.fmu")
    assert again.read_bytes() == fmus["controller"].read_bytes()
    assert complete_fmu(plain, cache).read_bytes() == again.read_bytes()
    with zipfile.ZipFile(plain) as before, zipfile.ZipFile(again) as after:
        assert {n: before.read(n) for n in before.namelist()} == {
            n: after.read(n) for n in after.namelist() if not n.startswith("extra/")
        }


def test_fmu_that_cannot_run_here(fmus: dict[str, Path], tmp_path: Path, cache: Path) -> None:
    foreign = tmp_path / "foreign.fmu"
    with zipfile.ZipFile(fmus["decay"]) as archive, zipfile.ZipFile(foreign, "w") as copy:
        for name in archive.namelist():
            if not name.startswith(("binaries/", "extra/")):
                copy.writestr(name, archive.read(name))
    assert complete_fmu(foreign, cache) == foreign
    with pytest.raises(FmuFileError, match=r"foreign.fmu: has no binary for this platform"):
        add_cross_check(foreign, tmp_path / "never.fmu")
    assert not (tmp_path / "never.fmu").exists()


@pytest.mark.slow
def test_build_writes_plant_channel_and_controller_complete(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    words = ["interarea", "build", "two-area-thesis", "--controller", "robust", "--out", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", words)
    with pytest.raises(SystemExit) as stopped:
        main()
    assert not stopped.value.code
    printed = [Path(line) for line in capfd.readouterr().out.split()]
    assert [f.name for f in printed] == ["two-area-thesis.fmu", "channel.fmu", "robust.fmu"]
    for fmu in printed:
        assert table_of(fmu, "_ref.csv")[1].shape[0] == 2001
