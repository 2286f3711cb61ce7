"""DLLs of linux64, win64 and win32 give the same bits in a C host: INTERAREA_DLL_STEPS calls, under Wine.

INTERAREA_WINE32: command that runs a 32-bit Windows program (Debian: `wine` of the architecture i386).
"""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from platforms.test_same_bits import Emulator, emulator_of, program

from interarea.cosim.run.controllers import controller_of
from interarea.fmu_build.open.images import read_image
from interarea.fmu_build.write.real_code import DLL_PLATFORMS, Chain, build_dll
from interarea.models.blocks.channel import channel_block
from interarea.models.blocks.pmu import pmu_block
from interarea.models.blocks.variables import Block
from interarea.models.case.case import load_case

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(900),
    pytest.mark.skipif(sys.platform != "linux", reason="Wine runs on Linux"),
]
HOST = Path(__file__).with_name("dll_host.c")
HEADERS = Path(__file__).parents[2] / "fmu_build" / "c" / "dll"
STEP = 0.001
COUNT = int(os.environ.get("INTERAREA_DLL_STEPS", "20000"))
CHANNEL = ("latency=0.1", "reporting_interval=0.02", "jitter=0.03", "loss_good=0.1", "loss_bad=0.1", "seed=5")


def emulator(name: str, folder: Path) -> Emulator:
    """Return what runs programs of a platform; skip where there is nothing."""
    if name != "win32":
        return emulator_of(name, folder)
    command = os.environ.get("INTERAREA_WINE32", "")
    if not command:
        pytest.skip("INTERAREA_WINE32 names no command that runs 32-bit Windows programs")
    return Emulator(tuple(shlex.split(command)), {"WINEDEBUG": "-all"})


@pytest.fixture(scope="module")
def wine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of Wine's files, which take it ten seconds to write."""
    return tmp_path_factory.mktemp("wine")


@pytest.fixture(scope="module")
def blocks(cache: Path) -> dict[str, Block | Chain]:
    """Return a block of each kind, and a chain."""
    case = load_case("two-area-thesis")
    robust, bank = (controller_of(name, case, cache) for name in ("robust", "active"))
    assert robust is not None and bank is not None
    controller, channel, pmu = robust.block(case.omega_b), channel_block(capacity=512), pmu_block(capacity=64)
    members = {"pmu": pmu, "remote": channel, "controller": controller}
    chain = Chain("wide", members, [("pmu.deviation", "remote.u"), ("remote.y", "controller.G2_dw")])
    supervisor = bank.block(case.omega_b)
    return {
        "controller": controller,
        "supervisor": supervisor,
        "channel": channel,
        "pmu": pmu,
        "chain": chain,
    }


@pytest.mark.parametrize("kind", ["controller", "supervisor", "channel", "pmu", "chain"])
@pytest.mark.parametrize("name", ["win64", "win32"])
def test_a_windows_dll_has_the_bits_of_the_linux_one(
    name: str, kind: str, blocks: dict[str, Block | Chain], wine: Path, tmp_path: Path, cache: Path
) -> None:
    rows = {}
    channel = CHANNEL if kind == "channel" else [f"remote_{p}" for p in CHANNEL] if kind == "chain" else ()
    for platform in ("linux64", name):
        tool = emulator(platform, wine)
        library = build_dll(blocks[kind], tmp_path, platform=platform, sample_time_s=STEP, cache=cache)
        assert all(name.startswith("Model_") for name in read_image(library.read_bytes()).exports)
        host = program(HOST, DLL_PLATFORMS[platform], HEADERS, tmp_path, cache)
        done = subprocess.run(
            [*tool.command, str(host), str(library), str(STEP), str(COUNT), *channel],
            env={**os.environ, **tool.environment},
            capture_output=True,
            text=True,
            check=False,
            timeout=800,
        )
        assert done.returncode == 0, done.stderr
        rows[platform] = done.stdout.split()
    assert len(set(rows["linux64"])) == 100
    assert rows[name] == rows["linux64"]
