"""The page of a grid's study, in the order of a planner's questions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2
import matplotlib as mpl
import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from interarea.design.certificates.mode_changes import most_taken
from interarea.design.modes.modes import Mode
from interarea.models.case.case import Case
from interarea.models.files import write_whole

from ..designs.certificate_words import in_words
from ..designs.worth import HEADER as WORTH_HEADER
from ..designs.worth import table_rows
from ..plots.curves import DASHES, MUTED, SERIES, STYLE, WIDTH
from ..plots.html import page_environment, page_figure, plain
from ..plots.mode_map import shape_plot
from .local_stabilizers import WASHOUT_S

SHAPES = 4  #: modes whose shapes are drawn


def study_environment(folder: Path) -> jinja2.Environment:
    """Return the templates of a folder with the filters that pages of studies of grids share."""
    environment = page_environment(folder)
    environment.filters |= {"plain": plain, "ratio": ratio}
    environment.filters["sentence"] = sentence
    return environment


def mode_shapes(modes: Sequence[Mode], case: Case) -> list[Markup]:
    """Draw the shapes of the first `SHAPES` modes as figures of a page."""
    return [page_figure(shape_plot(mode, case), f"shape-{k}") for k, mode in enumerate(modes[:SHAPES])]


def write_page(study: Mapping[str, Any], modes: Sequence[Mode], shapes: Sequence[Markup], path: Path) -> Path:
    """Write the page of the results in `study`; a section without results states so.

    modes : those shown, in the order of the page. shapes : figures of the first ones (`mode_shapes`).
    """
    environment = study_environment(Path(__file__).parent)
    text = environment.get_template("grid_study.html.j2").render(
        study=study,
        headline=headline(study),
        modes=modes,
        shapes=shapes,
        damping=damping_rows((study.get("certificate") or {}).get("rows", ())),
        left_out=damping_rows(study.get("left_out", ())),
        worth=_worth(study),
        latency=_latency(study),
        faults=_faults(study),
        washout_s=WASHOUT_S,
    )
    return write_whole(path, text.encode("utf-8"))


def sentence(text: str) -> str:
    """Return words as a sentence.

    >>> sentence("do not build the link from G2")
    'Do not build the link from G2.'
    """
    return f"{text[:1].upper()}{text[1:]}."


def headline(study: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the results of the study, one sentence each: weakest mode, damping reached, worth."""
    modes = [m for m in study["modes"]["modes"] if m["name"].startswith("inter-area")]
    lines = []
    if study["modes"]["growing"]:
        lines.append(f"The grid is unstable without control: {'; '.join(study['modes']['growing'])}.")
    if modes:
        least = min(modes, key=lambda m: float(m["damping_ratio"]))
        lines.append(
            f"The least damped inter-area mode without control is {least['name']}, "
            f"{least['frequency_hz']:.2f} Hz, damping ratio {least['damping_ratio']:.3f}."
        )
    if study.get("certificate") is not None:
        lines += _reached(study)
    if "worth" in study:
        lines.append(sentence(study["worth"]["sentence"]))
    if "local" in study:
        lines.append(sentence(study["local"]["sentence"]))
    if study["problem"]:
        lines.append(f"The study stopped: {study['problem']}.")
    return tuple(lines)


def _reached(study: Mapping[str, Any]) -> list[str]:
    """Return the results and violations of the controller of a study, one sentence each."""
    certificate = study["certificate"]
    lines = []
    beside = "the local stabilizers and " if (study.get("local") or {}).get("installed") else ""
    lines.append(
        f"With {beside}the controller the inter-area damping ratio is at least "
        f"{certificate['inter_area']:.3f} at all operating points, latencies and "
        "losses of one signal of the certificate."
    )
    short = [row["point"] for row in study.get("left_out", ()) if not _holds(row, study["asked"])]
    if short:
        lines.append(
            "At these operating points outside the design it does not meet the requirements: "
            f"{', '.join(dict.fromkeys(short))}."
        )
    if certificate.get("modes") is not None:
        lines.append(f"Without loss of a signal {most_taken(certificate['modes'])}.")
    if missed := len(certificate["violations"]):
        lines.append(f"It violates {missed} of the requirements, first: {certificate['violations'][0]}.")
    lines.append(sentence(in_words(certificate["acceptance"])))
    return lines


