"""The plants of a design's operating points: dense where that is faster, else sparse blocks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Protocol

import control

from interarea.design.certificates.large_loop import LargePlant
from interarea.design.certificates.mode_changes import ModeChange, mode_changes
from interarea.design.certificates.signal_margins import signal_margins
from interarea.design.delay.signal_conditions import Condition
from interarea.design.linear.linearise import remove_reference, speeds_in_rad
from interarea.design.linear.sparse_plant import SparsePlant
from interarea.design.modes.modes import Mode, ModeError, modes_of
from interarea.design.reduction.gramians import ReductionError
from interarea.design.reduction.low_rank import low_rank_reduction
from interarea.design.robust.operating_points import FamilyCertificate, JudgedPlant
from interarea.models.blocks.plant_shown import shown_of
from interarea.models.case.case import Case
from interarea.models.case.variants import operating_variant
from interarea.models.errors import nearest

from ..errors import ScenarioError
from ..run.artefacts import linear_plant, sparse_linear_plant
from .design_tables import AcceptanceTable, GuardTable, PointTable
from .first_swing import FaultTable

#: states above which a condition is judged sooner on the sparse blocks: .3 s against 1 s with 148 states, and
#: the dense time rises with the third power
DENSE_STATES = 400
#: states of the model of a large plant that a search starts from, and its largest error over the peak
MODEL_STATES, MODEL_ERROR = 120, 1e-4


class Family(Protocol):
    """The properties of a design that define its operating points."""

    @property
    def grid(self) -> Case: ...
    @property
    def point(self) -> tuple[PointTable, ...]: ...
    @property
    def signals(self) -> tuple[str, ...]: ...
    @property
    def actuators(self) -> tuple[str, ...]: ...


@dataclass(frozen=True)
class FamilyPlant:
    """One operating point. small : dense, without reference angle, speeds in pu; None: too large for that."""

    case: Case
    signals: tuple[str, ...]
    actuators: tuple[str, ...]
    blocks: SparsePlant
    small: control.StateSpace | None

    @classmethod
    def of(cls, case: Case, signals: tuple[str, ...], actuators: tuple[str, ...], cache: Path) -> FamilyPlant:
        """Linearise a case, dense where it is small enough."""
        blocks = sparse_linear_plant(case, cache)
        small = remove_reference(linear_plant(case, cache)) if blocks.nstates <= DENSE_STATES else None
        return cls(case, signals, actuators, blocks, small)

    @cached_property
    def judged(self) -> JudgedPlant:
        """The full plant, as certificates take it."""
        if self.small is not None:
            return speeds_in_rad(self.small, self.case.omega_b)
        return LargePlant(self.blocks, self.case.areas, self.case.omega_b)

    @cached_property
    def searched(self) -> control.StateSpace:
        """The plant of the design models, speeds in pu: for a large one a model of `MODEL_STATES`.

        Raises
        ------
        ReductionError : this number of states is not sufficient for `MODEL_ERROR`.
        """
        if self.small is not None:
            return self.small
        model = low_rank_reduction(
            self.blocks,
            MODEL_STATES,
            inputs=self.actuators,
            outputs={name: {name: 1.0} for name in self.signals},
        )
        if not model.error <= MODEL_ERROR:
            raise ReductionError(
                f"{self.case.name}: {MODEL_STATES} states leave an error of {model.error:.1e} over the peak, "
                f"allowed: {MODEL_ERROR:g}; use fewer signals or actuators"
            )
        return model.system

    @cached_property
    def modes(self) -> Mapping[str, Mode] | None:
        """The swing modes by name, of a large plant the inter-area ones; None if the case has none."""
        if isinstance(self.judged, LargePlant):
            return {mode.name: mode for mode in self.judged.inter_area}
        return named_modes(self.searched, self.case)


def named_modes(plant: control.StateSpace, case: Case) -> Mapping[str, Mode] | None:
    """Return the swing modes of an operating point by name; None if the case has none."""
    try:
        return modes_of(plant, case.areas)
    except ModeError:
        return None


def at_point(case: Case, point: PointTable) -> Case:
    """Return `case` at an operating point. Raises CaseError if there is none."""
    return operating_variant(
        case,
        tie_flow_mw=point.tie_flow_mw,
        out=point.out,
        load_scale=point.load_scale,
        vary=point.vary,
    )


def require_in_grid(
    name: str,
    grid: Case,
    guard: GuardTable | None,
    fault: FaultTable | None,
    acceptance: AcceptanceTable | None,
) -> None:
    """Raise ScenarioError for an output, bus or branch of a design that its grid does not have."""
    shown = [each.variable.name for each in shown_of(grid) if each.variable.role == "output"]
    buses, branches = [bus.number for bus in grid.buses], [branch.name for branch in grid.branches]
    rows: list[tuple[str, object, Sequence[object]]] = []
    if guard is not None:
        rows.append(("guard.follows: output", guard.follows, shown))
    if fault is not None:
        rows += [("fault.bus", fault.bus, buses), ("fault.branch", fault.branch, branches)]
    for place in () if acceptance is None else acceptance.fault:
        rows += [("acceptance.fault.bus", place.bus, buses), ("acceptance.fault.trip", place.trip, branches)]
    unknown = [row for row in rows if row[1] is not None and row[1] not in row[2]]
    if unknown:
        raise ScenarioError(
            *(
                f"design {name}: {key} {what!r} is not in {grid.name}; {nearest(what, known)}"
                for key, what, known in unknown
            )
        )


def family_cases(table: Family) -> dict[str, Case]:
    """Return operating point -> case of a design."""
    return {point.name: at_point(table.grid, point) for point in table.point}


def family_plants(table: Family, cache: Path) -> dict[str, FamilyPlant]:
    """Return operating point -> its plant."""
    return {
        name: FamilyPlant.of(case, table.signals, table.actuators, cache)
        for name, case in family_cases(table).items()
    }


def with_margins(
    judged: FamilyCertificate, table: Family, K: control.StateSpace, cache: Path
) -> FamilyCertificate:
    """Add the delay and gain margins of each signal to a certificate."""
    plants = {name: each.judged for name, each in family_plants(table, cache).items()}
    return replace(judged, margins=tuple(margin.as_dict() for margin in signal_margins(plants, K)))


def with_mode_changes(
    judged: FamilyCertificate,
    plants: Mapping[str, FamilyPlant],
    K: control.StateSpace,
    conditions: Sequence[Condition],
    given_away: float,
) -> FamilyCertificate:
    """Add the least damping of every mode without a lost signal, and its violations, to a certificate.

    given_away : damping ratio that a mode may lose; infinity: the certificate stays as it is.
    """
    if given_away == float("inf"):
        return judged
    there = [condition for condition in conditions if not condition.lost]
    changes: list[ModeChange] = []
    for name, each in plants.items():
        worst = {row.condition: row.worst_swing for row in judged.rows if row.point == name}
        plant = LargePlant(each.blocks, each.case.areas, each.case.omega_b)
        changes += mode_changes(name, plant, K, there, worst)
    missed = [
        f"{change.text}: allowed decrease {given_away:g}"
        for change in changes
        if not change.taken <= given_away
    ]
    return replace(
        judged,
        modes=tuple(asdict(change) for change in changes),
        violations=(*judged.violations, *missed),
    )
