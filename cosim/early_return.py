"""Steps that an FMU does not do to their end (fmi2Discard from fmi2DoStep, FMI2 4.2.2).

The FMU tells how far it came (fmi2LastSuccessfulTime), and whether it wants the simulation to end
(fmi2Terminated). Then either

* *continue* (default): it alone does the rest of the step from there, its inputs continued along the
  polynomials it was given. Needs nothing of the other FMUs, which see what happened at the step's end;
* *roll back*: every FMU is put back to the start of the step (all must save their state), the instant gets
  a communication point a tick before and after it, as a known event has, and the step is done in three.

An FMU that came nowhere is offered half the length, and half of that, before it counts as failed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from . import polynomials as ip
from .clock import TICKS_PER_SECOND, Step
from .errors import NoSolutionError, StepError

_LAST_SUCCESSFUL_TIME, _TERMINATED = 2, 3
_MOST_RETURNS, _SHORTEST = 10_000, 2.0**-20


class EarlyReturn(StepError):
    """An FMU came only to `reached_s`; raised to those who roll back."""

    def __init__(self, instance: str, time_s: float, reached_s: float, last_log: str) -> None:
        super().__init__(
            f"returned discard, having reached t = {reached_s:.9g} s",
            instance=instance,
            call="fmi2DoStep",
            time_s=time_s,
            last_log=last_log,
        )
        self.reached_s = reached_s


def go_on(fmu: Any, order: int, time_s: float, length_s: float) -> None:
    """Finish the step [time_s, time_s + length_s] of an FmuParticipant whose fmi2DoStep returned discard.

    order : of the input derivatives it was sent.

    Raises
    ------
    NoSolutionError : it gets nowhere with the shortest step, or cannot be continued. StepError : it wants to
        end, or tells no or an impossible time.
    """
    end, now, part = time_s + length_s, time_s, length_s
    provided = [(fmu.u[i], *(fmu.du[3 * i : 3 * i + 3] if order else (0.0,) * 3)) for i in _inputs(fmu)]
    log = fmu.last_log()
    try:
        for _ in range(_MOST_RETURNS):
            reached = reached_s(fmu, now, now + part)
            if reached > now:
                now, part = reached, end - reached
            else:
                part *= 0.5
                if not part > length_s * _SHORTEST:
                    break
            done = True
            while done and part > 4.0 * math.ulp(end):
                done = _offered(fmu, provided, order, time_s, now, part, log)
                if done:
                    now, part = now + part, end - (now + part)
            if done:
                fmu.time_s = end
                return
    finally:
        for i, d in zip(_inputs(fmu), provided, strict=True):
            fmu.u[i] = d[0]
            if order:
                fmu.du[3 * i : 3 * i + 3] = list(d[1:])
    raise NoSolutionError(
        f"returns discard repeatedly and stays at t = {now:.9g} s",
        instance=fmu.name,
        call="fmi2DoStep",
        time_s=now,
        last_log=fmu.last_log(),
        advice="take a shorter step_s",
    )


def _offered(
    fmu: Any,
    provided: list[tuple[float, ...]],
    order: int,
    start_s: float,
    now: float,
    part: float,
    message: str,
) -> bool:
    """Offer an FMU the step from `now` over `part`; return whether it took it."""
    try:
        _continue_inputs(fmu, provided, order, now - start_s)
        return bool(fmu.try_step(now, part))
    except StepError as refused:
        raise NoSolutionError(
            f"returned discard, and {refused.call} fails when it is to continue from t = {now:.9g} s",
            instance=fmu.name,
            call="fmi2DoStep",
            time_s=start_s,
            last_log=message,
            advice='early = "roll back" restores the state first' if fmu.description.saves_state else "",
        ) from refused


def reached_s(fmu: Any, time_s: float, end_s: float) -> float:
    """Return how far an FMU came in a step that it discarded.

    Raises
    ------
    StepError : it wants to end, does not say, or names a time outside the step.
    """
    if fmu.status_of("fmi2GetBooleanStatus", _TERMINATED):
        at = fmu.status_of("fmi2GetRealStatus", _LAST_SUCCESSFUL_TIME)
        raise _failed(fmu, time_s, f"asks for the simulation to end at t = {at or time_s:.9g} s")
    last = fmu.status_of("fmi2GetRealStatus", _LAST_SUCCESSFUL_TIME)
    if last is None:
        raise _failed(fmu, time_s, "returned discard and does not report the time it reached")
    slack = 1e-9 * max(1.0, abs(time_s))
    if not time_s - slack <= last <= end_s + slack:
        raise _failed(
            fmu,
            time_s,
            f"returned discard and names t = {last:.9g} s as the time it reached, "
            f"outside its step to {end_s:.9g} s",
        )
    return float(min(max(last, time_s), end_s))


def rolled_back(
    step: Step, once: Callable[[Step], None], save: Callable[[], Any], restore: Callable[[Any], None],
    release: Callable[[Any], None],
) -> int:  # fmt: skip
    """Do `step` by `once`; where an FMU returns early put everything back and stop there first.

    Returns how often. Raises
    ------
    StepError : see `go_on`; no progress.
    """
    todo, times = [step], 0
    while todo:
        piece = todo.pop()
        saved = save()
        try:
            once(piece)
        except EarlyReturn as early:
            restore(saved)
            tick = round(early.reached_s * TICKS_PER_SECOND)
            came = tick > piece.start
            before = max(tick - 1, piece.start) if came else (piece.start + piece.end) // 2
            after = min(tick + 1, piece.end) if came else before
            times += 1
            if (not came and too_short(piece)) or times > _MOST_RETURNS:
                raise
            if after < piece.end:
                todo.append(piece._replace(start=after, edge=False))
            if before < after:
                todo.append(Step(before, after, edge=True, recorded=False))
            if before > piece.start:
                todo.append(Step(piece.start, before, edge=False, recorded=False))
        finally:
            release(saved)
    return times


def _inputs(fmu: Any) -> range:
    return range(len(fmu.bound_inputs))


def _continue_inputs(fmu: Any, provided: list[tuple[float, ...]], order: int, at: float) -> None:
    """Send the inputs' polynomials as they are `at` seconds into the step."""
    for i, d in zip(_inputs(fmu), provided, strict=True):
        derivatives = [d[1 + k] if k < order else 0.0 for k in range(3)]
        cut: ip.Polynomial = (d[0], derivatives[0], derivatives[1], derivatives[2])
        fmu.u[i] = ip.value_at(cut, at)
        if order:
            fmu.du[3 * i : 3 * i + 3] = [ip.slope_at(cut, at), cut[2] + at * cut[3], cut[3]]
    if fmu.bound_inputs:
        fmu.send(order)


def _failed(fmu: Any, time_s: float, what: str) -> StepError:
    return StepError(what, instance=fmu.name, call="fmi2DoStep", time_s=time_s, last_log=fmu.last_log())


def too_short(step: Step) -> bool:
    """Whether a step is too short to be cut: in it an FMU goes on by itself."""
    return step.end - step.start <= 2
