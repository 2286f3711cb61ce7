"""The page of a screening, and its rows as CSV and JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from interarea.models.files import together, write_whole

from ..explorer.address import link_of
from ..explorer.content import RANGES
from ..plots.curves import DASHES, MUTED, SERIES, STYLE, WIDTH
from ..plots.html import page_environment, page_figure, plain
from ..results.largest_deviation import OUT_OF_STEP_DEG
from ..results.verdict import GROWING, STANDING
from .screening import PLACE, Screened, Screening

NO_SUCCESS = (STANDING, GROWING)  #: together, but not settling
SHOWN = 300  #: disturbances on the page; all are in the files beside it


@dataclass(frozen=True)
class Explorer:
    """The interactive page of a screening, with adjustable disturbances.

    file : its name; "" if there is none, for the reason `why`.
    """

    file: str = ""
    why: str = ""

    def address(self, screening: Screening, place: str, outage: str) -> str:
        """Return the URL that opens a disturbance without controller; "" if the page cannot represent it."""
        if not self.file or outage:
            return ""
        if screening.kind == "trip":
            return self.file + link_of({"k": "none", "ev": "trip", "trip": place})
        low, high = RANGES["tc"]
        cleared_ms = 1000.0 * screening.clearing_s
        if not low <= cleared_ms <= high:
            return ""
        return self.file + link_of({"k": "none", "ev": "fault", "fault": place, "tc": cleared_ms, "br": ""})


def write_grid(screening: Screening, folder: Path, cache: Path) -> Explorer:
    """Write `explorer.html` of the screened grid, or return why no page can simulate it."""
    from ..explorer.page import write_where_held

    path = folder / "explorer.html"
    subject, why = write_where_held(lambda: screening.sweep().base, path, cache)
    return Explorer("" if subject is None else path.name, why)


def write_screening(
    screening: Screening, result: Sequence[Screened], folder: Path, explorer: Explorer = Explorer()
) -> Path:
    """Write `screen.html`, `screen.csv` and `screen.json` into `folder`; return the page.

    explorer : page that its places open, from `write_grid`.
    """
    rows = [asdict(one) for one in result]
    for row in rows:  # JSON has no infinity: as long as was tried
        row["critical_at_least"] = row["critical_s"] is not None and math.isinf(row["critical_s"])
        if row["critical_at_least"]:
            row["critical_s"] = screening.longest_s
    document = {"screening": asdict(screening), "rows": rows}
    environment = page_environment(Path(__file__).parent)
    environment.filters["plain"] = plain
    controllers = list(dict.fromkeys(one.controller for one in result))
    groups: dict[tuple[str, str], dict[str, Screened]] = {}
    for one in result:
        groups.setdefault((one.place, one.outage), {})[one.controller] = one
    text = environment.get_template("screen.html.j2").render(
        screening=screening,
        name=Path(screening.case).name,
        place=PLACE[screening.kind],
        controllers=controllers,
        counts={c: _counts(result, c) for c in controllers},
        groups=list(groups.items())[:SHOWN],
        total=len(groups),
        explorer=explorer,
        failed=[one for one in result if one.verdict == "failed"],
        searched=any(one.critical_s is not None for one in result),
        svg=page_figure(angle_figure(result), "angles"),
    )
    with together():
        write_whole(folder / "screen.json", json.dumps(document, indent=1) + "\n")
        write_whole(folder / "screen.csv", pd.DataFrame(rows).to_csv(index=False, lineterminator="\n"))
        return write_whole(folder / "screen.html", text)


def _counts(result: Sequence[Screened], controller: str) -> dict[str, Any]:
    """How often each verdict fell, and the extremes of what kept synchronism."""
    own = [one for one in result if one.controller == controller]
    retained = [one for one in own if one.verdict == "kept"]
    return {
        **{verdict: sum(one.verdict == verdict for one in own) for verdict in ("kept", "lost", "failed")},
        "swinging": sum(one.came_to in NO_SUCCESS for one in retained),
        "voltage": min((v for one in retained if (v := one.voltage_pu) is not None), default=None),
        "nadir": min((f for one in retained if (f := one.nadir_hz) is not None), default=None),
        "zenith": max((f for one in retained if (f := one.zenith_hz) is not None), default=None),
    }


def angle_figure(result: Sequence[Screened]) -> Figure:
    """Draw the largest angle of each disturbance, sorted, a curve for each controller."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 3.0), layout="constrained")
        axes = figure.subplots()
        for k, controller in enumerate(dict.fromkeys(one.controller for one in result)):
            own = [one for one in result if one.controller == controller and one.verdict != "failed"]
            angles = [OUT_OF_STEP_DEG if one.verdict == "lost" else one.angle_deg or 0.0 for one in own]
            line = {
                "color": SERIES[k % len(SERIES)],
                "linestyle": DASHES[k % len(DASHES)],
                "label": controller,
            }
            axes.step(np.arange(1, len(angles) + 1), np.sort(angles)[::-1], where="mid", **line)
        axes.axhline(OUT_OF_STEP_DEG, color=MUTED, linewidth=0.8)
        axes.set_xlabel("disturbances, worst first for each controller")
        axes.set_ylabel("largest angle (deg)")
        axes.set_ylim(0.0, 1.05 * OUT_OF_STEP_DEG)
        axes.legend(title="controller")
    return figure
