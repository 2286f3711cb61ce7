"""Damping while signals come later, larger or smaller: exact roots over latency and scale, and their page."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import control
import matplotlib as mpl
from matplotlib.figure import Figure

from interarea.design.certificates.large_loop import LargePlant
from interarea.design.certificates.signal_margins import ALL, signal_margins
from interarea.design.delay.signal_conditions import Condition
from interarea.design.robust.operating_points import FamilyRow, JudgedPlant, family_row, inter_area_band
from interarea.design.robust.signal_worth import seen_by
from interarea.models.files import write_whole

from ..designs.family import Family, FamilyPlant, at_point
from ..plots.curves import DASHES, INK, SERIES, STYLE, new_figure
from ..plots.html import page_environment, page_figure

LATENCY, SCALE = "latency", "scale"
#: s and factors at which roots are computed; fewer of a plant above `DENSE_STATES`, where each takes seconds
LATENCIES_S = tuple(round(0.025 * k, 3) for k in range(21))
SCALES = tuple(round(0.1 * k, 1) for k in range(31))
FEW_LATENCIES_S, FEW_SCALES = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5), (0.0, 0.5, 1.0, 1.5, 2.0, 3.0)


@dataclass(frozen=True)
class CurvePoint:
    """The loop with one signal, or all (`ALL`), so late (`LATENCY`, s) or so large (`SCALE`, times)."""

    over: str
    signal: str
    value: float
    stable: bool
    rightmost: float  #: 1/s
    worst_swing: float
    inter_area: float


def damping_curves(
    table: Family,
    K: control.StateSpace,
    cache: Path,
    *,
    progress: Callable[[float], object] = lambda share: None,
) -> tuple[tuple[CurvePoint, ...], tuple[Mapping[str, Any], ...]]:
    """Return the exact damping of the loop at the first operating point of a design, and its margins there.

    Latencies common to all signals and of each alone, scales of each alone; the others are there at once.

    table : whose first operating point is looked at. K : speeds in rad/s.
    """
    point = table.point[0]
    each = FamilyPlant.of(at_point(table.grid, point), table.signals, table.actuators, cache)
    plant, band = each.judged, inter_area_band(each.modes)
    seen = {name for names in seen_by(K).values() for name in names}
    signals = [name for name in K.input_labels if name in seen]
    conditions = _conditions(signals, plant)
    rows: list[CurvePoint] = []
    known: dict[tuple[Any, ...], FamilyRow] = {}  # of the loop as it is, which every curve goes through
    for k, (over, signal, value, condition) in enumerate(conditions):
        progress(k / len(conditions))
        key = (tuple(condition.latency_s_of.items()), tuple(condition.scale_of.items()))
        if key not in known:
            known[key] = family_row(point.name, plant, K, condition, band)
        row = known[key]
        rows.append(
            CurvePoint(over, signal, value, row.stable, row.rightmost, row.worst_swing, row.inter_area)
        )
    margins = signal_margins({point.name: plant}, K)
    progress(1.0)
    return tuple(rows), tuple(margin.as_dict() for margin in margins)


def _conditions(signals: Sequence[str], plant: JudgedPlant) -> list[tuple[str, str, float, Condition]]:
    large = isinstance(plant, LargePlant)
    common = {ALL: signals} if len(signals) > 1 else {}
    each = common | {name: [name] for name in signals}
    latencies = [
        (LATENCY, name, s, Condition("", (), dict.fromkeys(late, s) if s else {}))
        for name, late in each.items()
        for s in (FEW_LATENCIES_S if large else LATENCIES_S)
    ]
    scales = [
        (SCALE, name, k, Condition("", scale_of={} if k == 1.0 else {name: k}))
        for name in signals
        for k in (FEW_SCALES if large else SCALES)
    ]
    return latencies + scales


def curve_figure(rows: Sequence[CurvePoint], over: str, margins: Sequence[Mapping[str, Any]]) -> Figure:
    """Draw the least damping of all swings over latency or scale, a dot where a root meets the axis."""
    figure, axes = new_figure(height=3.2)
    factor = 1e3 if over == LATENCY else 1.0
    with mpl.rc_context(STYLE):
        names = dict.fromkeys(row.signal for row in rows if row.over == over)
        for k, name in enumerate(names):
            own = [row for row in rows if row.over == over and row.signal == name]
            color = SERIES[k % len(SERIES)]
            x = [factor * row.value for row in own]
            y = [row.worst_swing for row in own]
            axes.plot(x, y, color=color, linestyle=DASHES[k % len(DASHES)], label=name)
            at = [factor * value for value in _contacts(name, over, margins)]
            inside = [value for value in at if min(x) <= value <= max(x)]
            axes.plot(inside, [0.0] * len(inside), "o", color=color, markersize=4)
        axes.axhline(0.0, color=INK, linewidth=0.6)
        axes.set_xlabel("latency (ms)" if over == LATENCY else "factor on the signal")
        axes.set_ylabel("least damping ratio")
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=7)
    return figure


def _contacts(signal: str, over: str, margins: Sequence[Mapping[str, Any]]) -> list[float]:
    """Return the latencies (s) or scales at which a root of the loop meets the axis."""
    met = next(margin for margin in margins if margin["signal"] == signal) if margins else {}
    kinds = ("delay",) if over == LATENCY else ("lower", "upper")
    return [met[kind]["value"] for kind in kinds if met.get(kind)]


def write_tolerance(
    path: Path,
    name: str,
    table: Family,
    rows: Sequence[CurvePoint],
    there: Sequence[Mapping[str, Any]],
    least: Sequence[Mapping[str, Any]],
    command: str,
) -> Path:
    """Write the page of a controller's curves.

    there, least : its margins at the operating point of the curves, and the least of all of the certificate.
    """
    text = (
        page_environment(Path(__file__).parent)
        .get_template("tolerance.html.j2")
        .render(
            name=name,
            case=table.grid.name,
            point=table.point[0].name,
            margins=least,
            rows=[asdict(row) for row in rows],
            latency=page_figure(curve_figure(rows, LATENCY, there), "latency"),
            scale=page_figure(curve_figure(rows, SCALE, there), "scale"),
            command=command,
        )
    )
    return write_whole(path, text)
