"""Robust design and certification from a TOML file: operating points, losses, latencies, requirements."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import control
from pydantic import Field, PrivateAttr, ValidationError, model_validator

from interarea.design.controllers.bank import ControllerBank
from interarea.design.controllers.bundled import shipped_controller, shipped_names
from interarea.design.controllers.controller import Controller
from interarea.design.delay.signal_conditions import Condition, condition_of_many
from interarea.design.linear.linearise import scaled_inputs, with_input
from interarea.design.robust.design import design_robust
from interarea.design.robust.operating_points import FamilyCertificate, inter_area_band, judge_family
from interarea.design.robust.smoothed_objective import BandOffsets
from interarea.design.robust.spec import RobustSpec, require_moved
from interarea.models.case.case import Case, load_case
from interarea.models.mistakes import mistakes
from interarea.models.table import Table

from ..errors import ScenarioError
from ..scenario.named import design_file as named_file
from ..toml_file import case_beside, read_toml
from .acceptance import judge_acceptance
from .certificate_words import not_covered
from .design_tables import (
    AcceptanceTable,
    AskTable,
    BankTable,
    GuardTable,
    Identifier,
    Offsets,
    PartTable,
    PointTable,
    Positive,
    StageTable,
    TargetTable,
    require_distinct,
)
from .family import family_cases, family_plants, require_in_grid, with_margins, with_mode_changes
from .first_swing import FaultRow, FaultTable, after_fault, predicted_drive
from .swing_sensitivity import FirstSwingTable, swing_penalty

DESIGN_STEPS = ("linear plants", "search", "certificate")  #: of `run_design`
CERTIFICATE_STEPS = ("linear family", "faults", "non-linear faults")  #: of `certify`
_OFFSETS = (BandOffsets().omega, BandOffsets().offset)


class DesignTable(Table):
    """A robust design: one controller for a family of operating points, losses and latencies.

    Either one loop (`remote`, `local`, `actuator`, `order`), or one `part` for each actuator.
    """

    name: Identifier  #: of the controller: letters, digits and _
    case: str  #: bundled name, or a case file relative to this one
    remote: str | None = None  #: the remote signal, such as `G2_dw`
    local: str | None = None  #: the signal measured at the actuator, such as `G4_dw`
    #: controlled input of the plant, such as `G4_vs`; with `part`: named there
    actuator: str | None = None
    order: Annotated[int, Field(ge=1, le=20)] = 6  #: states of the controller, including its washouts
    #: decentralised: one table for each actuator, instead of `actuator`, `remote` and `local`
    part: tuple[PartTable, ...] = ()
    #: N: all signals at once; L: the remote one lost; s100: all 100 ms late; ns150: the remote one 150 ms
    #: late; s300:G2_dw: that signal alone 300 ms late, as by a wrong time stamp; L:G2_dw: that signal lost;
    #: x2:G2_dw: that signal twice as large, x-1:G2_dw: of the wrong polarity; joined by +
    conditions: tuple[str, ...] = Field(min_length=1)
    point: tuple[PointTable, ...] = Field(min_length=1)  #: the operating points, each a change to the case
    #: of a washout at each output; 0: none. With `dc_block`: no answer to a speed that rises steadily either
    washout_s: Annotated[float, Field(ge=0.0)] = 0.0
    dc_block: bool = True  #: the controller does not answer a constant speed deviation
    feedthrough: bool = False  #: whether the controller may have direct feedthrough
    slowest_pole: Positive = 0.3  #: bound from below of the magnitude of the controller's poles, rad/s
    fastest_pole: Positive = 280.0  #: bound of the magnitude of the controller's poles, rad/s
    #: (rad/s, pu per rad/s): cap of the effort over frequency, straight between the points in log scales
    effort_cap: tuple[tuple[Positive, Positive], ...] = ((0.05, 0.155), (300.0, 0.155))
    effort_under: tuple[str, ...] = ()  #: conditions with that cap in the search; none: all
    #: signal -> factor on the controller's gain from it once the search has ended; none: 1
    gain_of: Mapping[str, float] = {}
    #: (rad/s, damping): how much more than elsewhere the optimisation wants there, piecewise linear
    offset: Offsets = Field(tuple(zip(*_OFFSETS, strict=True)), min_length=2)
    rho: Positive = 600.0  #: sharpness of the smoothed worst damping of the search
    limit_pu: Positive = 0.15  #: bound of the magnitude of every output
    guard: GuardTable | None = None  #: limits of the output that fall during a first swing
    start_from: str | None = None  #: bundled controller, or its JSON file, of the same loops and order
    starts: Annotated[int, Field(ge=0)] = 3  #: random starts of the search
    evaluations: Annotated[int, Field(ge=1)] = 1800  #: of the objective, from each start
    polishes: Annotated[int, Field(ge=0)] = 20  #: rounds of descent from the best start
    seed: int = 1  #: of the random starts
    #: number of first operating points for the starts; the best continues with all. 0: all
    starts_on: Annotated[int, Field(ge=0)] = 0
    plant_order: Annotated[int, Field(ge=2)] = 16  #: states of the reduced plants of the search
    pade_order: Annotated[int, Field(ge=1, le=8)] = 3  #: of the latencies in the search
    #: rounds of the search look at the models within this (damping) of the worst, which is quicker where
    #: there are many large ones; none: at all of them
    within: Positive | None = None
    #: the search in stages, from first guesses made for the loops (`starts` of them, tried in the first);
    #: none: all conditions at once from random starts, and `rho`, `evaluations`, `polishes`, `starts_on` and
    #: `within` say how
    stage: tuple[StageTable, ...] = ()
    ask: AskTable = AskTable()  #: requirements of the certificate
    target: tuple[TargetTable, ...] = ()  #: other targets if signals are all available, late, lost or scaled
    fault: FaultTable | None = None  #: the fault that the certificate runs at every operating point
    #: non-linear faults that `interarea certify NAME --acceptance` runs
    acceptance: AcceptanceTable | None = None
    first_swing: FirstSwingTable | None = None  #: limit of the controller's contribution to a first swing
    bank: BankTable | None = None  #: other controllers for lost signals, behind a supervisor
    source: str = ""  #: source of the design
    _grid: Case | None = PrivateAttr(None)  # of `on`

    @property
    def grid(self) -> Case:
        """The case of the design, without the changes of its operating points."""
        return self._grid if self._grid is not None else load_case(self.case)

    def on(self, case: Case | str | Path) -> DesignTable:
        """Return this design for another case: a `Case`, a bundled name or a file."""
        grid = case if isinstance(case, Case) else load_case(case)
        changed = self.model_copy(update={"case": grid.name if isinstance(case, Case) else str(case)})
        changed._grid = grid
        return changed

    @model_validator(mode="after")
    def _caps_agree(self) -> DesignTable:
        self.ask.check(min(cap for _, cap in self.effort_cap), self.slowest_pole)
        return self

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the controller's inputs."""
        if self.part:
            return tuple(dict.fromkeys(name for part in self.part for name in part.signals))
        return tuple(name for name in (self.remote, self.local) if name is not None)

    @property
    def seen(self) -> tuple[str, ...]:
        """Names of the controller's inputs, and of the signal that its guard follows."""
        follows = () if self.guard is None or self.guard.follows is None else (self.guard.follows,)
        return tuple(dict.fromkeys((*self.signals, *follows)))

    @property
    def actuators(self) -> tuple[str, ...]:
        """Names of the controller's outputs."""
        return tuple(part.actuator for part in self.part) or ((self.actuator,) if self.actuator else ())

    @model_validator(mode="after")
    def _points_agree(self) -> DesignTable:
        known = [point.name for point in self.point]
        require_distinct("point", known)
        for k, stage in enumerate(self.stage, start=1):
            if strange := sorted(set(stage.points) - set(known)):
                raise ValueError(f"stage {k} names unknown points {strange}; the design has {sorted(known)}")
        if self.acceptance is not None:
            self.acceptance.check(known)
        if self.first_swing is not None:
            self.first_swing.check(known, self.acceptance)
        return self

    @model_validator(mode="after")
    def _targets_agree(self) -> DesignTable:
        known = ("all", "late", "lost", "scaled", *self.conditions)
        for target in self.target:
            if target.under not in known:
                raise ValueError(f"target.under = {target.under!r}, allowed: {', '.join(known)}")
        if strange := sorted(set(self.gain_of) - set(self.signals)):
            raise ValueError(f"gain_of names {strange}, allowed: {', '.join(self.signals)}")
        if self.bank is not None:
            self.bank.check(self.signals, self.guard)
        if self.acceptance is not None:
            self.acceptance.check_signals(self.seen)
        if self.guard is not None:
            self.guard.guard().check(self.name, self.seen, self.actuators)
        return self

    @model_validator(mode="after")
    def _one_form(self) -> DesignTable:
        single = {"remote": self.remote, "local": self.local, "actuator": self.actuator}
        keys = [key for key, value in single.items() if value is not None]
        if self.part and keys:
            raise ValueError(f"give either [[part]] or {', '.join(single)}, got both ({', '.join(keys)})")
        if not self.part and len(keys) < len(single):
            missing = [key for key in single if key not in keys]
            raise ValueError(f"missing {', '.join(missing)} (or one [[part]] for each actuator)")
        require_distinct("remote, local", [s for s in (self.remote, self.local) if s is not None])
        return self

    def family(self) -> tuple[Condition, ...]:
        """Return the conditions of the codes in `conditions`."""
        return tuple(condition_of_many(code, self.signals, remote=self.remote) for code in self.conditions)

    def spec(self) -> RobustSpec:
        """Return the specification of the optimisation."""
        return RobustSpec(
            self.signals,
            self.actuators,
            self.family(),
            order=self.order,
            sees={part.actuator: (part.signals, part.order) for part in self.part},
            washout_s=self.washout_s,
            dc_block=self.dc_block,
            feedthrough=self.feedthrough,
            slowest_pole=self.slowest_pole,
            fastest_pole=self.fastest_pole,
            effort_cap=self.effort_cap,
            effort_under=self.effort_under,
            stages=tuple(stage.stage() for stage in self.stage),
            offsets=BandOffsets(*zip(*self.offset, strict=True)),
            more={p.name: BandOffsets(*zip(*p.more, strict=True)) for p in self.point if p.more},
            more_under={t.under: BandOffsets(*zip(*t.more, strict=True)) for t in self.target if t.more},
            rho=self.rho,
            starts=self.starts,
            evaluations=self.evaluations,
            polishes=self.polishes,
            seed=self.seed,
            start=None if self.start_from is None else _controller(self.start_from).system,
            within=float("inf") if self.within is None else self.within,
            starts_on=self.starts_on,
            plant_order=self.plant_order,
            pade_order=self.pade_order,
        )


