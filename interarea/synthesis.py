"""Public functions on controllers: design, load, certify."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from interarea.cosim.designs.bank_design import certify_bank
from interarea.cosim.designs.design_file import (
    DESIGN_STEPS,
    DesignTable,
    design_of,
    load_design,
    run_design,
    specification_of,
    steps_of,
)
from interarea.cosim.designs.design_file import certify as certify_family
from interarea.cosim.designs.worth import certified_worth
from interarea.cosim.errors import ScenarioError
from interarea.cosim.run.artefacts import plant_for_controllers
from interarea.cosim.run.controllers import controller_of
from interarea.design.controllers.bank import ControllerBank
from interarea.design.controllers.controller import Controller
from interarea.design.linear.systems import SystemLike
from interarea.fmu_build.write.cache import default_cache
from interarea.grids import case_like
from interarea.progress import notebook_bars, silent
from interarea.shown import Certificate

if TYPE_CHECKING:
    from interarea.models.case.case import Case

#: of every signal, under which a controller without a design of its own is judged; losses are added
PLAIN = ("N", "s50", "s100", "s150", "s200")


def design_controller(
    spec: str | Path | Mapping[str, Any],
    *,
    case: Case | str | Path | None = None,
    progress: Callable[[str, float, str], object] | None = None,
) -> Controller:
    """Design a fixed-order controller for a family of operating points, losses and latencies.

    Its `certificate` is computed on full linear plants with exact latency and lists violated requirements.

    Parameters
    ----------
    spec : design file, bundled name (``interarea list``), or the keys of such a file.
    case : replaces the case of the design.
    progress : called with the current step, its completed share, and the result of the search so far as
        text; without it a notebook shows bars.

    Raises
    ------
    UserError : an error in the design. InfeasibleDesign : a fixed mode, or no stable start.

    Examples
    --------
    >>> made = design_controller(
    ...     {
    ...         "name": "quick",
    ...         "case": "two-area-thesis",
    ...         "remote": "G2_dw",
    ...         "local": "G4_dw",
    ...         "actuator": "G4_vs",
    ...         "order": 2,
    ...         "conditions": ["N", "L"],
    ...         "point": [{"name": "base"}],
    ...         "starts": 1,
    ...         "evaluations": 100,
    ...         "polishes": 0,
    ...     }
    ... )
    >>> made.order, made.certificate["rows"][0]["stable"]
    (2, True)
    """
    table = _table(spec, case)
    if table.bank is not None:
        raise ScenarioError(
            f"design {table.name}: is a bank of controllers, allowed: one controller; "
            "`interarea design FILE --out FILE.json` designs a bank"
        )
    with notebook_bars(DESIGN_STEPS) as report:
        return run_design(table, default_cache(), progress=progress or report or silent).controller


def load_controller(
    name: str | Path, *, case: Case | str | Path = "two-area-thesis"
) -> Controller | ControllerBank:
    """Return a controller: bundled (``interarea list``), from a JSON file, or read back from its FMU.

    case : for which wdc, cc and ftc are designed; it defines the base speed of an FMU.

    Raises
    ------
    UserError : no such controller, or a file of another kind.

    Examples
    --------
    >>> load_controller("robust").inputs
    ('G2_dw', 'G4_dw')
    """
    controller = controller_of(name, case_like(case), default_cache())
    if controller is None:
        raise ScenarioError(
            "controller 'none' is not a controller, allowed: what `interarea list` names, or a file"
        )
    return controller


def controller_like(
    controller: Controller | ControllerBank | SystemLike | str | Path,
    case: Case | str | Path = "two-area-thesis",
) -> Controller | ControllerBank:
    """Return a controller from an object, a `StateSpace` (u = +K y, speeds in rad/s), a name or a file."""
    if isinstance(controller, str | Path):
        return load_controller(controller, case=case)
    if isinstance(controller, Controller | ControllerBank):
        return controller
    return Controller.of(controller)


def certify(
    controller: Controller | ControllerBank | SystemLike | str | Path,
    case: Case | str | Path | None = None,
    *,
    spec: str | Path | Mapping[str, Any] | None = None,
    conditions: Sequence[str] = (),
    progress: Callable[[str, float], object] | None = None,
) -> Certificate:
    """Recompute the certificate of a controller on full linear plants with exact latency.

    A controller is certified by the design in its record. Without a design it must be stable on the
    unchanged case: with all signals, with each lost in turn, with all 0 to 200 ms late. A bank of
    controllers is certified for every sequence of losses and returns.

    Parameters
    ----------
    controller : object, `control.StateSpace` (u = +K y, speeds in rad/s, actuators in pu), name, JSON or FMU.
    case : replaces the case of the design.
    spec : replaces the design of the record (file, bundled name, keys).
    conditions : replace the design: the controller must be stable under them on the unchanged case; codes
        of a design file, such as ``["N", "s100", "L:G2_dw"]``.
    progress : called with the current step and its completed share; without it a
        notebook shows bars.

    Raises
    ------
    UserError : no such controller, case or design, or no such condition.

    Examples
    --------
    >>> bool(certify("robust_linear").to_frame()["worst_swing"].min() > 0.24)
    True
    """
    judged, table = judged_and_design(controller, case, spec, conditions)
    grid = table.grid
    if isinstance(judged, ControllerBank):
        proof = certify_bank(plant_for_controllers(grid, default_cache()), judged)
        return Certificate(judged.name, grid.name, proof)
    with notebook_bars(steps_of(table, acceptance=False)) as report:
        certificate = certify_family(table, judged, default_cache(), progress=progress or report or silent)
        certificate = certified_worth(table, judged, certificate, default_cache())
    return Certificate(judged.name, table.case, certificate, {c.name: c.in_words for c in table.family()})


def judged_and_design(
    controller: Controller | ControllerBank | SystemLike | str | Path,
    case: Case | str | Path | None,
    spec: str | Path | Mapping[str, Any] | None,
    conditions: Sequence[str] = (),
) -> tuple[Controller | ControllerBank, DesignTable]:
    """Return a controller and the design of its certificate: `spec`, that of its record, or plain conditions.

    case : another than the design's. conditions : plain ones instead of any design.

    Raises
    ------
    UserError : no such controller, case or design, or one of another loop; conditions beside a design.
    """
    table = None if spec is None else _table(spec, case)
    if table is not None and conditions:
        raise ScenarioError(f"conditions and the design {table.name}, allowed: one of them")
    grid = table.grid if table is not None else case_like("two-area-thesis" if case is None else case)
    judged = controller_like(controller, grid)
    own = specification_of(judged) if table is None and not conditions else None
    if own is not None:
        return judged, own if case is None else own.on(grid)
    if table is not None:
        _require_same_loop(judged, table)
    return judged, table or plain_design(judged, grid, conditions)


def _require_same_loop(judged: Controller | ControllerBank, table: DesignTable) -> None:
    seen = set(table.signals) <= set(judged.inputs) <= set(table.seen)
    if not seen or set(judged.outputs) != set(table.actuators):
        loops = (table.signals, table.actuators, judged.inputs, judged.outputs)
        signals, actuators, inputs, outputs = (", ".join(names) for names in loops)
        raise ScenarioError(
            f"design {table.name}: is for {signals} -> {actuators}, controller {judged.name} has {inputs} -> "
            f"{outputs}; give the design of the controller with --spec, or --conditions"
        )


def plain_design(judged: Controller | ControllerBank, grid: Case, conditions: Sequence[str]) -> DesignTable:
    """Return the design that requires a stable loop on `grid` under `conditions` (`certify`)."""
    signals = tuple(judged.inputs)
    plain = (*PLAIN, *(f"L:{s}" for s in signals), *(f"s200+L:{s}" for s in signals if len(signals) > 1))
    states = max(c.order for c in (judged.members if isinstance(judged, ControllerBank) else (judged,)))
    keys: dict[str, Any] = {
        "name": judged.name,
        "case": grid.name,
        "part": [
            {"actuator": name, "signals": signals, "order": min(max(states, 1), 20)}
            for name in judged.outputs
        ],
        "conditions": tuple(conditions) or plain,
        "point": [{"name": "as it is"}],
    }
    return design_of(keys, where="conditions").on(grid)


def _table(spec: str | Path | Mapping[str, Any], case: Case | str | Path | None) -> DesignTable:
    table = design_of(spec) if isinstance(spec, Mapping) else load_design(spec)
    return table if case is None else table.on(case)
