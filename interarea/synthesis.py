"""Public functions on controllers: design one, load one, recompute what it holds."""

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

    Its `certificate` is on full linear plants with exact latency and says whether what was asked is held.

    Parameters
    ----------
    spec : design file, bundled name (``interarea list``), or the keys of such a file.
    case : another case than the design's.
    progress : called with the step that is under way, the share of it that is done, and in words what the
        search has reached; without it a notebook shows bars.

    Raises
    ------
    UserError : a mistake in the design. InfeasibleDesign : a mode out of reach, or no stable start.

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

    case : for which wdc, cc and ftc are designed; its base speed is that of an FMU.

    Raises
    ------
    UserError : no such controller, or a file of something else.

    Examples
    --------
    >>> load_controller("robust").inputs
    ('G2_dw', 'G4_dw')
    """
    controller = controller_of(name, case_like(case), default_cache())
    if controller is None:
        raise ScenarioError(
            "controller 'none' is no controller, allowed: what `interarea list` names, or a file"
        )
    return controller


def controller_like(
    controller: Controller | ControllerBank | SystemLike | str | Path,
    case: Case | str | Path = "two-area-thesis",
) -> Controller | ControllerBank:
    """Return a controller as it is, of a `StateSpace` (u = +K y, speeds in rad/s), or by name or file."""
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
    """Recompute what a controller holds, on full linear plants with exact latency.

    A controller is judged by the design in its own record. Without one it must be stable on the case as it
    is: every signal there, each lost in turn, all 0 to 200 ms late. A bank of controllers is judged for every
    sequence of losses and returns.

    Parameters
    ----------
    controller : object, `control.StateSpace` (u = +K y, speeds in rad/s, actuators in pu), name, JSON or FMU.
    case : another case than the design's.
    spec : design (file, bundled name, keys) that judges instead.
    conditions : under which the controller must be stable on the case as it is, instead of any design; codes
        as those of a design file, such as ``["N", "s100", "L:G2_dw"]``.
    progress : called with the step that is under way and the share of it that is done; without it a
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
    """Return a controller, and the design that judges it: `spec`, that of its record, or plain conditions.

    case : another than the design's. conditions : plain ones instead of any design.

    Raises
    ------
    UserError : no such controller, case or design; conditions beside a design, or of another kind.
    """
    table = None if spec is None else _table(spec, case)
    if table is not None and conditions:
        raise ScenarioError(f"conditions beside the design {table.name}, allowed: one of them")
    grid = table.grid if table is not None else case_like("two-area-thesis" if case is None else case)
    judged = controller_like(controller, grid)
    own = specification_of(judged) if table is None and not conditions else None
    if own is not None:
        return judged, own if case is None else own.on(grid)
    return judged, table or plain_design(judged, grid, conditions)


def plain_design(judged: Controller | ControllerBank, grid: Case, conditions: Sequence[str]) -> DesignTable:
    """Return the design that asks for a stable loop on `grid` as it is, under `conditions` (`certify`)."""
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
