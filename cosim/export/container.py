"""Write a scenario's whole loop as one FMU that simulates by itself, delays exact inside."""

from __future__ import annotations

import html
import re
from collections.abc import Sequence
from pathlib import Path

from interarea.fmu_build.write.description_xml import record_entries
from interarea.fmu_build.write.package import build_fmu
from interarea.fmu_build.write.real_code import Chain
from interarea.models.blocks.binary_table import pack_record
from interarea.models.blocks.container import LoopMember, loop_block
from interarea.models.blocks.variables import Block
from interarea.models.case.case import Case

from ..errors import ScenarioError
from ..run.controllers import ControllerLike
from ..run.instance import Fmus
from ..scenario.scenario import Scenario
from .instances import Members, members_of


def write_container(
    scenario: Scenario,
    path: Path | str,
    *,
    cache: Path,
    platforms: Sequence[str] | None = None,
    controller: ControllerLike | None = None,
) -> Path:
    """Write plant, channels and controller of `scenario` as one co-simulation FMU; return its path.

    The scenario's events, latencies and outages are its parameters `plant.event[k].*`,
    `CHANNEL.latency`, ...; arguments as in `write_ssp`. Where it can run here it has cross-check files.

    Raises
    ------
    ScenarioError, CaseError, BuildError
    """
    return build_fmu(
        container_block(scenario, cache=cache, controller=controller),
        path,
        platforms=platforms,
        cache=cache,
    )


def container_block(
    scenario: Scenario,
    *,
    cache: Path,
    controller: ControllerLike | None = None,
    case: Case | None = None,
    fmus: Fmus | None = None,
) -> Block:
    """Return the block that `write_container` builds.

    case, fmus : see `members_of`.

    Raises
    ------
    ScenarioError : a loop that one block cannot hold.
    """
    return block_of_members(members_of(scenario, cache=cache, controller=controller, case=case, fmus=fmus))


def block_of_members(loop: Members) -> Block:
    """Return the block that holds all instances of a scenario; ScenarioError where one block cannot."""
    scenario = loop.scenario
    foreign = [m.name for m in loop.all if m.block is None]
    if foreign:
        raise ScenarioError(
            f"{scenario.name}: {', '.join(foreign)} are third-party FMUs, which one block cannot "
            "contain; write an SSP, or use a tool for FMU containers"
        )
    members = [(m, m.baked(step_s=loop.step_s)) for m in loop.all]
    provenance = {f"{m.name}: {k}": v for m, block in members for k, v in block.provenance.items()}
    rows = (f"<tr><td>{html.escape(a)}</td><td>{html.escape(b)}</td></tr>" for a, b in loop.connections)
    documentation = {"Connections": f"<table><tr><th>from</th><th>to</th></tr>{''.join(rows)}</table>"}
    documentation |= {f"{m.name}: {k}": v for m, block in members for k, v in block.documentation.items()}
    try:
        return loop_block(
            _identifier(scenario.name),
            [LoopMember(m.name, block, pack_record(record_entries(block))) for m, block in members],
            loop.connections,
            step_s=loop.step_s,
            stop_s=scenario.stop_s,
            description=scenario.title,
            documentation=documentation,
            provenance={"scenario": scenario.name, **provenance},
        )
    except ValueError as error:
        raise ScenarioError(str(error)) from None


def chain_of(
    scenario: Scenario, *, cache: Path, controller: ControllerLike | None = None, case: Case | None = None
) -> Chain:
    """Return what lies between the plant and its inputs: PMUs, channels and controller, for `build_dll`.

    Latencies, losses and outages are parameters that begin as the scenario has them.

    Raises
    ------
    ScenarioError : members that a chain cannot hold, or none.
    """
    loop = members_of(scenario, cache=cache, controller=controller, case=case)
    order = {"pmu": 0, "channel": 1, "controller": 2, "supervisor": 2}
    parts = [(m.name, m.baked()) for m in loop.all if m.block is not None and m.block.kind != "plant"]
    strange = [m.name for m in loop.all if m.block is None and m.name != "plant"]
    strange += [name for name, block in parts if block.kind not in order]
    if strange or not parts:
        raise ScenarioError(
            f"{scenario.name}: a chain consists of PMUs, channels and a controller, "
            f"got {', '.join(strange) or 'none'}"
        )
    members = dict(sorted(parts, key=lambda part: order[part[1].kind]))
    inside = [c for c in loop.connections if all(end.partition(".")[0] in members for end in c)]
    name, description = f"{_identifier(scenario.name)}_chain", f"Chain of {', '.join(members)}"
    return Chain(name, members, inside, description, {"scenario": scenario.name})


def _identifier(name: str) -> str:
    text = re.sub(r"\W", "_", name, flags=re.ASCII)
    return text if text[:1].isalpha() else f"loop_{text}"
