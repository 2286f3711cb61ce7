"""Runs of a sweep in one process, on FMU instances that stay alive and are reset from run to run."""

from __future__ import annotations

import errno
import math
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from interarea.fmu_build.open.fmu_file import FmuFile
from interarea.fmu_build.write.package import build_fmu
from interarea.models.blocks.plant import plant_block
from interarea.models.case.case import Case

from ..clock import seconds
from ..errors import StepError
from ..master.isolated import participant_of
from ..master.lockstep import advance_together
from ..run.artefacts import channel_fmu, concentrator_fmu, controller_fmu, plant_fmu
from ..run.run import EVENT_SLOTS, Loop, Wiring, wire
from ..scenario.scenario import Scenario
from ..trajectory import Curves
from .bisection import edge_of
from .lane_batches import PlantKey, by_plant, common_s, has_lanes, how_many, lanes_here, plant_key
from .live_instances import Kept, Plant, TimeUpError, controller_start, watch_of
from .plan import SweepPlan, own_fmu
from .point import CaseChange, Point, packed, point_of
from .rows import Outcome, Row, failed_row, measure, start_row, trajectory_table
from .shared_start import (
    Beginning,
    Job,
    acts_of,
    beginning_of,
    in_order,
    late_parameters,
    place_of,
    places_to_save,
    taken_over,
)
from .values import Search, Value

_KEPT = 4  # sets of instances that stay alive
_FULL = (errno.ENOSPC, errno.EDQUOT)


