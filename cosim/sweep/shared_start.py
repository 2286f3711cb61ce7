"""Runs of a sweep that share their beginning: what acts when, where two first differ, in which order to run.

Parameters of disturbances and outages act from an instant on: until then runs that differ in nothing else are
the same to the bit. The first of them leaves its state there (a *fork*), the others start from it. Runs are
ordered so that those which share most follow each other, where that saves more than it costs.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from ..clock import seconds, to_ticks
from ..master.instances import FmuParticipant
from ..master.instances import Value as Start
from ..master.master import Master
from ..master.records import Fork
from ..run.instance import Instance
from ..scenario.scenario import Scenario
from .point import Point
from .spec import Sweep
from .values import Value

_LEAST_STEPS = 20  # of communication that a fork must save: what saving and taking over cost, twice
_NEW_CLOCK_STEPS = 300  # what a run costs more when its communication points are not those of the run before
_TIMED = ("event[", "outage[")
Action = tuple[float, str]
Instances = Mapping[str, Instance]


@dataclass(frozen=True)
class Job:
    """A run to be made: its values, and where runs may share their beginning its point and what acts when.

    base : values of the parameters that act from the start. like_next_s : until when the next job is equal.
    """

    run: int
    values: Mapping[str, Value]
    point: Point | None = None
    base: tuple[Value, ...] = ()
    actions: tuple[Action, ...] = ()
    like_next_s: float = -math.inf


@dataclass(frozen=True)
class Beginning:
    """A state that later jobs start from; `timed` are the parameters in it that act from an instant on."""

    job: Job
    until_s: float
    fork: Fork
    timed: Mapping[str, Mapping[str, Start]]


def late_parameters(sweep: Sweep) -> frozenset[str]:
    """Return the parameters that act from an instant on, not from the start of the run; none for a search."""
    if sweep.searched is not None or sweep.base.fmus:
        return frozenset()
    return frozenset(
        name
        for name in sweep.parameters
        if all(w[0] == "event" or (w[0] == "channels" and w[2:] == ("outages_s",)) for w in sweep.paths(name))
    )


def actions_of(scenario: Scenario) -> tuple[Action, ...]:
    """Return what acts in a scenario from an instant on, in order of time."""
    actions: list[Action] = []
    for k, event in enumerate(scenario.event):
        what = event.model_dump(exclude={"start_s", "end_s"})
        actions.append((event.start_s, f"event {k} {what}"))
        end = getattr(event, "end_s", None)
        if end is not None:
            actions.append((end, f"event {k} ends"))
    for name, channel in scenario.channels.items():
        for k, (start, end) in enumerate(channel.outages_s):
            actions += [(start, f"{name} outage {k}"), (end, f"{name} outage {k} ends")]
    return tuple(sorted(actions))


def shared_until_s(one: Job, other: Job) -> float:
    """Return when two jobs first differ: -inf where they differ throughout, inf where they are the same."""
    if one.point is None or other.point is None or one.base != other.base:
        return -math.inf
    for a, b in zip(one.actions, other.actions, strict=False):
        if a != b:
            return min(a[0], b[0])
    longer = max(one.actions, other.actions, key=len)
    shorter = min(len(one.actions), len(other.actions))
    return longer[shorter][0] if len(longer) > shorter else math.inf


def in_order(jobs: Sequence[Job]) -> list[Job]:
    """Return the jobs as given or sorted by what acts when, whichever costs less, with `like_next_s`."""
    provided = _linked(jobs)
    first: dict[tuple[Value, ...], int] = {}
    for job in jobs:
        first.setdefault(job.base, len(first))
    linked = _linked(sorted(jobs, key=lambda job: (first[job.base], job.actions)))
    more = _cost_s(linked) - _cost_s(provided)
    several = len({job.point.scenario.event_times_s for job in jobs if job.point is not None}) > 1
    # sorted, one fork at a time is enough for instants that move
    return linked if more < 0.0 or (more == 0.0 and several) else provided


def _linked(jobs: Sequence[Job]) -> list[Job]:
    likes = [shared_until_s(a, b) for a, b in pairwise(jobs)]
    return [replace(job, like_next_s=like) for job, like in zip(jobs, [*likes, -math.inf], strict=False)]


def _cost_s(jobs: Sequence[Job]) -> float:
    """Return the simulated time that an order takes, new clocks counted as time."""
    total = 0.0
    for before, job in zip([None, *jobs], jobs, strict=False):
        if job.point is None:
            continue
        scenario = job.point.scenario
        shared = 0.0 if before is None else min(max(before.like_next_s, 0.0), scenario.stop_s)
        total += scenario.stop_s - shared
        if (
            before is None
            or before.point is None
            or before.point.scenario.event_times_s != scenario.event_times_s
        ):
            total += _NEW_CLOCK_STEPS * (scenario.step_s or 0.01)
    return total


def places_to_save(jobs: Sequence[Job], k: int, master: Master) -> list[int]:
    """Return the steps, ascending, before which job `k` leaves its state for later jobs.

    A later job can start where everything between is still like it: the running minimum of `like_next_s`.
    """
    places: list[int] = []
    lowest = math.inf
    for job in jobs[k:]:
        lowest = min(lowest, job.like_next_s)
        if lowest >= seconds(master.clock.stop):
            continue  # the same run again
        index = place_of(lowest, master)
        if index is None:
            break
        if not places or index < places[-1]:
            places.append(index)
    return places[::-1]


def place_of(time_s: float, master: Master) -> int | None:
    """Return the last step before which a state serves runs that differ from `time_s` on.

    None: it is not worth a fork.
    """
    index = bisect_right(master.ends, to_ticks(time_s, "time of a fork") - 2) if time_s > 0.0 else 0
    return index if index >= master.index + _LEAST_STEPS else None


def beginning_of(job: Job, master: Master, instances: Instances) -> Beginning:
    """Return what a master has done so far, for later jobs; a tick on either side of an event is its own."""
    return Beginning(job, seconds(master.ends[master.index - 1] + 2), master.fork(), timed_of(instances))


def timed_of(instances: Instances) -> dict[str, dict[str, Start]]:
    """Return, for each instance, its start values that act from an instant on."""
    return {
        name: {key: value for key, value in instance.start.items() if key.startswith(_TIMED)}
        for name, instance in instances.items()
    }


def taken_over(beginning: Beginning, job: Job, master: Master, instances: Instances) -> bool:
    """Put a master where `beginning` is, with the parameters of `job`; False: it cannot start there."""
    if not shared_until_s(beginning.job, job) >= beginning.until_s or not master.take_over(beginning.fork):
        return False
    now = timed_of(instances)
    for name, participant in master.participants.items():
        assert isinstance(participant, FmuParticipant)
        old, new = beginning.timed[name], now[name]
        changed = {key: value for key, value in new.items() if old.get(key) != value}
        changed |= {key: participant.file.start_of(key) for key in old if key not in new}
        participant.change(changed)
    return True
