"""Start values of any name for an FMU that is added in Python."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path

import numpy as np
import pytest
from misbehaving import misbehaving_fmu

from interarea.cosim.errors import GraphError
from interarea.cosim.run.system import System


def renamed(folder: Path, name: str) -> Path:
    """The integrator, its start value x0 called `name`."""
    file, path = misbehaving_fmu(folder), folder / "renamed.fmu"
    with zipfile.ZipFile(file) as old, zipfile.ZipFile(path, "w") as new:
        for entry in old.namelist():
            new.writestr(entry, old.read(entry).replace(b'name="x0"', f'name="{name}"'.encode()))
    return path


@pytest.mark.parametrize("name", ["name", "file", "start", "latency_s", "isolate", "time_limit_s", "self"])
def test_every_name_can_be_set(tmp_path: Path, name: str) -> None:
    system = System(stop_s=0.02, step_s=0.01).fmu("a", renamed(tmp_path, name), start={name: 3.0})
    assert system.latency_s == {} and system.parts["a"].process["isolate"] is False
    np.testing.assert_allclose(system.run()["a.y"], 3.0)


def test_keywords_still_set_values(tmp_path: Path) -> None:
    np.testing.assert_allclose(System(stop_s=0.02).fmu("a", renamed(tmp_path, "k"), k=2.0).run()["a.y"], 2.0)


@pytest.mark.parametrize(
    ("name", "keywords", "says"),
    [
        (
            "latency_s",
            {"latency_s": 3.0},
            "latency_s = 3.0 is an option here, and renamed.fmu",
        ),
        ("time_limit_s", {"time_limit_s": 3.0, "isolate": True}, "time_limit_s = 3.0 is an option here"),
        ("isolate", {"isolate": True}, "give the variable in start={'isolate': ...}"),
        ("start", {"start": 3.0}, "start = 3.0, allowed: start values by name; of a variable called start"),
        ("k", {"start": {"k": 1.0}, "k": 1.0}, "k is given twice"),
        ("k", {"start": {"kk": 1.0}}, "has no variable 'kk'; did you mean 'kick' or 'k'"),
    ],
)
def test_what_may_be_meant_in_two_ways_is_refused(
    tmp_path: Path, name: str, keywords: dict[str, object], says: str
) -> None:
    with pytest.raises(GraphError, match=re.escape(says)):
        System(stop_s=0.02).fmu("a", renamed(tmp_path, name), **keywords)  # type: ignore[arg-type]


def test_an_option_is_taken_where_the_variable_has_its_value_too(tmp_path: Path) -> None:
    file = renamed(tmp_path, "latency_s")
    system = System(stop_s=0.02).fmu("a", file, start={"latency_s": 0.0}, latency_s=0.1)
    assert system.latency_s == {"a": 0.1}
