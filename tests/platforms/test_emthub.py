"""The public examples of EMTHub (github temcdrm/emthub, Apache-2.0) with our check, loader and library.

INTERAREA_EMTHUB: folder of a checkout. Nothing of it is part of this repository.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from platforms.test_same_bits import emulator_of
from zig_compiler import zig_cc

from interarea.cosim.run.system import System
from interarea.fmu_build.check.check import check_file
from interarea.fmu_build.open.real_code import ERROR, RealCode, RealCodeLibrary
from interarea.fmu_build.write.real_code import DLL_PLATFORMS, build_dll
from interarea.models.blocks.controller import controller_block
from interarea.models.case.case import load_case
from interarea.models.devices.library import library
from interarea.models.devices.rest import rest_of

EMTHUB = Path(os.environ.get("INTERAREA_EMTHUB", "not-there")).absolute()
DLL = EMTHUB / "dll"
FLAGS = ["-O1", "-w", f"-I{DLL / 'include'}"]
pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(900),
    pytest.mark.skipif(not DLL.is_dir(), reason="INTERAREA_EMTHUB names no checkout of temcdrm/emthub"),
    pytest.mark.skipif(sys.platform != "linux", reason="compiled for Linux and for Wine"),
]
EXAMPLES = {"scrx9/SCRX9.c": 1, "gfm_gfl_ibr/GFM_GFL_IBR.c": 1, "gfm_gfl_ibr2/gfm_gfl_ibr2.c": 1}
INPUTS = ("VRef", "Ec", "Vs", "IFD", "VT", "VUEL", "VOEL")


def example(source: str, folder: Path, cache: Path, step_s: float = 0.005) -> Path:
    """Return an example as a library for Linux; `step_s` in place of its own 5 ms."""
    text = (DLL / source).read_text(encoding="utf-8", errors="replace")
    own = ".FixedStepBaseSampleTime = 0.005"
    assert step_s == 0.005 or own in text
    copy = folder / f"{step_s:g}" / Path(source).name  # a loader takes the same path for the same library
    copy.parent.mkdir(exist_ok=True)
    copy.write_text(text.replace(own, f".FixedStepBaseSampleTime = {step_s:g}"), encoding="utf-8")
    (copy.parent / "windows.h").touch()  # one of them includes it, none needs it
    linux = [f"-I{copy.parent}", "-D__declspec(x)=", "-D__cdecl=", "-Dsprintf_s=snprintf"]
    path = copy.with_suffix(".so")
    zig_cc([*FLAGS, "-shared", "-fPIC", *linux, str(copy), "-o", str(path), "-lm"], cache)
    return path


@pytest.mark.parametrize("source", EXAMPLES)
def test_the_check_has_one_finding_a_true_one(source: str, tmp_path: Path, cache: Path) -> None:
    """`char ErrorMessage[1000]` of each is one text for all instances; nothing else is told."""
    report = check_file(example(source, tmp_path, cache))
    assert [f.rule for f in report.findings] == ["DLL messages"], report


def fault(t: float, dip: float) -> float:
    """Terminal voltage: a dip of 0.15 s, in EMTHub's own test to a half."""
    return 1.0 - dip if 2.0 <= t <= 2.15 else 1.0


def by_dll(path: Path, step_s: float, dip: float) -> np.ndarray:
    """Field voltage of SCRX9 in that test."""
    model = RealCode(RealCodeLibrary(path))
    model.outputs["EFD"] = 1.0

    def set_inputs(t: float) -> None:
        for name, value in zip(INPUTS, (1.0, fault(t, dip), 0.0, 0.0, fault(t, dip), -5.0, 5.0), strict=True):
            model.inputs[name] = value

    set_inputs(0.0)
    assert model.call("Model_Initialize", 0.0) < ERROR
    rows = []
    for k in range(round(5.0 / step_s) + 1):
        set_inputs(k * step_s)
        assert model.call("Model_Outputs", k * step_s) < ERROR
        rows.append(model.outputs["EFD"])
    return np.array(rows)


