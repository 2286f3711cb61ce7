"""Several controllers on one scenario: the same run with each, and where latency takes the roots."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from interarea.design.controllers.bank import ControllerBank
from interarea.design.controllers.controller import Controller
from interarea.design.delay.loop_modes import LoopModes
from interarea.design.modes.modes import damping_ratio
from interarea.models.case.case import Case
from interarea.models.errors import Collected
from interarea.models.files import write_whole

from ..errors import ScenarioError
from ..plots.curves import DASHES, INK, SERIES, STYLE, new_figure
from ..plots.html import page_environment, page_figure
from ..results.record import record_of, scenario_text
from ..results.run import Run
from ..scenario.scenario import Scenario
from .controllers import ControllerLike
from .linear_loop import linear_swings
from .run import system_of
from .system import System

#: common latency of all channels over which roots are followed, s
LATENCIES_S = tuple(float(x) for x in np.round(np.linspace(0.0, 0.4, 17), 6))


@dataclass(frozen=True)
class Compared:
    """One controller of a comparison: its run, and the swings of its loop by common latency of the channels.

    locus : latency, s -> roots of the linear loop (`LoopModes`), or why they are not known.
    """

    name: str
    run: Run
    locus: Mapping[float, LoopModes | str]

    def row(self) -> dict[str, Any]:
        """Return the numbers of the table, by name; None for what the run does not have."""
        m = self.run.metrics
        return {
            "controller": self.name,
            "stable": self.run.stable,
            "verdict": self.run.verdict.name,
            "least_damping_ratio": m.least_damping_ratio,
            "least_frequency_hz": m.least_frequency_hz,
            "least_mode": m.least_mode,
            "inter_area_damping_ratio": m.damping_ratio.get("inter-area"),
            "inter_area_frequency_hz": m.frequency_hz.get("inter-area"),
            "settling_time_s": m.settling_time_s,
            "peak_pu": m.peak_pu,
            "effort_pu2s": m.effort_pu2s,
        }

    def roots(self) -> list[dict[str, Any]]:
        """Return the locus as rows: latency, damping ratio and frequency of each root."""
        return [
            {
                "latency_s": latency_s,
                "real_per_s": z.real,
                "frequency_hz": z.imag / (2.0 * np.pi),
                "damping_ratio": damping_ratio(z),
            }
            for latency_s, result in self.locus.items()
            if isinstance(result, LoopModes)
            for z in sorted({complex(r.real, abs(r.imag)) for r in result.roots}, key=damping_ratio)
        ]


def compared_name(controller: ControllerLike) -> str:
    """Return what a controller is called in a comparison: its own name, or that of its file."""
    if isinstance(controller, str | Path):
        return Path(controller).stem if Path(controller).suffix else str(controller)
    if isinstance(controller, Controller | ControllerBank):
        return controller.name
    return Controller.of(controller).name


def folder_from(scenario: Scenario, controller: ControllerLike) -> Path:
    """Return the folder from which a controller's file is named: where one stands, or the scenario's."""
    exists = not isinstance(controller, str | Path) or Path(controller).exists()
    return Path() if exists else scenario.folder


def compare_controllers(
    scenario: Scenario,
    controllers: Sequence[ControllerLike],
    *,
    case: Case | None = None,
    cache: Path,
    progress: Callable[[str, float], object] = lambda name, done: None,
) -> list[Compared]:
    """Run a scenario with each controller (as `controller_of` takes it) and follow the roots of its loop.

    case : in place of the one that the scenario names.
    progress : called with the controller and the share that is done, 0 to 1.

    Raises
    ------
    ScenarioError : all that is wrong with scenario and controllers, a line each; a controller given twice.
    """
    if not controllers:
        raise ScenarioError("compare: no controller given, allowed: one or more, also 'none'")
    names = [compared_name(c) for c in controllers]
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise ScenarioError(f"compare: {' and '.join(twice)} given twice, allowed: each controller once")
    if not scenario.case:
        raise ScenarioError(f"{scenario.name}: case is missing; controllers are compared on one case")
    systems: dict[str, System] = {}
    wrong = Collected()
    for name, provided in zip(names, controllers, strict=True):
        with wrong:
            systems[name] = _system_with(scenario, name, provided, case or scenario.load_case(), cache)
    wrong.end(ScenarioError)
    rows = []
    for name, system in systems.items():
        run = system.warned().run(progress=lambda now, end, name=name: progress(name, 0.5 * now / end))  # type: ignore[misc]
        assert isinstance(run, Run)
        locus: dict[float, LoopModes | str] = {}
        for k, latency_s in enumerate(LATENCIES_S if scenario.channels else (), start=1):
            locus[latency_s] = _swings_at(system, latency_s)
            progress(name, 0.5 + 0.5 * k / len(LATENCIES_S))
        progress(name, 1.0)
        rows.append(Compared(name, run, locus))
    return rows


def _system_with(
    scenario: Scenario, name: str, controller: ControllerLike, case: Case, cache: Path
) -> System:
    """Return the system of a scenario with another controller; results tell its name."""
    if isinstance(controller, str | Path):
        folder = folder_from(scenario, controller)
        one = scenario.model_copy(update={"controller": str(controller), "folder": folder})
        return system_of(one, cache=cache, case=case)
    system = system_of(scenario, cache=cache, case=case, controller=controller)
    system.scenario = scenario.model_copy(update={"controller": name})
    return system


def _swings_at(system: System, latency_s: float) -> LoopModes | str:
    """Return the swings of a system with all of its channels that late."""
    assert system.scenario is not None
    late = {n: c.model_copy(update={"latency_s": latency_s}) for n, c in system.scenario.channels.items()}
    scenario = system.scenario.model_copy(update={"channels": late})
    return linear_swings(replace(system.linear_loop(), scenario=scenario))


def curves_figure(compared: Sequence[Compared]) -> Figure:
    """Draw the swing that runs are judged by with each controller, and what the controllers put out."""
    figure, axes = new_figure(2, 1, height=3.8, sharex=True)
    with mpl.rc_context(STYLE):
        for k, one in enumerate(compared):
            look: Any = {"color": SERIES[k % len(SERIES)], "linestyle": DASHES[k % len(DASHES)]}
            curves = one.run.trajectory
            axes[0].plot(curves.time_s, 1e3 * one.run.swing.of(curves), label=one.name, **look)
            for control in curves.reals_of("controller"):
                label = f"{one.name}: {control.partition('.')[2]}"
                axes[1].plot(curves.time_s, curves[control], label=label, **look)
        axes[0].set_ylabel(f"{compared[0].run.swing.name}\n(10⁻³ pu)")
        axes[1].set_ylabel("control (pu)")
        axes[1].set_xlabel("time (s)")
        axes[0].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=7)
    return figure


def damping_figure(compared: Sequence[Compared]) -> Figure:
    """Draw the least damping ratio of everything that swings over the common latency of the channels."""
    figure, axis = new_figure(height=2.6)
    with mpl.rc_context(STYLE):
        for k, one in enumerate(compared):
            least = [
                (1e3 * latency_s, damping_ratio(m.least))
                for latency_s, m in one.locus.items()
                if isinstance(m, LoopModes) and m.least is not None
            ]
            if least:
                x, y = zip(*least, strict=True)
                axis.plot(
                    x, y, color=SERIES[k % len(SERIES)], linestyle=DASHES[k % len(DASHES)], label=one.name
                )
        axis.axhline(0.0, color=INK, linewidth=0.6)
        axis.set_xlabel("latency of every channel (ms)")
        axis.set_ylabel("least damping ratio")
        axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=7)
    return figure


def locus_figure(compared: Sequence[Compared]) -> Figure:
    """Draw the roots of each loop in the complex plane, from no latency (large dots) to the most (small)."""
    figure, axis = new_figure(height=3.6)
    with mpl.rc_context(STYLE):
        for k, one in enumerate(compared):
            rows = one.roots()
            if rows:
                size = [22.0 - 20.0 * r["latency_s"] / LATENCIES_S[-1] for r in rows]
                axis.scatter(
                    [r["real_per_s"] for r in rows],
                    [r["frequency_hz"] for r in rows],
                    s=size,
                    color=SERIES[k % len(SERIES)],
                    label=one.name,
                )
        axis.axvline(0.0, color=INK, linewidth=0.6)
        axis.set_xlabel("real part (1/s)")
        axis.set_ylabel("frequency (Hz)")
        axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=7)
    return figure


def write_comparison(compared: Sequence[Compared], scenario: Scenario, path: Path, command: str) -> Path:
    """Write the page of a comparison; `command`: what makes it again."""
    known = any(isinstance(m, LoopModes) for one in compared for m in one.locus.values())
    why = next((m for one in compared for m in one.locus.values() if isinstance(m, str)), "")
    text = (
        page_environment(Path(__file__).parent)
        .get_template("compare.html.j2")
        .render(
            title=scenario.title or scenario.name,
            case=compared[0].run.case,
            compared=compared,
            rows=[one.row() for one in compared],
            curves=page_figure(curves_figure(compared), "curves"),
            damping=page_figure(damping_figure(compared), "damping") if known else "",
            locus=page_figure(locus_figure(compared), "locus") if known else "",
            why=why if scenario.channels else "the scenario has no channels whose latency could vary",
            latest_ms=1e3 * LATENCIES_S[-1],
            command=command,
            record=record_of(scenario, compared[0].run.case),
            scenario=scenario_text(scenario),
        )
    )
    return write_whole(path, text)
