"""Results of the public functions: one line as text, a table in a notebook, a DataFrame, a figure."""

from __future__ import annotations

import html
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from interarea.cosim.sweep.parts import read_plan, read_rows, read_trajectory, summary_of
from interarea.design.modes.loop_choice import LoopChoice, RankedLoop
from interarea.design.modes.modes import Modes
from interarea.progress import notebook_bars

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from interarea.cosim.results.run import Run
    from interarea.cosim.run.compare import Compared
    from interarea.cosim.scenario.scenario import Scenario
    from interarea.design.certificates.switching import SwitchingCertificate
    from interarea.design.robust.operating_points import FamilyCertificate
    from interarea.models.case.case import Case


def _frame(rows: Sequence[Mapping[str, Any]], index: str | None = None) -> pd.DataFrame:
    import pandas as pd

    table = pd.DataFrame([dict(row) for row in rows])
    return table if index is None else table.set_index(index)


def _html(title: str, table: pd.DataFrame) -> str:
    shown = table if table.index.name is None else table.reset_index()  # no header cell is left empty
    text = shown.to_html(float_format="{:.4g}".format, max_rows=40, index=False)
    return f"<p><b>{html.escape(title)}</b></p>{text}"


@dataclass(frozen=True, repr=False)
class SwingModes(Modes):
    """The swing modes of a case by name; a Mapping name -> `Mode`."""

    case: Case | None = None

    @classmethod
    def of(cls, modes: Modes, case: Case) -> SwingModes:
        """Return named modes with their case."""
        return cls(modes.by_name, modes.eigenvalues, modes.growth, case)

    def __repr__(self) -> str:
        listed = ", ".join(f"{n} {m.frequency_hz:.3f} Hz {m.damping_ratio:.3f}" for n, m in self.items())
        return f"Modes({self._title}: {self._verdict}; {listed})"

    @property
    def _verdict(self) -> str:
        return "" if self.growth is None else self.growth.text

    @property
    def _title(self) -> str:
        return self.case.name if self.case is not None else "modes"

    def to_frame(self) -> pd.DataFrame:
        """Return one row a mode: frequency_hz, damping_ratio, real and imag (1/s), share, caveat."""
        rows = [
            {
                "mode": name,
                "frequency_hz": mode.frequency_hz,
                "damping_ratio": mode.damping_ratio,
                "real": mode.eigenvalue.real,
                "imag": mode.eigenvalue.imag,
                "share": mode.share,
                "caveat": mode.caveat,
            }
            for name, mode in self.items()
        ]
        return _frame(rows, "mode")

    def plot(self, mode: str = "") -> Figure:
        """Draw the shape of a mode: speed of each machine, size and angle. Default: the inter-area mode.

        On a map if the case has coordinates of its buses, else as a polar plot.
        """
        from interarea.cosim.plots.mode_map import shape_plot

        return shape_plot(self[mode] if mode else self.inter_area, self.case)

    def _repr_html_(self) -> str:
        return f"<p>{html.escape(self._verdict)}</p>" + _html(f"{self._title}: swing modes", self.to_frame())


@dataclass(frozen=True, repr=False)
class RankedLoops(LoopChoice):
    """Actuators with signals for each target mode, best first (`loops`), and sets of actuators (`sets`)."""

    @property
    def selected(self) -> RankedLoop:
        """The best loop for the least damped target."""
        return self.loops[self.least_damped][0]

    def __repr__(self) -> str:
        best = self.selected
        return f"Loops({', '.join(self.targets)}: best {best.actuator} with {best.signal})"

    def to_frame(self) -> pd.DataFrame:
        """Return one row a loop: mode, actuator, signal, kind, index, lead_deg, moves_beside, times."""
        keys = ("mode", "actuator", "signal", "kind", "index", "lead_deg")
        rows = []
        for loop in (loop for ranked in self.loops.values() for loop in ranked):
            beside = {"moves_beside": loop.beside[0], "times": loop.beside[1]}
            rows.append({key: getattr(loop, key) for key in keys} | beside)
        return _frame(rows)

    def plot(self) -> Figure:
        """Draw the index of each loop for the least damped target, best first."""
        from interarea.cosim.plots.curves import new_figure

        ranked = self.loops[self.least_damped]
        labels = [f"{loop.actuator.removesuffix('_vs')} with {loop.signal}" for loop in ranked]
        figure, axes = new_figure(height=0.22 * len(labels) + 0.9)
        axes.barh(labels, [loop.index for loop in ranked])
        axes.invert_yaxis()
        axes.set_xlabel(f"loop index for the {self.least_damped} mode")
        return figure

    def _repr_html_(self) -> str:
        sets = [
            {
                "actuators": ", ".join(one.actuators),
                "score": one.score,
                "holds": one.holds,
                "each with": ", ".join(f"{a} with {s}" for a, s in one.loops.items()),
                "reason": one.reason,
            }
            for one in self.sets
        ]
        loops = _html(f"loops for {', '.join(self.targets)}", self.to_frame())
        return loops + _html("sets of actuators", _frame(sets))