def _controller(name: str) -> Controller:
    """Return a bundled controller, or that of a JSON file; ControllerError as they say."""
    return shipped_controller(name) if name in shipped_names() else Controller.load(name)


def load_design(path: str | Path) -> DesignTable:
    """Read and check a design file, or the bundled one of that name. A case name may be a file beside it.

    Raises ScenarioError naming file, key, value and what is allowed.
    """
    file = named_file(path)
    return design_of(case_beside(read_toml(file, "design", ScenarioError), file.parent), where=str(path))


def design_of(keys: Mapping[str, Any], *, where: str = "design") -> DesignTable:
    """Return the design of the keys of a design file; `where` names them in errors.

    Raises ScenarioError naming key, value and what is allowed.
    """
    try:
        table = DesignTable.model_validate(keys)
        table.spec()
    except ValidationError as error:
        raise ScenarioError(*(f"{where}: {line}" for line in mistakes(error, DesignTable))) from error
    except ValueError as error:
        raise ScenarioError(f"{where}: {error}") from error
    return table


@dataclass(frozen=True)
class Designed:
    """A certified controller, and the controllers of the other starts of the search."""

    controller: Controller
    tried: Mapping[str, control.StateSpace]


def run_design(
    table: DesignTable,
    cache: Path,
    *,
    start: control.StateSpace | None = None,
    progress: Callable[[str, float, str], object] = lambda step, share, text: None,
) -> Designed:
    """Design the controller of `table` and certify it on full linear plants with exact latency.

    start : an additional start of the search, instead of the one that the design names. progress : called
    with one of `DESIGN_STEPS`, its completed share, and the present result in words.

    Raises
    ------
    InfeasibleDesign : a mode out of reach, or no start that keeps every design model stable.
    ScenarioError : a bus, branch or followed output that the grid does not have.
    """
    linearising, searching, certifying = DESIGN_STEPS
    progress(linearising, 0.0, "")
    require_in_grid(table.name, table.grid, table.guard, table.fault, table.acceptance)
    points, spec, omega_b = family_plants(table, cache), table.spec(), table.grid.omega_b
    if start is not None:
        spec = replace(spec, start=start)
    plants = {name: each.searched for name, each in points.items()}
    for name, plant in plants.items():
        require_moved(name, plant, spec, points[name].modes)
    if table.first_swing is not None and table.acceptance is not None:
        penalty = swing_penalty(
            {name: each.case for name, each in points.items()},
            table.first_swing,
            table.acceptance,
            table.signals,
            table.actuators,
            list(dict.fromkeys(condition.lost for condition in spec.conditions)),
            table.limit_pu,
            cache,
        )
        spec = replace(spec, swing=penalty, margins_deg=table.first_swing.margins_deg)
    progress(linearising, 1.0, "")

    def tell(what: str, share: float, reached: float) -> None:
        progress(searching, min(share, 0.999), f"{what}: objective {reached:.4f}")

    design_result = design_robust(plants, spec, omega_b, progress=tell)
    progress(searching, 1.0, "")
    facts = {
        "method": "smoothed worst damping over operating points, losses and latencies",
        "objective": design_result.objective,
        "evaluations": design_result.evaluations,
    }
    guard = None if table.guard is None else table.guard.guard()
    system = scaled_inputs(design_result.system, table.gain_of)
    system = system if guard is None else with_input(system, guard.follows)
    controller = Controller(table.name, system, table.limit_pu, facts, guard=guard)
    certificate = certify(table, controller, cache, progress=lambda _, share: progress(certifying, share, ""))
    progress(certifying, 1.0, "")
    starts = {f"start {k}": K for k, K in enumerate(design_result.tried, start=1)}
    return Designed(judged_by(table, controller, certificate), starts)


