"""A design made and judged for a grid, from its data alone: sets of loops tried until one holds.

The linear certificate comes first: faults are run for a set that passes it, or for the best where none does.
Every part is kept in the cache by the hash of what it came from: what is stopped goes on where it was.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from interarea.design.certificates.mode_changes import ModeChange
from interarea.design.controllers.controller import Controller
from interarea.design.errors import InfeasibleDesign
from interarea.fmu_build.write.cache import cached_json, code_hash, content_hash
from interarea.models.case.case import Case
from interarea.models.errors import InterareaError

from ..designs.design_file import DESIGN_STEPS, DesignTable, run_design
from ..errors import machine_error
from .choices import Choices
from .clock import Clock
from .faults import falls_short, judged_with_faults
from .proposal import Findings, Proposal, find, propose
from .weak_modes import WeakModes, modes_of_grid, weak_modes

DESIGN_STAGES = ("modes", "loops and operating points", "search", "faults")  #: of `design_grid`
TRIED_SETS = 3  #: sets of loops for which a whole design is searched, at most

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

    def because(self, lines: tuple[str, ...]) -> GridDesign:
        """Return the design with more reasons."""
        return replace(self, proposal=replace(self.proposal, reasons=(*self.proposal.reasons, *lines)))


def design_grid(
    case: Case,
    cache: Path,
    clock: Clock,
    *,
    choices: Choices | None = None,
    name: str = "",
    named: str = "",
    report: Report = lambda stage, share: None,
) -> GridDesign:
    """Make a design for a grid, run it, judge it with faults; parts are found again in `cache`.

    clock : of the time that it may take. choices : of a person. name : of the controller. named : how the
    design file names the case. report : called with one of `DESIGN_STAGES` and the share of it that is done.

    Raises
    ------
    ScenarioError, ModeError, InfeasibleDesign : no weak mode, none within reach, or no stable controller.
    """
    report(DESIGN_STAGES[0], 0.0)
    weak = weak_modes(modes_of_grid(case, cache), choices)
    report(DESIGN_STAGES[0], 1.0)
    findings = findings_of(weak, cache, clock, report=report)
    return design_for(findings, cache, clock, name=name, named=named, report=report)


def findings_of(
    weak: WeakModes, cache: Path, clock: Clock, *, report: Report = lambda stage, share: None
) -> Findings:
    """Return what a grid shows before a design (`find`), reported as one of `DESIGN_STAGES`."""
    loops = DESIGN_STAGES[1]
    shares = {"loops": (0.0, 0.8), "operating points": (0.8, 0.2)}

    def relayed(step: str, share: float) -> None:
        start, part = shares[step]
        report(loops, start + part * share)

    findings = find(weak, cache, clock, progress=relayed)
    report(loops, 1.0)
    return findings


def design_for(
    findings: Findings,
    cache: Path,
    clock: Clock,
    *,
    name: str = "",
    named: str = "",
    report: Report = lambda stage, share: None,
) -> GridDesign:
    """Try sets of loops until a design holds what is asked, or return the best within the time.

    findings : of the grid. Other arguments and errors as `design_grid`.
    """
    *_, search, faults = DESIGN_STAGES
    weak = findings.weak
    weakest = {"base": weak.weakest.damping_ratio} | {r.point.name: r.least for r in findings.points}
    designs: list[GridDesign] = []
    problem = ""
    for taken in findings.sets[:TRIED_SETS]:
        names = ", ".join(taken.chosen.actuators)
        if clock.over("search") and (designs or problem):
            clock.leave(f"a design for {names}")
            continue
        report(search, 0.0)
        proposal = propose(findings, taken, cache, clock, name=name, case=named)
        try:
            controller = _searched(proposal.table, cache, lambda share: report(search, share))
        except InterareaError as error:
            if machine_error(error) is not None:
                raise
            problem = str(error)
            continue
        report(search, 1.0)
        designs.append(GridDesign(proposal, controller))
        if designs[-1].certificate["passed"]:
            designs[-1] = _with_faults(
                designs[-1], cache, clock, weakest, lambda share: report(faults, share)
            )
            if designs[-1].certificate["passed"]:
                break
    if not designs:
        raise InfeasibleDesign(problem, constraint="stability")
    best = max(designs, key=_better)
    if best.certificate["acceptance"] is None:
        best = _with_faults(best, cache, clock, weakest, lambda share: report(faults, share))
    report(search, 1.0)
    report(faults, 1.0)
    if not clock.left_out:
        return best
    return best.because(
        (f"Within {clock.minutes:g} minutes there was no time for: {'; '.join(clock.left_out)}.",)
    )


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
    design: GridDesign,
    cache: Path,
    clock: Clock,
    weakest: Mapping[str, float],
    progress: Callable[[float], object],
) -> GridDesign:
    """Judge a design with its faults, at the largest output limit that holds."""
    table = design.proposal.table
    judged = judged_with_faults(table, design.controller, cache, clock, weakest=weakest, progress=progress)
    limited = table.model_copy(update={"limit_pu": judged.limit_pu})
    return GridDesign(replace(design.proposal, table=limited), judged)


def _better(design: GridDesign) -> tuple[int, float, int]:
    """Return what decides between designs: unstable loops, what is missed of what is asked, lost faults."""
    certificate, requested = design.certificate, design.proposal.table.ask
    unstable, short = falls_short(certificate, requested.inter_area, requested.worst_swing)
    lost = len((certificate["acceptance"] or {}).get("lost", ()))
    taken = max((ModeChange(**mode).taken for mode in certificate["modes"]), default=0.0)
    return -unstable, min(short, requested.given_away - taken), -lost
