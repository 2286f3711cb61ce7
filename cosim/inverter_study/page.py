"""The page of the study `inverters`: conclusions, a map of the swings by share, curves and the table."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from interarea.models.files import write_whole

from ..grid_study.page import study_environment
from ..plots.curves import DASHES, MUTED, SERIES, STYLE, WIDTH
from ..plots.html import page_figure
from .replaced import KINDS


def write_inverter_page(study: Mapping[str, Any], path: Path) -> Path:
    """Write the page of what `study` holds so far."""
    environment = study_environment(Path(__file__).parent)
    figures = {
        grid["grid"]: page_figure(_figure(grid), f"inverters-{k}", f"Inverters by share, {grid['grid']}")
        for k, grid in enumerate(study["grids"])
        if any(row["swings"] for row in grid["rows"])
    }
    text = environment.get_template("inverters.html.j2").render(study=study, figures=figures)
    return write_whole(path, text.encode("utf-8"))


def _figure(grid: Mapping[str, Any]) -> Figure:
    """Draw a map of all swings for each kind, then damping and clearing times over the share."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 6.2), layout="constrained")
        axes = figure.subplots(2, 2)
        for k, kind in enumerate(KINDS):
            rows = [row for row in grid["rows"] if row["kind"] == kind]
            _map(axes[0, k], rows)
            axes[0, k].set_title(kind)
            _curves(axes[1, 0], rows, "inter_area_damping", kind, k, DASHES[0])
            _curves(axes[1, 0], rows, "controlled_damping", f"{kind}, controller", k, DASHES[1])
            _curves(axes[1, 1], rows, "clearing_cycles", kind, k, DASHES[0])
            _curves(axes[1, 1], rows, "clearing_controlled", f"{kind}, controller", k, DASHES[1])
        axes[1, 0].set_ylabel("inter-area damping ratio")
        axes[1, 1].set_ylabel("longest fault (cycles)")
        axes[1, 1].set_ylim(bottom=0.0)
        for place in axes[1]:
            place.set_xlabel("share of inverters (%)")
        axes[1, 0].legend(fontsize="small")
    return figure


def _map(place: Axes, rows: list[Mapping[str, Any]]) -> None:
    """Draw frequency and damping of every swing, larger marks for larger shares."""
    for row in rows:
        x = [damping for _, _, damping in row["swings"]]
        y = [hz for _, hz, _ in row["swings"]]
        colour = SERIES[0] if row["share"] else MUTED
        place.plot(x, y, "o", color=colour, markersize=2.0 + 5.0 * row["share"], alpha=0.6)
    place.axvline(0.0, color=MUTED, linewidth=0.8)
    place.set_xlabel("damping ratio")
    place.set_ylabel("frequency (Hz)")


def _curves(place: Axes, rows: list[Mapping[str, Any]], key: str, label: str, k: int, dashes: Any) -> None:
    """Draw one number over the share, in per cent, where it is known."""
    known = [row for row in rows if row[key] is not None]
    if known:
        x, y = [100.0 * row["share"] for row in known], [row[key] for row in known]
        place.plot(x, y, "o", color=SERIES[k], linestyle=dashes, markersize=3, label=label)
