"""Which figure of chapter 5 is drawn from what: number or name -> figure."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
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
from interarea.models.case.case import Case
from interarea.models.grid.powerflow import PowerFlow

from ..plots.curves import (
    bode_plot,
    hankel_plot,
    latency_damping_plot,
    latency_panels,
    magnitude_plot,
    mode_shape_plot,
    participation_plot,
    save_figure,
    singular_value_plot,
    time_plot,
)
from ..plots.diagrams import generalised_plant_diagram, one_line_diagram
from .runs import WIRINGS, StudyRun

Array = npt.NDArray[np.float64]
DW24 = {"dw24": {"G2_dw": 1.0, "G4_dw": -1.0}}
MICRO: Any = {"scale": 1e6, "ylabel": r"$\Delta\omega_{24}$ ($10^{-6}$ pu)"}
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


def save_figures(parts: StudyParts, folder: Path, progress: Callable[[float], None]) -> dict[str, Path]:
    """Draw every figure into `folder` as SVG that is not there yet; return number or name -> file."""
    recipes = dict(_recipes(parts))
    files = {}
    for k, (key, draw) in enumerate(recipes.items()):
        prefix = "figure-" if key[0].isdigit() else ""
        path = folder / f"{prefix}{key.replace('.', '-')}.svg"
        files[key] = path if path.exists() else save_figure(draw(), path, transparent=True)
        progress((k + 1) / len(recipes))
    return files


def _recipes(p: StudyParts) -> Iterator[tuple[str, Callable[[], Figure]]]:
    positions = {int(bus): place for bus, place in p.spec.get("diagram", {}).items()}
    if set(positions) >= {bus.number for bus in p.case.buses}:
        yield "5.1", lambda: one_line_diagram(p.flow, positions)
    machines = [m.name for m in p.case.machines]
    numbers = zip(("5.2", "5.3", "5.4"), ("5.5", "5.6", "5.7"), p.modes.items(), strict=False)
    for first, second, (name, mode) in numbers:
        title = f"{name}: {mode.frequency_hz:.3f} Hz, ζ = {mode.damping_ratio:.3f}"
        yield first, partial(participation_plot, mode.participation, machines)
        yield second, partial(mode_shape_plot, mode.shape, p.case.areas, title)
    yield "5.8", lambda: singular_value_plot(_against(p, "6", True), OMEGA)
    yield "5.17", generalised_plant_diagram
    yield "5.19", lambda: singular_value_plot(_against(p, "8", False), OMEGA)
    yield (
        "hankel",
        lambda: hankel_plot(
            {f"plant of order {k}": r.hankel_values for k, r in p.reductions.items()},
            {f"plant of order {k}": r.order for k, r in p.reductions.items()},
        ),
    )
    for number, name in (("5.9", "wdc"), ("5.20", "cc"), ("5.22", "ftc")):
        yield number, partial(bode_plot, _orders(p, name), OMEGA)
    yield from _sensitivities(p)
    yield from _time_figures(p)
    yield (
        "delay",
        lambda: latency_damping_plot(
            {label: p.delay[key]["damping"] for key, label in WIRINGS.items()},
            {label: measured_damping(p, label) for label in WIRINGS.values()},
            {label: p.delay[key]["margin_s"] for key, label in WIRINGS.items()},
        ),
    )


def _against(p: StudyParts, order: str, difference: bool) -> dict[str, control.StateSpace]:
    """Return the full plant as that reduction saw it, and the reduction."""
    reduced = p.reductions[order].system
    outputs = DW24 if difference else [p.spec["remote"], p.spec["local"]]
    full = select(p.plant, list(reduced.input_labels), outputs)
    return {f"full, {full.nstates} states": full, f"reduced, {reduced.nstates} states": reduced}


def _orders(p: StudyParts, name: str) -> dict[str, control.StateSpace]:
    shipped, full = p.controllers[name].system, p.full_controllers.get(name)
    systems = {} if full is None else {f"designed, order {full.nstates}": full}
    return systems | {f"shipped, order {shipped.nstates}": shipped}


def loop_functions(p: StudyParts, name: str = "wdc") -> tuple[Array, Array]:
    """Return |S| and |KS| of the dw24 loop over `OMEGA`: S = 1/(1 - G K), u = +K dw24.

    Only for a controller that acts on the difference alone: K of the remote signal.
    """
    K = p.controllers[name].system
    G = select(p.plant, list(K.output_labels), DW24)
    remote = list(K.input_labels).index(p.spec["remote"])
    k = response(K, OMEGA)[:, 0, remote]
    s = 1.0 / (1.0 - response(G, OMEGA)[:, 0, 0] * k)
    return np.abs(s), np.abs(k * s)


def _sensitivities(p: StudyParts) -> Iterator[tuple[str, Callable[[], Figure]]]:
    def draw(which: int, label: str, weight: Array) -> Figure:
        curves = {label: loop_functions(p)[which], "1 / weight": 1.0 / weight}
        return magnitude_plot(curves, OMEGA, f"|{label}| (dB)")

    jw = 1j * OMEGA
    yield "5.11", lambda: draw(0, "S", np.abs(30.0 / (jw + 30.0)))
    yield "5.12", lambda: draw(1, "KS", np.abs(10.0 * jw / (jw + 100.0)))


def dw24(p: StudyParts, run: str) -> tuple[Array, Array]:
    """Return time (s) and dw24 = dw2 - dw4 (pu) of a run."""
    curves = p.runs[run].curves
    return curves.time_s, curves[f"plant.{p.spec['remote']}"] - curves[f"plant.{p.spec['local']}"]


def _time_figures(p: StudyParts) -> Iterator[tuple[str, Callable[[], Figure]]]:
    def compare(names: Mapping[str, str], **kwargs: Any) -> Callable[[], Figure]:
        return lambda: time_plot({label: dw24(p, run) for label, run in names.items()}, **kwargs)

    yield "5.10", compare({"without WDC": "none-pulse", "with WDC": "wdc-pulse"})
    for number, wiring in (("5.13", "synchronous"), ("5.14", "non-synchronous")):
        names = {
            f"{round(1e3 * v)} ms": f"wdc-{wiring}-{round(1e3 * v)}ms" for v in p.spec["latency"]["values_s"]
        }
        yield number, partial(_panels, p, names)
    for number, wiring in (("5.15", "synchronous"), ("5.16", "non-synchronous")):
        yield number, compare({"without WDC": "none-pulse", f"{wiring}, 100 ms": f"wdc-{wiring}-100ms"})
    lost = {"remote lost": 10.0}
    for number, name in (("5.21", "cc"), ("5.23", "ftc")):
        yield (
            number,
            compare({"normal": f"{name}-pulse", "remote lost at 10 s": f"{name}-lost-10s"}, marks=lost),
        )
    yield (
        "5.24",
        compare(
            {"normal": "ftc-pulse", "remote lost at 10 s": "ftc-lost-10s"},
            marks=lost,
            span_s=(9.0, 15.0),
            **MICRO,
        ),
    )
    yield "5.25", compare({"CC": "cc-pulse", "FTC": "ftc-pulse"})
    yield "5.26", compare({"CC": "cc-lost-1s", "FTC": "ftc-lost-1s"}, marks={"remote lost": 1.0})
    yield (
        "fault",
        compare({n.upper() if n != "none" else n: f"{n}-fault" for n in ("none", "wdc", "cc", "ftc")}),
    )
    yield "fault-lost", compare({"CC": "cc-fault-lost", "FTC": "ftc-fault-lost"}, marks={"remote lost": 1.5})
    yield (
        "control",
        lambda: time_plot(
            {n.upper(): _control(p, f"{n}-fault") for n in ("wdc", "cc", "ftc")},
            ylabel="control of G4 (pu)",
            scale=1.0,
        ),
    )


def _panels(p: StudyParts, names: Mapping[str, str]) -> Figure:
    curves = {label: dw24(p, run) for label, run in names.items()}
    return latency_panels(curves, ("no latency", dw24(p, "wdc-pulse")))


def _control(p: StudyParts, run: str) -> tuple[Array, Array]:
    curves = p.runs[run].curves
    actuator = p.controllers[str(p.runs[run].document["controller"])].outputs[0]
    return curves.time_s, curves[f"controller.{actuator}"]


def measured_damping(p: StudyParts, wiring: str) -> list[list[float]]:
    """Return rows (latency, damping ratio of what swings longest) of the co-simulated runs."""
    rows = []
    for value in p.spec["latency"]["values_s"]:
        run = p.runs[f"{p.spec['latency']['controller']}-{wiring}-{round(1e3 * value)}ms"]
        if run.metrics["late_damping"] is not None:
            rows.append([value, run.metrics["late_damping"]])
    return rows