def design_record(table: DesignTable) -> dict[str, Any]:
    """A design as JSON values; infinite requirements are omitted, because JSON has no infinity."""
    data = table.model_dump(mode="json", exclude_none=True)
    data["ask"] = {key: value for key, value in data["ask"].items() if value != float("inf")}
    return data


def judge(
    table: DesignTable,
    K: control.StateSpace,
    cache: Path,
    *,
    progress: Callable[[float], object] = lambda share: None,
) -> FamilyCertificate:
    """Evaluate a controller (speeds in rad/s) on the family of a design by its requirements, without faults.

    progress : called with the completed share.
    """
    plants = family_plants(table, cache)
    judged = judge_family(
        {name: each.judged for name, each in plants.items()},
        K,
        table.family(),
        worst_swing=table.ask.worst_swing,
        inter_area=table.ask.inter_area,
        targets={t.under: (t.worst_swing, t.inter_area) for t in table.target},
        at={p.name: p.ask for p in table.point if p.ask is not None},
        effort_cap=table.ask.effort,
        fastest_pole=table.ask.fastest_pole,
        bands_hz={name: inter_area_band(each.modes) for name, each in plants.items()},
        progress=progress,
    )
    return with_mode_changes(judged, plants, K, table.family(), table.ask.given_away)


