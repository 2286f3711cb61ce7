"""`fmpy compile` rebuilds each FMU from its own sources/ alone, to the same bits."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from fmu_blocks import blocks
from fmu_runner import Runner
from tools.conftest import require

from interarea.cosim.export.container import container_block
from interarea.cosim.scenario.scenario import load_scenario
from interarea.design.controllers.controller import Controller
from interarea.fmu_build.write.package import build_fmu
from interarea.models.blocks.variables import Block

pytestmark = [pytest.mark.tools, pytest.mark.slow]
SCENARIO = {
    "name": "loop",
    "case": "two-area-thesis",
    "controller": "ftc",
    "stop_s": 1.0,
    "step_s": 0.01,
    "channels": {"remote": {"signal": "G2_dw", "latency_s": 0.05}},
    "event": [{"kind": "bus_fault", "bus": 8, "start_s": 0.1, "end_s": 0.15, "x_pu": 1e-4}],
}
#: what goes in, so that something comes out
START = {"plant": {"G4_vs": 0.01}, "channel": {"u": 0.5, "outage[1].start": 0.3, "outage[1].end": 0.4}}


def compiled(fmu: Path, folder: Path) -> Path:
    """Return the FMU with the binary that `fmpy compile` makes, with this machine's compiler or zig."""
    require("cmake")
    rebuilt = folder / f"rebuilt_{fmu.name}"
    shutil.copy(fmu, rebuilt)
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    if shutil.which("cc") is None:
        compiler = folder / "cc"
        compiler.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m ziglang cc "$@"\n', encoding="utf-8")
        compiler.chmod(0o755)
        environment["CC"] = str(compiler)
    command = [str(Path(sys.executable).with_name("fmpy")), "compile", str(rebuilt)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=280)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    return rebuilt


def bits(fmu: Path, start: dict[str, float]) -> npt.NDArray[np.float64]:
    """Return every Real after each of 50 steps."""
    with Runner(fmu) as run:
        run.start(start)
        rows = []
        for k in range(50):
            run.step(k * 0.01, 0.01)
            rows.append(run.every_real())
    return np.array(rows)


@pytest.mark.parametrize("kind", ["controller", "channel", "plant", "loop"])
def test_sources_rebuild_to_the_same_bits(
    kind: str, cache: Path, by_hand: Controller, tmp_path: Path
) -> None:
    block: Block
    if kind == "loop":
        block = container_block(load_scenario(SCENARIO), cache=cache, controller=by_hand)
    else:
        block = blocks()[kind]
    fmu = build_fmu(block, tmp_path, cache=cache)
    rebuilt = compiled(fmu, tmp_path)
    with zipfile.ZipFile(fmu) as before, zipfile.ZipFile(rebuilt) as after:
        (binary,) = [n for n in before.namelist() if n.startswith("binaries/")]
        assert before.read(binary) != after.read(binary)
    start = START.get(kind, {"G2_dw": 0.01} if kind == "controller" else {})
    expected = bits(fmu, start)
    assert np.any(np.ptp(expected, axis=0) > 0.0)
    assert np.array_equal(bits(rebuilt, start), expected)
