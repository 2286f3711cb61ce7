"""FMUs and instances of a sweep that stay alive from run to run."""

from __future__ import annotations

import math
import time
from collections import OrderedDict
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from interarea.design.controllers.bank import ControllerBank
from interarea.design.controllers.controller import Controller
from interarea.fmu_build.open.fmu_file import FmuFile
from interarea.fmu_build.write.package import build_fmu
from interarea.models.blocks.plant import plant_block
from interarea.models.case.case import Case

from ..clock import seconds
from ..errors import ScenarioError
from ..master.instances import FmuParticipant
from ..master.instances import Value as Start
from ..master.master import Master
from ..results.judge import Judge
from ..results.largest_deviation import LargestDeviation, largest_deviation_of
from ..results.metrics import SYNCHRONISM
from ..results.ringdown import control_limit_pu, disturbance_end_s
from ..run.artefacts import EVENT_SLOTS, plant_fmu
from ..run.instance import Fmus
from ..run.system import System
from ..trajectory import Trajectory
from .plan import SweepPlan, own_fmu
from .point import CaseChange, Point
from .rows import COMMUTATION, Row, deviation_row, measured, packet_counts
from .shared_start import Beginning, Instances, Job, beginning_of, taken_over
from .spec import Sweep

MOST_LIVE = 4  #: plants, and sets of instances, that stay alive


class TimeUpError(RuntimeError):
    """A run computes longer than the sweep allows."""


def watch_of(limit_s: float) -> Callable[[float, float], None]:
    """Return what ends a run that computes longer than `limit_s` from now."""
    end = time.monotonic() + limit_s

    def watch(now_s: float, stop_s: float) -> None:
        if time.monotonic() > end:
            raise TimeUpError(f"more than {limit_s:g} s of computing, at t = {now_s:g} of {stop_s:g} s")

    return watch


@dataclass
class Plant:
    """A case of the sweep as an FMU; `own` files go when it is no longer needed."""

    case: Case
    file: FmuFile
    own: bool

    def close(self) -> None:
        self.file.close()
        if self.own:
            self.file.path.unlink(missing_ok=True)


def shown_of_sweep(sweep: Sweep, case: Case) -> dict[str, Any]:
    """Return what the plant of an unchanged or changed case shows in the runs of a sweep."""
    return {"show": sweep.show, "more": (*sweep.base.shows, *Judge.reads(case))}


def plant_of_sweep(sweep: Sweep, case: Case, cache: Path) -> Path:
    """Return the plant FMU of an unchanged case of a sweep."""
    return plant_fmu(case, cache, **shown_of_sweep(sweep, case))


class LiveFmus(Fmus):
    """The FMUs of a sweep: of changed cases made in `scratch`, few at a time, of controllers as planned.

    on_drop : called with the change and the slots of a plant before it is closed.
    """

    def __init__(self, plan: SweepPlan, cache: Path, scratch: Path) -> None:
        super().__init__(cache)
        self.plan, self.scratch = plan, scratch
        self.on_drop: Callable[[tuple[CaseChange, int]], None] = lambda _: None
        self._live: OrderedDict[tuple[CaseChange, int], Plant] = OrderedDict()
        self._cases: dict[str, Case] = {}
        self._planned: dict[tuple[str, str], Controller | ControllerBank | None] = {}

    def base(self, name: str) -> Case:
        """Return an unchanged case of the plan, the same object each time."""
        if name not in self._cases:
            self._cases[name] = self.plan.case(name)
        return self._cases[name]

    def case(self, change: CaseChange, slots: int) -> Case:
        """Return a changed case whose plant is there until some others have been asked for."""
        key = (change, slots)
        result = self._live.pop(key, None) or self._new_plant(change, slots)
        self._live[key] = result
        while len(self._live) > MOST_LIVE:
            old, plant = self._live.popitem(last=False)
            self.on_drop(old)
            plant.close()
        return result.case

    def _new_plant(self, change: CaseChange, slots: int) -> Plant:
        base = self.base(change.case)
        case = change.apply(base)
        if case is base and slots == EVENT_SLOTS:
            return Plant(case, self.built(plant_of_sweep(self.plan.sweep, case, self.cache)), own=False)
        path = self.scratch / f"plant-{case.hash}-{slots}.fmu"
        shown = shown_of_sweep(self.plan.sweep, case)
        build_fmu(plant_block(case, event_slots=slots, **shown), path, cache=self.cache)
        return Plant(case, FmuFile(path), own=True)

    def plant(self, case: Case, event_slots: int, more: tuple[str, ...] = ()) -> FmuFile:
        """Return the plant of a `case` of this object, with what the scenario of the sweep shows."""
        return next(plant.file for plant in self._live.values() if plant.case is case)

    def planned(self, case: str, name: str) -> Controller | ControllerBank | None:
        """Return a controller of the plan, None for none."""
        key = (case, name)
        if key not in self._planned:
            self._planned[key] = self.plan.controller(case, name)
        return self._planned[key]

    def own(self, name: str, path: Path) -> FmuFile:
        """Return the user's FMU of an instance, as the plan has it."""
        return self.open(own_fmu(self.cache, self.plan.fmus[name]))

    def close(self) -> None:
        """Close all files and remove those made here."""
        for plant in self._live.values():
            plant.close()
        self._live.clear()
        super().close()