def steps_of(table: DesignTable, *, acceptance: bool) -> list[str]:
    """Return the names of the steps of `certify`."""
    linear, faults, accepting = CERTIFICATE_STEPS
    steps = {
        linear: True,
        accepting: acceptance and table.acceptance is not None,
        faults: table.fault is not None,
    }
    return [step for step, requested in steps.items() if requested]


def certify(
    table: DesignTable,
    controller: Controller,
    cache: Path,
    *,
    acceptance: bool = False,
    progress: Callable[[str, float], object] = lambda step, share: None,
) -> FamilyCertificate:
    """Evaluate a controller on the family of a design by its requirements; its fault is run at every point.

    acceptance : every case of the design's acceptance too, clearing times included (minutes).
    progress : called with one of `steps_of` and its completed share.
    """
    linear, faults, accepting = CERTIFICATE_STEPS
    require_in_grid(
        table.name, table.grid, table.guard, table.fault, table.acceptance if acceptance else None
    )
    certificate = judge(table, controller.system, cache, progress=lambda share: progress(linear, share))
    certificate = with_margins(certificate, table, controller.system, cache)
    if acceptance and table.acceptance is not None:
        judged = judge_acceptance(
            controller,
            family_cases(table),
            table.acceptance,
            cache,
            progress=lambda share: progress(accepting, share),
        )
        certificate = replace(
            certificate,
            acceptance=judged.as_dict(),
            violations=(*certificate.violations, *judged.violations),
        )
    certificate = replace(
        certificate, not_covered=not_covered(table, controller.inputs, certificate.acceptance)
    )
    if table.fault is None:
        return certificate
    cases = family_cases(table)
    losses = list(dict.fromkeys(c.lost for c in table.family() if c.lost)) or [()]
    drive, predicted = predicted_drive(controller, cases, table.fault, losses, cache)
    runs: list[FaultRow] = []
    for point, case in cases.items():
        for lost in losses:
            progress(faults, len(runs) / (len(cases) * len(losses)))
            runs.append(after_fault(controller, point, case, table.fault, lost, cache))
    progress(faults, 1.0)
    missed = tuple(run.missed for run in runs if not run.passed)
    return replace(
        certificate,
        drive=drive,
        predicted=predicted,
        faults=tuple(asdict(run) for run in runs),
        violations=(*certificate.violations, *(missed if table.ask.synchronism else ())),
    )


def judged_by(table: DesignTable, controller: Controller, certificate: FamilyCertificate) -> Controller:
    """Return `controller` with its design and its `certificate` in its record."""
    design = {**controller.design, "specification": design_record(table)}
    return replace(controller, design=design, certificate=certificate.as_dict())


def specification_of(controller: Controller | ControllerBank) -> DesignTable | None:
    """Return the design for a family in the record of a controller or bank, None if there is none.

    The designs of the study are for one operating point: their records name no conditions.

    Raises ScenarioError if the record exists but is not a design.
    """
    specification = controller.design.get("specification")
    one_point = isinstance(specification, Mapping) and {"conditions", "point"}.isdisjoint(specification)
    if specification is None or one_point:
        return None
    try:
        return DesignTable.model_validate(specification)
    except ValidationError as error:
        where = f"controller {controller.name}: its specification"
        raise ScenarioError(*(f"{where}: {line}" for line in mistakes(error, DesignTable))) from error
