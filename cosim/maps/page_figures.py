"""Figures of a sweep: maps over two parameters, distributions, worst runs, margins."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from ..plots.curves import DASHES, INK, MUTED, SERIES, STYLE, WIDTH
from .page_data import Map, settled

Array = npt.NDArray[np.float64]
#: unstable (vermilion) over mixed (grey) to stable (blue): told apart by colour-blind readers too
STABILITY = LinearSegmentedColormap.from_list("stability", ["#d55e00", "#e9e4df", "#0072b2"])
DAMPING = "viridis"
_DARK, _LIGHT = "#000001", "#fffffe"  # in cells: not the theme's colours
_NUMBERS = 150  #: most cells that carry their number
_MOST_POINTS = 4000
_CERTIFIED: dict[str, Any] = {"marker": "D", "color": INK, "markersize": 5, "linestyle": "none"}


def map_figure(
    maps: Mapping[str, Map],
    labels: Mapping[str, str],
    lines: Mapping[str, Sequence[tuple[str, Array, Array]]],
    links: Mapping[str, Mapping[tuple[float, float], str]] | None = None,
) -> Figure:
    """Draw share of stable runs and least damping over two parameters, one row for each facet.

    labels : parameter -> axis label. lines : facet -> (label, x, y) drawn over the maps.
    links : facet -> address that a click on the cell of these two values opens.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(1.45 * WIDTH, 2.9 * len(maps) + 0.2), layout="constrained")
        axes = figure.subplots(len(maps), 2, squeeze=False)
        finite = [m.damping[np.isfinite(m.damping)] for m in maps.values()]
        every = np.concatenate(finite) if finite else np.array([])
        limits = Normalize(float(every.min()), float(every.max())) if every.size else Normalize(0.0, 1.0)
        for row, (facet, one) in zip(axes, maps.items(), strict=True):
            title = f"{facet}: " if facet else ""
            shares = _cells(row[0], one, one.stable, STABILITY, Normalize(0.0, 1.0), "{:.0%}")
            row[0].set_title(f"{title}share of stable runs")
            damping = _cells(row[1], one, one.damping, DAMPING, limits, "{:.2f}")
            row[1].set_title(f"{title}least damping ratio")
            for axis, mesh in zip(row, (shares, damping), strict=True):
                _link(axis, one, (links or {}).get(facet, {}))
                axis.set_xlabel(labels[one.x_name])
                axis.set_ylabel(labels[one.y_name])
                figure.colorbar(mesh, ax=axis, shrink=0.9)
                for k, (label, x, y) in enumerate(lines.get(facet, ())):
                    colour = _DARK if k == 0 else MUTED
                    axis.plot(x, y, color=colour, linewidth=1.8, linestyle=DASHES[k + 1], label=label)
        drawn: dict[str, Any] = {}
        for row in axes:
            handles, names = row[0].get_legend_handles_labels()
            drawn |= dict(zip(names, handles, strict=True))
        if drawn:
            figure.legend(list(drawn.values()), list(drawn), loc="outside lower center", ncols=2)
    return figure


