"""An error of the machine ends a sweep, wherever in the chain of causes it stands, and is never a row."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

from interarea.cosim.errors import StepError, SweepError, machine_error
from interarea.cosim.sweep.plan import plan_sweep
from interarea.cosim.sweep.runner import Runner
from interarea.cosim.sweep.spec import load_sweep
from interarea.cosim.sweep.workers import dask_cluster

SWEEP = {
    "scenario": {"case": "two-area-thesis", "stop_s": 0.5},
    "parameters": {"load": {"path": "case.load_scale", "values": [1.0, 1.01]}},
}


def wrapped(error: BaseException) -> StepError:
    """Return a step's error that was caused by another, two links down the chain."""
    try:
        try:
            try:
                raise error
            except BaseException as first:
                raise RuntimeError("cannot be opened") from first
        except RuntimeError as second:
            raise StepError("no instance", instance="plant", call="fmi2Instantiate", time_s=None) from second
    except StepError as error:
        return error


@pytest.mark.parametrize("name", ["ENOSPC", "EDQUOT", "EFBIG", "EMFILE", "EIO", "ENOMEM"])
def test_it_is_found_among_the_causes(name: str) -> None:
    number = getattr(errno, name)
    result = machine_error(wrapped(OSError(number, "said the system")))
    assert result is not None and result.errno == number
    assert machine_error(wrapped(OSError(errno.ENOENT, "no such file"))) is None
    assert machine_error(ValueError("no such case")) is None


def test_memory_that_runs_out_is_one_too() -> None:
    result = machine_error(wrapped(MemoryError()))
    assert result is not None and result.errno == errno.ENOMEM


def test_a_sweep_ends_with_it(cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise wrapped(OSError(errno.EFBIG, "File too large"))

    monkeypatch.setattr("interarea.cosim.sweep.runner.system_of", full)
    with (
        Runner(plan_sweep(load_sweep(SWEEP), cache), cache, tmp_path) as runner,
        pytest.raises(OSError, match="File too large"),
    ):
        list(runner.outcomes([0, 1]))


@pytest.mark.parametrize(
    ("error", "says"),
    [
        (OSError(errno.ENOSPC, "No space left on device", "x.bin"), "x.bin: No space left"),
        (MemoryError(), ""),
    ],
)
def test_a_worker_of_a_cluster_ends_the_sweep_too(
    error: BaseException, says: str, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On whatever it fails there: a sweep's error goes back, which is never taken for a row."""

    def failing(*_: object) -> None:
        raise error

    monkeypatch.setattr(dask_cluster, "_runner", failing)
    document = plan_sweep(load_sweep(SWEEP), cache).document()
    with pytest.raises(SweepError, match=f"a worker on .*: {says}"):
        dask_cluster.compute([0], [""], document)