@dataclass
class LiveLoop:
    """Live instances for one structure (case, controller, channels), and the system and master made last.

    beginnings : states that runs to come start from, earliest first.
    """

    participants: dict[str, FmuParticipant] = field(default_factory=dict)
    key: Any = None
    system: System = field(init=False)
    master: Master = field(init=False)
    beginnings: list[Beginning] = field(default_factory=list)

    def measure(self, requested: Collection[str], modes: Sequence[str]) -> Row:
        """Return the metrics of the run that has come to its end, by column."""
        judge = self.system.gathered(self.master, requested=requested).judge
        assert judge is not None  # a sweep's scenario has a case
        trajectory = self.master.trajectory
        judge.add(trajectory)
        linear = bool({"least", "damping", "frequency"} & set(requested)) or judge.at_rest
        roots = self.system.linear_swings() if linear else ""
        metrics = judge.metrics(control_limit_pu(self.master), roots)
        packets = [packet_counts(self.master.participants[name]) for name in self.system.channels]
        row = measured(metrics, requested, modes, packets)
        if judge.case.hvdcs:
            row[COMMUTATION] = ", ".join(judge.commutations.failed) or None
        if SYNCHRONISM in requested:
            row |= deviation_row(self.largest_deviation(trajectory))
        return row

    def largest_deviation(self, trajectory: Trajectory) -> LargestDeviation:
        """Return the extremes of the run that has come to its end, of its `trajectory`."""
        scenario = self.system.scenario
        assert scenario is not None
        case = self.system.case
        return largest_deviation_of(trajectory, case, disturbance_end_s(scenario), scenario.event)

    def start(self, job: Job, instances: Instances, left: Sequence[Beginning]) -> bool:
        """Start a job; return whether it starts from the last of what other jobs `left`."""
        if left and taken_over(left[-1], job, self.master, instances):
            return True
        self.release()
        self.master.start()
        return False

    def leave(
        self, job: Job, instances: Instances, place: int, watch: Callable[[float, float], None]
    ) -> None:
        """Step a job to the step `place` and keep its state there for later jobs."""
        self.master.advance(seconds(self.master.ends[place - 1]), progress=watch)
        self.beginnings.append(beginning_of(job, self.master, instances))

    def release(self, after_s: float = -math.inf) -> None:
        """Free the beginnings that reach beyond `after_s`."""
        while self.beginnings and self.beginnings[-1].until_s > after_s:
            self.master.release(self.beginnings.pop().fork.snapshot)

    def detach(self) -> None:
        """Free what the master made last, if there is one, keeps of the participants."""
        if self.key is not None:
            self.master.detach()

    def close(self) -> None:
        self.release()
        self.detach()
        for p in self.participants.values():
            p.close()


def controller_start(file: FmuFile, point: Point) -> dict[str, Start]:
    """Return the start values that a point asks of its controller's FMU.

    Raises
    ------
    ScenarioError : a gain for a controller without matrices.
    """
    start: dict[str, Start] = {}
    if point.gain != 1.0:
        for v in file.model.variables:
            if v.causality == "parameter" and v.name[:2] in ("C[", "D[") and file.start_of(v.name) != 0.0:
                start[v.name] = point.gain * file.start_of(v.name)
        if not start:
            raise ScenarioError(
                f"controller.gain = {point.gain:g}: {file.path.name} has no matrices among its parameters; "
                "allowed for a single linear controller"
            )
    return start | dict(point.controller_start)