@dataclass(frozen=True, repr=False)
class Certificate:
    """Certificate of a controller: `ok`, `rows` as a DataFrame, `violations`; `record` has everything.

    A controller is certified for a family of operating points, losses and latencies; a bank of controllers
    for every sequence of losses and returns.
    """

    controller: str
    case: str
    record: FamilyCertificate | SwitchingCertificate
    conditions: Mapping[str, str] = field(default_factory=dict)  #: name -> in words

    @property
    def ok(self) -> bool:
        """Whether all requirements are met."""
        return not self.violations

    @property
    def violations(self) -> tuple[str, ...]:
        """Violated requirements, one line each."""
        from interarea.design.robust.operating_points import FamilyCertificate

        if isinstance(self.record, FamilyCertificate):
            return self.record.violations
        wait = self.record.dwell_s
        return () if wait == 0.0 else (f"changes of the signals must be at least {wait:.3g} s apart",)

    @property
    def worth(self) -> str:
        """Value of the signals from other machines, a sentence; empty if not computed."""
        result = getattr(self.record, "worth", None)
        return "" if result is None else str(result["sentence"])

    @property
    def rows(self) -> pd.DataFrame:
        """One row for each operating point and condition; of a bank, one for each loop of its proof."""
        return self.to_frame()

    def to_frame(self) -> pd.DataFrame:
        """Return `rows`: point, condition, stable, rightmost (1/s), worst_swing, inter_area."""
        from dataclasses import asdict

        from interarea.design.robust.operating_points import FamilyCertificate

        if isinstance(self.record, FamilyCertificate):
            return _frame([asdict(row) for row in self.record.rows])
        return _frame([{"loop": loop} for loop in self.record.loops])

    def as_dict(self) -> dict[str, Any]:
        """Return everything as JSON values."""
        return self.record.as_dict()

    def plot(self) -> Figure:
        """Draw the least damping of every swing, for each operating point under each condition."""
        import numpy as np

        from interarea.cosim.plots.curves import new_figure

        table = self.to_frame()
        if "worst_swing" not in table:
            from interarea.models.errors import UserError

            raise UserError(f"{self.controller}: the proof of a bank has no damping ratios to draw")
        points, conditions = (list(dict.fromkeys(table[key])) for key in ("point", "condition"))
        figure, axes = new_figure(height=0.35 * len(points) + 1.2)
        for k, condition in enumerate(conditions):
            part = table[table.condition == condition].set_index("point")
            places = np.arange(len(points)) + 0.1 * (k - (len(conditions) - 1) / 2)
            axes.plot([part.worst_swing[p] for p in points], places, "o", markersize=4, label=condition)
        axes.set_yticks(range(len(points)), points)
        axes.invert_yaxis()
        axes.set_xlabel("least damping ratio of the swings")
        axes.legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return figure

    def __repr__(self) -> str:
        message = "holds what was asked" if self.ok else "; ".join(self.violations)
        return f"Certificate({self.controller} on {self.case}: {message})"

    def _repr_html_(self) -> str:
        message = "holds what was asked" if self.ok else "; ".join(self.violations)
        return _html(f"{self.controller} on {self.case}: {message}", self.to_frame())


