"""A scenario run as its container: plant, channels and controller in one block, no master between them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from interarea.fmu_build.open.fmu_file import FmuFile
from interarea.fmu_build.write.cache import default_cache
from interarea.fmu_build.write.package import block_fmu
from interarea.models.blocks.container import shown_name

from ..errors import ScenarioError
from ..master.graph import Connection, End
from ..master.isolated import participant_of
from ..master.master import Master
from ..master.plan import LoopPlan
from ..results.accumulators import Accumulators
from ..results.delay_ledger import DelayLedger, LedgerRow, packet_ledger
from ..results.judge import Judge
from ..results.metrics import METRICS, RING_DOWN
from ..results.run import Run
from ..run.controllers import ControllerLike
from ..run.linear_loop import linear_swings
from ..scenario.channels import Delays
from ..scenario.scenario import Scenario, load_scenario
from ..trajectory import TIME, Trajectory
from .container import block_of_members
from .instances import Members, members_of

_NAME = "loop"  #: of the one instance
_HOW = "joint: plant, controller and channels are one block, their delays exact inside"


def run_joint(
    scenario: Scenario | str | Path | Mapping[str, Any],
    *,
    cache: Path | None = None,
    progress: Callable[[float, float], object] | None = None,
    controller: ControllerLike | None = None,
) -> Run:
    """Run a scenario as its container FMU and return what `run_scenario` does, under the same column names.

    What a page of `interarea explore` shows for the same settings has the same bits. Parameters as
    `run_scenario`.

    Raises
    ------
    ScenarioError, CaseError : a mistake in the scenario, or a loop that one block cannot hold.
    StepError : the container refused a step; the results so far are with it.
    """
    loaded = load_scenario(scenario)
    if not loaded.case:
        raise ScenarioError(f"{loaded.name}: case is missing; user-defined FMUs are stepped by a master")
    folder = default_cache() if cache is None else cache
    members = members_of(loaded, cache=folder, controller=controller)
    system, case = members.system, members.system.case
    container = FmuFile(block_fmu(block_of_members(members), folder))
    plan = LoopPlan((), stop_s=loaded.stop_s, step_s=members.step_s)
    with Master(plan, [participant_of(_NAME, container, {})]) as master:
        trajectory = _named(master.run(progress=progress), members)
    ledger = _ledger(loaded, members)
    assert system.swing is not None  # of a scenario with a case
    requested, stop_s = (*METRICS, RING_DOWN), float(trajectory.time_s[-1])
    judge = Judge(case, system.swing, loaded, step_s=members.step_s, stop_s=stop_s, requested=requested)
    judge.add(trajectory)
    loop = system.linear_loop()
    limits = [float(m.start.get("limit", _limit(m))) for m in members.all if m.name == "controller"]
    return Run(
        trajectory=trajectory,
        ledger=ledger,
        packets=packet_ledger(trajectory, Accumulators.of(trajectory, loaded.lines)),
        explanation=f"step {1e3 * members.step_s:g} ms, {_HOW}\n{ledger}",
        warnings=(*system.warnings, *judge.commutations.warnings),
        scenario=loaded,
        case=case,
        swing=system.swing,
        measure=lambda: judge.metrics(next(iter(limits), None), linear_swings(loop)),
    )


def _limit(member: Any) -> float:
    return float(member.block.table["limit"].start) if "limit" in member.block.table else float("inf")


def _named(trajectory: Trajectory, members: Members) -> Trajectory:
    """Columns by the instances that the container is made of, as a master names them."""
    names = {TIME: TIME}
    for member in members.all:
        assert member.block is not None  # a container holds no other
        for v in member.block.table:
            if v.role == "output":
                shown = shown_name(member.name, member.block.kind, v)
                names[f"{_NAME}.{shown}"] = f"{member.name}.{v.name}"
    columns = {names[k]: trajectory[k] for k in trajectory.units}
    units = {names[k]: unit for k, unit in trajectory.units.items()}
    descriptions = {names[k]: text for k, text in trajectory.descriptions.items()}
    return Trajectory(columns, units, descriptions, trajectory.engine)


def _ledger(scenario: Scenario, members: Members) -> DelayLedger:
    """What each connection delays: the channels' own latency and nothing else."""
    rows = []
    for source, target in members.connections:
        begin, end = (End(*name.split(".", 1)) for name in (source, target))
        line = scenario.lines.get(end.instance)
        d = Delays(0.0, 0.0) if line is None else line.delays()
        rows.append(
            LedgerRow(
                Connection(begin, end),
                d.requested_s,
                network_s=d.network_s,
                reporting_s=d.reporting_s,
                jitter_mean_s=d.jitter_mean_s,
                note=d.seed_of(end.instance),
            )
        )
    return DelayLedger(tuple(rows), members.step_s, "joint", scenario.rounded)