def _holds(row: Mapping[str, Any], required: Mapping[str, float]) -> bool:
    return bool(row["stable"]) and all(row[key] >= required[key] for key in ("inter_area", "worst_swing"))


def damping_rows(judged: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return the least damping at each operating point by kind of condition: normal, late, one lost."""
    rows: dict[str, dict[str, Any]] = {}
    for row in judged:
        kind = "lost" if "L" in row["condition"] else "all" if row["condition"] == "N" else "late"
        own = rows.setdefault(row["point"], {"point": row["point"], "stable": True})
        own["stable"] &= row["stable"]
        for key in ("inter_area", "worst_swing"):
            own[f"{key}_{kind}"] = min(own.get(f"{key}_{kind}", 1.0), row[key])
    return list(rows.values())


def _worth(study: Mapping[str, Any]) -> dict[str, Any] | None:
    if "worth" not in study:
        return None
    return {
        "header": WORTH_HEADER,
        "rows": table_rows(study["worth"]),
        "sentence": study["worth"]["sentence"],
    }


def _faults(study: Mapping[str, Any]) -> dict[str, Any] | None:
    certificate = study.get("certificate")
    if certificate is None or certificate["acceptance"] is None:
        return None
    record = certificate["acceptance"]
    rows = [row for row in record["clearing"] if row["without"] is not None]
    return {
        "record": record,
        "sentence": in_words(record),
        "rows": rows,
        "svg": page_figure(_clearing_figure(rows), "clearing") if rows else "",
    }


def _latency(study: Mapping[str, Any]) -> dict[str, Any] | None:
    rows = study.get("latency")
    if rows is None:
        return None
    unstable = [row["latency_s"] for row in rows if not row["stable"]]
    stable = [r["latency_s"] for r in rows if r["latency_s"] < min(unstable, default=float("inf"))]
    return {
        "svg": page_figure(_latency_figure(rows, study), "latency"),
        "stable_to": max(stable, default=0.0),
        "all": not unstable,
    }


def _latency_figure(rows: Sequence[Mapping[str, Any]], study: Mapping[str, Any]) -> Figure:
    """Draw inter-area damping over the latency of all signals, a curve for each lost signal."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 3.2), layout="constrained")
        axes = figure.subplots()
        for k, lost in enumerate(dict.fromkeys(row["lost"] for row in rows)):
            own = [row for row in rows if row["lost"] == lost]
            axes.plot(
                [1e3 * row["latency_s"] for row in own],
                [row["inter_area"] if row["stable"] else np.nan for row in own],
                color=SERIES[k % len(SERIES)],
                linestyle=DASHES[k % len(DASHES)],
                label=f"{lost} lost" if lost else "nothing lost",
            )
        axes.axhline(study["asked"]["inter_area"], color=MUTED, linewidth=0.8)
        axes.set_xlabel("latency of all signals (ms)")
        axes.set_ylabel("inter-area damping ratio")
        axes.legend(fontsize="small")
    return figure


def _clearing_figure(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """Draw the change of the clearing times where both are known, sorted."""
    changes = [row["with_control"] - row["without"] for row in rows if row["with_control"] is not None]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 2.6), layout="constrained")
        axes = figure.subplots()
        axes.bar(range(1, len(changes) + 1), sorted(changes), color=SERIES[0])
        axes.axhline(0.0, color=MUTED, linewidth=0.8)
        axes.set_xlabel("operating points and faults, sorted")
        axes.set_ylabel("change (cycles)")
    return figure


def ratio(value: float | None) -> str:
    """Return a damping ratio, or another number of that size, with three decimals; a dash for none."""
    return "–" if value is None else f"{value:.3f}".replace("-", "−")
