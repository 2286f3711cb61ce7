"""The master on FMUs that others made: pythonfmu's offer no derivatives, slopes or saved states."""

from __future__ import annotations

import multiprocessing
import shutil
import tempfile
import zipfile
from pathlib import Path

import numpy as np
import pytest

from interarea.cosim.errors import GraphError, StepError
from interarea.cosim.master.instances import FmuParticipant
from interarea.cosim.master.master import Master
from interarea.cosim.master.plan import LoopPlan
from interarea.cosim.results.delay_ledger import delay_ledger, explain
from interarea.fmu_build.errors import FmuFileError
from interarea.fmu_build.open.fmu_file import FmuFile

pythonfmu = pytest.importorskip("pythonfmu.builder")


@pytest.fixture(scope="module")
def lag(tmp_path_factory: pytest.TempPathFactory) -> FmuFile:
    folder = tmp_path_factory.mktemp("pythonfmu")
    script = Path(__file__).parents[3] / "pythonfmus" / "lag.py"
    return FmuFile(pythonfmu.FmuBuilder.build_FMU(script, dest=folder))


def ring(lag: FmuFile, step_s: float, **options: object) -> Master:
    """Two lags, T = 0.5 and 0.2 s, each fed by the other: dx/dt = (z - x)/.5, dz/dt = (x - z)/.2."""
    parts = [FmuParticipant("a", lag, {"T": 0.5}), FmuParticipant("b", lag, {"T": 0.2})]
    parts.append(FmuParticipant("fading", lag, {"T": 0.3}))
    wires = [("a.y", "b.u"), ("b.y", "a.u")]
    return Master(LoopPlan(wires, stop_s=2.0, step_s=step_s, **options), parts)  # type: ignore[arg-type]


def test_a_loop_of_foreign_fmus_runs_without_what_they_lack(lag: FmuFile) -> None:
    with ring(lag, 0.05) as master:
        run = master.run()
        text = explain(master, delay_ledger(master))
    assert "extrapolated: a, b cannot save its state" in text
    assert "not connected: fading.u keeps its start value" in text
    assert delay_ledger(master)["a.u"].note.startswith("no input derivatives")
    # with both at 1 nothing moves; the third fades by its closed form
    np.testing.assert_allclose(run["a.y"], 1.0, rtol=1e-12)
    np.testing.assert_allclose(run["fading.y"], np.exp(-run.time_s / 0.3), rtol=1e-9)


def test_a_driven_foreign_fmu_converges_with_second_order(lag: FmuFile) -> None:
    """a fades, b follows it: closed form of two lags in a row."""
    errors = []
    for h in (0.1, 0.05):
        parts = [FmuParticipant("a", lag, {"T": 0.5}), FmuParticipant("b", lag, {"T": 0.2})]
        with Master(LoopPlan([("a.y", "b.u")], stop_s=2.0, step_s=h), parts) as master:
            run = master.run()
        t = run.time_s
        exact = (0.5 * np.exp(-t / 0.5) - 0.2 * np.exp(-t / 0.2)) / 0.3
        errors.append(np.max(np.abs(run["b.y"] - exact)))
    assert errors[1] <= 1e-3
    assert np.log2(errors[0] / errors[1]) >= 1.8


def test_a_failing_fmu_is_named_with_call_time_and_results_so_far(lag: FmuFile) -> None:
    bad = FmuParticipant("bad", lag, {"spoil_at": 1.0})
    with Master(LoopPlan([], stop_s=2.0, step_s=0.1), [bad]) as master, pytest.raises(StepError) as caught:
        master.run()
    assert (caught.value.instance, caught.value.call, caught.value.time_s) == ("bad", "fmi2DoStep", 1.0)
    assert caught.value.trajectory is not None
    assert caught.value.trajectory.time_s[-1] == 1.0


def test_a_rerun_on_live_instances_gives_the_same_bits(lag: FmuFile) -> None:
    with ring(lag, 0.1) as master:
        first = master.run().data
        saved_error = pytest.raises(GraphError, match="cannot save its state")
        with saved_error:
            master.save()
    with ring(lag, 0.1) as master:
        assert master.run().data.equals(first)


@pytest.mark.parametrize(
    ("start", "says"),
    [
        ({"Tau": 1.0}, r"has no variable 'Tau'"),
        ({"y": 1.0}, r"causality output"),
        ({"T": "long"}, r"wants a number"),
    ],
)
def test_start_values_are_checked(lag: FmuFile, start: dict[str, float], says: str) -> None:
    with pytest.raises(GraphError, match=says):
        FmuParticipant("x", lag, start)


def test_what_is_no_fmi_2_fmu_is_refused(lag: FmuFile, tmp_path: Path) -> None:
    with pytest.raises(FmuFileError, match="no such file, wanted: an FMU"):
        FmuFile(tmp_path / "none.fmu")
    (tmp_path / "text.fmu").write_text("no zip", encoding="utf-8")
    with pytest.raises(FmuFileError, match="not an FMU"):
        FmuFile(tmp_path / "text.fmu")
    for version in ("1.0", "3.0"):
        with pytest.raises(FmuFileError, match=f"is FMI {version}"):
            FmuFile(
                _changed(
                    lag.path, tmp_path / "v.fmu", b'fmiVersion="2.0"', f'fmiVersion="{version}"'.encode()
                )
            )
    bare = tmp_path / "bare.fmu"
    with zipfile.ZipFile(lag.path) as old, zipfile.ZipFile(bare, "w") as new:
        new.writestr("modelDescription.xml", old.read("modelDescription.xml"))
        new.writestr("binaries/other64/x.so", b"")
    with pytest.raises(FmuFileError, match=r"no binary for this platform.*it has other64"):
        FmuFile(bare)


def _changed(path: Path, to: Path, old: bytes, new: bytes) -> Path:
    with zipfile.ZipFile(path) as source, zipfile.ZipFile(to, "w") as target:
        for name in source.namelist():
            target.writestr(
                name, source.read(name).replace(old, new) if name.endswith(".xml") else source.read(name)
            )
    return to


def test_unpacked_files_are_removed(lag: FmuFile, tmp_path: Path) -> None:
    file = FmuFile(Path(shutil.copy(lag.path, tmp_path / "copy.fmu")))
    folder = file.folder
    assert folder.is_dir()
    file.close()
    assert not folder.exists()


def _unpack_in(folder: Path, fmu: Path) -> None:
    tempfile.tempdir = str(folder)
    assert FmuFile(fmu).folder.is_dir()


@pytest.mark.slow
@pytest.mark.parametrize("method", sorted(multiprocessing.get_all_start_methods()))
def test_a_worker_process_leaves_no_unpacked_fmu(lag: FmuFile, tmp_path: Path, method: str) -> None:
    """Children of multiprocessing end without atexit and finalizers: a study left 194 folders behind."""
    child = multiprocessing.get_context(method).Process(target=_unpack_in, args=(tmp_path, lag.path))
    child.start()
    child.join(60)
    assert child.exitcode == 0 and list(tmp_path.iterdir()) == []
