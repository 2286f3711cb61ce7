"""Run FMUs and SSPs in foreign tools, each in a process of its own.

A tool that is not installed is skipped; with INTERAREA_REQUIRE_TOOLS=1 it is a failure
(`pip install -e ".[tools]"` brings them all).
"""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

Result = dict[str, npt.NDArray[np.float64]]
RunTool = Callable[..., Result]
_PACKAGE = {"ecos": "ecospy", "libcosim": "libcosimpy", "cofmupy": "cofmupy", "fmpy": "fmpy"}


def require(package: str) -> None:
    """Skip, or fail where tools are required, when `package` is not installed."""
    if importlib.util.find_spec(package) is None:
        missing = f"{package} is not installed; `pip install -e '.[tools]'` brings it"
        if os.environ.get("INTERAREA_REQUIRE_TOOLS") == "1":
            pytest.fail(missing)
        pytest.skip(missing)


@pytest.fixture
def run_tool(tmp_path: Path) -> RunTool:
    """Return a function (driver, file, step_s, stop_s, names) -> {"time": ..., name: ...}."""

    def run(driver: str, file: Path, step_s: float, stop_s: float, names: list[str]) -> Result:
        require(_PACKAGE[driver.partition("_")[0]])
        out = tmp_path / f"{driver}.npz"
        command = [sys.executable, str(Path(__file__).with_name("drivers.py")), driver, str(file)]
        command += [str(step_s), str(stop_s), str(out), *names]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
        assert done.returncode == 0, f"{driver}: exit code {done.returncode}\n{done.stderr[-3000:]}"
        with np.load(out) as result:
            return dict(result)

    return run
