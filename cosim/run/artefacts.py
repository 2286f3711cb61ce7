"""FMUs, linear models and designed controllers of a case, made once and found again in the cache."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import control
import numpy as np

from interarea.design.certificates.closed_loop import certificate
from interarea.design.controllers.bank import ControllerBank, load_controller
from interarea.design.controllers.bundled import shipped_controller, shipped_names
from interarea.design.controllers.controller import Controller
from interarea.design.linear.linearise import linearise, remove_reference, speeds_in_rad
from interarea.design.modes.modes import ModeError, modes_of
from interarea.fmu_build.open.plant import open_plant
from interarea.fmu_build.write.cache import (
    artefact,
    cached_json,
    code_hash,
    content_hash,
    file_hash,
    numerics_versions,
    source_hash,
)
from interarea.fmu_build.write.package import block_fmu, build_fmu
from interarea.models.blocks.channel import channel_block
from interarea.models.blocks.concentrator import concentrator_block
from interarea.models.blocks.plant import plant_block
from interarea.models.blocks.variables import Block
from interarea.models.case.case import Case

from ..errors import ScenarioError, nearest
from ..results.ringdown import Swing
from ..scenario.scenario import CONTROLLER_NAMES, NAMED_CONTROLLERS

EVENT_SLOTS = 8  #: of the plant FMU; a scenario with more events gets one of its own

#: What a controller can be given as: an object, a name, a file.
ControllerLike: TypeAlias = "Controller | ControllerBank | control.StateSpace | str | Path"


def plant_fmu(case: Case, cache: Path, *, event_slots: int = EVENT_SLOTS) -> Path:
    """Return the plant FMU of a case, built when its data or the sources that make it are new."""
    return _kept_fmu(
        cache,
        "plant",
        case.name,
        [case.model_dump_json(), event_slots],
        lambda: plant_block(case, event_slots=event_slots),
    )


def concentrator_fmu(signals: int, cache: Path) -> Path:
    """Return the FMU of a concentrator of so many signals."""
    return _kept_fmu(
        cache, "concentrator", f"concentrator{signals}", [signals], lambda: concentrator_block(signals)
    )


def channel_fmu(cache: Path) -> Path:
    """Return the FMU of one channel; latency, outages and the rule on loss are its parameters."""
    return _kept_fmu(cache, "channel", "channel", [], channel_block)


def _kept_fmu(cache: Path, kind: str, name: str, given: list[Any], block: Callable[[], Block]) -> Path:
    """Return the FMU of a block, which is made from `given` only when no FMU made of the same is there."""
    key = content_hash(
        given,
        source_hash("models"),
        source_hash("models", "*.[ch]"),
        source_hash("fmu_build/write"),
        source_hash("fmu_build", "*.[ch]"),
        numerics_versions(),
        os.environ.get("CC", ""),
    )
    return artefact(cache, kind, f"{name}-{key}", ".fmu", lambda path: build_fmu(block(), path, cache=cache))


def active_bank(case: Case, cache: Path) -> ControllerBank:
    """Return the bank of controllers with its switching certificate, designed when it is new."""
    key = content_hash(
        file_hash(plant_fmu(case, cache)),
        code_hash("interarea.design.certificates.bank_design"),
        numerics_versions(),
    )

    def make(path: Path) -> Path:
        from interarea.design.certificates.bank_design import design_active

        relative = remove_reference(linear_plant(case, cache))
        return design_active(relative, omega_b=case.omega_b).save(path)

    return ControllerBank.load(artefact(cache, "controllers", f"active-{key}", ".json", make))


def controller_fmu(controller: Controller | ControllerBank, omega_b: float, cache: Path) -> Path:
    """Return the FMU of a controller: pu in, pu out; `omega_b` in rad/s."""
    return block_fmu(controller.block(omega_b), cache)


def linear_plant(case: Case, cache: Path) -> control.StateSpace:
    """Return the plant FMU linearised at its operating point, reference angle included.

    Inputs `G1_vs`.. in pu, outputs as the FMU gives them (speeds in pu); all states in s.
    """
    fmu = plant_fmu(case, cache)
    key = content_hash(fmu.name, code_hash(linearise.__module__), numerics_versions())

    def make(path: Path) -> None:
        with open_plant(fmu) as plant:
            _save_linear(linearise(plant), path)

    path = artefact(cache, "linear", key, ".npz", make)
    with np.load(path) as z:
        return control.ss(
            *(z[m] for m in "ABCD"),
            states=[str(s) for s in z["states"]],
            inputs=[str(s) for s in z["inputs"]],
            outputs=[str(s) for s in z["outputs"]],
            name=case.name.replace(".", "_"),  # python-control refuses a dot
        )


def _save_linear(system: control.StateSpace, path: Path) -> None:
    arrays: dict[str, Any] = {m: getattr(system, m) for m in "ABCD"}
    arrays |= {"states": system.state_labels, "inputs": system.input_labels, "outputs": system.output_labels}
    with path.open("wb") as out:
        np.savez(out, **arrays)


def swing_of(case: Case, cache: Path, stated: tuple[str, ...] | None = None) -> Swing:
    """Return the speed difference that runs of a case are judged by.

    stated : two machines, of the scenario; else those the case states; else the extreme machines of the
        inter-area mode (the least damped one), of the local mode in a single area.
    """
    machines = [m.name for m in case.machines]
    if stated is not None:
        return Swing(*_two_of(stated, machines), "stated by the scenario")
    if case.swing is not None:
        return Swing(*_two_of(case.swing, machines), "stated by the case")
    if len(machines) == 1:
        return Swing(machines[0], "", "the only machine")
    key = content_hash(
        plant_fmu(case, cache).name, case.areas, code_hash(modes_of.__module__), numerics_versions()
    )
    return Swing(*cached_json(cache, "swing", key, lambda: _extremes(case, cache)))


def _two_of(names: tuple[str, ...], machines: Sequence[str]) -> tuple[str, str]:
    for name in names:
        if name not in machines:
            raise ScenarioError(f"swing: machine {name!r} does not exist; {nearest(name, machines)}")
    return names[0], names[1]


def _extremes(case: Case, cache: Path) -> tuple[str, str, str]:
    """Return the two machines that swing furthest against each other, and in which mode."""
    try:
        modes = modes_of(remove_reference(linear_plant(case, cache)), case.areas)
        between = [m for m in modes.values() if m.name.startswith("inter-area")]
        mode = min(between or modes.values(), key=lambda m: m.damping_ratio)
    except ModeError:
        first, last = case.machines[0].name, case.machines[-1].name
        return first, last, "first and last machine: the case has no mode with a name"
    shape = mode.shape
    far = max(shape, key=lambda m: abs(shape[m]))
    against = min(shape, key=lambda m: (shape[m] * shape[far].conjugate()).real)
    ahead, behind = sorted((far, against), key=list(shape).index)
    return ahead, behind, f"extreme machines of mode {mode.name!r} at {mode.frequency_hz:.3f} Hz"


def controller_of(
    which: ControllerLike, case: Case, cache: Path, *, folder: Path = Path()
) -> Controller | ControllerBank | None:
    """Return the controller that is meant: the object itself, a named one designed or bundled, one of a file.

    which : a `Controller`, a bank, a `control.StateSpace` (inputs named by signal, speeds in rad/s, outputs
        by actuator), a name (`NAMED_CONTROLLERS`), or a controller file (beside `folder`). None for "none".

    Raises
    ------
    ScenarioError : neither a name nor a file. ControllerError : a file or numbers that cannot be used.
    """
    if isinstance(which, control.StateSpace):
        return Controller.of(which)
    if not isinstance(which, str | Path):
        return which
    name = str(which)
    if name == "none":
        return None
    if name == "active":
        return active_bank(case, cache)
    if name in NAMED_CONTROLLERS:
        return design_controller(case, name, cache)
    path = folder / name
    if not path.is_file():
        raise ScenarioError(
            f"controller = {name!r} is neither a name nor a file; {nearest(name, NAMED_CONTROLLERS)} "
            "(or the path of a controller file)"
        )
    return load_controller(path)


def design_controller(case: Case, name: str, cache: Path, *, reduce: bool = True) -> Controller:
    """Return controller `name` (wdc | cc | ftc) of a case, designed and certified when it is new.

    The conventional controller (cc) is the one with the normal damping of the fault-tolerant one (ftc), so
    that the two compare. reduce : False keeps the order that synthesis gave.

    Raises
    ------
    ValueError : an unknown name. InfeasibleDesign, UncertifiedDesign : as the design says.
    """
    if name in shipped_names():
        return shipped_controller(name)
    if name not in CONTROLLER_NAMES:
        raise ValueError(f"controller {name!r} is not known; {nearest(name, NAMED_CONTROLLERS)}")
    key = content_hash(
        [name, reduce],
        file_hash(plant_fmu(case, cache)),
        code_hash("interarea.design.synthesis.study_designs"),
        code_hash(certificate.__module__),
        numerics_versions(),
    )
    path = artefact(
        cache, "controllers", f"{name}-{key}", ".json", lambda p: _design(case, name, cache, reduce).save(p)
    )
    return Controller.load(path)


def designed_anew(case: Case, name: str, cache: Path) -> Controller:
    """Design controller `name` (wdc | cc | ftc) of a case again, whatever the cache holds of it."""
    return _design(case, name, cache, True)


def _design(case: Case, name: str, cache: Path, reduce: bool) -> Controller:
    from interarea.design.synthesis import study_designs as designs

    relative = remove_reference(linear_plant(case, cache))
    order = {} if reduce else {"order": relative.nstates}
    if name == "wdc":
        made = designs.design_wdc(relative, replace(designs.WdcSpec(), **order), omega_b=case.omega_b)
    elif name == "ftc":
        made = designs.design_ftc(relative, replace(designs.FtcSpec(), **order), omega_b=case.omega_b)
    else:
        spec = replace(designs.CcSpec(), **order)
        reference = design_controller(case, "ftc", cache)
        made = designs.design_cc_like(reference, relative, spec, omega_b=case.omega_b)
    if not reduce:
        return made
    plant = speeds_in_rad(relative, case.omega_b)
    return replace(made, certificate=certificate(plant, made, modes_of(relative, case.areas)))
