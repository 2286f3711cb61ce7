"""The figures that a study asks for, by kind: key -> figure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache as once
from functools import partial
from pathlib import Path
from typing import Any

import control
import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from interarea.design.controllers.controller import Controller
from interarea.design.linear.linearise import select
from interarea.design.linear.norms import response
from interarea.design.modes.modes import Modes
from interarea.design.reduction.balanced import Reduction
from interarea.design.synthesis.study_designs import WdcSpec
from interarea.fmu_build.write.cache import artefact
from interarea.models.case.case import Case
from interarea.models.grid.powerflow import PowerFlow

from ..plots.curves import (
    bode_plot,
    difference_label,
    hankel_plot,
    latency_damping_plot,
    latency_panels,
    magnitude_plot,
    save_figure,
    singular_value_plot,
    time_plot,
)
from ..plots.diagrams import generalised_plant_diagram, one_line_diagram
from ..plots.html import page_figure
from ..plots.mode_shapes import mode_shape_plot, participation_plot
from .runs import WIRINGS, StudyRun
from .tables import latency_name

Array = npt.NDArray[np.float64]
#: frequencies of the design figures, rad/s
OMEGA: Array = np.logspace(-1.0, 2.0, 400)


@dataclass(frozen=True)
class StudyParts:
    """What a study found out before it writes: the numbers behind table, figure and report.

    plant : full plant without reference angle, speeds in rad/s. reductions : order -> reduced plant.
    controllers, full_controllers : as shipped, and before their order was reduced.
    delay : wiring -> {"margin_s", "damping", "inter_area"} as in study.json.
    """

    spec: Mapping[str, Any]
    case: Case
    flow: PowerFlow
    modes: Modes
    plant: control.StateSpace
    reductions: Mapping[str, Reduction]
    controllers: Mapping[str, Controller]
    full_controllers: Mapping[str, control.StateSpace]
    delay: Mapping[str, Mapping[str, Any]]
    runs: Mapping[str, StudyRun]

    @property
    def difference(self) -> dict[str, dict[str, float]]:
        """The remote less the local signal under the study's name for it, as `select` takes it."""
        return difference_of(self.spec)


def difference_of(spec: Mapping[str, Any]) -> dict[str, dict[str, float]]:
    """Return the remote less the local signal under the study's name for it, as `select` takes it."""
    return {spec["swing"]: {spec["remote"]: 1.0, spec["local"]: -1.0}}


def save_figures(
    parts: StudyParts, cache: Path, kind: str, progress: Callable[[float], None]
) -> dict[str, Path]:
    """Draw every figure that is not in the cache yet, below `kind` there; return key -> SVG.

    Beside each lies what a page shows of it (`page_figure`), with the suffix ``.html``.
    """
    files = {}
    rows = [row for row in parts.spec["figure"] if can_be_drawn(row, parts)]
    for k, row in enumerate(rows):
        key = row["key"]
        name = f"{'figure-' if key[0].isdigit() else ''}{key.replace('.', '-')}"
        drawn = once(partial(_draw, row, parts))
        files[key] = artefact(cache, kind, name, ".svg", partial(_save, drawn))
        artefact(cache, kind, name, ".html", partial(_save_for_page, drawn, row))
        progress((k + 1) / len(rows))
    return files


def _save(drawn: Callable[[], Figure], path: Path) -> None:
    save_figure(drawn(), path, transparent=True)


def _save_for_page(drawn: Callable[[], Figure], row: Mapping[str, Any], path: Path) -> None:
    path.write_text(page_figure(drawn(), row["key"], row["title"]), encoding="utf-8")


def data_of(row: Mapping[str, Any], spec: Mapping[str, Any]) -> list[str]:
    """Return the files of a study's folder that hold the numbers of a figure."""
    if row["kind"] in _DRAWN:
        return ["study.json"]
    if row["kind"] != "latencies":
        runs = list(row["runs"].values())
    else:
        name, latencies = spec["latency"]["controller"], spec["latency"]["values_s"]
        runs = [row["reference"], *(latency_name(name, row["wiring"], v) for v in latencies)]
    return [f"results/{run}.parquet" for run in dict.fromkeys(runs)]


def can_be_drawn(row: Mapping[str, Any], p: StudyParts) -> bool:
    """Return whether there is what a figure shows: places of every bus, the mode it names."""
    if row["kind"] == "one_line":
        return {int(bus) for bus in p.spec.get("diagram", {})} >= {bus.number for bus in p.case.buses}
    return "mode" not in row or row["mode"] in p.modes


def _draw(row: Mapping[str, Any], p: StudyParts) -> Figure:
    """Draw one figure of the specification (`tables.Figure`)."""
    return _DRAWN.get(row["kind"], _time_figure)(row, p)


def _one_line(_: Mapping[str, Any], p: StudyParts) -> Figure:
    return one_line_diagram(p.flow, {int(bus): place for bus, place in p.spec["diagram"].items()})


def _participation(row: Mapping[str, Any], p: StudyParts) -> Figure:
    machines = [m.name for m in p.case.machines]
    return participation_plot(p.modes[row["mode"]].participation, machines)


def _mode_shape(row: Mapping[str, Any], p: StudyParts) -> Figure:
    mode = p.modes[row["mode"]]
    title = f"{row['mode']}: {mode.frequency_hz:.3f} Hz, ζ = {mode.damping_ratio:.3f}"
    return mode_shape_plot(mode.shape, p.case.areas, title)


def _hankel_values(_: Mapping[str, Any], p: StudyParts) -> Figure:
    names = {f"plant of order {k}": r for k, r in p.reductions.items()}
    return hankel_plot(
        {name: r.hankel_values for name, r in names.items()},
        {name: r.order for name, r in names.items()},
    )


