"""Every FMU and SSP the program writes: nothing from `interarea check`, `fmpy validate`, `fmutool -check`."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from fmpy.validation import validate_fmu
from fmu_blocks import blocks

from interarea.cosim.export.container import write_container
from interarea.cosim.export.ssp import write_ssp
from interarea.cosim.run.artefacts import channel_fmu, plant_fmu
from interarea.cosim.run.controllers import controller_fmu, design_controller
from interarea.cosim.scenario.scenario import load_scenario
from interarea.design.controllers.bundled import shipped_bank
from interarea.design.controllers.controller import Controller
from interarea.fmu_build.check.check import check_file
from interarea.fmu_build.write.package import block_fmu
from interarea.models.case.case import Case, load_case

pytestmark = pytest.mark.slow

#: What `interarea study` writes below fmus/, one plant of another size, and the bank of controllers.
FMUS: dict[str, Callable[[Case, Path], Path]] = {
    "plant": plant_fmu,
    "plant of New England": lambda case, cache: plant_fmu(load_case("new-england"), cache),
    "plant of NETS-NYPS": lambda case, cache: plant_fmu(load_case("nets-nyps"), cache),
    "channel": lambda case, cache: channel_fmu(cache),
    "concentrator": lambda case, cache: block_fmu(blocks()["concentrator"], cache),
    "detector": lambda case, cache: block_fmu(blocks()["detector"], cache),
    "pmu": lambda case, cache: block_fmu(blocks()["pmu"], cache),
    "wdc": lambda case, cache: controller_fmu(design_controller(case, "wdc", cache), case.omega_b, cache),
    "cc": lambda case, cache: controller_fmu(design_controller(case, "cc", cache), case.omega_b, cache),
    "ftc": lambda case, cache: controller_fmu(design_controller(case, "ftc", cache), case.omega_b, cache),
    "bank": lambda case, cache: controller_fmu(shipped_bank("active"), case.omega_b, cache),
}


def check_is_clean(fmu: Path) -> None:
    report = check_file(fmu)
    assert [f.line() for f in report.findings] == []
    assert len(report.facts["topics"]) in (11, 22)  # eleven for each interface
    assert validate_fmu(str(fmu)) == []
    tool = Path(sys.executable).with_name("fmutool")
    done = subprocess.run([tool, "-input", fmu, "-check"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("name", FMUS)
def test_fmus(name: str, two_area: Case, cache: Path) -> None:
    check_is_clean(FMUS[name](two_area, cache))


def test_container(by_hand: Controller, cache: Path, tmp_path: Path) -> None:
    loop = load_scenario("wide-area-damping")
    check_is_clean(write_container(loop, tmp_path / "loop.fmu", cache=cache, controller=by_hand))


@pytest.mark.parametrize("scenario", ["wide-area-damping", "lost-signal"])
def test_ssps(scenario: str, by_hand: Controller, cache: Path, tmp_path: Path) -> None:
    loop = write_ssp(load_scenario(scenario), tmp_path / "loop.ssp", cache=cache, controller=by_hand)
    report = check_file(loop)
    assert [f.line() for f in report.findings] == []
    assert len(report.facts["fmus"]) == report.facts["components"]
