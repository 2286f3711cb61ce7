"""The page of the study `actuators`: conclusions, figures of damping and faults over latency, the table."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from interarea.models.files import write_whole

from ..grid_study.page import study_environment
from ..plots.curves import DASHES, MUTED, SERIES, STYLE, WIDTH
from ..plots.html import page_figure
from .installed import KINDS

OWN_AT = -40  #: on the axis of latencies, ms: where the own-signal controller, which is never late, is drawn


def write_actuator_page(study: Mapping[str, Any], path: Path) -> Path:
    """Write the page of what `study` holds so far."""
    environment = study_environment(Path(__file__).parent)
    figure = page_figure(_figure(study), "actuators", "Actuators over latency") if study["cells"] else ""
    text = environment.get_template("actuators.html.j2").render(study=study, figure=figure, kinds=KINDS)
    return write_whole(path, text.encode("utf-8"))


def _figure(study: Mapping[str, Any]) -> Figure:
    """Draw damping and survived faults over the latency of remote signals, a curve for each kind."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 3.4), layout="constrained")
        left, right = figure.subplots(1, 2)
        for k, one in enumerate(study["actuators"]):
            rows = [row for row in study["cells"] if row["kind"] == one["kind"]]
            _draw(left, right, rows, one["name"], k)
        left.axhline(study["mode"]["damping_ratio"], color=MUTED, linewidth=0.8)
        right.axhline(study["survived_without"], color=MUTED, linewidth=0.8)
        left.set_ylim(bottom=0.0)
        left.set_ylabel("inter-area damping ratio")
        right.set_ylabel("stable faults, worst signal lost")
        right.set_ylim(0, len(study["faults"]) * len(study["clear_ms"]) + 0.5)
        right.yaxis.set_major_locator(MaxNLocator(integer=True))
        for axes in (left, right):
            axes.set_xlabel("latency of remote signals (ms)")
            axes.set_xticks([OWN_AT, 0, 100, 200, 300], ["own", "0", "100", "200", "300"])
            axes.set_xlim(2 * OWN_AT, 320)
        figure.legend(loc="outside upper left", ncols=5, fontsize="small")
    return figure


def _draw(left: Axes, right: Axes, rows: list[Mapping[str, Any]], name: str, k: int) -> None:
    """Draw one kind; its own-signal controller is a mark left of latency 0."""
    colour = SERIES[k % len(SERIES)]
    remote = [row for row in rows if row["signals"] == "remote"]
    x = [row["latency_ms"] for row in remote]
    damping = [min(row["there"], row["late"]) for row in remote]
    style: dict[str, Any] = {"color": colour, "linestyle": DASHES[k % len(DASHES)], "markersize": 3}
    left.plot(x, damping, "o", label=name, **style)
    survived = [row["survived"] if row["survived_lost"] is None else row["survived_lost"] for row in remote]
    right.plot(x, survived, "o", **style)
    for row in (row for row in rows if row["signals"] == "own"):
        left.plot([OWN_AT], [min(row["there"], row["late"])], "s", color=colour, markersize=5)
        right.plot([OWN_AT], [row["survived"]], "s", color=colour, markersize=5)
