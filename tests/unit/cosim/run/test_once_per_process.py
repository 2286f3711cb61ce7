"""An FMU that can be instantiated only once per process: its second instance has a process of its own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from misbehaving import misbehaving_fmu

from interarea.cosim.errors import StepError
from interarea.cosim.master.instances import FmuParticipant
from interarea.cosim.master.isolated import WorkerParticipant, participant_of
from interarea.cosim.run.system import System
from interarea.fmu_build.open.fmu_file import FmuFile


def chain(file: Path) -> System:
    """a: y = 1 + 2 t, b: dy/dt = a.y; each refuses to begin beside another in its process."""
    system = System(stop_s=0.1, step_s=0.01)
    system.fmu("a", file, alone=0.0, x0=1.0, u=2.0).fmu("b", file, alone=0.0)
    return system.connect("a.y", "b.u")


@pytest.mark.slow
def test_the_second_instance_runs_apart(tmp_path: Path) -> None:
    result = chain(misbehaving_fmu(tmp_path, once=True)).run()
    t = result["time_s"]
    np.testing.assert_allclose(result["b.y"], t + t**2, atol=1e-12)


def test_without_the_flag_both_are_here_and_this_fmu_says_so(tmp_path: Path) -> None:
    with pytest.raises(StepError, match="2 instances"):
        chain(misbehaving_fmu(tmp_path)).run()


def test_the_first_instance_is_here_again_when_the_other_has_ended(tmp_path: Path) -> None:
    """By the guid: a copy of the file is the same model."""
    file = FmuFile(misbehaving_fmu(tmp_path / "1", once=True))
    copy = FmuFile(misbehaving_fmu(tmp_path / "2", once=True))
    first = participant_of("a", file, {})
    second = participant_of("b", copy, {})
    assert type(first) is FmuParticipant and type(second) is WorkerParticipant
    first.close()
    assert type(participant_of("c", copy, {})) is FmuParticipant
