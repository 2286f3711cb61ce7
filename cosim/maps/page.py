"""One self-contained page for the results of a sweep: maps, margins, worst runs, distributions, failures."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup
from matplotlib.figure import Figure

from interarea.fmu_build.write.cache import default_cache
from interarea.models.files import temporary_folder, together, write_whole

from ..errors import SweepError
from ..plots.html import page_environment, page_figure, plain
from ..sweep.parts import read_plan, read_rows
from ..sweep.plan import SweepPlan, code_version
from ..sweep.rows import FAILURES
from ..sweep.runner import Runner
from ..sweep.spec import Sweep
from . import page_figures as figures
from .links import Explorer, write_runs
from .margins import Margin, margins_of
from .page_data import (
    facets_of,
    is_grid,
    kind_of,
    least_damping,
    map_of,
    numeric,
    pairs_of,
    worst_runs,
)

TEMPLATES = Path(__file__).parent
STEPS = ("margins", "worst runs", "explorer", "figures")  #: of writing the page
_UNITS = {"latency": "s", "loss": "share of packets", "tie": "MW"}
_WORDS = {"latency": "latency", "loss": "loss rate", "tie": "tie flow added"}


def write_maps(
    folder: Path,
    path: Path,
    *,
    worst: int = 6,
    workers: int | None = None,
    cache: Path | None = None,
    progress: Callable[[str, float], object] | None = None,
) -> Path:
    """Write the page of the results in `folder` to `path`, as one finished file.

    Beside it, as ``STEM-explorer.html``, the explorer: a click on a cell opens its worst run there.
    worst : runs that are simulated again for their trajectories. workers : processes that search margins
        side by side; default one for each core. progress : called with one of `STEPS` and the share of it
        that is done.

    Raises
    ------
    SweepError : no results in `folder`.
    """
    report = progress or _silent
    plan, rows = read_plan(folder), read_rows(folder)
    cached = default_cache() if cache is None else cache
    path.parent.mkdir(parents=True, exist_ok=True)
    searching, again, exploring, drawing = STEPS
    with temporary_folder() as scratch, Runner(plan, cached, scratch) as runner:
        report(searching, 0.0)
        margins: list[Margin] = []
        if plan.controllers:
            margins = margins_of(
                plan, rows, runner, workers=workers, progress=lambda share: report(searching, share)
            )
        report(searching, 1.0)
        curves = _curves(plan, rows, runner, worst, lambda share: report(again, share))
    report(exploring, 0.0)
    with together():
        explorer = write_runs(plan, explorer_beside(path), cached)
        report(exploring, 1.0)
        drawn = _draw(plan.sweep, rows, margins, curves, explorer)
        opens = _titles(plan, rows, explorer)
        svg: dict[str, Markup] = {}
        for key, figure in drawn.items():
            report(drawing, len(svg) / len(drawn))
            svg[key] = page_figure(figure, key, links=opens if key.startswith("map-") else None)
        text = _render(plan, rows, margins, svg, folder, explorer)
        report(drawing, 1.0)
        return write_whole(path, text.encode("utf-8"))


def explorer_beside(page: Path) -> Path:
    """Return where the explorer of the sweep's scenario goes, beside the page of its maps."""
    return page.with_name(f"{page.stem}-explorer.html")


def labels_of(sweep: Sweep) -> dict[str, str]:
    """Return the axis label of each parameter: its own label, or what it is, with its unit."""
    labels = {}
    for name, p in sweep.parameters.items():
        kind = kind_of(sweep, name)
        unit = p.unit or _UNITS.get(kind, "")
        words = p.label or (_WORDS[kind] if kind in _WORDS and name in (kind, _WORDS[kind]) else name)
        labels[name] = f"{words} ({unit})" if unit else words
    return labels


def _draw(
    sweep: Sweep,
    rows: pd.DataFrame,
    margins: list[Margin],
    curves: list[Any],
    explorer: Explorer | None = None,
) -> dict[str, Figure]:
    labels = labels_of(sweep)
    facet, _ = facets_of(sweep, rows)
    maps = _maps(sweep, rows, margins, labels, explorer)
    names = numeric(sweep, rows)
    damped = "damping_least" in rows and rows["damping_least"].notna().any()
    if names and damped and not sweep.parameters[names[0]].sampled:
        maps["line"] = figures.line_figure(rows, names[0], facet, labels)
    for kind in ("latency", "loss"):
        known = [m for m in margins if kind_of(sweep, m.name) == kind and m.is_known]
        if known:
            maps[f"margin-{kind}"] = _margins(known, labels, facet)
    spread = figures.distribution_figure(rows, facet)
    if spread is not None:
        maps["distribution"] = spread
    if curves:
        maps["worst"] = figures.worst_figure(curves)
    return maps


