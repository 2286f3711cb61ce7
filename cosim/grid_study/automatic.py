"""Automatic design for a grid from its data: sets of loops are tried until one meets the requirements.

The linear certificate comes first: faults are run for a set that passes it, or for the best if none does.
Every part is cached by the hash of its inputs, so an interrupted design resumes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from interarea.design.certificates.mode_changes import ModeChange
from interarea.design.controllers.controller import Controller
from interarea.design.errors import InfeasibleDesign
from interarea.design.robust.operating_points import inter_area_band, judge_family
from interarea.fmu_build.write.cache import cached_json, code_hash, content_hash
from interarea.models.case.case import Case
from interarea.models.errors import InterareaError

from ..designs.design_file import DESIGN_STEPS, DesignTable, run_design
from ..designs.family import FamilyPlant, at_point
from ..errors import machine_error
from .beside_local import beside_local, leaves_something
from .choices import Choices
from .clock import Clock
from .faults import falls_short, judged_with_faults
from .local_stabilizers import local_rival, which_to_build
from .proposal import Findings, Proposal, find, propose
from .weak_modes import WeakModes, modes_of_grid, weak_modes

DESIGN_STAGES = (
    "modes",
    "loops and operating points",
    "local stabilizers",
    "search",
    "faults",
)  #: of `design_grid`
TRIED_SETS = 3  #: sets of loops for which a whole design is searched, at most
#: operating points that one design takes up after its search, at most: each costs another search
TAKEN_UP = 2
GAINED = 1e-3  #: damping ratio that such a search must add: less is not seen in the three digits of a page

Report = Callable[[str, float], object]


@dataclass(frozen=True)
class GridDesign:
    """An automatic design, and its controller with its certificate, faults included."""

    proposal: Proposal
    controller: Controller
    local: Controller | None = None  #: local stabilizers by themselves; None where no machine can have one
    #: the grid with those of them that it can have, where the loop is for it; else None
    stabilized: Case | None = None

    @property
    def certificate(self) -> dict[str, Any]:
        """The certificate as JSON values."""
        return dict(self.controller.certificate or {})

    @property
    def passed(self) -> bool:
        """Whether the loop, or the local stabilizers alone, meet all requirements."""
        return any((one.certificate or {})["passed"] for one in (self.controller, self.local) if one)

    @property
    def sentence(self) -> str:
        """Recommendation what to build, as a sentence."""
        requested = self.proposal.table.ask
        required = (requested.inter_area, requested.worst_swing)
        return which_to_build(self.controller, self.local, required, self.proposal.findings.weak.stabilized)

    def because(self, lines: tuple[str, ...]) -> GridDesign:
        """Return the design with additional reasons."""
        return replace(self, proposal=replace(self.proposal, reasons=(*self.proposal.reasons, *lines)))


def design_grid(
    case: Case,
    cache: Path,
    clock: Clock,
    *,
    choices: Choices | None = None,
    name: str = "",
    named: str = "",
    named_stabilized: str = "",
    report: Report = lambda stage, share: None,
) -> GridDesign:
    """Propose a design for a grid, run it, and evaluate it with faults; `cache` stores the parts.

    clock : of the available processor time. choices : of the user. name : of the controller. named,
    named_stabilized : names of the case in the design file, without and with local stabilizers. report :
    called with one of `DESIGN_STAGES` and its completed share.

    Raises
    ------
    ScenarioError, ModeError, InfeasibleDesign : no weak mode, none within reach, or no stable controller.
    """
    report(DESIGN_STAGES[0], 0.0)
    weak = weak_modes(modes_of_grid(case, cache), choices)
    report(DESIGN_STAGES[0], 1.0)
    findings = findings_of(weak, cache, clock, report=report)
    return design_of_findings(
        findings, cache, clock, name=name, named=named, named_stabilized=named_stabilized, report=report
    )


def design_of_findings(
    findings: Findings,
    cache: Path,
    clock: Clock,
    *,
    name: str = "",
    named: str = "",
    named_stabilized: str = "",
    report: Report = lambda stage, share: None,
) -> GridDesign:
    """Tune local stabilizers, then design a wide-area loop for the remaining weak modes, if any.

    Arguments and errors as `design_grid`.
    """
    beside, weak = DESIGN_STAGES[2], findings.weak
    report(beside, 0.0)
    first = propose(findings, findings.sets[0], cache, clock, name=name, case=named)
    local = local_rival(weak, first.table, cache, clock, progress=lambda share: report(beside, 0.9 * share))
    stabilized: WeakModes | None = None
    lines: tuple[str, ...] = ()
    if local is not None and leaves_something(local, first.table.ask):
        stabilized = beside_local(weak, local, cache)
    report(beside, 1.0)
    if stabilized is not None:
        clock.again()
        try:
            again = findings_of(stabilized, cache, clock, report=report)
            name = f"{first.table.name}_with_stabilizers"
            done = design_for(again, cache, clock, name=name, named=named_stabilized, report=report)
            return replace(done, local=local, stabilized=stabilized.case)
        except InfeasibleDesign as error:
            lines = (f"No loop was designed for the grid with local stabilizers: {error}.",)
    done = design_for(findings, cache, clock, first=first, report=report)
    return replace(done.because(lines), local=local)


def findings_of(
    weak: WeakModes, cache: Path, clock: Clock, *, report: Report = lambda stage, share: None
) -> Findings:
    """Return the analysis of a grid before its design (`find`), reported as one of `DESIGN_STAGES`."""
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
    first: Proposal | None = None,
    name: str = "",
    named: str = "",
    report: Report = lambda stage, share: None,
) -> GridDesign:
    """Try sets of loops until a design meets the requirements, or return the best within the time.

    findings : of the grid. first : the proposal for the first set, where it is there already. name, named :
    of other proposals. Other arguments and errors as `design_grid`.
    """
    *_, search, faults = DESIGN_STAGES
    if first is not None:
        name, named = first.table.name, first.table.case
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
        proposal = first
        if proposal is None or proposal.taken is not taken:
            proposal = propose(findings, taken, cache, clock, name=name, case=named)
        try:
            controller = _searched(proposal.table, cache, lambda share: report(search, share))
        except InterareaError as error:
            if machine_error(error) is not None:
                raise
            problem = str(error)
            continue
        first_try = GridDesign(proposal, controller)
        designs.append(_with_worst_points(first_try, cache, clock, lambda share: report(search, share)))
        report(search, 1.0)
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
    return best.because(_without_time(clock))


def left_out_rows(
    proposal: Proposal, controller: Controller, cache: Path, clock: Clock, stage: str
) -> list[dict[str, Any]]:
    """Evaluate a controller at operating points that were tried but are not in its design.

    Rows as those of a certificate, as JSON values. stage : of `clock`; after its end no point is evaluated.
    """
    table, rows = proposal.table, []
    for row in proposal.left_out:
        if clock.over(stage):
            clock.leave(f"the controller at {row.point.name}, a point outside its design")
            continue
        case = at_point(table.grid, row.point)

        def compute(name: str = row.point.name, case: Case = case) -> list[dict[str, Any]]:
            plant = FamilyPlant.of(case, table.signals, table.actuators, cache)
            band = inter_area_band(plant.modes)
            judged = judge_family(
                {name: plant.judged}, controller.system, table.family(), bands_hz={name: band}
            )
            return [asdict(one) for one in judged.rows]

        # by what is judged: limits and faults of the controller may change meanwhile
        setup = [table.signals, table.actuators, table.conditions]
        K = controller.matrices
        key = content_hash(
            case.hash, row.point.name, setup, K.A, K.B, K.C, K.D, code_hash(judge_family.__module__)
        )
        rows += cached_json(cache, "grid-left-out", key, compute)
    return rows


def least_held(rows: Sequence[Mapping[str, Any]]) -> float:
    """Return the least inter-area damping ratio of rows of a certificate; -1 where a loop is unstable.

    >>> least_held([{"stable": True, "inter_area": 0.2}, {"stable": False, "inter_area": 0.1}])
    -1.0
    """
    return min((float(row["inter_area"]) if row["stable"] else -1.0 for row in rows), default=1.0)


def _with_worst_points(
    design: GridDesign, cache: Path, clock: Clock, progress: Callable[[float], object]
) -> GridDesign:
    """Add the operating point with the least margin of a design, if it is not among the design's own.

    It is searched for again with that point, and what comes out is taken where it holds more over the points
    of both. A point counts where the design holds less there than it is asked for and than at its own points.
    """
    also: list[str] = []
    lines: list[str] = []
    while len(also) < TAKEN_UP and not clock.over("search"):
        name, reached = _worst_outside(design, cache, clock)
        if not name:
            break
        also.append(name)
        lines.append(f"Point {name} added: without it the design reaches {reached:.3f} there.")
        again = _searched_with(design.proposal, also, cache, clock, progress)
        if again is None or not least_held(again.certificate["rows"]) > reached + GAINED:
            break
        design = again.because(tuple(lines))
    return design


def _worst_outside(design: GridDesign, cache: Path, clock: Clock) -> tuple[str, float]:
    """Return the point that is not in a design and counts, and what is held there; "" for none."""
    outside = left_out_rows(design.proposal, design.controller, cache, clock, "search")
    worst = min(outside, key=lambda row: least_held([row]), default=None)
    if worst is None:
        return "", 1.0
    inside, reached = least_held(design.certificate["rows"]), least_held([worst])
    counts = reached < min(inside, design.proposal.table.ask.inter_area)
    return str(worst["point"]) if counts else "", reached


def _searched_with(
    proposal: Proposal, also: Sequence[str], cache: Path, clock: Clock, progress: Callable[[float], object]
) -> GridDesign | None:
    """Search for a design again with more points; None where no controller comes out."""
    table = proposal.table
    wider = propose(
        proposal.findings, proposal.taken, cache, clock, name=table.name, case=table.case, also=also
    )
    try:
        return GridDesign(wider, _searched(wider.table, cache, progress))
    except InterareaError as error:
        if machine_error(error) is not None:
            raise
        return None


def _without_time(clock: Clock) -> tuple[str, ...]:
    if not clock.left_out:
        return ()
    rows = "; ".join(clock.left_out)
    return (f"Within {clock.minutes:g} minutes of processor time these were not computed: {rows}.",)


def _searched(table: DesignTable, cache: Path, progress: Callable[[float], object]) -> Controller:
    """Return the controller of a design, its linear certificate in its record."""
    key = content_hash(table.grid.hash, table.model_dump(mode="json"), code_hash(run_design.__module__))

    def tell(step: str, share: float, _: str) -> None:
        if step == DESIGN_STEPS[1]:
            progress(share)

    def compute() -> dict[str, Any]:
        return run_design(table, cache, progress=tell).controller.as_dict()

    return Controller.from_dict(cached_json(cache, "grid-design", key, compute))


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
    return replace(design, proposal=replace(design.proposal, table=limited), controller=judged)


def _better(design: GridDesign) -> tuple[int, float, int]:
    """Return the criteria for comparing designs: unstable loops, missed requirements, lost faults."""
    certificate, requested = design.certificate, design.proposal.table.ask
    unstable, short = falls_short(certificate, requested.inter_area, requested.worst_swing)
    lost = len((certificate["acceptance"] or {}).get("lost", ()))
    taken = max((ModeChange(**mode).taken for mode in certificate["modes"]), default=0.0)
    return -unstable, min(short, requested.given_away - taken), -lost
