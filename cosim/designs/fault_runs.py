"""Hundreds of faults in a grid: batched runs of one plant, with FMUs and instances kept alive."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np

from interarea.design.controllers.bank import ControllerBank
from interarea.design.controllers.controller import Controller
from interarea.fmu_build.errors import BuildError
from interarea.fmu_build.write.lane_library import GroupLibrary, plant_group
from interarea.models.blocks.plant import plant_sources
from interarea.models.blocks.plant_shown import shown_of
from interarea.models.case.case import Case

from ..errors import StepError
from ..master.instances import FmuParticipant
from ..master.isolated import participant_of
from ..master.lockstep import advance_together
from ..master.master import Master
from ..results.accumulators import Commutations
from ..results.judge import motion_of
from ..results.largest_deviation import angles_of, with_angles
from ..results.ringdown import Swing, control_limit_pu
from ..results.verdict import Verdict
from ..run.instance import Fmus
from ..run.run import system_of
from ..scenario.scenario import Scenario, load_scenario
from ..trajectory import Trajectory
from .fault_loops import LONG_S, LONGEST_S, LoopEnd

#: side by side at most; the processor's vectors take them in parts
TOGETHER = 32
Key = TypeVar("Key", bound=Hashable)


@dataclass(frozen=True)
class FaultRun:
    """One run from the equilibrium: its events, and the controller with late, wrong or lost signals.

    events : as in a scenario file. latency_s : of every signal, or of each, default 0. lost_s : signal ->
    instant of its permanent loss: it is zero at once, as in the linear loops. wrong : signal -> the table of
    its `signal_faults`.
    """

    events: Sequence[Mapping[str, Any]]
    stop_s: float
    controller: Controller | ControllerBank | None = None
    latency_s: float | Mapping[str, float] = 0.0
    lost_s: Mapping[str, float] = field(default_factory=dict)
    wrong: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def document(self) -> dict[str, Any]:
        """Return the run as a scenario, without case and controller, which are passed as objects."""
        document: dict[str, Any] = {"case": "given", "stop_s": self.stop_s, "event": list(self.events)}
        if self.controller is not None:
            late = self.latency_s
            document["channels"] = {
                f"from_{signal}": {
                    "signal": signal,
                    "latency_s": late.get(signal, 0.0) if isinstance(late, Mapping) else late,
                    "on_loss": "zero",
                    "outages_s": [[self.lost_s[signal], self.stop_s]] if signal in self.lost_s else [],
                    "signal_faults": [dict(self.wrong[signal])] if signal in self.wrong else [],
                }
                for signal in self.controller.inputs
            }
        return document


@dataclass(frozen=True)
class Outcome:
    """The outcome of a run.

    angle_rad : largest between two machines; inf, and no verdict, if it ended early. failed_links : dc links
    that failed to commutate in it.
    """

    angle_rad: float
    verdict: Verdict | None
    failed_links: tuple[str, ...] = ()

    @property
    def synchronous(self) -> bool:
        """Whether no angle between two machines reached half a turn."""
        return self.angle_rad < np.pi

    @property
    def stable(self) -> bool:
        """Whether it has settled or is settling slowly."""
        return self.verdict is not None and self.verdict.stable


class GridRun(Protocol):
    """A run: a scenario as a document, and its controller as an object."""

    @property
    def stop_s(self) -> float: ...
    @property
    def controller(self) -> Controller | ControllerBank | None: ...
    def document(self) -> dict[str, Any]: ...


class FaultRuns:
    """Runs faults in one grid; FMUs and instances exist as long as this context manager."""

    def __init__(self, case: Case, cache: Path) -> None:
        self.case = case
        self._fmus = Fmus(cache)
        self._library: GroupLibrary | None = None
        with suppress(BuildError):
            self._library = plant_group(plant_sources(case), cache=cache)
        angles = {f"{name}_delta" for name in with_angles(case)}
        names = [s.variable.name for s in shown_of(case)]
        #: input of a controller -> output of the plant, where a linear model has `_` for its dot
        self._dotted = {name.replace(".", "_"): name for name in names if "." in name}
        # a large grid shows them when asked
        self._show = [] if angles <= set(names) else ["*_delta"]
        first, last = case.machines[0].name, case.machines[-1].name
        self._swing = Swing(first, last, "not looked at")
        self._live: dict[tuple[int, int, tuple[str, ...]], dict[str, FmuParticipant]] = {}

    def __enter__(self) -> FaultRuns:
        return self

    def __exit__(self, *_: object) -> None:
        for participants in self._live.values():
            for p in participants.values():
                p.close()
        self._fmus.close()

    def run(self, runs: Sequence[GridRun]) -> Iterator[Trajectory]:
        """Yield the trajectory of each run in order, up to its last step.

        Raises any error of a run except a failed step (StepError).
        """
        return (master.trajectory for _, master in self._ended(runs))

    def outcomes(self, runs: Sequence[GridRun], roots: Sequence[complex | None]) -> list[Outcome]:
        """Return the outcome of each run.

        roots : rightmost root of the linear loop after each run, 1/s; None if not known.
        """
        return [outcome for outcome, _ in self.judged(runs, roots)]

    def outcomes_to_end(
        self, runs: Sequence[FaultRun], ends: Sequence[LoopEnd], since_s: float
    ) -> tuple[list[Outcome], float]:
        """Return the outcomes of runs whose durations follow from their linear loops, and the longest
        duration, s.

        ends : the linear loop after each run. since_s : instant of the last loss. A run that keeps
        synchronism without decaying is continued to `LONG_S` and, if that loop is stable, to `LONGEST_S`.
        """
        lengths = [end.run_s(run.stop_s, since_s) for run, end in zip(runs, ends, strict=True)]
        outcomes = self.outcomes(
            [replace(run, stop_s=s) for run, s in zip(runs, lengths, strict=True)], [end.root for end in ends]
        )
        for horizon_s in (LONG_S, LONGEST_S):
            open_ended = [
                k
                for k, (o, end) in enumerate(zip(outcomes, ends, strict=True))
                if o.synchronous and not o.stable and lengths[k] < horizon_s
                if end.stable or horizon_s <= LONG_S
            ]
            again = self.outcomes(
                [replace(runs[k], stop_s=horizon_s) for k in open_ended], [ends[k].root for k in open_ended]
            )
            for k, outcome in zip(open_ended, again, strict=True):
                outcomes[k], lengths[k] = outcome, horizon_s
        return outcomes, max(lengths, default=0.0)

    def judged(
        self, runs: Sequence[GridRun], roots: Sequence[complex | None]
    ) -> Iterator[tuple[Outcome, Trajectory]]:
        """Yield outcome and trajectory of each run; roots as in `outcomes`."""
        for run, root, (scenario, master) in zip(runs, roots, self._ended(runs), strict=True):
            data = master.trajectory
            angle = self._largest_angle(run, data)
            if not np.isfinite(angle):
                yield Outcome(angle, None), data
                continue
            motion = motion_of(self.case, scenario, run.stop_s)
            speeds = np.array([data[f"plant.{name}_dw"] for name in motion.machines])
            controls = {name: data[name] for name in data.reals_of("controller")}
            motion.add(data.time_s, speeds, angles_of(data, motion.names), controls)
            limit = None if run.controller is None else control_limit_pu(master)
            commutations = Commutations(self.case)
            commutations.add(data)
            yield Outcome(angle, motion.verdict(limit, root), commutations.failed), data

    def _ended(self, runs: Sequence[GridRun]) -> Iterator[tuple[Scenario, Master]]:
        for first in range(0, len(runs), TOGETHER):
            chunk = runs[first : first + TOGETHER]
            scenarios = [self._scenario(run) for run in chunk]
            masters = [
                self._master(lane, run, scenario)
                for lane, (run, scenario) in enumerate(zip(chunk, scenarios, strict=True))
            ]
            for master in masters:
                master.start()
            errors = advance_together(masters)
            for scenario, master, error in zip(scenarios, masters, errors, strict=True):
                if error is not None and not isinstance(error, StepError):
                    raise error
                yield scenario, master
                master.detach()

    def largest_angles(self, runs: Sequence[GridRun]) -> list[float]:
        """Return the largest angle between two machines of each run, rad; inf if it ended early."""
        return [self._largest_angle(run, data) for run, data in zip(runs, self.run(runs), strict=True)]

    def _largest_angle(self, run: GridRun, data: Trajectory) -> float:
        """Return the largest angle between two machines or sources, rad; inf where the run ended early."""
        if not data.time_s[-1] >= run.stop_s - 1e-9:
            return float(np.inf)
        return float(np.ptp(angles_of(data, with_angles(self.case)), axis=0).max())

    def _scenario(self, run: GridRun) -> Scenario:
        document = run.document() | ({"show": self._show} if self._show else {})
        for name, channel in document.get("channels", {}).items():
            if (signal := channel["signal"]) in self._dotted:
                del channel["signal"]
                path = [f"plant.{self._dotted[signal]}", name, f"controller.{signal}"]
                document.setdefault("connections", []).append(path)
        return load_scenario(document)

    def _master(self, lane: int, run: GridRun, scenario: Scenario) -> Master:
        system = system_of(
            scenario,
            case=self.case,
            controller="none" if run.controller is None else run.controller,
            swing=self._swing,
            fmus=self._fmus,
        )
        live = self._live.setdefault((lane, id(run.controller), tuple(system.instances)), {})
        for name, instance in system.instances.items():
            if name in live:
                live[name].set_start(instance.start)
            else:
                group = self._library if name == "plant" else None
                live[name] = participant_of(name, instance.file, instance.start, group=group)
        return system.master(live.values())


def longest_stable(
    settings: Sequence[Key],
    are_stable: Callable[[Mapping[Key, float]], Mapping[Key, bool]],
    low: float,
    high: float,
    tolerance: float,
) -> dict[Key, float]:
    """Bisect the end of `are_stable` between `low` and `high` for each setting; each call has all settings.

    Returns
    -------
    setting -> the longest kept value; 0 if `low` is not kept, `high` if it is kept.
    """
    first, last = are_stable(dict.fromkeys(settings, low)), are_stable(dict.fromkeys(settings, high))
    good = {s: (high if last[s] else low) if first[s] else 0.0 for s in settings}
    bad = {s: high for s in settings if first[s] and not last[s]}
    while bad:
        stable = are_stable({s: 0.5 * (good[s] + limit) for s, limit in bad.items()})
        for s, holds in stable.items():
            middle = 0.5 * (good[s] + bad[s])
            good[s], bad[s] = (middle, bad[s]) if holds else (good[s], middle)
        bad = {s: limit for s, limit in bad.items() if limit - good[s] > tolerance}
    return good
