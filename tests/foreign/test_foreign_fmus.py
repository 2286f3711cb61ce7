"""FMUs that other tools made: each runs, or is refused for a true reason."""

from __future__ import annotations

import platform
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from fetch import Foreign, corpus

from interarea.cosim.errors import StepError
from interarea.cosim.run.system import System
from interarea.fmu_build.check.check import check_file
from interarea.fmu_build.errors import FmuFileError

FMUS = corpus()
REFERENCE = [f for f in FMUS if f.tool == "Reference FMUs"]


MISSING = "cannot open shared object file"


def local_file(fmu: Foreign) -> Path:
    """Return the file of an FMU; skip the test where it was not fetched."""
    if not fmu.there:
        pytest.skip(f"{fmu.file.name} is not in {fmu.file.parent}; tests/foreign/fetch.py fetches it")
    return fmu.file


def test_the_corpus_names_enough_tools_and_each_fmu_once() -> None:
    tools = {f.tool for f in FMUS}
    assert len(FMUS) >= 90 and len(tools) >= 15
    assert len({f.sha256 for f in FMUS}) == len({f.url for f in FMUS}) == len(FMUS)
    assert all(len(f.sha256) == 64 and len(f.commit) == 40 for f in FMUS)


@pytest.mark.slow
@pytest.mark.skipif(
    platform.machine() != "x86_64" or sys.platform != "linux", reason="as Linux on x86-64 says"
)
@pytest.mark.parametrize("fmu", FMUS, ids=lambda f: f"{f.tool}-{Path(f.path).stem}")
def test_runs_or_says_why(fmu: Foreign) -> None:
    """Half a second in a process of its own: all its points, or the one line that corpus.csv has."""
    file = local_file(fmu)
    said, points = "", 0
    try:
        result = System(stop_s=0.5, step_s=0.01).fmu("x", file, isolate=True).run()
        points = len(result.trajectory.time_s)
        assert np.isfinite(result.trajectory.time_s).all()
        assert all(
            "breaks the standard" in line or "nothing is connected" in line for line in result.warnings
        )
    except (FmuFileError, StepError) as error:
        said = str(error)
    if fmu.refused == MISSING and not said:
        return  # a library that is missing on most machines is here
    assert "\n" not in said and fmu.refused in said and bool(said) == bool(fmu.refused), said
    assert points == (51 if not said else 0)


#: what is wrong with Reference FMUs 0.0.1 and 0.0.31, by rule
TRUE = {
    "FMI2 2.2.7 causality, variability, initial": "a parameter is constant",
    "FMI2 2.2.9 variable names": "the same, told by another tool",
    "FMI2 2.2.7 start": "a start value where initial is calculated",
    "FMI2 2.2.7 continuous": "an Integer without variability, which is continuous then",
    "FMI2 2.2.8 InitialUnknowns": "an output is missing there",
    "FMI2 2.2.8 dependencies": "states and inputs passed on declare that they depend on nothing",
    "FMI2 3.2.3, 4.2.4 call sequence": "fixed parameters are taken after initialization, steps before it",
    "FMI2 4.3.1 variable communication step": "whole Euler steps of its own only",
    "binary symbols": "all functions are exported",
}


@pytest.mark.slow
@pytest.mark.parametrize("fmu", REFERENCE, ids=lambda f: f"{f.commit[:4]}-{Path(f.path).stem}")
def test_check_tells_nothing_false_of_reference_fmus(fmu: Foreign) -> None:
    report = check_file(local_file(fmu))
    assert [f.line() for f in report.findings if f.rule not in TRUE] == []
    assert not any("input" in f.message for f in report.findings), "no input is set where it must not be"
