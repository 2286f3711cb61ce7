"""Which runs of a sweep advance side by side: those of one grid, where that costs less than one by one."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path

from interarea.fmu_build.errors import BuildError
from interarea.fmu_build.write.lane_library import GroupLibrary, plant_group
from interarea.models.blocks.plant import plant_sources
from interarea.models.case.case import Case
from interarea.models.case.events import slot_count
from interarea.models.grid.network_tables import has_many_ports

from ..run.artefacts import EVENT_SLOTS
from .live_instances import LiveLoop
from .point import CaseChange
from .shared_start import Job

#: time of n runs side by side over that of one alone: what they share, what each adds (measured, AVX-512)
_SHARED, _EACH = 0.9, 0.2
PlantKey = tuple[CaseChange, int]


@dataclass(frozen=True)
class Lanes:
    """The library that steps plants side by side, and how many at most; None and 1 where it cannot be had."""

    library: GroupLibrary | None
    count: int


def host_lanes(cache: Path, case: Case | None = None) -> Lanes:
    """Return what this processor can do; `case`: of the plants, as `plant_sources`.

    Plants with many ports go one by one: nothing is compiled for them.
    """
    if case is not None and has_many_ports(case):
        return Lanes(None, 1)
    with suppress(BuildError):
        library = plant_group(plant=plant_sources(case), cache=cache)
        return Lanes(library, library.lanes)
    return Lanes(None, 1)


def lanes_for(cache: Path, cases: Iterable[Case]) -> Lanes:
    """Return what this processor can do for plants of `cases` without devices of their own."""
    return Lanes(None, 1) if all(map(has_many_ports, cases)) else host_lanes(cache)


def has_lanes(live: LiveLoop) -> bool:
    """Whether the plant among instances that have begun can be stepped with others of its kind."""
    plant = live.participants["plant"]
    return plant.group is not None and plant.group.work(plant.component, 2) is not None


def plant_key(job: Job) -> PlantKey | None:
    """Return what decides the plant FMU of a job; None where its point is not known."""
    if job.point is None or job.point.scenario.fmus:
        return None
    return job.point.change, max(EVENT_SLOTS, slot_count(job.point.scenario.event))


def by_plant(jobs: Sequence[Job]) -> list[Job]:
    """Return jobs of the same plant after each other, otherwise in the order given."""
    first: dict[PlantKey | None, int] = {}
    for job in jobs:
        first.setdefault(plant_key(job), len(first))
    return sorted(jobs, key=lambda job: first[plant_key(job)])


def common_s(jobs: Sequence[Job]) -> float:
    """Return until when these jobs, in the order of `sweep_forks`, are identical; 0: not from the start."""
    return max(0.0, min((job.like_next_s for job in jobs[:-1]), default=0.0))


def how_many(jobs: Sequence[Job], lanes: int) -> int:
    """Return how many of the first of `jobs` to make side by side; 1 where one by one costs less.

    One by one, each run starts where the one before was when they began to differ; side by side, all start
    where the first two of them differ.
    """
    plant = plant_key(jobs[0])
    if plant is None:
        return 1
    selected = list(takewhile(lambda job: plant_key(job) == plant, jobs[:lanes]))
    stops = [job.point.scenario.stop_s for job in selected if job.point is not None]
    shared = [0.0, *(min(max(job.like_next_s, 0.0), stop) for job, stop in zip(selected, stops, strict=True))]
    one_by_one = sum(stops) - math.fsum(shared[: len(selected)])
    together = min(common_s(selected), *stops) if len(selected) > 1 else 0.0
    rest = max(stops) - together
    beside = together + (_SHARED + _EACH * len(selected)) * rest
    return len(selected) if beside < one_by_one else 1
