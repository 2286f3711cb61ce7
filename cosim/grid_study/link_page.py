"""Page of the study `worth`: the value of a link for each grid, as a sentence, a figure and a table."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from interarea.models.files import write_whole

from ..plots.curves import DASHES, MUTED, SERIES, STYLE, WIDTH
from ..plots.html import page_figure
from .link_worth import OWN, SIGNALS
from .page import study_environment


def write_link_page(study: Mapping[str, Any], path: Path) -> Path:
    """Write the page of the present results in `study`."""
    environment = study_environment(Path(__file__).parent)
    figures = {
        grid["grid"]: page_figure(_figure(grid), f"worth-{k}", f"Worth of links, {grid['grid']}")
        for k, grid in enumerate(study["grids"])
        if any(one["rows"] for one in grid["sets"])
    }
    text = environment.get_template("link_worth.html.j2").render(study=study, figures=figures)
    return write_whole(path, text.encode("utf-8"))


def _figure(grid: Mapping[str, Any]) -> Figure:
    """Draw what each set reaches over the latency, an axis for each set, a curve for each kind of signals."""
    sets = [one for one in grid["sets"] if one["rows"]]
    last = max(row["latency_ms"] for one in sets for row in one["rows"])
    high = (len(sets) + 1) // 2
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 2.9 * high), layout="constrained")
        axes = figure.subplots(high, min(len(sets), 2), squeeze=False, sharey=True)
        for place, one in zip(axes.flat, sets, strict=False):
            _draw(place, one, last)
            place.axhline(grid["mode"]["damping_ratio"], color=MUTED, linewidth=0.8)
        for place in axes.flat[len(sets) :]:
            place.remove()
        axes[0, 0].set_ylim(bottom=0.0)
        axes[0, 0].set_ylabel("inter-area damping ratio")
        axes[0, 0].legend(fontsize="small")
    return figure


def _draw(place: Axes, one: Mapping[str, Any], last: int) -> None:
    """Draw one set of loops; the own signal alone is a line over all latencies to `last`, ms."""
    for k, signals in enumerate(SIGNALS):
        rows = [row for row in one["rows"] if row["signals"] == signals]
        x = [row["latency_ms"] for row in rows]
        y = [min(row["there"], row["late"]) for row in rows]
        if signals == OWN:
            x, y = [*x, *(last for _ in x)], [*y, *y]
        marker = "" if signals == OWN else "o"
        place.plot(x, y, marker, color=SERIES[k], linestyle=DASHES[k], markersize=3, label=signals)
    place.set_title(", ".join(one["actuators"]))
    place.set_xlabel("latency of other machines' signals (ms)")