def point_figure(rows: pd.DataFrame, x: str, y: str, labels: Mapping[str, str]) -> Figure:
    """Draw sampled runs as points: stable ones by damping, unstable and failed ones as crosses."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 3.4), layout="constrained")
        axes = figure.subplots()
        thinned = rows.iloc[:: max(1, len(rows) // _MOST_POINTS)]
        ok = thinned[thinned.status == "ok"]
        flag = ok["stable"].astype(bool) if "stable" in ok else pd.Series(True, index=ok.index)
        good, bad = ok[flag], ok[~flag]
        damping = good.get("damping_least")
        dots = axes.scatter(
            good[x], good[y], c=SERIES[0] if damping is None else damping, cmap=DAMPING, s=14, label="stable"
        )
        axes.scatter(bad[x], bad[y], color=SERIES[1], marker="x", s=22, label="not stable")
        failed = thinned[thinned.status != "ok"]
        if len(failed):
            axes.scatter(failed[x], failed[y], color=MUTED, marker="+", s=22, label="failed")
        if damping is not None:
            figure.colorbar(dots, ax=axes, label="least damping ratio")
        axes.set_xlabel(labels[x])
        axes.set_ylabel(labels[y])
        axes.legend(loc="upper left", bbox_to_anchor=(0.0, 1.14), ncols=3)
    return figure


def line_figure(rows: pd.DataFrame, x: str, groups: str, labels: Mapping[str, str]) -> Figure:
    """Draw damping over one parameter: median and range of the runs, one colour for each group."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 2.8), layout="constrained")
        axes = figure.subplots()
        ok = settled(rows)
        names = sorted(ok[groups].unique()) if groups else [""]
        for k, name in enumerate(names[: len(SERIES)]):
            part = ok[ok[groups] == name] if groups else ok
            by = part.groupby(x)["damping_least"]
            median, low, high = by.median(), by.min(), by.max()
            axes.fill_between(median.index, low, high, color=SERIES[k], alpha=0.18, linewidth=0)
            axes.plot(median.index, median, color=SERIES[k], linestyle=DASHES[k], label=str(name) or None)
        axes.axhline(0.0, color=MUTED, linewidth=0.7)
        axes.set_xlabel(labels[x])
        axes.set_ylabel("least damping ratio")
        if groups:
            axes.legend(loc="best")
    return figure


def distribution_figure(rows: pd.DataFrame, groups: str) -> Figure | None:
    """Draw how damping, settling time, peak and effort are distributed; None without such columns."""
    labels = {
        "damping_least": "least damping ratio",
        "settling_time_s": "settling time (s)",
        "peak_pu": "peak (10⁻³ pu)",
        "effort_pu2s": "control effort (pu² s)",
    }
    ok = rows[rows.status == "ok"]
    shown = [c for c in labels if c in ok and ok[c].notna().sum() > 1]
    if not shown:
        return None
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(1.45 * WIDTH, 2.4), layout="constrained")
        axes = figure.subplots(1, len(shown), squeeze=False)[0]
        names = sorted(ok[groups].unique())[: len(SERIES)] if groups else [""]
        for axis, column in zip(axes, shown, strict=True):
            for k, name in enumerate(names):
                part = ok[ok[groups] == name] if groups else ok
                values = np.sort(part[column].dropna().to_numpy(float)) * (
                    1e3 if column == "peak_pu" else 1.0
                )
                share = np.arange(1, len(values) + 1) / max(1, len(part))
                axis.plot(
                    values,
                    share,
                    color=SERIES[k],
                    linestyle=DASHES[k],
                    drawstyle="steps-post",
                    label=str(name),
                )
            axis.set_xlabel(labels[column])
            axis.set_ylim(0.0, 1.02)
        axes[0].set_ylabel("share of runs at most")
        if groups:
            axes[0].legend(loc="best", fontsize=7)
    return figure


