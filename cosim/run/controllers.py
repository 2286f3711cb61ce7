"""Which controller is meant by an object, a name or a file, and those that are designed for a case."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from interarea.design.controllers.bank import ControllerBank, load_controller
from interarea.design.controllers.bundled import (
    shipped_bank,
    shipped_banks,
    shipped_controller,
    shipped_names,
)
from interarea.design.controllers.controller import Controller
from interarea.fmu_build.open.ports import DLL_SUFFIXES
from interarea.fmu_build.write.cache import (
    artefact,
    code_hash,
    content_hash,
    file_hash,
    numerics_versions,
    source_hash,
)
from interarea.models.blocks.controller import with_trust
from interarea.models.blocks.variables import Block
from interarea.models.case.case import Case
from interarea.models.threads import one_thread

from ..errors import ScenarioError, nearest
from ..scenario.names import CONTROLLER_NAMES, NAMED_CONTROLLERS, require_controller
from ..toml_file import case_beside
from .artefacts import built_fmu, linear_plant, plant_fmu
from .controller_fmu import controller_from_fmu

if TYPE_CHECKING:
    import control

    from interarea.design.synthesis.study_designs import StudySpec

#: What a controller can be given as: an object, a name, a file.
ControllerLike: TypeAlias = "Controller | ControllerBank | control.StateSpace | str | Path"


def controller_of(
    which: ControllerLike, case: Case, cache: Path, *, folder: Path = Path()
) -> Controller | ControllerBank | None:
    """Return the controller that is meant: the object itself, a named one designed or bundled, one of a file.

    which : a `Controller`, a bank, a `control.StateSpace` (inputs named by signal, speeds in rad/s, outputs
        by actuator), a name (`NAMED_CONTROLLERS`), or its JSON file or FMU (from `folder`). None for "none".

    Raises
    ------
    ScenarioError : neither a name nor a file. ControllerError : a file or numbers that cannot be used.
    """
    if isinstance(which, Controller | ControllerBank):
        return which
    if not isinstance(which, str | Path):
        return Controller.of(which)
    name = str(which)
    if name == "none":
        return None
    if name in shipped_banks():
        return shipped_bank(name)
    if name in NAMED_CONTROLLERS:
        return design_controller(case, name, cache)
    path = folder / name
    if path.suffix in DLL_SUFFIXES:
        raise ScenarioError(
            f"controller = {name!r} is a DLL, its equations are unknown; use it in a run or a `System`"
        )
    require_controller(name, folder)
    if path.suffix == ".fmu":
        return controller_from_fmu(path, case.omega_b)
    controller = load_controller(path)
    specification = controller.design.get("specification")
    if not isinstance(specification, Mapping):
        return controller
    design = {**controller.design, "specification": case_beside(specification, path.parent)}
    return replace(controller, design=design)


def design_controller(
    case: Case,
    name: str,
    cache: Path,
    *,
    reduce: bool = True,
    specs: Mapping[str, StudySpec] | None = None,
) -> Controller:
    """Return controller `name` (wdc | cc | ftc) of a case, designed and certified when it is new.

    The conventional controller (cc) is the one with the normal damping of the fault-tolerant one (ftc), so
    that the two compare. reduce : False keeps the order that synthesis gave. specs : specifications by name
    in place of the study's own.

    Raises
    ------
    ValueError : an unknown name. InfeasibleDesign, UncertifiedDesign : as the design says.
    """
    if name in shipped_names():
        return shipped_controller(name)
    if name not in CONTROLLER_NAMES:
        raise ValueError(f"controller {name!r} is not known; {nearest(name, NAMED_CONTROLLERS)}")
    key = content_hash(
        [name, reduce, {k: asdict(spec) for k, spec in (specs or {}).items()}],
        file_hash(plant_fmu(case, cache)),
        code_hash("interarea.design.synthesis.study_designs"),
        code_hash("interarea.design.certificates.closed_loop"),
        numerics_versions(),
    )

    def make(path: Path) -> Path:
        with one_thread():  # on two cores the pools of numpy and scipy fight
            return _design(case, name, cache, reduce, specs).save(path)

    path = artefact(cache, "controllers", f"{name}-{key}", ".json", make)
    return Controller.load(path)


def designed_anew(
    case: Case, name: str, cache: Path, specs: Mapping[str, StudySpec] | None = None
) -> Controller:
    """Design controller `name` (wdc | cc | ftc) of a case again, whatever the cache holds of it."""
    with one_thread():
        return _design(case, name, cache, True, specs)


def _design(
    case: Case, name: str, cache: Path, reduce: bool, specs: Mapping[str, StudySpec] | None
) -> Controller:
    from interarea.design.certificates.closed_loop import certificate
    from interarea.design.linear.linearise import remove_reference, speeds_in_rad
    from interarea.design.modes.modes import modes_of
    from interarea.design.synthesis import study_designs as designs

    relative = remove_reference(linear_plant(case, cache))
    order = {} if reduce else {"order": relative.nstates}
    spec = replace((specs or {}).get(name) or designs.SPECIFICATIONS[name](), **order)
    if isinstance(spec, designs.WdcSpec):
        design = designs.design_wdc(relative, spec, omega_b=case.omega_b)
    elif isinstance(spec, designs.FtcSpec):
        design = designs.design_ftc(relative, spec, omega_b=case.omega_b)
    else:
        reference = design_controller(case, "ftc", cache, specs=specs)
        design = designs.design_cc_like(reference, relative, spec, omega_b=case.omega_b)
    if not reduce:
        return design
    plant = speeds_in_rad(relative, case.omega_b)
    return replace(design, certificate=certificate(plant, design, modes_of(relative, case.areas)))


def controller_fmu(
    controller: Controller | ControllerBank, omega_b: float, cache: Path, *, trust: bool = False
) -> Path:
    """Return the FMU of a controller: pu in, pu out; `omega_b` in rad/s. trust : `controller_block_of`."""
    provided = [controller.as_dict(), omega_b, trust, source_hash("design/controllers")]

    def block() -> Block:
        return controller_block_of(controller, omega_b, trust=trust)

    return built_fmu(cache, "controller", controller.name, provided, block)


def controller_block_of(controller: Controller | ControllerBank, omega_b: float, *, trust: bool) -> Block:
    """Return the block of a controller; trust : one that is no bank has flags for a detector too."""
    block = controller.block(omega_b)
    return with_trust(block) if trust and isinstance(controller, Controller) else block
