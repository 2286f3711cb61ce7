"""Runs of a sweep in one process, on FMU instances that stay alive and are reset from run to run."""

from __future__ import annotations

import errno
import math
import time
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from interarea.fmu_build.compile import compile_binary, host_platform
from interarea.fmu_build.errors import BuildError
from interarea.fmu_build.package import build_fmu
from interarea.models.case import Case
from interarea.models.plant_block import plant_block

from .artefacts import channel_fmu, concentrator_fmu, controller_fmu, plant_fmu
from .clock import seconds
from .errors import ScenarioError, StepError
from .fmu_file import FmuFile
from .instances import FmuParticipant
from .instances import Value as Start
from .kernel_build import load_kernel
from .run import EVENT_SLOTS, Loop, Wiring, wire
from .scenario import Scenario
from .sweep_forks import (
    Beginning,
    Job,
    acts_of,
    beginning_of,
    in_order,
    late_parameters,
    places_to_save,
    taken_over,
)
from .sweep_plan import SweepPlan, own_fmu
from .sweep_point import CaseChange, Point, packed, point_of
from .sweep_rows import Outcome, Row, failed_row, measure, start_row, trajectory_table
from .sweep_values import Search, Value
from .trajectory import Curves
from .worker import participant_of

if TYPE_CHECKING:
    from interarea.design.bank import ControllerBank
    from interarea.design.controller import Controller

_KEPT = 4  # sets of instances that stay alive
_FULL = (errno.ENOSPC, errno.EDQUOT)


class TimeUpError(RuntimeError):
    """A run computes longer than the sweep allows."""


@dataclass
class _Plant:
    """A case of the sweep as an FMU; `own` files go when it is no longer needed."""

    case: Case
    file: FmuFile
    own: bool

    def close(self) -> None:
        self.file.close()
        if self.own:
            self.file.path.unlink(missing_ok=True)


@dataclass
class _Kept:
    """Live instances for one structure (case, controller, channels), and the loop made of them last.

    beginnings : states that runs to come start from, earliest first.
    """

    participants: dict[str, FmuParticipant] = field(default_factory=dict)
    key: Any = None
    loop: Loop = field(init=False)
    beginnings: list[Beginning] = field(default_factory=list)

    def release(self, after_s: float = -math.inf) -> None:
        """Free the beginnings that reach beyond `after_s`."""
        while self.beginnings and self.beginnings[-1].until_s > after_s:
            self.loop.master.release(self.beginnings.pop().fork.saved)

    def close(self) -> None:
        self.release()
        for p in self.participants.values():
            p.close()


