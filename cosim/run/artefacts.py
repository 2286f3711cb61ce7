"""FMUs and linear models of a case, made once and found again in the cache.

What makes them is loaded when something has to be made.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from interarea.design.linear.matrices import LinearMatrices
from interarea.fmu_build.write.cache import (
    artefact,
    cached_json,
    code_hash,
    content_hash,
    device_hash,
    numerics_versions,
    source_hash,
)
from interarea.models.case.case import Case
from interarea.models.case.checks import require_one_network
from interarea.models.grid.memory import build_bytes, require_memory

if TYPE_CHECKING:
    import control

    from interarea.design.linear.sparse_plant import SparsePlant
    from interarea.design.modes.growth import Growth
    from interarea.models.blocks.detector import Patterns
    from interarea.models.blocks.variables import Block

MOST_DENSE = 3000  #: states of a linear model as matrices: 72 MB each, and a minute for all modes
_MANY = 100  # machines: below them no grid has so many states
EVENT_SLOTS = 8  #: of the plant FMU; a scenario with more events gets one of its own


def plant_fmu(
    case: Case,
    cache: Path,
    *,
    event_slots: int = EVENT_SLOTS,
    show: Sequence[str] | None = None,
    more: Sequence[str] = (),
) -> Path:
    """Return the plant FMU of a case, built when its data or the sources that make it are new.

    show : patterns of its outputs; None: what a plant shows by itself. more : of outputs beside those.
    """

    def block() -> Block:
        from interarea.fmu_build.write.compile import host_platform, objects_begun
        from interarea.fmu_build.write.sources import record_source, source_files
        from interarea.models.blocks.plant import plant_block, plant_sources
        from interarea.models.blocks.plant_shown import shows_powers

        require_memory(
            build_bytes(case, powers=show is None and shows_powers(case)),
            f"{case.name}: the plant of {len(case.buses)} buses and {len(case.machines)} machines",
            "free memory, use a larger computer or a smaller grid",
        )
        sources = source_files((*plant_sources(case), record_source()))
        with objects_begun("plant", sources, host_platform(), cache):
            return plant_block(case, event_slots=event_slots, show=show, more=more)

    provided = [case.model_dump_json(), event_slots, None if show is None else list(show), list(more)]
    return built_fmu(cache, "plant", case.name, provided, block)


def concentrator_fmu(signals: int, cache: Path) -> Path:
    """Return the FMU of a concentrator of so many signals."""

    def block() -> Block:
        from interarea.models.blocks.concentrator import concentrator_block

        return concentrator_block(signals)

    return built_fmu(cache, "concentrator", f"concentrator{signals}", [signals], block)


def detector_fmu(signals: Sequence[str], cache: Path, patterns: Patterns | None = None) -> Path:
    """Return the FMU of a detector of these signals; its thresholds are its parameters."""
    designed = [] if patterns is None else [patterns.basis.tolist(), *patterns.numbers]

    def block() -> Block:
        from interarea.models.blocks.detector import detector_block

        return detector_block(signals, patterns=patterns)

    return built_fmu(cache, "detector", f"detector{len(signals)}", [*signals, *designed], block)


def pmu_fmu(cache: Path) -> Path:
    """Return the FMU of one PMU; class and window are its parameters."""

    def block() -> Block:
        from interarea.models.blocks.pmu import pmu_block

        return pmu_block()

    return built_fmu(cache, "pmu", "pmu", [], block)


def channel_fmu(cache: Path) -> Path:
    """Return the FMU of one channel; latency, outages and the rule on loss are its parameters."""

    def block() -> Block:
        from interarea.models.blocks.channel import channel_block

        return channel_block()

    return built_fmu(cache, "channel", "channel", [], block)


def built_fmu(cache: Path, kind: str, name: str, provided: list[Any], block: Callable[[], Block]) -> Path:
    """Return the FMU of a block, which is made from `provided` only when no FMU made of the same is there."""
    key = content_hash(
        provided,
        source_hash("models"),
        source_hash("models", "*.[ch]"),
        device_hash(),
        source_hash("fmu_build/write"),
        source_hash("fmu_build", "*.[ch]"),
        numerics_versions(),
        os.environ.get("CC", ""),
    )

    def make(path: Path) -> None:
        from interarea.fmu_build.write.package import build_fmu

        build_fmu(block(), path, cache=cache)

    return artefact(cache, kind, f"{name}-{key}", ".fmu", make)


def linear_matrices(case: Case, cache: Path) -> LinearMatrices:
    """Return the plant FMU linearised at its operating point, reference angle included, as plain matrices.

    Inputs `G1_vs`.. in pu, outputs as the FMU gives them (speeds in pu); all states in s.

    Raises
    ------
    UserError : no operating point, several parts, or more states than `MOST_DENSE`.
    """
    _require_linear(case)
    _require_dense(case)
    return matrices_of_fmu(plant_fmu(case, cache), cache)


def matrices_of_fmu(fmu: Path, cache: Path) -> LinearMatrices:
    """Return the matrices of a plant FMU that lies in the cache, where its name has the hash of its content.

    Raises
    ------
    LinearisationError, FmuFileError, FmuError
    """
    key = content_hash(fmu.name, code_hash("interarea.design.linear.linearise"), numerics_versions())

    def make(path: Path) -> None:
        _save_linear(linearised(fmu), path)

    path = artefact(cache, "linear", key, ".npz", make)
    with np.load(path) as z:
        return LinearMatrices(
            *(z["A"], z["B"], z["C"], z["D"]),
            [str(s) for s in z["states"]],
            [str(s) for s in z["inputs"]],
            [str(s) for s in z["outputs"]],
            z["output_start"],
        )


def linearised(fmu: Path) -> LinearMatrices:
    """Linearise a plant FMU at its operating point; the differences are checked here, once."""
    from interarea.design.linear.linearise import linearise
    from interarea.fmu_build.open.plant import open_plant

    with open_plant(fmu) as plant:
        system = linearise(plant)
        start = plant.derivatives(*plant.operating_point())[1]
    states, inputs = list(system.state_labels), list(system.input_labels)
    return LinearMatrices(
        system.A, system.B, system.C, system.D, states, inputs, list(system.output_labels), start
    )


def _require_linear(case: Case) -> None:
    """Refuse a grid in parts, and one with a device at a bus on its limit."""
    require_one_network(case, "each has a separate rotation")
    if case.svcs or case.tcscs or case.links:
        from interarea.models.grid.start import require_off_limits

        require_off_limits(case)


def states_beyond_dense(case: Case) -> int:
    """Return the number of states of a grid whose matrices would fill the memory, 0 of a smaller one."""
    if len(case.machines) < _MANY:
        return 0
    from interarea.models.grid.equilibrium import operating_point
    from interarea.models.grid.machine_tables import in_plant_order

    states = len(operating_point(in_plant_order(case)).states)
    return states if states > MOST_DENSE else 0


def _require_dense(case: Case) -> None:
    """Refuse a grid whose matrices would fill the memory, before its FMU is built."""
    from interarea.models.errors import UserError

    if states := states_beyond_dense(case):
        raise UserError(
            f"{case.name}: {states} states, allowed for a dense linear model: {MOST_DENSE}; "
            "`interarea modes --band`, `loops` and `reduce` work on the sparse blocks of a grid of any size"
        )


def linear_plant(case: Case, cache: Path) -> control.StateSpace:
    """Return `linear_matrices` as a system of python-control, which takes a second to load."""
    import control

    m = linear_matrices(case, cache)
    return control.ss(
        *(m.A, m.B, m.C, m.D),
        states=m.state_labels,
        inputs=m.input_labels,
        outputs=m.output_labels,
        name=case.name.replace(".", "_"),  # python-control refuses a dot
    )


def plant_for_controllers(case: Case, cache: Path) -> control.StateSpace:
    """Return `linear_plant` as linear controllers take it: relative angles, speeds in rad/s."""
    from interarea.design.linear.linearise import remove_reference, speeds_in_rad

    return speeds_in_rad(remove_reference(linear_plant(case, cache)), case.omega_b)


def sparse_linear_plant(case: Case, cache: Path) -> SparsePlant:
    """Return the plant of a case at rest as sparse blocks, from the C of its FMU; only the library is kept.

    Raises
    ------
    UserError : no operating point, or parts that no branch connects.
    """
    from interarea.design.linear.sparse_plant import sparse_plant
    from interarea.fmu_build.write.device_slopes import DeviceSlopes
    from interarea.models.blocks.plant import plant_block
    from interarea.models.grid.equilibrium import operating_point
    from interarea.models.grid.machine_tables import in_plant_order

    _require_linear(case)
    case = in_plant_order(case)
    point = operating_point(case)
    block = plant_block(case, event_slots=0, point=point)
    return sparse_plant(DeviceSlopes(block, cache=cache), block.data, point.power_flow.voltages)


def growth_at_rest(case: Case, cache: Path) -> Growth | None:
    """Return the verdict on a case at rest without a controller; None where it has no dynamics to judge.

    Of a case in several parts, of one that has power flow alone and of one that cannot start there is none.
    """
    from interarea.design.modes.growth import Growth, growth_of_plant
    from interarea.models.errors import UserError

    if not case.machines or any(machine.model == "power_flow" for machine in case.machines):
        return None
    sources = [source_hash(room) for room in ("models", "design/modes", "design/linear", "fmu_build/write")]
    sources += [source_hash("models", "*.[ch]"), device_hash()]
    key = content_hash(case.model_dump_json(), *sources, numerics_versions())
    try:
        verdict = cached_json(
            cache, "growth", key, lambda: growth_of_plant(sparse_linear_plant(case, cache)).as_dict()
        )
    except UserError:  # said where the case is run
        return None
    return Growth.from_dict(verdict)


def _save_linear(system: LinearMatrices, path: Path) -> None:
    arrays: dict[str, Any] = {m: getattr(system, m) for m in "ABCD"}
    arrays["output_start"] = system.output_start
    arrays |= {"states": system.state_labels, "inputs": system.input_labels, "outputs": system.output_labels}
    with path.open("wb") as out:
        np.savez(out, **arrays)