class Runner:
    """Makes outcomes of runs, one after the other; the same run gives the same outcome whatever ran before.

    cache : artefacts that stay (FMUs of unchanged cases, binaries). scratch : folder for what goes again.
    """

    def __init__(self, plan: SweepPlan, cache: Path, scratch: Path) -> None:
        self.plan, self.cache, self.scratch = plan, cache, scratch
        self._plants: OrderedDict[tuple[CaseChange, int], Plant] = OrderedDict()
        self._kept: OrderedDict[Any, Kept] = OrderedDict()
        self._controllers: dict[tuple[str, str], FmuFile] = {}
        self._cases: dict[str, Case] = {}
        self._channel: FmuFile | None = None
        self._own: dict[str, FmuFile] = {}
        self._packed = packed(plan.sweep)
        self._late = late_parameters(plan.sweep)
        beside = lanes_here(cache)
        self.library = beside.library  #: that steps plants side by side
        self.lanes = beside.count  #: runs that advance side by side at most
        self._alone: set[PlantKey | None] = set()  # plants that gain nothing by company
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
            count = 1 if plant_key(jobs[k]) in self._alone else how_many(jobs[k:], self.lanes)
            if count > 1:
                yield from self._outcomes_together(jobs[k : k + count])
            else:
                yield self._outcome(jobs, k)
            k += count

    def simulate(self, values: Mapping[str, Value], *, seed: int | None = None) -> tuple[Loop, Curves]:
        """Run the point where the sweep's parameters have `values`, all channels seeded from `seed` if given.

        Raises
        ------
        TimeUpError, StepError, ScenarioError, CaseError, PowerFlowError
        """
        kept, _ = self._ready(point_of(self.plan.sweep, values, seed=seed, base=self._packed))
        self.on_start()
        kept.loop.master.start()
        kept.loop.master.advance(progress=self._watch())
        return kept.loop, kept.loop.master.records

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
                loop, curves = self.simulate({**values, name: at}, seed=seed if search.seeds > 1 else None)
                counted += 1
                if not measure(loop, curves, ("stable",), ())["stable"]:
                    return False
            return True

        return *edge_of(stable, search), counted

    def plant_of(self, values: Mapping[str, Value]) -> tuple[Case, Path]:
        """Return the case of a point and its plant FMU (there until other cases are asked for)."""
        point = point_of(self.plan.sweep, values)
        plant = self._plant(point.change, max(EVENT_SLOTS, len(point.scenario.event)))
        return plant.case, plant.file.path

    def close(self) -> None:
        """Free all instances and remove what is in the scratch folder."""
        self._free_instances()
        for plant in self._plants.values():
            plant.close()
        self._plants.clear()
        for file in (self._channel, *self._own.values(), *self._controllers.values()):
            if file is not None:
                file.close()
        self._channel = None
        self._own.clear()
        self._controllers.clear()

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
            with suppress(Exception):  # what is wrong with a point is told when it is run
                job = replace(job, point=point_of(sweep, job.values, base=self._packed), base=base)
                if forks and job.point is not None:
                    job = replace(job, acts=acts_of(job.point.scenario))
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
            kept, wiring = self._ready(point)
            self.on_start()
            forked = _started(kept, job, wiring, kept.beginnings)
            self._advance(kept, jobs, k, wiring)
            return self._measured(job, kept, forked)
        except Exception as error:  # a failing run is a row, never the end of a sweep
            if isinstance(error, StepError):
                self._free_instances()  # after an FMU's error its instance is not to be trusted
            return self._failure(run, error)

    def _outcomes_together(self, jobs: Sequence[Job]) -> Iterator[Outcome]:
        """Yield what jobs of one plant give, made side by side on instances of their own."""
        self.on_build(*(job.run for job in jobs))
        ended: dict[int, Exception | None] = {}
        ready: list[tuple[Job, Kept, Wiring]] = []
        for job in jobs:
            assert job.point is not None
            try:
                ready.append((job, *self._ready(job.point, [kept for _, kept, _ in ready])))
            except Exception as error:
                ended[job.run] = error
        self.on_start()
        watch = self._watch()
        forked: set[int] = set()
        begun: list[tuple[Job, Kept]] = []
        for job, kept, wiring in ready:
            try:
                if self._begun(ready, job, kept, wiring, watch):
                    forked.add(job.run)
                begun.append((job, kept))
            except Exception as error:
                ended[job.run] = error
        masters = [kept.loop.master for _, kept in begun]
        if begun and not has_lanes(self.library, begun[0][1]):
            self._alone.add(plant_key(jobs[0]))
        found = advance_together(masters, watch=lambda _, now_s, stop_s: watch(now_s, stop_s))
        ended |= {job.run: error for (job, _), error in zip(begun, found, strict=True)}
        home = {job.run: kept for job, kept in begun}
        outcomes = []
        for job in jobs:
            reason = ended[job.run]
            if isinstance(reason, TimeUpError):  # with company; alone it may be quick enough
                continue
            try:
                if reason is not None:
                    raise reason
                outcomes.append(self._measured(job, home[job.run], job.run in forked))
            except Exception as error:
                outcomes.append(self._failure(job.run, error))
        if any(isinstance(error, StepError) for error in ended.values()):
            self._free_instances()
        elif ready:
            ready[0][1].release(jobs[-1].like_next_s)
        yield from outcomes
        for job in jobs:
            if isinstance(ended[job.run], TimeUpError):
                self._alone.add(plant_key(job))
                yield self._outcome([replace(job, like_next_s=-math.inf)], 0)

    def _begun(
        self,
        ready: Sequence[tuple[Job, Kept, Wiring]],
        job: Job,
        kept: Kept,
        wiring: Wiring,
        watch: Callable[[float, float], None],
    ) -> bool:
        """Start one of several masters; return whether from what another job left.

        The first of them leaves its state where the others begin to differ.
        """
        first, master = ready[0][1], kept.loop.master
        forked = _started(kept, job, wiring, first.beginnings)
        if kept is first:
            alike_s = min(common_s([job for job, _, _ in ready]), seconds(master.clock.stop))
            place = place_of(alike_s, master)
            if place is not None:
                _leave(kept, job, wiring, place, watch)
        return forked

    def _measured(self, job: Job, kept: Kept, forked: bool) -> Outcome:
        """Return the outcome of a job that has come to its end."""
        sweep, loop = self.plan.sweep, kept.loop
        row = start_row(job.run, dict(job.values))
        row |= measure(loop, loop.master.records, sweep.metrics, self.plan.modes)
        return Outcome(row, self._wanted(job.run, row, loop), forked)

    def _failure(self, run: int, error: Exception) -> Outcome:
        """Return the outcome of a run that ended with `error`; raise what ends the sweep."""
        if isinstance(error, TimeUpError):
            return self._failed(run, "time limit", error)
        if isinstance(error, StepError):
            kind = "not finite" if any(f" is {v}" in str(error) for v in ("nan", "inf", "-inf")) else "fmu"
            return self._failed(run, kind, error)
        if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno in _FULL):
            raise error
        ours = type(error).__module__.startswith("interarea")
        return self._failed(run, "invalid" if ours and not isinstance(error, OSError) else "internal", error)

    def _advance(self, kept: Kept, jobs: Sequence[Job], k: int, wiring: Wiring) -> None:
        """Step a job's master to its end, leaving its state on the way where later jobs start from it."""
        master, watch = kept.loop.master, self._watch()
        for place in places_to_save(jobs, k, master):
            _leave(kept, jobs[k], wiring, place, watch)
        master.advance(progress=watch)
        kept.release(jobs[k].like_next_s)

    def _watch(self) -> Callable[[float, float], None]:
        """Return what ends a run that computes too long."""
        return watch_of(self.plan.sweep.time_limit_s)

    # -- private --------------------------------------------------------------------------

    def _free_instances(self) -> None:
        for kept in self._kept.values():
            kept.close()
        self._kept.clear()

    def _failed(self, run: int, failure: str, error: BaseException) -> Outcome:
        reason = str(error) if failure != "internal" else f"{type(error).__name__}: {error}"
        return Outcome(failed_row(self.plan.sweep, run, failure, reason))

    def _wanted(self, run: int, row: Row, loop: Loop) -> Any:
        keep = self.plan.sweep.trajectories.keep
        if keep == "none":
            return None
        if keep == "unstable":
            stable = (
                row["stable"]
                if "stable" in row
                else measure(loop, loop.master.records, ("stable",), ())["stable"]
            )
            if stable:
                return None
        return trajectory_table(self.plan.sweep, run, loop.master.trajectory)

    def _search(self, run: int, values: dict[str, Value]) -> Row:
        assert self.plan.sweep.searched is not None
        name, search = self.plan.sweep.searched
        good, bad, counted = self.edge(values, name, search)
        return start_row(run, values) | {name: good, f"{name}_unstable": bad, "evaluations": counted}

    def _ready(self, point: Point, busy: Sequence[Kept] = ()) -> tuple[Kept, Wiring]:
        """Return live instances with the start values of a point, wired into a loop; none that is `busy`."""
        scenario = point.scenario
        slots = max(EVENT_SLOTS, len(scenario.event))
        plant = self._plant(point.change, slots)
        controller = self._controller(point.change.case, scenario.controller)
        channel = self._channel_file() if scenario.channels else None
        own = {name: self._own_file(name) for name in scenario.fmus}
        wiring = wire(
            scenario,
            plant.case,
            plant=plant.file,
            controller=controller,
            channel=channel,
            concentrators={n: self._aligner(len(c.signals)) for n, c in scenario.concentrators.items()},
            own=own,
        )
        if controller is not None:
            wiring.instances["controller"][1].update(controller_start(controller, point))
        structure = (point.change, slots, scenario.controller, tuple(wiring.instances))
        kept = self._instances(structure, wiring, scenario, busy)
        key = (
            scenario.stop_s,
            scenario.step_s,
            scenario.marks_s,
            tuple(c.timing for c in scenario.lines.values()),
            scenario.master,
            wiring.connections,
        )
        if kept.key != key:
            master = wiring.master(scenario, kept.participants.values())
            swing = self.plan.swing(point.change.case)
            kept.loop = Loop(scenario, plant.case, swing, master, list(scenario.lines))
            kept.key = key
        kept.loop.scenario = scenario
        return kept, wiring

    def _instances(
        self, structure: tuple[Any, ...], wiring: Wiring, scenario: Scenario, busy: Sequence[Kept]
    ) -> Kept:
        place = sum(any(kept is b for b in busy) for s, kept in self._kept.items() if s[:-1] == structure)
        structure = (*structure, place)
        kept = self._kept.pop(structure, None) or Kept()
        for name, (file, start) in wiring.instances.items():
            if name in kept.participants:
                kept.participants[name].set_start(start)
            else:
                process = scenario.fmus[name].process if name in scenario.fmus else {}
                group = self.library if name == "plant" else None
                kept.participants[name] = participant_of(name, file, start, group=group, **process)
        self._kept[structure] = kept
        while len(self._kept) > _KEPT * self.lanes:
            self._kept.popitem(last=False)[1].close()
        return kept

    def _plant(self, change: CaseChange, slots: int) -> Plant:
        key = (change, slots)
        found = self._plants.pop(key, None)
        if found is None:
            base = self._cases.setdefault(change.case, self.plan.case(change.case))
            case = change.apply(base)
            own = case is not base or slots != EVENT_SLOTS
            if own:
                block = plant_block(case, event_slots=slots)
                path = self.scratch / f"plant-{case.hash}-{slots}.fmu"
                build_fmu(block, path, cache=self.cache)
            else:
                path = plant_fmu(case, self.cache)
            found = Plant(case, self._open(path), own)
        self._plants[key] = found
        while len(self._plants) > _KEPT:
            old, plant = self._plants.popitem(last=False)
            for structure in [s for s in self._kept if s[:2] == old]:
                self._kept.pop(structure).close()
            plant.close()
        return found

    def _controller(self, case: str, name: str) -> FmuFile | None:
        if name == "none":
            return None
        key = (case, name)
        if key not in self._controllers:
            made = self.plan.controller(case, name)
            assert made is not None
            base = self._cases.setdefault(case, self.plan.case(case))
            self._controllers[key] = self._open(controller_fmu(made, base.omega_b, self.cache))
        return self._controllers[key]

    def _channel_file(self) -> FmuFile:
        if self._channel is None:
            self._channel = self._open(channel_fmu(self.cache))
        return self._channel

    def _aligner(self, signals: int) -> FmuFile:
        key = f"{signals} signals"  # no name of an FMU of the user's has a blank
        if key not in self._own:
            self._own[key] = self._open(concentrator_fmu(signals, self.cache))
        return self._own[key]

    def _own_file(self, name: str) -> FmuFile:
        if name not in self._own:
            self._own[name] = self._open(own_fmu(self.cache, self.plan.fmus[name]))
        return self._own[name]

    def _open(self, path: Path) -> FmuFile:
        return FmuFile(path)


def _started(kept: Kept, job: Job, wiring: Wiring, left: Sequence[Beginning]) -> bool:
    """Start a job's master; return whether it starts from the last of what other jobs `left`."""
    if left and taken_over(left[-1], job, kept.loop.master, wiring):
        return True
    kept.release()
    kept.loop.master.start()
    return False


def _leave(kept: Kept, job: Job, wiring: Wiring, place: int, watch: Callable[[float, float], None]) -> None:
    """Step a job's master to the step `place` and keep its state there for later jobs."""
    master = kept.loop.master
    master.advance(seconds(master.ends[place - 1]), progress=watch)
    kept.beginnings.append(beginning_of(job, master, wiring))


def _nothing(*_runs: int) -> None:
    pass
