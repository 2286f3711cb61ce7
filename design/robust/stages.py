"""The search in stages: few conditions at first, then more, each stage from the result of the previous
one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from interarea.models.processes import processor_s

from .first_guess import first_guess
from .newton import newton_descent
from .smoothed_objective import Array, BandOffsets, Objective

#: what a turn of steps and L-BFGS must have gained for another, and how many there are at most
WORTHWHILE, TURNS = 2e-3, 3
#: rounds of L-BFGS in which a start is to become stable, at most
STABILISING = 10
#: on the outputs of a controller that goes on to a stage with more models; the last is nearly no control
GAINS = (1.0, 0.5, 0.25, 0.125, 0.0625, 0.0156)

Descend = Callable[[Objective, Array], tuple[Array, int]]
Balanced = Callable[[Objective, Array], Array]
Tell = Callable[[str, float, float], object]  #: what is under way, the share that is done, the objective


@dataclass(frozen=True)
class Stage:
    """One stage of the search.

    points, conditions : names of those that are used; none: all.
    rho : how closely the smoothed worst follows the worst, from one to the next.
    steps : of the descent at each, at most.
    offsets : additional damping required of each band in this stage; none: that of the design.
    longest_s : processor time of each start, after which no step begins; the next stage uses its result.
    """

    points: tuple[str, ...] = ()
    conditions: tuple[str, ...] = ()
    rho: tuple[float, ...] = (60.0, 120.0, 300.0)
    steps: int = 40
    offsets: BandOffsets | None = None
    longest_s: float = float("inf")

    def of(self, objective: Objective) -> Objective:
        """Return the objective over the models of this stage."""

        def looked_at(name: str) -> bool:
            point, condition = name.rsplit(": ", 1)
            return (not self.points or point in self.points) and (
                not self.conditions or condition in self.conditions
            )

        return replace(
            objective,
            models=[model for model in objective.models if looked_at(model.name)],
            efforts=[effort for effort in objective.efforts if looked_at(effort.name)],
            offsets=self.offsets or objective.offsets,
        )


def staged_search(
    objective: Objective,
    stages: Sequence[Stage],
    starts: Sequence[Array],
    guesses: int,
    bound: float,
    rng: np.random.Generator,
    *,
    balanced: Balanced,
    descend: Descend,
    progress: Tell | None = None,
) -> tuple[Array, int, list[tuple[float, Array]]]:
    """Return the parameters after the last stage, evaluations, and (objective, parameters) of every start.

    starts : given ones, used with their best gain; the first stage adds `guesses` more, with gains within
    `bound`. The best after the first stage continues. descend : L-BFGS for some evaluations; returns
    parameters and evaluations.
    progress : called with (one of `stage_parts`, its completed share, the objective).
    """
    report = progress or _silent
    count_of = len(starts) + guesses
    first = stages[0].of(objective)
    begun = [
        *(with_best_gain(first, theta) for theta in starts),
        *(first_guess(first, rng, bound) for _ in range(guesses)),
    ]
    reached, count = [], 0
    for what, theta in zip(stage_parts(1, len(stages), count_of), begun, strict=True):
        theta, used = _through(first, stages[0], theta, balanced, descend, partial(report, what))
        count += used
        reached.append((first.value(theta), theta))
        report(what, 1.0, reached[-1][0])
    theta = min(reached, key=lambda each: each[0])[1]
    for k, stage in enumerate(stages[1:], start=2):
        selected = stage.of(objective)
        (what,) = stage_parts(k, len(stages), count_of)
        theta = with_best_gain(selected, theta)
        theta, used = _through(selected, stage, theta, balanced, descend, partial(report, what))
        count += used
        report(what, 1.0, selected.value(theta))
    return theta, count, reached


def with_best_gain(objective: Objective, theta: Array) -> Array:
    """Return the controller with its outputs scaled by the one of `GAINS` with the least objective.

    A controller designed for few models may destabilise others; a descent from there may end worse than no
    control.
    """
    A, B, C, D = objective.unpack(theta)
    scaled = [objective.pack(A, B, gain * C, gain * D) for gain in GAINS]
    return min(scaled, key=objective.value)


def stabilised(
    objective: Objective, theta: Array, descend: Descend, over: Callable[[], bool] = lambda: False
) -> tuple[Array, int]:
    """Return parameters that keep every model stable, if `descend` finds them from `theta`, and evaluations.

    The effort is unbounded where an eigenvalue crosses the imaginary axis, so its penalty would keep an
    unstable eigenvalue from crossing. It is omitted until all models are stable.
    """
    free, count = replace(objective, efforts=(), swing=None), 0
    for _ in range(STABILISING):
        if objective.stable(theta) or over():
            break
        theta, used = descend(free, theta)
        count += used
    return theta, count


def stage_parts(k: int, stages: int, starts: int) -> list[str]:
    """Return the parts of stage `k`; the first stage has one for each start.

    >>> stage_parts(1, 2, 2), stage_parts(2, 2, 2)
    (['stage 1 of 2, start 1 of 2', 'stage 1 of 2, start 2 of 2'], ['stage 2 of 2'])
    """
    name = f"stage {k} of {stages}"
    return [name] if k > 1 else [f"{name}, start {start} of {starts}" for start in range(1, starts + 1)]


def _through(
    objective: Objective,
    stage: Stage,
    theta: Array,
    balanced: Balanced,
    descend: Descend,
    tell: Callable[[float, float], object],
) -> tuple[Array, int]:
    """Steps at each rho, and some of `descend` where they end: two eigenvalues may have met."""
    end = processor_s() + stage.longest_s

    def over() -> bool:
        return processor_s() > end

    theta, count = stabilised(objective, theta, descend, over)
    for k, rho in enumerate(stage.rho):
        smoothed = replace(objective, rho=rho)
        value = smoothed.value(theta)
        for turn in range(TURNS):

            def within(share: float, reached: float, done: float = k + turn / TURNS) -> None:
                tell((done + share / TURNS) / len(stage.rho), reached)

            theta, used = newton_descent(
                smoothed, theta, stage.steps, balanced=balanced, progress=within, over=over
            )
            count += used
            if over():
                return theta, count
            theta, more = descend(smoothed, theta)
            count += more
            gained, value = value - smoothed.value(theta), smoothed.value(theta)
            if not gained > WORTHWHILE:
                break
    return theta, count


def _silent(what: str, share: float, reached: float) -> None:
    pass