def _margins(margins: list[Margin], labels: Mapping[str, str], facet: str) -> Figure:
    return figures.margin_figure(
        [point_text(m.values, facet) or "as in the scenario" for m in margins],
        [m.certified for m in margins],
        [(m.stable, m.unstable) for m in margins],
        labels[margins[0].name],
    )


def _maps(
    sweep: Sweep,
    rows: pd.DataFrame,
    margins: list[Margin],
    labels: Mapping[str, str],
    explorer: Explorer | None,
) -> dict[str, Figure]:
    """Draw stability and damping over each pair of parameters: cells on a grid, else points."""
    facet, parts = _by_facet(sweep, rows)
    result: dict[str, Figure] = {}
    for k, (x, y) in enumerate(pairs_of(sweep, rows)):
        if not is_grid(rows, x, y):
            result[f"map-{k}"] = figures.point_figure(rows, x, y, labels)
            continue
        maps = {name: map_of(part, x, y) for name, part in parts.items()}
        links = {} if explorer is None else {n: explorer.cells(part, x, y) for n, part in parts.items()}
        lines = _lines(sweep, margins, x, y, facet, maps)
        result[f"map-{k}"] = figures.map_figure(maps, labels, lines, links)
    return result


def _by_facet(sweep: Sweep, rows: pd.DataFrame) -> tuple[str, dict[str, pd.DataFrame]]:
    """The parameter that splits the maps, "" for none, and the rows of each of its values."""
    facet, values = facets_of(sweep, rows)
    return facet, {str(v or ""): rows if v is None else rows[rows[facet] == v] for v in values}


def _titles(plan: SweepPlan, rows: pd.DataFrame, explorer: Explorer) -> dict[str, str]:
    """Return address -> what it opens, of every run that the explorer's page can be."""
    titles = {}
    for run in rows.run:
        address = explorer.known(int(run))
        if address is not None:
            titles[address] = f"open run {run}: {point_text(plan.sweep.values(int(run)))}"
    return titles


def first_figure(sweep: Sweep, rows: pd.DataFrame) -> Figure:
    """Return the first map of a sweep without margins; with one parameter of numbers damping over it.

    Raises
    ------
    SweepError : nothing to draw: no parameter of numbers with two values.
    """
    drawn = _draw(sweep, rows, [], [])
    if not drawn:
        raise SweepError(f"{sweep.name}: no parameter has two numbers or more, so no map can be drawn")
    return next(iter(drawn.values()))


def _lines(
    sweep: Sweep, margins: list[Margin], x: str, y: str, facet: str, maps: Mapping[str, Any]
) -> dict[str, list[tuple[str, Any, Any]]]:
    """Return the margins in latency over a map whose first axis is latency: certified and simulated."""
    lines: dict[str, list[tuple[str, Any, Any]]] = {}
    if kind_of(sweep, x) != "latency":
        return lines
    for name, one in maps.items():
        of_line = [m for m in margins if m.name == x and (not facet or str(m.values.get(facet)) == name)]
        for label, margin in (("certified margin (linear)", _certified), ("simulated margin", _simulated)):
            known = _known_margins(of_line, margin, y, one.x)
            constant = len({at for _, at in known}) == 1
            # one simulated without loss is no line over all losses
            if known and not (constant and margin is _simulated and kind_of(sweep, y) == "loss"):
                line = _vertical(known, one.y) if constant else _through(known)
                lines.setdefault(name, []).append((label, *line))
    return lines


def _vertical(known: list[tuple[float, float]], y: Any) -> tuple[Any, Any]:
    return np.full(2, known[0][0]), np.array([y.min(), y.max()])


def _through(known: list[tuple[float, float]]) -> tuple[Any, Any]:
    ordered = sorted(known, key=lambda pair: pair[1])
    return np.array([v for v, _ in ordered]), np.array([at for _, at in ordered])


def _known_margins(
    margins: list[Margin], value_of: Callable[[Margin], float | None], y: str, x: Any
) -> list[tuple[float, float]]:
    """Return (margin, value of parameter `y`) of those that lie within a map's `x`."""
    known_margins = []
    for m in margins:
        value, at = value_of(m), m.values.get(y)
        if value is not None and isinstance(at, int | float) and x.min() <= value <= x.max():
            known_margins.append((float(value), float(at)))
    return known_margins


def _certified(m: Margin) -> float | None:
    return m.certified


