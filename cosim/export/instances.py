"""A scenario's instances as blocks with start values, for archives that other tools run without us."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from interarea.fmu_build.open.fmu_file import FmuFile
from interarea.models.blocks.variables import Block, VariableTable
from interarea.models.case.case import Case

from ..errors import ScenarioError
from ..master.instances import Value
from ..master.plan import LoopPlan
from ..run.controllers import ControllerLike
from ..run.instance import Fmus
from ..run.run import system_of
from ..run.system import System
from ..scenario.scenario import Scenario


@dataclass(frozen=True)
class Member:
    """One instance of a scenario: its FMU and the start values the scenario gives it.

    block : what the FMU is made of; None for an FMU of others, which is taken as it is.
    """

    name: str
    file: FmuFile
    block: Block | None
    start: Mapping[str, Value]

    def baked(self, **changes: Any) -> Block:
        """Return the block with the scenario's start values as its own; `changes` replace further fields."""
        assert self.block is not None, self.name
        table = VariableTable(
            [replace(v, start=self.number(v.name)) if v.name in self.start else v for v in self.block.table]
        )
        return replace(self.block, table=table, **changes)

    def number(self, name: str) -> float | int | bool:
        """Return start value `name` as a number; an enumeration's item as its value."""
        value = self.start[name]
        return self.file.enumerations[name][value] if isinstance(value, str) else value


@dataclass(frozen=True)
class Members:
    """The system of a scenario, its instances, and its loop as it is when they are there."""

    scenario: Scenario
    system: System
    all: tuple[Member, ...]
    plan: LoopPlan

    @property
    def connections(self) -> tuple[tuple[str, str], ...]:
        """Pairs ("instance.output", "instance.input")."""
        return tuple(self.plan.connections)

    @property
    def step_s(self) -> float:
        """The communication step, s."""
        return self.plan.chosen_step[0]


def members_of(
    scenario: Scenario,
    *,
    cache: Path,
    controller: ControllerLike | None = None,
    case: Case | None = None,
    fmus: Fmus | None = None,
) -> Members:
    """Return the FMUs of a scenario's instances, what ours are made of, and how they are connected.

    cache : folder of FMUs and designs. controller : see `run_scenario`. case : what `scenario.load_case()`
        gives, where it is known. fmus : those that other scenarios have opened.

    Raises
    ------
    ScenarioError, CaseError, GraphError : as `system_of`; DLLs among the instances.
    """
    system = system_of(scenario, cache=cache, controller=controller, case=case, fmus=fmus).warned()
    if system.others:
        raise ScenarioError(
            f"{scenario.name}: {', '.join(system.others)} run as DLLs, which an archive of FMUs cannot "
            "contain"
        )
    members = tuple(
        Member(i.name, i.file, None if i.block is None else i.block(), i.start)
        for i in system.instances.values()
    )
    return Members(scenario, system, members, system.plan)