def worst_figure(curves: Sequence[tuple[str, Array, Array, Mapping[str, Array]]]) -> Figure:
    """Draw runs one below the other: (title, time, speed difference in pu, controls in pu)."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(1.45 * WIDTH, 1.35 * len(curves) + 0.4), layout="constrained")
        axes = figure.subplots(len(curves), 2, squeeze=False, sharex=True)
        for place, (row, (title, time, swing, controls)) in enumerate(zip(axes, curves, strict=True)):
            row[0].plot(time, 1e3 * swing, color=SERIES[0], linewidth=1.1)
            row[0].set_title(title, fontsize=8)
            row[0].set_ylabel("10⁻³ pu")
            for k, (name, values) in enumerate(controls.items()):
                row[1].plot(time, values, color=SERIES[(k + 1) % len(SERIES)], linewidth=1.1, label=name)
            row[1].set_ylabel("control (pu)")
            if controls and place == 0:  # above the axes, where no curve is
                row[1].legend(
                    loc="lower right",
                    bbox_to_anchor=(1.0, 1.0),
                    borderaxespad=0.0,
                    ncols=len(controls),
                    fontsize=7,
                )
            row[0].set_xlim(float(time[0]), float(time[-1]))
        for axis in axes[-1]:
            axis.set_xlabel("time (s)")
    return figure


def margin_figure(
    labels: Sequence[str], certified: Sequence[float | None], edges: Sequence[Any], unit: str
) -> Figure:
    """Draw simulated brackets as bars and certified margins as diamonds.

    edges : (stable, unstable) of each label; unstable None: open to the right.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 0.9 + 0.34 * len(labels)), layout="constrained")
        axes = figure.subplots()
        sure = [v if v is not None and np.isfinite(v) else None for v in certified]
        known = [v for v in (*(v for pair in edges for v in pair), *sure) if v is not None]
        most = 1.15 * max(known, default=1.0)
        for k, (margin, (good, bad)) in enumerate(zip(sure, edges, strict=True)):
            if good is not None:
                label = "simulated: stable" if k == 0 else None
                axes.barh(k, good, color=SERIES[0], height=0.55, label=label)
                if bad is not None:
                    axes.plot([bad], [k], marker="|", color=SERIES[1], markersize=13, markeredgewidth=2)
            if margin is not None:
                axes.plot([margin], [k], **_CERTIFIED)
        bar: dict[str, Any] = {"marker": "|", "markersize": 10, "markeredgewidth": 2, "linestyle": "none"}
        axes.plot([], [], color=SERIES[1], label="unstable", **bar)
        if any(v is not None for v in sure):
            axes.plot([], [], label="certified (linear)", **_CERTIFIED)
        axes.set_yticks(range(len(labels)), labels)
        axes.invert_yaxis()
        axes.grid(axis="y", visible=False)
        axes.set_xlim(0.0, most)
        axes.set_xlabel(unit)
        axes.legend(loc="upper left", bbox_to_anchor=(0.0, 1.0 + 0.5 / len(labels)), ncols=3)
    return figure


def _cells(axes: Axes, one: Map, values: Array, colours: Any, norm: Normalize, text: str) -> Any:
    x, y = _edges(one.x), _edges(one.y)
    many = values.size > 2500
    mesh = axes.pcolormesh(x, y, np.ma.masked_invalid(values), cmap=colours, norm=norm, rasterized=many)
    axes.set_facecolor("#8c959f")
    axes.grid(visible=False)
    if values.size <= _NUMBERS:
        shade = mpl.colormaps[colours] if isinstance(colours, str) else colours
        for j, i in np.ndindex(*values.shape):
            value = float(values[j, i])
            if np.isfinite(value):
                r, g, b, _ = shade(norm(value))
                ink = _DARK if 0.299 * r + 0.587 * g + 0.114 * b > 0.5 else _LIGHT
                size = 6.5 if values.shape[1] <= 12 else 5.0
                axes.text(
                    float(one.x[i]),
                    float(one.y[j]),
                    text.format(value),
                    ha="center",
                    va="center",
                    color=ink,
                    fontsize=size,
                )
    return mesh


def _link(axes: Axes, one: Map, links: Mapping[tuple[float, float], str]) -> None:
    """Lay a shape that is not painted over each cell with an address."""
    x, y = _edges(one.x), _edges(one.y)
    for j, i in np.ndindex(*one.stable.shape):
        address = links.get((float(one.x[i]), float(one.y[j])))
        if address is not None:
            corner, size = (float(x[i]), float(y[j])), (float(x[i + 1] - x[i]), float(y[j + 1] - y[j]))
            axes.add_patch(Rectangle(corner, *size, fill=False, linewidth=0, url=address))


def _edges(values: Array) -> Array:
    """Return cell borders half way between values."""
    if len(values) == 1:
        return np.array([values[0] - 0.5, values[0] + 0.5])
    middle = 0.5 * (values[1:] + values[:-1])
    return np.concatenate([[2 * values[0] - middle[0]], middle, [2 * values[-1] - middle[-1]]])