def _simulated(m: Margin) -> float | None:
    return m.stable if m.unstable is not None else None


def _curves(
    plan: SweepPlan, rows: pd.DataFrame, runner: Runner, count: int, tell: Callable[[float], object]
) -> list[Any]:
    """Simulate the worst runs again."""
    curves_of: list[Any] = []
    worst = worst_runs(rows, count) if plan.sweep.searched is None else []
    for run in worst:
        tell(len(curves_of) / len(worst))
        values = plan.sweep.values(run)
        record, curves = runner.simulate(values)
        assert record.system.swing is not None
        swing = record.system.swing.of(curves)
        controls = {c.partition(".")[2]: curves[c] for c in curves.reals_of("controller")}
        row = rows[rows.run == run].iloc[0]
        verdict = "" if "stable" not in row else "stable" if row["stable"] else "not stable"
        curves_of.append(
            (f"run {run}, {verdict}: {point_text(values)}", curves.time_s.copy(), swing, controls)
        )
    tell(1.0)
    return curves_of


def point_text(values: Mapping[str, Any], first: str = "") -> str:
    """Return parameters in words: "controller ftc, latency 0.1"."""
    names = sorted(values, key=lambda n: n != first)
    return ", ".join(f"{n} {plain(values[n])}" for n in names)


def _render(
    plan: SweepPlan,
    rows: pd.DataFrame,
    margins: list[Margin],
    svg: Mapping[str, Markup],
    folder: Path,
    explorer: Explorer,
) -> str:
    environment = page_environment(TEMPLATES)
    environment.filters["plain"] = plain
    sweep = plan.sweep
    labels = labels_of(sweep)
    ok, failed = rows[rows.status == "ok"], rows[rows.status != "ok"]
    order = [*(f"map-{k}" for k in range(len(svg))), "line"]
    columns = ["run", *(str(c) for c in rows if c in sweep.parameters or c in _SHOWN)]
    return environment.get_template("maps.html.j2").render(
        sweep=sweep,
        size=sweep.size,
        rows=len(rows),
        ok=len(ok),
        failures=[(k, n) for k in FAILURES if (n := int((failed.failure == k).sum()))],
        reasons=[(r.run, r.failure, r.reason) for r in failed.head(8).itertuples()],
        stable=int((ok["stable"] == True).sum()) if "stable" in ok else None,  # noqa: E712
        least=least_damping(ok),
        parameters=[(n, labels[n], _range(sweep, n)) for n in sweep.parameters],
        margins=[(m, labels.get(m.name, m.name), point_text(m.values)) for m in margins],
        maps=[key for key in order if key in svg],
        svg=svg,
        columns=[(c, labels.get(c) or _SHOWN.get(c, c)) for c in columns],
        worst=_worst(sweep, rows, explorer),
        explorer=explorer,
        version=plan.version,
        specification=plan.hash,
        same_version=plan.version == code_version(),
        folder=folder.name,
    )


def _worst(sweep: Sweep, rows: pd.DataFrame, explorer: Explorer) -> list[dict[Hashable, Any]]:
    """The worst runs with the address that opens each; none of a search, whose rows are no runs."""
    if sweep.searched:
        return []
    worst = rows.set_index("run", drop=False).loc[worst_runs(rows, 12)].to_dict("records")
    return [{**row, "address": explorer.run(int(row["run"]))} for row in worst]


#: columns beside the parameters, as a reader calls them
_SHOWN = {
    "stable": "stable",
    "damping_least": "least damping ratio",
    "damping_inter_area": "damping ratio, inter-area",
    "settling_time_s": "settling time (s)",
    "peak_pu": "peak (pu)",
    "effort_pu2s": "effort (pu² s)",
    "packets_lost": "packets lost",
}


def _range(sweep: Sweep, name: str) -> str:
    p = sweep.parameters[name]
    where = " and ".join(".".join(w) for w in sweep.paths(name))
    if p.bisect is not None:
        what = f"searched from {p.bisect.low:g} to {p.bisect.high:g}, to {p.bisect.tolerance:g}"
    elif p.latin_hypercube is not None:
        what = f"Latin hypercube, {p.latin_hypercube.low:g} to {p.latin_hypercube.high:g}"
    elif p.random is not None:
        what = "random: " + ", ".join(f"{k} = {v}" for k, v in p.random.model_dump(exclude_none=True).items())
    else:
        listed = [plain(p.grid_value(k)) for k in range(min(p.size, 12))]
        what = ", ".join(listed) + (f", ... ({p.size} values)" if p.size > 12 else "")
    return f"{where}: {what}"


def _silent(_: str, __: float) -> None:
    pass