def by_device(step_s: float, parts: int, dip: float) -> np.ndarray:
    """Field voltage of our `scrx` with the same parameters, its input along lines between the calls."""
    parameters = {"TA_TB": 0.1, "TB": 10.0, "K": 100.0, "TE": 0.05, "EMIN": -5.0, "EMAX": 5.0, "CSWITCH": 1.0}
    parameters |= {"RC_RFD": 0.0, "MBASE": 100.0, "FBASE": 60.0}
    inputs = {"vc": 1.0, "vt": 1.0, "vs": 0.0, "ifd": 1.0}
    rest = rest_of(library()["scrx"], parameters, inputs, 1.0, "scrx")
    x, rows, h = np.array(rest.states), [1.0], step_s / parts

    def rates(x: np.ndarray, v: float) -> np.ndarray:
        return np.array(rest.instance.run(x, inputs | {"vc": v, "vt": v})[1])

    for k in range(round(5.0 / step_s)):
        v0, v1 = fault(k * step_s, dip), fault((k + 1) * step_s, dip)
        for i in range(parts):
            at = [v0 + (v1 - v0) * (i + part) / parts for part in (0.0, 0.5, 1.0)]
            k1 = rates(x, at[0])
            k2 = rates(x + 0.5 * h * k1, at[1])
            k3 = rates(x + 0.5 * h * k2, at[1])
            x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + rates(x + h * k3, at[2]))
        rows.append(rest.instance.run(x, inputs | {"vc": v1, "vt": v1})[0]["efd"])
    return np.array(rows)


@pytest.mark.parametrize(("dip", "most", "falls"), [(0.02, 1e-4, 50.0), (0.5, 1e-3, 10.0)])
def test_scrx9_is_our_scrx_but_for_its_rule(
    dip: float, most: float, falls: float, tmp_path: Path, cache: Path
) -> None:
    """Its trapezoidal rule at 5 ms on a lag of 50 ms: the error falls with the square of the step.

    Where it comes to a limit (a dip to a half) it stops at the next call, so there it falls with the step.
    """
    errors = []
    for step_s in (0.005, 0.0005):
        dll = by_dll(example("scrx9/SCRX9.c", tmp_path, cache, step_s), step_s, dip)
        device = by_device(step_s, 8 if step_s == 0.005 else 1, dip)
        errors.append(np.abs(dll - device).max() / np.abs(device).max())
    print(f"SCRX9 against scrx, dip {dip:g}: {errors[0]:.2e} of the peak at 5 ms, {errors[1]:.2e} at 0.5 ms")
    assert errors[1] < most and errors[0] < 1e-2
    assert errors[0] / errors[1] > falls


FIELD_INPUT = """name = "FIELD_INPUT"
kind = "exciter"
title = "field voltage as an input: what comes to the summing point is its deviation"
sources = ["none: a wire"]
diagram = "efd = vref + vs  # field voltage"
"""
SCRX = (
    '{ kind = "scrx", TA_TB = 0.1, TB = 10.0, K = 100.0, TE = 0.05, '
    "EMIN = -5.0, EMAX = 5.0, CSWITCH = 1.0, RC_RFD = 0.0 }"
)


def in_loop(folder: Path, cache: Path, step_s: float, dll: Path | None) -> np.ndarray:
    """Terminal voltage of G2, its exciter SCRX9 or, without `dll`, our `scrx`, while G1's reference moves."""
    exciter, devices = (SCRX, "") if dll is None else ('{ kind = "field_input" }', '"field_input.toml"')
    (folder / "field_input.toml").write_text(FIELD_INPUT)
    change = f"[change]\ndevices = [{devices}]\n[change.machines.G2]\nexciter = {exciter}\n"
    (folder / "grid.toml").write_text(f'base = "two-area-thesis"\nname = "grid"\n{change}')
    system = System(stop_s=2.0, step_s=step_s, cache=cache)
    system.plant(load_case(folder / "grid.toml"))
    if dll is not None:  # EFD begins at 0: the deviation, as SCRX9 is linear within its limits
        system.fmu("avr", dll, VRef=1.01, Ec=1.01, VT=1.01, VUEL=-5.0, VOEL=5.0, EMin=-9.0, EMax=9.0)
        system.connect("plant.G2_vt", "avr.Ec").connect("avr.EFD", "plant.G2_vs")
    system.event("vref_pulse", machine="G1", size_pu=0.05, start_s=0.2, end_s=0.4)
    data = system.run().data
    return np.interp(np.arange(0.0, 2.0, 0.01), data["time_s"].to_numpy(), data["plant.G2_vt"].to_numpy())


