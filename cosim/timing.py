"""Choose the communication step and the points of a run from latencies, events and what the FMUs can do."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from .clock import Clock, seconds
from .errors import GraphError
from .participant import Description

_DEFAULT_STEP_S, _LEAST_CHOSEN_STEP_S = 0.01, 0.001


def choose_step(latencies_s: Iterable[float]) -> float:
    """Return H: 10 ms, or the shortest positive latency when that is less, but at least 1 ms.

    >>> choose_step([0.1, 0.004, 0.0])
    0.004
    """
    positive = [v for v in latencies_s if v > 0.0]
    return max(_LEAST_CHOSEN_STEP_S, min([_DEFAULT_STEP_S, *positive]))


def clock_of(
    descriptions: Mapping[str, Description],
    *,
    start_s: float,
    stop_s: float,
    step_s: float,
    marks_s: Iterable[float],
    latency_ticks: Mapping[str, int],
    edges: bool,
) -> Clock:
    """Return the clock of a run: its marks, and each again when it comes out of a channel.

    Raises
    ------
    GraphError : an FMU that takes steps of one length only, with a mark or the end off the grid.
    ScenarioError : see `Clock.of_seconds`.
    """
    plain = Clock.of_seconds(stop_s, step_s, start_s=start_s, marks_s=marks_s)
    rigid = sorted(n for n, d in descriptions.items() if not d.variable_step)
    if rigid:
        for mark in (*plain.marks, plain.stop):
            off = (mark - plain.start) % plain.step
            if off:
                raise GraphError(
                    f"{rigid[0]} takes steps of one length only (canHandleVariableCommunicationStepSize "
                    f"= false), but t = {seconds(mark)} s is no multiple of step_s = {step_s:g}; "
                    f"use {seconds(mark - off)} or {seconds(mark - off + plain.step)}"
                )
        return Clock(plain.start, plain.stop, plain.step, plain.marks, edges=False)
    late = {m + d for m in plain.marks for d in latency_ticks.values()}
    marks = tuple(sorted({*plain.marks, *(m for m in late if m < plain.stop)}))
    return Clock(plain.start, plain.stop, plain.step, marks, edges=edges)
