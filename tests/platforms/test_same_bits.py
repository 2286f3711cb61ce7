"""The same numbers to the bit on linux64, win64 (under Wine) and linux-arm64 (under qemu-user).

Each FMU's own binary of each platform is loaded by `driver.c`, compiled for that platform, and driven
through events, outages and lost packets; every state and output of every step is compared as 64 bits.
Debian: `apt-get install wine64 qemu-user libc6-arm64-cross`. Without an emulator its test is skipped;
with INTERAREA_REQUIRE_EMULATORS=1 that is a failure.
"""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import fmpy
import pytest
from zig_compiler import zig_cc

from interarea.cosim.export.container import container_block
from interarea.cosim.export.instances import members_of
from interarea.cosim.scenario.scenario import load_scenario
from interarea.design.controllers.controller import Controller
from interarea.fmu_build.write.compile import PLATFORMS, Platform
from interarea.fmu_build.write.package import build_fmu
from interarea.fmu_build.write.sources import fmi_headers

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(900),  # builds four binaries for three platforms from nothing
    pytest.mark.skipif(
        (sys.platform, platform.machine()) != ("linux", "x86_64"), reason="the emulators run on x86-64 Linux"
    ),
]
#: with any other ones zig would make the libraries of a platform, a minute each, once more
FMU_FLAGS = (
    "-std=c99",
    "-O2",
    "-ffp-contract=off",
    "-fvisibility=hidden",
    "-fno-ident",
    "-g0",
    "-fcx-limited-range",
)
EMULATED = ("win64", "linux-arm64")
STEP, COUNT = 0.01, 100
SCENARIO = {
    "name": "bits",
    "case": "two-area-thesis",
    "controller": "ftc",
    "stop_s": 1.0,
    "step_s": STEP,
    "channels": {
        "remote": {
            "signal": "G2_dw",
            "latency_s": 0.03,
            "reporting_interval_s": 0.02,
            "jitter_s": 0.02,
            "loss": {"kind": "bernoulli", "rate": 0.2},
            "outages_s": [[0.6, 0.7]],
            "seed": 3,
        }
    },
    "event": [
        {"kind": "bus_fault", "bus": 8, "start_s": 0.1, "end_s": 0.1833, "x_pu": 1e-4},
        {"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 0.3, "end_s": 0.5},
    ],
}
#: inputs as (name, value and slope per second), so that something goes in
INPUTS = {"plant": {"G4_vs": 0.01}, "controller": {"G2_dw": 0.002, "G4_dw": -0.001}, "remote": {"u": 0.3}}


@dataclass(frozen=True)
class Emulator:
    """How to start a program of another platform."""

    command: tuple[str, ...]
    environment: Mapping[str, str]


def emulator_of(name: str, folder: Path) -> Emulator:
    """Return the emulator of a platform; skip, or fail where they are required, when it is missing."""
    if name == "linux64":
        return Emulator((), {})
    if name == "win64":
        result = shutil.which("wine64") or shutil.which("wine64", path="/usr/lib/wine:/usr/lib/wine64")
        if result:
            quiet = {"WINEDEBUG": "-all", "WINEPREFIX": str(folder / "wine"), "DISPLAY": ""}
            return Emulator((result,), quiet)
        missing = "wine64 is not installed (Debian: apt-get install wine64)"
    else:
        result = shutil.which("qemu-aarch64") or shutil.which("qemu-aarch64-static")
        root = Path("/usr/aarch64-linux-gnu")
        if result and (root / "lib" / "ld-linux-aarch64.so.1").exists():
            return Emulator((result, "-L", str(root)), {})
        missing = "qemu-aarch64 is not installed (Debian: apt-get install qemu-user libc6-arm64-cross)"
    if os.environ.get("INTERAREA_REQUIRE_EMULATORS") == "1":
        pytest.fail(missing)
    pytest.skip(missing)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the FMUs, drivers and Wine's files."""
    return tmp_path_factory.mktemp("platforms")


@pytest.fixture(scope="module")
def fmus(cache: Path, by_hand: Controller, folder: Path) -> dict[str, Path]:
    """Return the unpacked FMUs, each with the binaries of all platforms compared here."""
    scenario = load_scenario(SCENARIO)
    blocks = {m.name: m.baked() for m in members_of(scenario, cache=cache, controller=by_hand).all}
    blocks["loop"] = container_block(scenario, cache=cache, controller=by_hand)
    for name, block in blocks.items():
        file = build_fmu(block, folder / f"{name}.fmu", platforms=("linux64", *EMULATED), cache=cache)
        fmpy.extract(str(file), str(folder / name))
    return {name: folder / name for name in blocks}


@pytest.fixture(scope="module")
def drivers(cache: Path, folder: Path) -> dict[str, Path]:
    """Return `driver.c` compiled for each platform."""
    source = Path(__file__).with_name("driver.c")
    names = ("linux64", *EMULATED)
    return {name: program(source, PLATFORMS[name], fmi_headers(), folder, cache) for name in names}


def program(source: Path, to: Platform, headers: Path, folder: Path, cache: Path) -> Path:
    """Return a program of one C file for a platform.

    With the flags of FMUs and DLLs: then zig finds the platform's libraries that it made for those.
    """
    compiled, linked = (folder / f"{source.stem}-{to.name}.{end}" for end in ("o", "exe"))
    runtime = ["-rtlib=none"] if to.suffix == ".so" else []  # of zig, of which no line is needed
    for words in (
        ["-c", f"-I{headers}", str(source), "-o", str(compiled)],
        ["-Wl,-s", *runtime, str(compiled), "-o", str(linked)],
    ):
        zig_cc([*FMU_FLAGS, *words], cache, to.targets[0])
    return linked


def printed(name: str, fmu: Path, driver: Path, folder: Path, inputs: Mapping[str, float]) -> list[str]:
    """Return the lines of bits that `driver` prints of an unpacked FMU on platform `name`."""
    emulator = emulator_of(name, folder)
    model = fmpy.read_model_description(str(fmu))
    reference = {v.name: v.valueReference for v in model.modelVariables}
    reals = [v for v in model.modelVariables if v.type == "Real" and v.causality in ("output", "local")]
    binary = f"{model.coSimulation.modelIdentifier}{PLATFORMS[name].suffix}"
    library = fmu / "binaries" / PLATFORMS[name].folder / binary
    resources = (fmu / "resources").as_uri()
    if name == "win64":  # Wine shows the root of the file system as drive Z
        resources = resources.replace("file:///", "file:///Z:/")
    command = [*emulator.command, str(driver), str(library), model.guid, resources, str(STEP), str(COUNT)]
    command.append(",".join(str(v.valueReference) for v in reals))
    command += [f"{reference[n]}={value}" for n, value in inputs.items()]
    done = subprocess.run(
        command,
        env={**os.environ, **emulator.environment},
        capture_output=True,
        text=True,
        check=False,
        timeout=280,
    )
    assert done.returncode == 0, f"{name}: exit code {done.returncode}\n{done.stderr[-2000:]}"
    return done.stdout.splitlines()


@pytest.mark.parametrize("name", EMULATED)
@pytest.mark.parametrize("member", ["plant", "controller", "remote", "loop"])
def test_every_state_and_output_has_the_same_bits(
    name: str, member: str, fmus: dict[str, Path], drivers: dict[str, Path], folder: Path
) -> None:
    inputs = INPUTS.get(member, {})
    local = printed("linux64", fmus[member], drivers["linux64"], folder, inputs)
    there = printed(name, fmus[member], drivers[name], folder, inputs)
    assert len(local) == COUNT + 1
    assert len(set(local)) > 20  # something happens
    different = [k for k, (a, b) in enumerate(zip(local, there, strict=True)) if a != b]
    assert not different, f"first difference after {different[0] * STEP:g} s"
