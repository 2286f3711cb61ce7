"""What a scenario did: its result with metrics, named by the modes of its case."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from interarea.models.files import together, write_whole

from ..errors import nearest
from ..scenario.scenario import Scenario
from .metrics import GOOD_FIT, Metrics
from .record import write_json
from .result import Result
from .ringdown import Swing, fit_window, ring_down_of
from .trajectory_files import TrajectoryFiles
from .verdict import Verdict

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from interarea.models.case.case import Case


_SHOWN = 4  # modes in a line: inter-area ones first, then the least damped
METRICS_FILES = ("metrics.json", "run.svg", "report.html")
LEAST = "least"  #: in place of a mode's name: what is damped least


@dataclass(frozen=True, kw_only=True, repr=False)
class Run(Result):
    """What a scenario did: `trajectory`, `metrics`, `ledger` (delays), `packets`.

    measure : computes the metrics; called once, when they are first read.
    """

    scenario: Scenario
    case: Case
    swing: Swing
    measure: Callable[[], Metrics] = field(compare=False)

    @cached_property
    def metrics(self) -> Metrics:
        """The metrics, computed on first access: the roots of the linear loop cost more than the run.

        Raises
        ------
        BuildError : the plant has to be linearised anew and cannot be.
        """
        return self.measure()

    def __getstate__(self) -> dict[str, Any]:
        """Return what another process needs: the metrics themselves instead of what computes them."""
        metrics = self.metrics
        return {k: v for k, v in vars(self).items() if k != "measure"} | {"metrics": metrics}

    def __repr__(self) -> str:
        """Return in a line what ran and how it went: pytest shows it where an assertion fails."""
        return f"Run({self.scenario.name!r}: {self.summary})"

    @property
    def summary(self) -> str:
        """What ran and how it went, in a line."""
        m, settled = self.metrics, self.metrics.settling_time_s
        order = sorted(m.damping_ratio, key=lambda n: (not n.startswith("inter-area"), m.damping_ratio[n]))
        shown = sorted(order[:_SHOWN])
        named = ", ".join(f"{n} {m.damping_ratio[n]:.3f} at {m.frequency_hz[n]:.2f} Hz" for n in shown)
        if len(order) > _SHOWN:
            named += f" and {len(order) - _SHOWN} more"
        within = "not within 2 %" if settled is None else f"within 2 % after {settled:.2f} s"
        return (
            f"{self.case.name}, controller {Path(self.scenario.controller).name}, "
            f"{float(self.trajectory.time_s[-1]):g} s: {self.verdict}; "
            f"{self.least_in_words}; {f'{named}; ' if named else ''}{self.swing.name} {within}"
        )

    @property
    def least_in_words(self) -> str:
        """The least damping of everything that swings, with its frequency and whose it is."""
        m = self.metrics
        if m.least_damping_ratio is None or m.least_frequency_hz is None:
            return "nothing swings"
        whose = m.least_mode
        if not whose and m.methods["least_damping_ratio"].startswith("roots"):
            whose = "from controller or latency"
        elif not whose:
            error = m.fit_error or 0.0
            whose = "no mode has its shape" if error <= GOOD_FIT else f"no name: fit within {error:.1%} only"
        return f"least damping {m.least_damping_ratio:.3f} at {m.least_frequency_hz:.2f} Hz ({whose})"

    def plot(self) -> Figure:
        """Draw the swing between the areas, the speeds of the machines and the controls over time."""
        from .run_figure import run_plot

        return run_plot(self)

    def save(
        self,
        folder: str | Path,
        *,
        record: Sequence[str] | None = None,
        every: int | None = None,
        explorer: str = "",
    ) -> list[Path]:
        """Write what `Result.save` does, metrics.json, run.svg and the page report.html; return the files.

        record, every : see `Result.save`; default as the scenario says.
        explorer : address of the explorer's page of this run, for the page to link.
        """
        record = self.scenario.record if record is None else record
        with together():
            with TrajectoryFiles(Path(folder), record, every or self.scenario.every) as files:
                files.add(self.trajectory)
            return [*files.files, *self.save_beside(Path(folder), explorer)]

    def save_beside(self, folder: Path, explorer: str = "") -> list[Path]:
        """Write what `save` does beside the trajectory."""
        from ..plots.curves import save_figure
        from .run_page import run_page

        files = super().save_beside(folder)
        metrics, figure, page = (folder / name for name in METRICS_FILES)
        write_json(self.metrics.as_dict(), metrics)
        drawn = self.plot()
        save_figure(drawn, figure)
        write_whole(page, run_page(self, drawn, explorer))
        return [*files, metrics, figure, page]

    def _repr_html_(self) -> str:
        """Return the summary and the figure, for notebooks."""
        from .run_figure import run_html

        return run_html(self)

    @property
    def verdict(self) -> Verdict:
        """What the run came to: settled, settling slowly, standing swing, growing or synchronism lost."""
        assert self.metrics.verdict is not None  # a single run is always judged
        return self.metrics.verdict

    @property
    def stable(self) -> bool:
        """Whether the machines stayed together and what is left of the disturbance falls (`verdict`)."""
        return self.verdict.stable

    @property
    def synchronous(self) -> bool:
        """Whether no two machines or voltage sources of an island came half a turn apart."""
        return self.verdict.synchronous

    @property
    def unmet(self) -> tuple[str, ...]:
        """What `[expect]` of the scenario states and the run did not do, a sentence each."""
        expect, m = self.scenario.expect, self.metrics
        ratios = {LEAST: m.least_damping_ratio, **m.damping_ratio}
        limits = {
            f"damping_ratio of {mode}": (row, ratios.get(mode)) for mode, row in expect.damping_ratio.items()
        }
        limits |= {
            name: (row, getattr(m, name))
            for name in ("settling_time_s", "peak_pu")
            if (row := getattr(expect, name)) is not None
        }
        stated = {
            "stable": (expect.stable, self.stable),
            "synchronism": (expect.synchronism, self.synchronous),
            "verdict": (expect.verdict, self.verdict.name),
        }
        return (
            *(f"{k} is {is_}, expected {e}" for k, (e, is_) in stated.items() if e is not None and e != is_),
            *(
                f"{k} is {'none' if is_ is None else f'{is_:.4g}'}, expected from {low:g} to {high:g}"
                for k, ((low, high), is_) in limits.items()
                if is_ is None or not low <= is_ <= high
            ),
        )

    def damping_ratio(
        self, mode: str = "inter-area", *, start_s: float | None = None, stop_s: float | None = None
    ) -> float:
        """Return the damping ratio of a mode, or of ``least``: of everything that swings, the least.

        As `metrics` has it; with `start_s` or `stop_s` that of the ring-down in a given window.

        Raises
        ------
        ValueError : the mode does not show in the window; the message names those that do.
        """
        if start_s is None and stop_s is None:
            ratios = dict(self.metrics.damping_ratio)
            if self.metrics.least_damping_ratio is not None:
                ratios[LEAST] = self.metrics.least_damping_ratio
        else:
            window = fit_window(self.scenario)
            chosen = (window[0] if start_s is None else start_s, window[1] if stop_s is None else stop_s)
            step = self.ledger.step_s
            named, fit = ring_down_of(self.trajectory, self.case, chosen, step)
            ratios = {name: m.damping_ratio for name, m in named.items()}
            if not fit.good:
                raise ValueError(
                    f"mode {mode!r}: the ring-down from {chosen[0]:g} to {chosen[1]:g} s is fitted within "
                    f"{fit.error:.1%} only, wanted {GOOD_FIT:.0%} for a mode to have a name; choose another "
                    "window, or omit start_s and stop_s"
                )
        if mode not in ratios:
            raise ValueError(f"mode {mode!r} is not identified in this run; {nearest(mode, ratios)}")
        return ratios[mode]

    def settling_time_s(self, column: str | None = None, *, band: float = 0.02) -> float | None:
        """Return the time from the last disturbance to where a signal stays within `band` of its peak.

        column : a column of the trajectory; default the speed difference that the metrics are of, `swing`.
        """
        from . import metrics

        if column is None and band == 0.02:
            return self.metrics.settling_time_s
        from .ringdown import disturbance_end_s

        values = self.swing.of(self.trajectory) if column is None else self.trajectory[column]
        return metrics.settling_time_s(
            self.trajectory.time_s, values, disturbance_end_s(self.scenario), band=band
        )
