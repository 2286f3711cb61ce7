"""DLLs of linux64 and win64 give the same bits in a C host: INTERAREA_DLL_STEPS calls, win64 under Wine."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from platforms.test_same_bits import FMU_FLAGS, emulator_of

from interarea.cosim.run.controllers import controller_of
from interarea.fmu_build.write.cache import COMPILERS_OWN
from interarea.fmu_build.write.compile import SYSTEM_LIBRARIES
from interarea.fmu_build.write.real_code import DLL_PLATFORMS, build_dll
from interarea.models.blocks.channel import channel_block
from interarea.models.case.case import load_case

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(900),
    pytest.mark.skipif(sys.platform != "linux", reason="Wine runs on Linux"),
]
HOST = Path(__file__).with_name("dll_host.c")
STEP = 0.001
COUNT = int(os.environ.get("INTERAREA_DLL_STEPS", "20000"))
CHANNEL = ("latency=0.1", "reporting_interval=0.02", "jitter=0.03", "loss_good=0.1", "loss_bad=0.1", "seed=5")


def host(name: str, folder: Path, cache: Path) -> Path:
    """Return the host compiled for a platform."""
    kept = (cache / COMPILERS_OWN).absolute()
    folders = {"GLOBAL": SYSTEM_LIBRARIES, "LOCAL": "objects"}
    environment = {**os.environ} | {f"ZIG_{k}_CACHE_DIR": str(kept / part) for k, part in folders.items()}
    header = Path(__file__).parents[2] / "fmu_build" / "c" / "dll"
    command = [sys.executable, "-m", "ziglang", "cc", "-target", DLL_PLATFORMS[name].targets[0], *FMU_FLAGS]
    compiled, program = folder / f"{name}.o", folder / f"{name}.exe"
    for words in (
        ["-c", f"-I{header}", str(HOST), "-o", str(compiled)],
        [str(compiled), "-o", str(program), *(["-ldl"] if name == "linux64" else [])],
    ):
        subprocess.run([*command, *words], check=True, env=environment, capture_output=True)
    return program


@pytest.mark.parametrize("kind", ["controller", "channel"])
@pytest.mark.parametrize("name", ["win64"])
def test_a_windows_dll_has_the_bits_of_the_linux_one(
    name: str, kind: str, tmp_path: Path, cache: Path
) -> None:
    case = load_case("two-area-thesis")
    controller = controller_of("robust", case, cache)
    assert controller is not None
    block = controller.block(case.omega_b) if kind == "controller" else channel_block(capacity=512)
    rows = {}
    for platform in ("linux64", name):
        emulator = emulator_of("linux64" if platform == "linux64" else "win64", tmp_path)
        library = build_dll(block, tmp_path, platform=platform, sample_time_s=STEP, cache=cache)
        command = [
            *emulator.command,
            str(host(platform, tmp_path, cache)),
            str(library),
            str(STEP),
            str(COUNT),
        ]
        done = subprocess.run(
            [*command, *(CHANNEL if kind == "channel" else ())],
            env={**os.environ, **emulator.environment},
            capture_output=True,
            text=True,
            check=False,
            timeout=400,
        )
        assert done.returncode == 0, done.stderr
        rows[platform] = done.stdout.split()
    assert len(set(rows["linux64"])) == 100
    assert rows[name] == rows["linux64"]
