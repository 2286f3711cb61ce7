"""What the runs of a sweep are made of, built once and shipped to where they run."""

from __future__ import annotations

from collections.abc import Collection
from contextlib import suppress
from pathlib import Path

from interarea.fmu_build.errors import BuildError
from interarea.fmu_build.write.compile import compile_binary, host_platform
from interarea.models.blocks.plant import plant_sources
from interarea.models.case.case import Case

from ..master.kernel.build import load_kernel
from ..run.artefacts import channel_fmu, concentrator_fmu, detector_fmu, plant_fmu, pmu_fmu
from ..run.controllers import controller_fmu
from ..run.detector import patterns_of
from .lane_batches import host_lanes
from .plan import SweepPlan, case_in, own_fmu


def prepare(plan: SweepPlan, cache: Path) -> list[Path]:
    """Build FMUs of unchanged cases and controllers, and what FMUs of changed cases are made of.

    Returns the files in `cache` with which runs need no compiler.
    """
    files = [channel_fmu(cache)]
    with suppress(BuildError):  # without it Python steps the FMUs
        files.append(Path(load_kernel(cache)._name))
    files += [own_fmu(cache, key) for key in dict.fromkeys(plan.fmus.values())]
    files += [concentrator_fmu(len(c.signals), cache) for c in plan.sweep.base.concentrators.values()]
    base = plan.sweep.base
    detected = base.detector is not None
    if detected:
        files.append(detector_fmu(tuple(path.signal for path in base.signals), cache, patterns_of(base)))
    if any(path.pmu for path in plan.sweep.base.signals):
        files.append(pmu_fmu(cache))
    cases = {name: plan.case(name) for name in plan.cases}
    files += _plant_binaries(cases.values(), cache)
    show, more = plan.sweep.show, plan.sweep.base.shows
    files += [plant_fmu(case, cache, show=show, more=more) for case in cases.values()]
    for key in plan.controllers:
        name = case_in(key, cases)
        controller = plan.controller(name, key[len(name) + 1 :])
        if controller is not None:
            files.append(controller_fmu(controller, cases[name].omega_b, cache, trust=detected))
    return files


def _plant_binaries(cases: Collection[Case], cache: Path) -> list[Path]:
    """Return the libraries that step plants of `cases` side by side, and their FMUs' binaries."""
    libraries = (host_lanes(cache, case).library for case in cases)
    beside = dict.fromkeys(library.path for library in libraries if library is not None)
    sources = dict.fromkeys(plant_sources(case) for case in cases)
    return [*beside, *(compile_binary("plant", files, host_platform(), cache=cache) for files in sources)]