class Runner:
    """Makes outcomes of runs, one after the other; the same run gives the same outcome whatever ran before.

    cache : artefacts that stay (FMUs of unchanged cases, binaries). scratch : folder for what goes again.
    """

    def __init__(self, plan: SweepPlan, cache: Path, scratch: Path) -> None:
        self.plan, self.cache, self.scratch = plan, cache, scratch
        self._plants: OrderedDict[tuple[CaseChange, int], _Plant] = OrderedDict()
        self._kept: OrderedDict[Any, _Kept] = OrderedDict()
        self._controllers: dict[
            tuple[str, str], tuple[Controller | ControllerBank | None, FmuFile | None]
        ] = {}
        self._cases: dict[str, Case] = {}
        self._channel: FmuFile | None = None
        self._own: dict[str, FmuFile] = {}
        self._packed = packed(plan.sweep)
        self._late = late_parameters(plan.sweep)
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
        for k in range(len(jobs)):
            yield self._outcome(jobs, k)

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

        good: float | None = None
        bad: float | None = None
        for k in range(search.scan):
            at = round(search.low + (search.high - search.low) * k / (search.scan - 1), 9)
            if not stable(at):
                bad = at
                break
            good = at
        while good is not None and bad is not None and bad - good > search.tolerance:
            middle = round(0.5 * (good + bad), 9)
            if middle in (good, bad):
                break
            if stable(middle):
                good = middle
            else:
                bad = middle
        return good, bad, counted

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
        for file in (self._channel, *self._own.values(), *(f for _, f in self._controllers.values())):
            if file is not None:
                file.close()
        self._channel = None
        self._own.clear()
        self._controllers.clear()

    # -- one run --------------------------------------------------------------------------

    def _jobs(self, runs: Sequence[int]) -> list[Job]:
        """Return the runs as jobs, in the order in which they are to be made."""
        sweep = self.plan.sweep
        jobs = [Job(run, sweep.values(run)) for run in runs]
        if not (self._late and self.shares and len(jobs) > 1):
            return jobs
        described = []
        for job in jobs:
            base = tuple(v for name, v in job.values.items() if name not in self._late)
            with suppress(Exception):  # what is wrong with a point is told when it is run
                point = point_of(sweep, job.values, base=self._packed)
                job = replace(job, point=point, base=base, acts=acts_of(point.scenario))
            described.append(job)
        return in_order(described)

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
            forked = self._started(kept, job, wiring)
            self._advance(kept, jobs, k, wiring)
            loop = kept.loop
            row = start_row(run, values) | measure(loop, loop.master.records, sweep.metrics, self.plan.modes)
            return Outcome(row, self._wanted(run, row, loop), forked)
        except TimeUpError as error:
            return self._failed(run, "time limit", error)
        except StepError as error:
            kind = "not finite" if any(f" is {v}" in str(error) for v in ("nan", "inf", "-inf")) else "fmu"
            self._free_instances()  # after an FMU's error its instance is not to be trusted
            return self._failed(run, kind, error)
        except MemoryError:
            raise
        except OSError as error:
            if error.errno in _FULL:
                raise
            return self._failed(run, "internal", error)
        except Exception as error:  # a failing run is a row, never the end of a sweep
            ours = type(error).__module__.startswith("interarea")
            return self._failed(run, "invalid" if ours else "internal", error)

    def _started(self, kept: _Kept, job: Job, wiring: Wiring) -> bool:
        """Start a job's master; return whether it starts from what another job left."""
        if kept.beginnings and taken_over(kept.beginnings[-1], job, kept.loop.master, wiring):
            return True
        kept.release()
        kept.loop.master.start()
        return False

    def _advance(self, kept: _Kept, jobs: Sequence[Job], k: int, wiring: Wiring) -> None:
        """Step a job's master to its end, leaving its state on the way where later jobs start from it."""
        master, watch = kept.loop.master, self._watch()
        for place in places_to_save(jobs, k, master):
            master.advance(seconds(master.ends[place - 1]), progress=watch)
            kept.beginnings.append(beginning_of(jobs[k], master, wiring))
        master.advance(progress=watch)
        kept.release(jobs[k].like_next_s)

    def _watch(self) -> Callable[[float, float], None]:
        """Return what ends a run that computes too long."""
        limit = self.plan.sweep.time_limit_s
        end = time.monotonic() + limit

        def watch(now_s: float, stop_s: float) -> None:
            if time.monotonic() > end:
                raise TimeUpError(f"more than {limit:g} s of computing, at t = {now_s:g} of {stop_s:g} s")

        return watch

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

    def _ready(self, point: Point) -> tuple[_Kept, Wiring]:
        """Return live instances with the start values of a point, wired into a loop."""
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
            wiring.instances["controller"][1].update(_controller_start(controller, point))
        structure = (point.change, slots, scenario.controller, tuple(wiring.instances))
        kept = self._instances(structure, wiring, scenario)
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
            kept.loop, kept.key = Loop(scenario, plant.case, master, list(scenario.lines)), key
        kept.loop.scenario = scenario
        return kept, wiring

    def _instances(self, structure: Any, wiring: Wiring, scenario: Scenario) -> _Kept:
        kept = self._kept.pop(structure, None) or _Kept()
        for name, (file, start) in wiring.instances.items():
            if name in kept.participants:
                kept.participants[name].set_start(start)
            else:
                process = scenario.fmus[name].process if name in scenario.fmus else {}
                kept.participants[name] = participant_of(name, file, start, **process)
        self._kept[structure] = kept
        while len(self._kept) > _KEPT:
            self._kept.popitem(last=False)[1].close()
        return kept

    def _plant(self, change: CaseChange, slots: int) -> _Plant:
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
            found = _Plant(case, self._open(path), own)
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
            self._controllers[key] = (made, self._open(controller_fmu(made, base.omega_b, self.cache)))
        return self._controllers[key][1]

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
        return FmuFile(path, scratch=self.scratch)


def _nothing(*_runs: int) -> None:
    pass


def prepare(plan: SweepPlan, cache: Path) -> list[Path]:
    """Build FMUs of unchanged cases and controllers, and what FMUs of changed cases are made of.

    Returns the files in `cache` with which runs need no compiler.
    """
    files = [channel_fmu(cache)]
    with suppress(BuildError):  # without it Python steps the FMUs
        files.append(Path(load_kernel(cache)._name))
    files += [own_fmu(cache, key) for key in dict.fromkeys(plan.fmus.values())]
    files += [concentrator_fmu(len(c.signals), cache) for c in plan.sweep.base.concentrators.values()]
    cases = {name: plan.case(name) for name in plan.cases}
    block = plant_block(next(iter(cases.values())))
    files.append(compile_binary(block.kind, block.sources, host_platform(), cache=cache))
    files += [plant_fmu(case, cache) for case in cases.values()]
    for key in plan.controllers:
        case, _, name = key.rpartition("/") if key.partition("/")[0] not in cases else key.partition("/")
        made = plan.controller(case, name)
        if made is not None:
            files.append(controller_fmu(made, cases[case].omega_b, cache))
    return files


def _controller_start(file: FmuFile, point: Point) -> dict[str, Start]:
    start: dict[str, Start] = {}
    if point.gain != 1.0:
        for v in file.model.modelVariables:
            if v.causality == "parameter" and v.name[:2] in ("C[", "D[") and float(v.start) != 0.0:
                start[v.name] = point.gain * float(v.start)
        if not start:
            raise ScenarioError(
                f"controller.gain = {point.gain:g}: {file.path.name} has no matrices among its parameters; "
                "allowed for a single linear controller"
            )
    return start | dict(point.controller_start)
