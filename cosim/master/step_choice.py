"""Choose the communication step and the points of a run from latencies, events and what the FMUs can do."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping

from interarea.fmu_build.open.ports import Description

from ..clock import Clock, seconds, to_ticks
from ..errors import GraphError

_DEFAULT, _LEAST = 10_000_000, 1_000_000  # ticks


def step_and_reason(latencies_s: Iterable[float], instants_s: Iterable[float] = ()) -> tuple[float, str]:
    """Return H and the reason: 10 ms, or the shortest latency when that is less, but at least 1 ms.

    When a step between half of that and that divides every latency and every instant (events, reporting
    intervals, the end), the largest such step is taken; failing that, one that divides the latencies.

    >>> step_and_reason([0.1, 0.004, 0.0])
    (0.004, 'chosen: the shortest latency; divides all latencies and instants')
    >>> step_and_reason([0.1], [1.0, 1.1333])
    (0.01, 'chosen: the longest step; divides all latencies, events between steps shorten them')
    """
    latencies = [t for t in (to_ticks(v, "latency") for v in latencies_s) if t > 0]
    instants = [to_ticks(v, "instant") for v in instants_s]
    limit = max(_LEAST, min([_DEFAULT, *latencies]))
    why = "the longest step" if limit == _DEFAULT else "the shortest latency"
    if limit == _LEAST and limit > min([_DEFAULT, *latencies]):
        why = "the shortest step, which is longer than the shortest latency"
    for times, reason in (
        ([*latencies, *instants], "divides all latencies and instants"),
        (latencies, "divides all latencies, events between steps shorten them"),
    ):
        shared = math.gcd(*times)
        least = -(-shared // limit)  # parts of `shared` that are no longer than the limit
        parts = next((n for n in range(least, 2 * least) if shared % n == 0), 0)
        if parts and 2 * (shared // parts) > limit:
            step = shared // parts
            return seconds(step), f"chosen: {why}{'' if step == limit else ', shortened'}; {reason}"
    return seconds(limit), f"chosen: {why}"


def latency_ticks(latency_s: Mapping[str, float], known: Collection[str]) -> dict[str, int]:
    """Return latencies of instances in ticks. Raises GraphError for one that is not `known`."""
    for name in latency_s:
        if name not in known:
            raise GraphError(f"latency_s names {name!r}, which is not an instance")
    return {n: to_ticks(v, f"latency of {n}") for n, v in latency_s.items()}


def clock_of(
    descriptions: Mapping[str, Description],
    *,
    start_s: float,
    stop_s: float,
    step_s: float,
    event_times_s: Iterable[float],
    latency_ticks: Mapping[str, int],
    edges: bool,
    points: Iterable[int] = (),
    at_rest: bool = True,
) -> Clock:
    """Return the clock of a run: event times, each again when it comes out of a channel, further points.

    points : ticks; left out when an FMU allows steps of one length only.
    at_rest : nothing moves at the start. Otherwise the output of a channel begins to move with a slope jump a
        latency after the start, as the signal before the start is taken to have been what it is there.

    Raises
    ------
    GraphError : an FMU that allows steps of one length only, with a mark or the end off the grid.
    ScenarioError : see `Clock.of_seconds`.
    """
    plain = Clock.of_seconds(stop_s, step_s, start_s=start_s, event_times_s=event_times_s)
    rigid = sorted(n for n, d in descriptions.items() if not d.variable_step)
    if rigid:
        _refuse_off_grid(plain, rigid[0], step_s)
        return Clock(plain.start, plain.stop, plain.step, plain.event_times, edges=False)
    event_times = _with_echoes(plain, latency_ticks.values())
    inside = tuple(sorted({p for p in points if plain.start < p < plain.stop}))
    first = {plain.start + d for n, d in latency_ticks.items() if d and not _steps_only(descriptions[n])}
    slope_events = (
        () if at_rest else tuple(sorted(t for t in first.difference(event_times) if t < plain.stop))
    )
    return Clock(
        plain.start,
        plain.stop,
        plain.step,
        event_times,
        edges=edges,
        points=inside,
        slope_events=slope_events,
    )


def _with_echoes(clock: Clock, latencies: Collection[int]) -> tuple[int, ...]:
    """Return the event times, and each again a latency later while the run lasts."""
    late = {event + d for event in clock.event_times for d in latencies}
    return tuple(sorted({*clock.event_times, *(m for m in late if m < clock.stop)}))


def _refuse_off_grid(clock: Clock, rigid: str, step_s: float) -> None:
    """Raise GraphError where a mark or the end is no multiple of the step."""
    for event in (*clock.event_times, clock.stop):
        off = (event - clock.start) % clock.step
        if off:
            raise GraphError(
                f"{rigid} allows steps of one length only (canHandleVariableCommunicationStepSize "
                f"= false), but t = {seconds(event)} s is no multiple of step_s = {step_s:g}; "
                f"use {seconds(event - off)} or {seconds(event - off + clock.step)}"
            )


def _steps_only(description: Description) -> bool:
    """Whether all that comes out is held between instants, such as packets."""
    return all(p.discrete or p.type != "Real" for p in description.outputs)
