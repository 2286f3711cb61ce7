"""The metrics of a run of a power system, from its points: in parts as they come, or at once."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from interarea.design.delay.loop_modes import LoopModes
from interarea.design.modes.modes import damping_ratio
from interarea.models.case.events import instants

from ..scenario.scenario import Scenario
from ..trajectory import Trajectory
from . import metrics as m
from .accumulators import Accumulators, Commutations, Curves, Settling, Squares
from .largest_deviation import judged_of, parts_of
from .ringdown import (
    Swing,
    disturbance_end_s,
    fit_window,
    fitted_modes,
    hertz,
    least_of_fit,
    samples_of,
    speeds_of,
)
from .verdict import Motion

if TYPE_CHECKING:
    from interarea.models.case.case import Case

Array = npt.NDArray[np.float64]
_LONGEST_FIT_S = 120.0  #: a ring-down is over by then; the fit's memory grows with the square of the window
_BAND = 0.02  #: of the peak, within which a swing has settled


class Judge:
    """Takes the parts of a trajectory and gives the run's metrics.

    step_s : of the master. stop_s : time of the last point to come. requested : names of `METRICS`; the
        others stay None.
    """

    def __init__(
        self,
        case: Case,
        swing: Swing,
        scenario: Scenario,
        *,
        step_s: float,
        stop_s: float,
        requested: Collection[str] = m.METRICS,
    ) -> None:
        self.case, self.swing, self.requested = case, swing, set(requested)
        self.end_s = end = disturbance_end_s(scenario)
        begin, change = fit_window(scenario)
        self.window = begin, min(change, stop_s, begin + _LONGEST_FIT_S)
        self._samples = samples_of(case, self.window, step_s)
        self._settling, self._energy = Settling(end, _BAND), Squares()
        self._effort: dict[str, Squares] = {}
        self._motion = motion_of(case, scenario, stop_s)
        self._last: dict[str, Array] = {}
        self.commutations = Commutations(case)  #: of its line-commutated dc links

    @staticmethod
    def reads(case: Case) -> tuple[str, ...]:
        """Return the outputs of a plant that are judged beside those that it shows by itself."""
        return tuple(f"bus{row.inverter_bus}.v" for row in case.hvdcs)

    def add(self, part: Trajectory) -> None:
        """Take the points of a part."""
        time = self._joined("time", part.time_s)
        signal = self._joined("swing", self.swing.of(part))
        self._settling.add(time, signal)
        self.commutations.add(part)
        if "energy" in self.requested:
            self._energy.add(time, signal)
        controls = {name: self._joined(name, part[name]) for name in part.reals_of("controller")}
        if "effort" in self.requested:
            for name, control in controls.items():
                self._effort.setdefault(name, Squares()).add(time, control)
        if self._fits or "stable" in self.requested:
            speeds = {c: self._joined(f"of {c}", part[c]) for c in speeds_of(self.case)}
            if self._fits:
                self._samples.add(time, list(speeds.values()))
            if "stable" in self.requested:
                self._move(part, time, speeds, controls)

    def _move(
        self, part: Trajectory, time: Array, speeds: Mapping[str, Array], controls: Mapping[str, Array]
    ) -> None:
        """Take what the verdict is judged by."""
        motion = self._motion
        columns = [f"plant.{name}_delta" for name in motion.names]
        angles = None
        if all(column in part for column in columns):
            angles = np.array([self._joined(column, part[column]) for column in columns])
        motion.add(time, np.array([speeds[f"plant.{m}_dw"] for m in motion.machines]), angles, controls)

    def metrics(
        self,
        limit_pu: float | None = None,
        roots: LoopModes | str = "its linear loop was not computed",
    ) -> m.Metrics:
        """Return the metrics of what was taken.

        limit_pu : of the control signals, None where they have none. roots : of the linear loop, or why
            there are none.
        """
        name, end, peak = self.swing.name, self.end_s, self._settling.peak
        swings = self._swings(roots)

        def if_requested(metric: str, value: Callable[[], Any]) -> Any:
            return value() if metric in self.requested else None

        return m.Metrics(
            signal=name,
            least_damping_ratio=swings.least[0],
            least_frequency_hz=swings.least[1],
            least_mode=swings.least[2],
            verdict=if_requested("stable", lambda: self._motion.verdict(limit_pu, self._root(roots))),
            damping_ratio={n: damping_ratio(z) for n, z in swings.named.items()},
            frequency_hz={n: hertz(z) for n, z in swings.named.items()},
            ring_down={n: mode.damping_ratio for n, mode in swings.fitted.items()},
            settling_time_s=if_requested("settling_time", lambda: self._settling.time_s),
            peak_pu=if_requested("peak", lambda: peak),
            energy_pu2s=if_requested("energy", lambda: self._energy.total),
            effort_pu2s=if_requested("effort", lambda: float(sum(u.total for u in self._effort.values()))),
            fit_error=swings.error,
            methods={
                "signal": self.swing.text,
                "least_damping_ratio": swings.how,
                "damping_ratio": swings.how,
                "frequency_hz": swings.how,
                "ring_down": swings.fit,
                "verdict": self._motion.rule,
                "settling_time_s": f"from {end:g} s to the last time |{name}| exceeds 2 % of its peak",
                "peak_pu": f"largest |{name}| of the run",
                "energy_pu2s": f"integral of {name}^2 over the run, trapezoids",
                "effort_pu2s": "sum over controller outputs of the integral of their square, trapezoids",
            },
        )

    @property
    def at_rest(self) -> bool:
        """Whether nothing moved, so that the linear loop alone can tell what the grid does."""
        return "stable" in self.requested and self._motion.at_rest

    def _root(self, roots: LoopModes | str) -> complex | None:
        """The least damped root of the loop that the verdict is of; None where another loop is linearised."""
        begin, end = self._motion.window_s
        return roots.least if isinstance(roots, LoopModes) and begin <= self.window[0] < end else None

    @property
    def _fits(self) -> bool:
        """Whether a fit may be wanted; where the roots are known it may not."""
        return bool({"fit_error", "least", "damping", "frequency"} & self.requested)

    def _joined(self, what: str, values: Array) -> Array:
        """Return values with the last ones of the part before at their head."""
        joined = np.concatenate([self._last[what], values]) if what in self._last else values
        self._last[what] = values[-1:].copy()
        return joined

    def _swings(self, roots: LoopModes | str) -> _Swings:
        known, window = None if isinstance(roots, str) else roots, self.window
        numbers = bool({"least", "damping", "frequency"} & self.requested)
        fitted: dict[str, m.RingDownMode] = {}
        fit = m.RingDown((), window, 0.0)
        if window[1] > window[0] and ("fit_error" in self.requested or (numbers and known is None)):
            robust = known is None or m.RING_DOWN in self.requested
            fitted, fit = fitted_modes(self._samples, self.case, window, known, robust)
        text = (
            f"{fit.method} on the speeds less their mean, {window[0]:g} to {window[1]:g} s, "
            f"largest misfit {fit.error:.1e} of the largest signal"
            + ("" if fit.good else f": poor, above {m.GOOD_FIT:g}, so that no mode has a name")
        )
        if not numbers:
            return _Swings({}, _NOTHING, fitted, fit.error, "", text)
        if known is None:
            poles = {n: one.pole for n, one in fitted.items()}
            how = f"{text} (no linear loop: {roots})"
            return _Swings(poles, least_of_fit(fit, fitted), fitted, fit.error, how, text)
        least = known.least
        least_row = (
            (damping_ratio(least), hertz(least), known.name_of(least)) if least is not None else _NOTHING
        )
        return _Swings(known.named, least_row, fitted, fit.error, _ROOTS, text)


def motion_of(case: Case, scenario: Scenario, stop_s: float) -> Motion:
    """Return what takes the motion of all machines of a case through a scenario, for its verdict."""
    machines, sources = judged_of(case, scenario.event)
    events = [t for e in scenario.event for t in instants(e)]
    lines = [t for line in scenario.lines.values() for t in line.event_times_s]
    parts = parts_of(case, [*machines, *sources])
    return Motion(machines, parts, events, [*events, *lines], stop_s, case.omega_b, sources)


@dataclass(frozen=True)
class Gathered:
    """All that is gathered of a run: counts, judge (None without a case), curves for the figure."""

    accumulators: Accumulators
    judge: Judge | None
    curves: Curves

    def add(self, part: Trajectory) -> None:
        """Take a part that nobody else keeps."""
        self.count(part)
        self.curves.add(part, part.units if self.judge is None else self._needed(self.judge, part))

    def count(self, part: Trajectory) -> None:
        """Take a part that is kept elsewhere."""
        self.accumulators.add(part)
        if self.judge is not None:
            self.judge.add(part)

    @property
    def warnings(self) -> list[str]:
        """A line on each signal that is not finite, and on each dc link that fails to commutate."""
        links = [] if self.judge is None else self.judge.commutations.warnings
        return [*self.accumulators.warnings, *links]

    def _needed(self, judge: Judge, part: Trajectory) -> list[str]:
        """Columns that the figure draws, and what channels count."""
        counts = [n for n in part.units if n.rpartition(".")[0] in self.accumulators.channels]
        return [*speeds_of(judge.case), *part.reals_of("controller"), *counts]


@dataclass(frozen=True)
class _Swings:
    """What swings in a run: named poles, the least damped one (ratio, Hz, name), the fit, and how."""

    named: Mapping[str, complex]
    least: tuple[float | None, float | None, str]
    fitted: Mapping[str, m.RingDownMode]
    error: float
    how: str
    fit: str


_NOTHING = (None, None, "")
_ROOTS = (
    "roots of the linear loop at the operating point with exact delay, packets and losses in the mean; names "
    "followed from the open loop"
)
