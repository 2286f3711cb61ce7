"""A scenario's instances as blocks with start values, for archives that other tools run without us."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from interarea.fmu_build.open.fmu_file import FmuFile
from interarea.fmu_build.write.package import block_fmu
from interarea.models.blocks.channel import channel_block
from interarea.models.blocks.concentrator import concentrator_block
from interarea.models.blocks.plant import plant_block
from interarea.models.blocks.variables import Block, VariableTable

from ..master.instances import Value
from ..master.step_choice import choose_step
from ..run.run import EVENT_SLOTS, Controllers, controller_of, wire
from ..run.system import pairs_of
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
    """Instances of a scenario, connections ("instance.output", "instance.input"), step to run it with."""

    scenario: Scenario
    all: tuple[Member, ...]
    connections: tuple[tuple[str, str], ...]
    step_s: float


def members_of(scenario: Scenario, *, cache: Path, controllers: Controllers | None = None) -> Members:
    """Return the FMUs of a scenario's instances, what ours are made of, and how they are connected.

    cache : folder of FMUs and designs. controllers : see `run_scenario`.

    Raises
    ------
    ScenarioError, CaseError, GraphError : as `assemble` and `system_of`.
    """
    blocks: dict[str, Block] = {"channel": channel_block()} if scenario.channels else {}
    blocks |= {n: concentrator_block(len(c.signals)) for n, c in scenario.concentrators.items()}
    foreign: dict[str, FmuFile] = {}
    if scenario.case:
        case = scenario.load_case()
        blocks["plant"] = plant_block(case, event_slots=max(EVENT_SLOTS, len(scenario.event)))
        path = scenario.controller_path
        if path is not None and path.suffix == ".fmu":
            foreign["controller"] = FmuFile(path)
        else:
            controller = controller_of(scenario, case, cache, controllers)
            if controller is not None:
                blocks["controller"] = controller.block(case.omega_b)
    files = {kind: FmuFile(block_fmu(block, cache)) for kind, block in blocks.items()} | foreign
    if scenario.case:
        wiring = wire(
            scenario,
            case,
            plant=files["plant"],
            controller=files.get("controller"),
            channel=files.get("channel"),
            concentrators=files,
        )
        instances, connections = dict(wiring.instances), wiring.connections
    else:
        instances = {n: (FmuFile(scenario.folder / f.file), dict(f.start)) for n, f in scenario.fmus.items()}
        where = f"{scenario.name}: channels"
        instances |= {
            n: (files["channel"], c.parameters(f"{where}.{n}")) for n, c in scenario.channels.items()
        }
        instances |= {n: (files[n], c.parameters(n)) for n, c in scenario.concentrators.items()}
        pairs = [pair for path in scenario.connections for pair in pairs_of(path, scenario.channels)]
        connections = tuple(dict.fromkeys(pairs))
    of_file = {id(file): blocks.get(kind) for kind, file in files.items()}
    members = tuple(
        Member(name, file, of_file.get(id(file)), start) for name, (file, start) in instances.items()
    )
    latencies = [c.least_latency_s for c in scenario.lines.values()]
    instants = [scenario.stop_s, *scenario.marks_s]
    step_s = choose_step(latencies, instants) if scenario.step_s is None else scenario.step_s
    return Members(scenario, members, connections, step_s)
