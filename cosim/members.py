"""A scenario's instances as blocks with start values, for archives that other tools run without us."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from interarea.models.case import load_case
from interarea.models.channel_block import channel_block
from interarea.models.plant_block import plant_block
from interarea.models.variables import Block, VariableTable

from .fmu_file import FmuFile
from .instances import Value
from .run import Controllers, controller_of, wire
from .scenario import Scenario
from .timing import choose_step

if TYPE_CHECKING:
    from interarea.models.case import Case

_SLOTS = 8


@dataclass(frozen=True)
class Member:
    """One instance of a scenario: its block and the start values the scenario gives it."""

    name: str
    block: Block
    start: Mapping[str, Value]

    def baked(self, **changes: Any) -> Block:
        """Return the block with the scenario's start values as its own; `changes` replace further fields."""
        table = VariableTable(
            [replace(v, start=self.number(v.name)) if v.name in self.start else v for v in self.block.table]
        )
        return replace(self.block, table=table, **changes)

    def number(self, name: str) -> float | int | bool:
        """Return start value `name` as a number; an enumeration's item as its value."""
        value = self.start[name]
        if not isinstance(value, str):
            return value
        enumeration = self.block.table[name].enumeration
        assert enumeration is not None, name
        return next(number for item, number, _ in enumeration.items if item == value)


@dataclass(frozen=True)
class Members:
    """Instances of a scenario, connections ("instance.output", "instance.input"), step to run it with."""

    scenario: Scenario
    case: Case
    all: tuple[Member, ...]
    connections: tuple[tuple[str, str], ...]
    step_s: float


def members_of(scenario: Scenario, *, cache: Path, controllers: Controllers | None = None) -> Members:
    """Return the blocks of a scenario's instances and how they are connected.

    cache : folder of FMUs and designs. controllers : see `run_scenario`.

    Raises
    ------
    ScenarioError, CaseError : as `assemble`.
    """
    from . import artefacts

    case = load_case(scenario.case_path)
    blocks = {"plant": plant_block(case, event_slots=max(_SLOTS, len(scenario.event)))}
    controller = controller_of(scenario, case, cache, controllers)
    if controller is not None:
        blocks["controller"] = controller.block(case.omega_b)
    if scenario.channels:
        blocks["channel"] = channel_block()
    files = {kind: FmuFile(artefacts.block_fmu(block, cache)) for kind, block in blocks.items()}
    wiring = wire(
        scenario,
        case,
        plant=files["plant"],
        controller=files.get("controller"),
        channel=files.get("channel"),
    )
    members = tuple(
        Member(name, blocks.get(name, blocks.get("channel", blocks["plant"])), start)
        for name, (_, start) in wiring.instances.items()
    )
    latencies = [c.least_latency_s for c in scenario.channels.values()]
    instants = [scenario.stop_s, *scenario.marks_s]
    step_s = choose_step(latencies, instants) if scenario.step_s is None else scenario.step_s
    return Members(scenario, case, members, wiring.connections, step_s)
