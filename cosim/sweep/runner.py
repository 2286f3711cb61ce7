"""Runs of a sweep in one process, on FMU instances that stay alive and are reset from run to run."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from interarea.fmu_build.write.lane_library import GroupLibrary
from interarea.models.case.case import Case
from interarea.models.case.events import slot_count
from interarea.models.errors import InterareaError

from ..clock import seconds
from ..errors import NoSolutionError, StepError, machine_error
from ..master.isolated import participant_of
from ..master.lockstep import advance_together
from ..results.metrics import SYNCHRONISM
from ..run.artefacts import EVENT_SLOTS
from ..run.run import system_of
from ..run.system import System
from ..trajectory import Trajectory
from .lane_batches import PlantKey, by_plant, common_s, has_lanes, host_lanes, how_many, lanes_for, plant_key
from .live_instances import MOST_LIVE, LiveFmus, LiveLoop, TimeUpError, controller_start, watch_of
from .plan import SweepPlan
from .point import CaseChange, Point, packed, point_of
from .rows import Outcome, Row, failed_row, start_row, trajectory_table
from .shared_start import (
    Instances,
    Job,
    actions_of,
    in_order,
    late_parameters,
    place_of,
    places_to_save,
)
from .values import Search, Value, edge_of


class Runner:
    """Makes outcomes of runs, one after the other; the same run gives the same outcome whatever ran before.

    cache : artefacts that stay (FMUs of unchanged cases, binaries). scratch : folder for what goes again.
    """

    def __init__(self, plan: SweepPlan, cache: Path, scratch: Path) -> None:
        self.plan, self.cache, self.scratch = plan, cache, scratch
        self._fmus = LiveFmus(plan, cache, scratch)
        self._fmus.on_drop = self._drop
        self._live: OrderedDict[Any, LiveLoop] = OrderedDict()
        self._packed = packed(plan.sweep)
        self._late = late_parameters(plan.sweep)
        beside = lanes_for(cache, map(self._fmus.base, plan.cases))
        self.library = beside.library  #: that steps plants side by side
        self.lanes = beside.count  #: runs that advance side by side at most
        self._unbatched: set[PlantKey | None] = set()  # plants that gain nothing by company
        self.shares = True  #: whether runs start from states that others left
        self.on_build: Callable[..., object] = _nothing  #: called with the run (or runs) that are begun
        self.on_start: Callable[[], object] = _nothing  #: called when their FMUs are ready to compute

    def __enter__(self) -> Runner:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def outcome(self, run: int) -> Outcome:
        """Return what run number `run` gives; a failure is an outcome, only a full disk is raised."""
        return next(self.outcomes([run]))

    def outcomes(self, runs: Sequence[int]) -> Iterator[Outcome]:
        """Yield what `runs` give, each once, in the order in which they share most (see `sweep_forks`)."""
        jobs = self._jobs(runs)
        k = 0
        while k < len(jobs):
            count = 1 if plant_key(jobs[k]) in self._unbatched else how_many(jobs[k:], self.lanes)
            if count > 1:
                yield from self._outcomes_together(jobs[k : k + count])
            else:
                yield self._outcome(jobs, k)
            k += count

    def simulate(
        self, values: Mapping[str, Value], *, seed: int | None = None
    ) -> tuple[LiveLoop, Trajectory]:
        """Run the point where the sweep's parameters have `values`, all channels seeded from `seed` if given.

        Raises
        ------
        TimeUpError, StepError, ScenarioError, CaseError, PowerFlowError
        """
        retained, _ = self._ready(point_of(self.plan.sweep, values, seed=seed, base=self._packed))
        self.on_start()
        retained.master.start()
        retained.master.advance(progress=self._watch())
        return retained, retained.master.trajectory

    def edge(
        self, values: Mapping[str, Value], name: str, search: Search
    ) -> tuple[float | None, float | None, int]:
        """Return where stability ends in parameter `name`: last stable value, first unstable one, runs made.

        None: no value of the scan is stable, or none is unstable.
        """
        counted = 0

        def stable(at: float) -> bool:
            nonlocal counted
            for seed in range(search.seeds):
                counted += 1
                if not self._holds({**values, name: at}, seed if search.seeds > 1 else None):
                    return False
            return True

        return *edge_of(stable, search), counted

    def _holds(self, values: Mapping[str, Value], seed: int | None) -> bool:
        """Whether a run is stable; where synchronism is asked for, whether it keeps that."""
        if SYNCHRONISM not in self.plan.sweep.metrics:
            return bool(self.simulate(values, seed=seed)[0].measure(("stable",), ())["stable"])
        try:
            retained, trajectory = self.simulate(values, seed=seed)
            return retained.largest_deviation(trajectory).synchronous
        except StepError:  # voltages have collapsed
            self._free_instances()
            return False

    def refused(self, run: int) -> str:
        """Return why run number `run` cannot be wired into a loop; "" where it can. No FMU is loaded."""
        sweep = self.plan.sweep
        values = dict(sweep.values(run))
        if sweep.searched is not None:
            name, search = sweep.searched
            values[name] = search.low
        try:
            point = point_of(sweep, values, base=self._packed)
            with self._system(point, max(EVENT_SLOTS, slot_count(point.scenario.event))).master():
                return ""
        except InterareaError as error:
            if machine_error(error) is not None:
                raise
            return " ".join(str(error).split())

    def plant_of(self, values: Mapping[str, Value]) -> tuple[Case, Path]:
        """Return the case of a point and its plant FMU (there until other cases are asked for)."""
        point = point_of(self.plan.sweep, values)
        slots = max(EVENT_SLOTS, slot_count(point.scenario.event))
        case = self._fmus.case(point.change, slots)
        return case, self._fmus.plant(case, slots).path

    def close(self) -> None:
        """Free all instances and remove what is in the scratch folder."""
        self._free_instances()
        self._fmus.close()

    # -- one run --------------------------------------------------------------------------

    def _jobs(self, runs: Sequence[int]) -> list[Job]:
        """Return the runs as jobs, in the order in which they are to be made."""
        sweep, forks = self.plan.sweep, bool(self._late and self.shares)
        jobs = [Job(run, sweep.values(run)) for run in runs]
        if len(jobs) == 1 or sweep.searched is not None or not (forks or self.lanes > 1):
            return jobs
        described = []
        for job in jobs:
            base = tuple(v for name, v in job.values.items() if name not in self._late)
            with suppress(Exception):  # what is wrong with a point is reported when it is run
                job = replace(job, point=point_of(sweep, job.values, base=self._packed), base=base)
                if forks and job.point is not None:
                    job = replace(job, actions=actions_of(job.point.scenario))
            described.append(job)
        jobs = in_order(described) if forks else described
        return by_plant(jobs) if self.lanes > 1 else jobs

    def _outcome(self, jobs: Sequence[Job], k: int) -> Outcome:
        """Return what a job gives: prepare its FMUs, start them, advance, measure."""
        job, sweep = jobs[k], self.plan.sweep
        run, values = job.run, dict(job.values)
        self.on_build(run)
        try:
            if sweep.searched is not None:
                return Outcome(self._search(run, values))
            point = job.point or point_of(sweep, values, base=self._packed)
            retained, instances = self._ready(point)
            self.on_start()
            forked = retained.start(job, instances, retained.beginnings)
            self._advance(retained, jobs, k, instances)
            return self._measured(job, retained, forked)
        except Exception as error:  # a failing run is a row, never the end of a sweep
            if isinstance(error, StepError):
                self._free_instances()  # after an FMU's error its instance is not to be trusted
            return self._failure(run, error)

    def _outcomes_together(self, jobs: Sequence[Job]) -> Iterator[Outcome]:
        """Yield what jobs of one plant give, made side by side on instances of their own."""
        self.on_build(*(job.run for job in jobs))
        ended: dict[int, Exception | None] = {}
        ready = self._prepared(jobs, ended)
        self.on_start()
        watch = self._watch()
        begun = self._all_begun(ready, ended, watch)
        if begun and not has_lanes(begun[0][1]):
            self._unbatched.add(plant_key(jobs[0]))
        masters = [retained.master for _, retained, _ in begun]
        result = advance_together(masters, watch=lambda _, now_s, stop_s: watch(now_s, stop_s))
        ended |= {job.run: error for (job, _, _), error in zip(begun, result, strict=True)}
        home = {job.run: (retained, forked) for job, retained, forked in begun}
        # what ran out of time with company may be quick enough alone
        late = [job for job in jobs if isinstance(ended[job.run], TimeUpError)]
        quick = [job for job in jobs if not isinstance(ended[job.run], TimeUpError)]
        outcomes = [self._ended(job, ended[job.run], home) for job in quick]
        if any(isinstance(error, StepError) for error in ended.values()):
            self._free_instances()
        elif ready:
            ready[0][1].release(jobs[-1].like_next_s)
        yield from outcomes
        yield from map(self._outcome_unbatched, late)

    def _outcome_unbatched(self, job: Job) -> Outcome:
        """Return what a job gives that has lost by company; its plant has none from now on."""
        self._unbatched.add(plant_key(job))
        return self._outcome([replace(job, like_next_s=-math.inf)], 0)

    def _prepared(
        self, jobs: Sequence[Job], ended: dict[int, Exception | None]
    ) -> list[tuple[Job, LiveLoop, Instances]]:
        """Return jobs with instances of their own; one that has none is `ended` with its error."""
        ready: list[tuple[Job, LiveLoop, Instances]] = []
        for job in jobs:
            assert job.point is not None
            try:
                ready.append((job, *self._ready(job.point, [retained for _, retained, _ in ready])))
            except Exception as error:
                ended[job.run] = error
        return ready

    def _all_begun(
        self,
        ready: Sequence[tuple[Job, LiveLoop, Instances]],
        ended: dict[int, Exception | None],
        watch: Callable[[float, float], None],
    ) -> list[tuple[Job, LiveLoop, bool]]:
        """Start the masters; return those that have begun and whether from what another job left."""
        begun: list[tuple[Job, LiveLoop, bool]] = []
        for job, retained, instances in ready:
            try:
                begun.append((job, retained, self._begun(ready, job, retained, instances, watch)))
            except Exception as error:
                ended[job.run] = error
        return begun

    def _ended(self, job: Job, error: Exception | None, home: Mapping[int, tuple[LiveLoop, bool]]) -> Outcome:
        """Return the outcome of a job that came to its end, or to an error."""
        if error is None:
            try:
                return self._measured(job, *home[job.run])
            except Exception as raised:
                error = raised
        return self._failure(job.run, error)

    def _begun(
        self,
        ready: Sequence[tuple[Job, LiveLoop, Instances]],
        job: Job,
        loop: LiveLoop,
        instances: Instances,
        watch: Callable[[float, float], None],
    ) -> bool:
        """Start one of several masters; return whether from what another job left.

        The first of them leaves its state where the others begin to differ.
        """
        first, master = ready[0][1], loop.master
        forked = loop.start(job, instances, first.beginnings)
        if loop is first:
            shared_s = min(common_s([job for job, _, _ in ready]), seconds(master.clock.stop))
            place = place_of(shared_s, master)
            if place is not None:
                loop.leave(job, instances, place, watch)
        return forked

    def _measured(self, job: Job, loop: LiveLoop, forked: bool) -> Outcome:
        """Return the outcome of a job that has come to its end."""
        row = start_row(job.run, dict(job.values))
        row |= loop.measure(self.plan.sweep.metrics, self.plan.modes)
        return Outcome(row, self._requested_trajectory(job.run, row, loop), forked)

    def _failure(self, run: int, error: Exception) -> Outcome:
        """Return the outcome of a run that ended with `error`; raise what ends the sweep."""
        machine = machine_error(error)
        if machine is not None:
            raise machine
        if isinstance(error, TimeUpError):
            return self._failed(run, "time limit", error)
        if isinstance(error, NoSolutionError):
            return self._failed(run, "no solution", error)
        if isinstance(error, StepError):
            kind = "not finite" if any(f" is {v}" in str(error) for v in ("nan", "inf", "-inf")) else "fmu"
            return self._failed(run, kind, error)
        ours = type(error).__module__.startswith("interarea")
        return self._failed(run, "invalid" if ours and not isinstance(error, OSError) else "internal", error)

    def _advance(self, loop: LiveLoop, jobs: Sequence[Job], k: int, instances: Instances) -> None:
        """Step a job's master to its end, leaving its state on the way where later jobs start from it."""
        master, watch = loop.master, self._watch()
        for place in places_to_save(jobs, k, master):
            loop.leave(jobs[k], instances, place, watch)
        master.advance(progress=watch)
        loop.release(jobs[k].like_next_s)

    def _watch(self) -> Callable[[float, float], None]:
        """Return what ends a run that computes too long."""
        return watch_of(self.plan.sweep.time_limit_s)

    # -- private --------------------------------------------------------------------------

    def _free_instances(self) -> None:
        for retained in self._live.values():
            retained.close()
        self._live.clear()

    def _failed(self, run: int, failure: str, error: BaseException) -> Outcome:
        reason = str(error) if failure != "internal" else f"{type(error).__name__}: {error}"
        return Outcome(failed_row(self.plan.sweep, run, failure, reason))

    def _requested_trajectory(self, run: int, row: Row, loop: LiveLoop) -> Any:
        keep = self.plan.sweep.trajectories.keep
        if keep == "none":
            return None
        if keep == "unstable":
            known = row if "stable" in row else loop.measure(("stable",), ())
            if known["stable"]:
                return None
        return trajectory_table(self.plan.sweep, run, loop.master.trajectory)

    def _search(self, run: int, values: dict[str, Value]) -> Row:
        assert self.plan.sweep.searched is not None
        name, search = self.plan.sweep.searched
        good, bad, counted = self.edge(values, name, search)
        return start_row(run, values) | {name: good, f"{name}_unstable": bad, "evaluations": counted}

    def _system(self, point: Point, slots: int) -> System:
        """Return the system of a point, with so many slots for events."""
        change, name = point.change, point.scenario.controller
        return system_of(
            point.scenario,
            case=self._fmus.case(change, slots),
            controller=self._fmus.planned(change.case, name) or "none",
            swing=self.plan.swing(change.case),
            fmus=self._fmus,
        )

    def _ready(self, point: Point, busy: Sequence[LiveLoop] = ()) -> tuple[LiveLoop, Instances]:
        """Return live instances with the start values of a point, wired into a loop; none that is `busy`."""
        scenario, change = point.scenario, point.change
        slots = max(EVENT_SLOTS, slot_count(scenario.event))
        system = self._system(point, slots)
        instances = system.instances
        if "controller" in instances:
            own = controller_start(instances["controller"].file, point)
            instances["controller"] = replace(instances["controller"], start=own)
            system.parts["controller"] = instances["controller"]  # of which its linear loop is made
        structure = (change, slots, scenario.controller, tuple(instances))
        live = self._instances(structure, instances, busy, system.plants["plant"])
        key = (
            scenario.stop_s,
            scenario.step_s,
            scenario.event_times_s,
            tuple(c.timing for c in scenario.lines.values()),
            scenario.master,
            tuple(system.connections),
        )
        if live.key != key:
            live.detach()
            live.master, live.key = system.master(live.participants.values()), key
        live.system = system
        return live, instances

    def _library_of(self, case: Case) -> GroupLibrary | None:
        own = case.own_devices and self.library is not None
        return host_lanes(self.cache, case).library if own else self.library

    def _instances(
        self, structure: tuple[Any, ...], instances: Instances, busy: Sequence[LiveLoop], case: Case
    ) -> LiveLoop:
        place = sum(
            any(retained is b for b in busy) for s, retained in self._live.items() if s[:-1] == structure
        )
        structure = (*structure, place)
        retained = self._live.pop(structure, None) or LiveLoop()
        for name, result in instances.items():
            if name in retained.participants:
                retained.participants[name].set_start(result.start)
            else:
                group = self._library_of(case) if name == "plant" else None
                retained.participants[name] = participant_of(
                    name, result.file, result.start, group=group, **result.process
                )
        self._live[structure] = retained
        while len(self._live) > MOST_LIVE * self.lanes:
            self._live.popitem(last=False)[1].close()
        return retained

    def _drop(self, plant: tuple[CaseChange, int]) -> None:
        """Free the instances of a plant that goes."""
        for structure in [s for s in self._live if s[:2] == plant]:
            self._live.pop(structure).close()


def _nothing(*_runs: int) -> None:
    pass