def _latency_damping(_: Mapping[str, Any], p: StudyParts) -> Figure:
    return latency_damping_plot(
        {label: p.delay[key]["damping"] for key, label in WIRINGS.items()},
        {label: measured_damping(p, label) for label in WIRINGS.values()},
        {label: p.delay[key]["margin_s"] for key, label in WIRINGS.items()},
    )


def _time_figure(row: Mapping[str, Any], p: StudyParts) -> Figure:
    """Draw a figure over time."""
    label = difference_label(p.spec["swing"])
    if row["kind"] == "latencies":
        name, latency = p.spec["latency"]["controller"], p.spec["latency"]["values_s"]
        runs = {f"{round(1e3 * v)} ms": latency_name(name, row["wiring"], v) for v in latency}
        curves = {text: swing_of(p, run) for text, run in runs.items()}
        return latency_panels(curves, ("no latency", swing_of(p, row["reference"])), label)
    if row["kind"] == "control":
        shown = {text: _control(p, run) for text, run in row["runs"].items()}
        actuators = sorted({c.outputs[0].removesuffix("_vs") for c in p.controllers.values()})
        return time_plot(shown, ylabel=f"control of {', '.join(actuators)} (pu)", scale=1.0)
    curves = {text: swing_of(p, run) for text, run in row["runs"].items()}
    requested: dict[str, Any] = {key: row[key] for key in ("marks", "span_s") if key in row}
    if row.get("micro"):
        requested |= {"scale": 1e6, "ylabel": difference_label(p.spec["swing"], 6)}
    return time_plot(curves, **{"ylabel": label, **requested})


def _against(p: StudyParts, order: str) -> dict[str, control.StateSpace]:
    """Return the full plant as that reduction saw it, and the reduction."""
    reduced = p.reductions[order].system
    signals = [p.spec["remote"], p.spec["local"]]
    outputs = p.difference if p.spec["reduction"][order] == "difference" else signals
    full = select(p.plant, list(reduced.input_labels), outputs)
    return {f"full, {full.nstates} states": full, f"reduced, {reduced.nstates} states": reduced}


def _orders(p: StudyParts, name: str) -> dict[str, control.StateSpace]:
    shipped, full = p.controllers[name].system, p.full_controllers.get(name)
    systems = {} if full is None else {f"designed, order {full.nstates}": full}
    return systems | {f"shipped, order {shipped.nstates}": shipped}


def loop_functions(p: StudyParts) -> tuple[Array, Array]:
    """Return |S| and |KS| over `OMEGA` of the loop of the difference: S = 1/(1 - G K), u = +K difference.

    Of the study's `sensitivity` controller, which acts on the difference alone: K of the remote signal.
    """
    K = p.controllers[p.spec["sensitivity"]].system
    G = select(p.plant, list(K.output_labels), p.difference)
    remote = list(K.input_labels).index(p.spec["remote"])
    k = response(K, OMEGA)[:, 0, remote]
    s = 1.0 / (1.0 - response(G, OMEGA)[:, 0, 0] * k)
    return np.abs(s), np.abs(k * s)


def weight_gains(p: StudyParts) -> tuple[Array, Array]:
    """Return |W1| and |W2| over `OMEGA`, those that this controller was designed with."""
    requested = p.controllers[p.spec["sensitivity"]].design["specification"]
    weights = WdcSpec(low_pass=requested["low_pass"], high_pass=tuple(requested["high_pass"])).weights()
    low, high = (np.abs(response(W, OMEGA)[:, 0, 0]) for W in weights)
    return low, high


def _sensitivity(p: StudyParts, function: str) -> Figure:
    which = 0 if function == "S" else 1
    curves = {function: loop_functions(p)[which], "1 / weight": 1.0 / weight_gains(p)[which]}
    return magnitude_plot(curves, OMEGA, f"|{function}| (dB)")


def swing_of(p: StudyParts, run: str) -> tuple[Array, Array]:
    """Return time (s) and the remote less the local speed (pu) of a run."""
    curves = p.runs[run].curves
    return curves.time_s, curves[f"plant.{p.spec['remote']}"] - curves[f"plant.{p.spec['local']}"]


def _control(p: StudyParts, run: str) -> tuple[Array, Array]:
    curves = p.runs[run].curves
    actuator = p.controllers[str(p.runs[run].document["controller"])].outputs[0]
    return curves.time_s, curves[f"controller.{actuator}"]


def measured_damping(p: StudyParts, wiring: str) -> list[list[float]]:
    """Return rows (latency, damping ratio of what swings longest) of the co-simulated runs."""
    rows = []
    for value in p.spec["latency"]["values_s"]:
        run = p.runs[latency_name(p.spec["latency"]["controller"], wiring, value)]
        if run.metrics["late_damping"] is not None:
            rows.append([value, run.metrics["late_damping"]])
    return rows


#: kind of a figure -> what draws it; all others are over time
_DRAWN: dict[str, Callable[[Mapping[str, Any], StudyParts], Figure]] = {
    "one_line": _one_line,
    "participation": _participation,
    "mode_shape": _mode_shape,
    "singular_values": lambda row, p: singular_value_plot(_against(p, row["reduction"]), OMEGA),
    "hankel_values": _hankel_values,
    "generalised_plant": lambda row, p: generalised_plant_diagram(),
    "bode": lambda row, p: bode_plot(_orders(p, row["controller"]), OMEGA),
    "sensitivity": lambda row, p: _sensitivity(p, row["function"]),
    "latency_damping": _latency_damping,
}
