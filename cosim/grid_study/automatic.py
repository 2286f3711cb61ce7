"""A design made and judged for a grid, from its data alone: sets of loops tried until one holds.

Every part is kept in the cache by the hash of what it came from: what is stopped goes on where it was.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from interarea.design.controllers.controller import Controller
from interarea.design.errors import InfeasibleDesign
from interarea.fmu_build.write.cache import cached_json, code_hash, content_hash
from interarea.models.case.case import Case

from ..designs.design_file import DESIGN_STEPS, DesignTable, certify, judged_by, run_design
from .proposal import Proposal, find, propose
from .weak_modes import WeakModes, modes_of_grid, weak_modes

DESIGN_STAGES = ("modes", "loops and operating points", "search", "faults")  #: of `design_grid`
TRIED_SETS = 3  #: sets of loops for which a whole design is searched, at most
#: output limits that are tried until no fault is lost that holds without control, pu: a guard that watches a
#: lost signal limits nothing, and a smaller output adds less to a first swing
LIMITS_PU = (0.05, 0.02, 0.01)

Report = Callable[[str, float], object]


@dataclass(frozen=True)
class GridDesign:
    """A design made from the grid, and its controller with its certificate, faults included."""

    proposal: Proposal
    controller: Controller

    @property
    def certificate(self) -> dict[str, Any]:
        """The certificate as JSON values."""
        return dict(self.controller.certificate or {})


def design_grid(
    case: Case, cache: Path, *, name: str = "", named: str = "", report: Report = lambda stage, share: None
) -> GridDesign:
    """Make a design for a grid, run it, judge it with faults; parts are found again in `cache`.

    name : of the controller. named : how the design file names the case. report : called with one of
    `DESIGN_STAGES` and the share of it that is done.

    Raises
    ------
    ScenarioError, ModeError, InfeasibleDesign : no weak mode, none within reach, or no stable controller.
    """
    report(DESIGN_STAGES[0], 0.0)
    weak = weak_modes(modes_of_grid(case, cache))
    report(DESIGN_STAGES[0], 1.0)
    return design_for(weak, cache, name=name, named=named, report=report)


def design_for(
    weak: WeakModes,
    cache: Path,
    *,
    name: str = "",
    named: str = "",
    report: Report = lambda stage, share: None,
) -> GridDesign:
    """Try sets of loops until a design holds what is asked, or return the best of `TRIED_SETS`.

    Arguments and errors as `design_grid`.
    """
    _, loops, search, faults = DESIGN_STAGES
    shares = {"loops": (0.0, 0.8), "operating points": (0.8, 0.2)}

    def shown(step: str, share: float) -> None:
        start, part = shares[step]
        report(loops, start + part * share)

    findings = find(weak, cache, progress=shown)
    report(loops, 1.0)
    best, problem = None, ""
    for taken in findings.sets[:TRIED_SETS]:
        report(search, 0.0)
        proposal = propose(findings, taken, cache, name=name, case=named)
        try:
            controller = _searched(proposal.table, cache, lambda share: report(search, share))
        except InfeasibleDesign as error:
            problem = str(error)
            continue
        report(search, 1.0)
        done = _with_faults(proposal, controller, cache, lambda share: report(faults, share))
        report(faults, 1.0)
        if best is None or _better(done) > _better(best):
            best = done
        if done.certificate["passed"]:
            break
    if best is None:
        raise InfeasibleDesign(problem, constraint="stability")
    return best


def _searched(table: DesignTable, cache: Path, progress: Callable[[float], object]) -> Controller:
    """Return the controller of a design, its linear certificate in its record."""
    key = content_hash(table.grid.hash, table.model_dump(mode="json"), code_hash(run_design.__module__))

    def tell(step: str, share: float, _: str) -> None:
        if step == DESIGN_STEPS[1]:
            progress(share)

    def made() -> dict[str, Any]:
        return run_design(table, cache, progress=tell).controller.as_dict()

    return Controller.from_dict(cached_json(cache, "grid-design", key, made))


def _with_faults(
    proposal: Proposal, controller: Controller, cache: Path, progress: Callable[[float], object]
) -> GridDesign:
    """Judge a controller with the faults of its design, with smaller output limits where faults are lost."""
    best: GridDesign | None = None
    for k, limit_pu in enumerate(LIMITS_PU):
        table = proposal.table.model_copy(update={"limit_pu": limit_pu})
        limited = replace(controller, limit_pu=limit_pu)
        key = content_hash(
            table.grid.hash, table.model_dump(mode="json"), limited.as_dict(), code_hash(certify.__module__)
        )

        def made(table: DesignTable = table, limited: Controller = limited, k: int = k) -> dict[str, Any]:
            def tell(step: str, share: float) -> None:
                progress((k + 0.99 * share) / len(LIMITS_PU))

            judged = certify(table, limited, cache, acceptance=True, progress=tell)
            return judged_by(table, limited, judged).as_dict()

        judged = Controller.from_dict(cached_json(cache, "grid-faults", key, made))
        done = GridDesign(replace(proposal, table=table), judged)
        if best is None or _better(done) > _better(best):
            best = done
        if not done.certificate["acceptance"]["lost"] and not done.certificate["acceptance"]["standing"]:
            break
    assert best is not None
    return best


def _better(design: GridDesign) -> tuple[int, float]:
    """Return what decides between designs: fewer violations, then more inter-area damping."""
    certificate = design.certificate
    return -len(certificate["violations"]), certificate["inter_area"]