def test_scrx9_in_a_loop_is_our_scrx_but_for_a_held_output(tmp_path: Path, cache: Path) -> None:
    """Its output is held from call to call, half a step of delay on average: the difference falls so."""
    ours = in_loop(tmp_path, cache, 0.001, None)
    errors = []
    for step_s in (0.001, 0.00025):
        loop = in_loop(tmp_path, cache, step_s, example("scrx9/SCRX9.c", tmp_path, cache, step_s))
        errors.append(np.abs(loop - ours).max() / np.abs(ours - ours[0]).max())
    print(f"SCRX9 in our loop against scrx: {errors[0]:.2e} of the peak at 1 ms, {errors[1]:.2e} at 0.25 ms")
    assert np.ptp(ours) > 0.01 and errors[1] < 1e-4
    assert 3.9 < errors[0] / errors[1] < 4.1


@pytest.mark.parametrize("name", ["win64", "win32"])
def test_their_test_program_runs_our_dll(name: str, tmp_path: Path, cache: Path) -> None:
    """A controller of ours with the ports of SCRX9, in the unchanged test program, by its file."""
    A, B = np.array([[-2.0]]), np.array([[0.0, -1.0, 0.0, 0.0, 0.5, 0.0, 0.0]])
    block = controller_block("SCRX9", A, B, [[1.0]], np.zeros((1, 7)), INPUTS, ["EFD"], limit=5.0)
    command = os.environ.get("INTERAREA_WINE32", "").split()
    if name == "win32" and not command:
        pytest.skip("INTERAREA_WINE32 names no command that runs 32-bit Windows programs")
    emulator = emulator_of("win64", tmp_path)
    sources = [DLL / "scrx9" / "test_scrx9.c", DLL / "wrapper" / "IEEE_Cigre_DLLWrapper.c"]
    program = tmp_path / "test.exe"
    words = [*FLAGS, "-include", "stddef.h", *map(str, sources)]  # which MinGW's windows.h does not bring
    zig_cc([*words, "-o", str(program)], cache, DLL_PLATFORMS[name].targets[0])
    build_dll(block, tmp_path / "SCRX9.dll", platform=name, sample_time_s=0.005, cache=cache)
    done = subprocess.run(
        [*(command if name == "win32" else emulator.command), "test.exe"],
        cwd=tmp_path,
        env={**os.environ, **emulator.environment},
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    assert "normal finish" in done.stdout, done.stdout[-2000:] + done.stderr[-2000:]
    rows = np.genfromtxt(tmp_path / "scrx9.csv", delimiter=",", names=True)
    linux = build_dll(block, tmp_path, platform="linux64", sample_time_s=0.005, cache=cache)
    model = RealCode(RealCodeLibrary(linux))
    expected = []
    for k, row in enumerate(rows):
        for port in INPUTS:
            model.inputs[port] = float(row[port])
        if k == 0:
            assert model.call("Model_Initialize", 0.0) < ERROR
        assert model.call("Model_Outputs", k * 0.005) < ERROR
        expected.append(model.outputs["EFD"])
    assert len(rows) > 1900 and np.ptp(rows["EFD"]) > 0.01
    assert np.abs(rows["EFD"] - expected).max() < 1e-5 * np.abs(expected).max()  # the file has six digits