@dataclass(frozen=True, repr=False)
class Comparison:
    """One scenario with several controllers (`compare`): `runs` by name, `roots` over latency, `worth`.

    worth : controller -> value of its signals from other machines in the linear loop, a sentence.
    """

    scenario: Scenario
    compared: tuple[Compared, ...]
    worth: Mapping[str, str]

    @property
    def runs(self) -> dict[str, Run]:
        """The run with each controller, by its name."""
        return {one.name: one.run for one in self.compared}

    @property
    def roots(self) -> pd.DataFrame:
        """Roots of each linear loop with all channels that late: latency_s, real_per_s, frequency_hz, ..."""
        return _frame([{"controller": one.name, **row} for one in self.compared for row in one.roots()])

    def to_frame(self) -> pd.DataFrame:
        """Return one row a controller: verdict, damping of the linear loop, settling, peak, effort."""
        return _frame([one.row() for one in self.compared], "controller")

    def as_dict(self) -> dict[str, Any]:
        """Return everything as JSON values, as compare.json has it."""
        return {
            "scenario": self.scenario.name,
            "controllers": [one.row() for one in self.compared],
            "roots": {one.name: one.roots() for one in self.compared},
            "worth": dict(self.worth),
        }

    def plot(self) -> Figure:
        """Draw the swing signal and the controller outputs for each controller."""
        from interarea.cosim.run.compare import curves_figure

        return curves_figure(self.compared)

    def save(self, folder: str | Path, *, command: str = "interarea.compare") -> list[Path]:
        """Write the files of each run in a folder of its own, compare.json and the page compare.html.

        All files or none. command : that made the comparison, for the page.
        """
        from interarea.cosim.results.record import write_json
        from interarea.cosim.run.compare import write_comparison
        from interarea.models.files import together

        place = Path(folder)
        with together():
            files = [file for name, run in self.runs.items() for file in run.save(place / name)]
            files.append(place / "compare.json")
            write_json(self.as_dict(), files[-1])
            page = write_comparison(self.compared, self.scenario, place / "compare.html", command)
        return [*files, page]

    def __repr__(self) -> str:
        listed = ", ".join(f"{one.name} {one.run.verdict.name}" for one in self.compared)
        return f"Comparison({self.scenario.name}: {listed})"

    def _repr_html_(self) -> str:
        return _html(self.scenario.title or self.scenario.name, self.to_frame())


@dataclass(frozen=True, repr=False)
class SweepResults:
    """The results of a sweep in their folder: `to_frame()` has a row for each run with a result."""

    folder: Path

    @property
    def summary(self) -> dict[str, Any]:
        """Counts of the runs: runs, ok, failed, failures by kind, stable, unstable."""
        return summary_of(self.folder)

    def to_frame(self) -> pd.DataFrame:
        """Return one row for each run, in order: parameters, status, metrics."""
        return read_rows(self.folder)

    def trajectory(self, run: int) -> pd.DataFrame | None:
        """Return the trajectory of a run, None if it was not stored."""
        return read_trajectory(self.folder, run)

    def plot(self) -> Figure:
        """Draw the map of the first two parameters: share of stable runs, least damping.

        With one parameter of numbers, the damping over it.
        """
        from interarea.cosim.maps.page import first_figure

        return first_figure(read_plan(self.folder).sweep, self.to_frame())

    def maps(
        self,
        file: str | Path | None = None,
        *,
        worst: int = 6,
        workers: int | None = None,
        progress: Callable[[str, float], object] | None = None,
    ) -> Path:
        """Write the page of all maps, margins and worst runs; default ``maps.html`` in the folder.

        workers : processes that search margins; default one for each core. progress : called with the current
        step and its completed share; without it a notebook shows bars.
        """
        from interarea.cosim.maps.page import STEPS, write_maps

        page = Path(file or self.folder / "maps.html")
        with notebook_bars(STEPS) as report:
            own_report = progress or report
            return write_maps(self.folder, page, worst=worst, workers=workers, progress=own_report)

    def __repr__(self) -> str:
        counts = self.summary
        return f"SweepResults({str(self.folder)!r}: {counts['runs']} runs, {counts['stable']} stable)"

    def _repr_html_(self) -> str:
        counts = self.summary
        title = f"{self.folder}: {counts['runs']} runs, {counts['stable']} stable, {counts['failed']} failed"
        return _html(title, self.to_frame())
