"""Pages of the house: figures inside HTML, one style, values under the pointer."""

from __future__ import annotations

import html
import json
import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from markupsafe import Markup, escape
from matplotlib.axes import Axes
from matplotlib.container import BarContainer
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from interarea.models.files import temporary_folder

from .curves import GRID, INK, MUTED, SERIES, save_figure

THEME = {INK: "var(--ink)", MUTED: "var(--muted)", GRID: "var(--grid)"} | {
    colour: f"var(--s{k})" for k, colour in enumerate(SERIES)
}


def inline_svg(
    path: Path, key: str, title: str | None = None, *, links: Mapping[str, str] | None = None
) -> str:
    """Return an SVG file as an element for a page: ids unique by `key`, colours of the theme.

    title : what a screen reader says of it; default the key.
    links : address in it -> what it opens, which is shown and read there.
    """
    text = path.read_text(encoding="utf-8")
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    prefix = "f" + re.sub(r"\W", "-", key) + "-"
    text = re.sub(r'\bid="', f'id="{prefix}', text)
    text = re.sub(r"url\(#", f"url(#{prefix}", text)
    text = re.sub(r'href="#', f'href="#{prefix}', text)
    for address, words in (links or {}).items():
        there = re.escape(str(escape(address)))
        label = f'<a href="{escape(address)}" aria-label="{escape(words)}"><title>{escape(words)}</title>'
        text = re.sub(rf'<a xlink:href="{there}"[^>]*>', label.replace("\\", r"\\"), text)
    for colour, variable in THEME.items():
        text = re.sub(re.escape(colour), variable, text, flags=re.IGNORECASE)
    head, _, body = text.partition(">")
    width = re.search(r'width="([\d.]+)pt"', head)
    head = re.sub(r'\s(?:width|height)="[^"]*"', "", head)
    style = f' style="max-width:{float(width.group(1)) * 4 / 3:.0f}px"' if width else ""
    role = "group" if links else "img"  # what is inside an image is not read
    return re.sub(
        r"\n\s*", "\n", f'{head} role="{role}" aria-label="{escape(title or f"figure {key}")}"{style}>{body}'
    ).strip()


_MOST_POINTS = 800  #: of a curve that a page keeps for its pointer


def page_environment(folder: Path) -> jinja2.Environment:
    """Return the templates of a folder, all of them pages of one house: its style and its pointer."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader([folder, Path(__file__).parent]),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    script = (Path(__file__).parent / "hover.js").read_text(encoding="utf-8")
    environment.globals["hover_script"] = Markup(script)  # our own
    return environment


def page_figure(
    figure: Figure, key: str, title: str | None = None, *, links: Mapping[str, str] | None = None
) -> Markup:
    """Return a figure for a page: text as text, colours of the theme, values under the pointer.

    Named curves over an increasing x are kept with it, `_MOST_POINTS` of each at most, and so are bars.
    Others as `inline_svg`.
    """
    with temporary_folder() as scratch:
        file = save_figure(figure, scratch / "figure.svg", transparent=True, outlines=False)
        drawn = inline_svg(file, key, title, links=links)
    data = json.dumps(_curves_of(figure), separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    return Markup(f'{drawn}<script type="application/json">{data}</script>')  # our own SVG and numbers


def _curves_of(figure: Figure) -> dict[str, Any]:
    """Return where the axes of a drawn figure lie, in points from the top left, and their curves and bars."""
    wide, high = (float(72.0 * inches) for inches in figure.get_size_inches())
    axes = []
    for axis in figure.axes:
        curves, place = _named_curves(axis), axis.get_position()
        if curves and axis.get_xscale() in ("linear", "log"):
            at = [place.x0 * wide, (1.0 - place.y1) * high, place.x1 * wide, (1.0 - place.y0) * high]
            name = axis.get_xlabel() or next(
                (a.get_xlabel() for a in figure.axes[::-1] if a.get_xlabel()), "x"
            )
            row = {"name": name, "at": [round(v, 1) for v in at], "x": [*axis.get_xlim()], "curves": curves}
            axes.append(row | ({"log": True} if axis.get_xscale() == "log" else {}))
    data: dict[str, Any] = {"size": [wide, high], "axes": axes}
    bars = [bar for axis in figure.axes for bar in _bars_of(axis, high)]
    return data | ({"bars": bars} if bars else {})


def _named_curves(axis: Axes) -> list[dict[str, Any]]:
    named = {str(line.get_label()): _thinned(line) for line in axis.get_lines()}
    return [
        {"name": name, "x": points[0], "y": points[1]}
        for name, points in named.items()
        if points is not None and not name.startswith("_")
    ]


def _bars_of(axis: Axes, high: float) -> list[dict[str, Any]]:
    """Return each bar with a length: where it lies, in points from the top left, and what it says."""
    groups = [bars for bars in axis.containers if isinstance(bars, BarContainer)]
    return [bar for bars in groups for bar in _bars_in(axis, bars, high)]


def _bars_in(axis: Axes, bars: BarContainer, high: float) -> Iterator[dict[str, Any]]:
    lying = bars.orientation == "horizontal"
    labels = (axis.yaxis if lying else axis.xaxis).get_majorticklabels()
    names = {label.get_position()[lying]: label.get_text() for label in labels}
    for bar, value in zip(bars.patches, np.asarray(bars.datavalues, dtype=float), strict=True):
        if not value or not np.isfinite(value):
            continue
        place = bar.get_y() + bar.get_height() / 2 if lying else bar.get_x() + bar.get_width() / 2
        corners = axis.transData.transform(bar.get_bbox().get_points()) * 72 / axis.figure.dpi
        (left, low), (right, top) = corners.min(axis=0), corners.max(axis=0)
        at = [round(float(v), 1) for v in (left, high - top, right, high - low)]
        yield {"at": at, "text": f"{names.get(place, '')} {value:.4g}".strip()}


def _thinned(line: Line2D) -> tuple[list[float], list[float | None]] | None:
    """Return a curve as few enough points, in four digits; None of one that goes back in x."""
    x, y = (np.asarray(v, dtype=float) for v in line.get_data())
    if len(x) < 2 or not np.all(np.diff(x) >= 0.0):
        return None
    every = -(-len(x) // _MOST_POINTS)
    return (
        [float(f"{v:.6g}") for v in x[::every]],
        [float(f"{v:.4g}") if np.isfinite(v) else None for v in y[::every]],
    )


def plain(value: Any) -> str:
    """Return a value as the cell of a table shows it: 4 digits, a minus sign, a dash for none."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "–"
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, float | np.floating):
        text = f"{value:.0f}" if 1e4 <= abs(float(value)) < 1e7 else f"{value:.4g}"
        return text.replace("-", "−")
    return html.unescape(str(value))
