"""One self-contained page: each printed table and figure beside ours, what agrees, what does not and why.

Figures are inlined as SVG whose colours follow the page's light or dark theme;
nothing is loaded from anywhere and nothing depends on the clock, so the same
study gives the same bytes.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup, escape

from interarea.fmu_build.write.package import write_whole

from .claims import judge_loops, judge_modes, judge_statements
from .plots import GRID, INK, MUTED, SERIES
from .published import TEMPLATES, published

THEME = {INK: "var(--ink)", MUTED: "var(--muted)", GRID: "var(--grid)"} | {
    colour: f"var(--s{k})" for k, colour in enumerate(SERIES)
}


def render_report(study: Mapping[str, Any], figures: Mapping[str, Path]) -> str:
    """Return the page for `study` (as in study.json) with `figures` (number or name -> SVG file)."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters |= {"number": _number, "percent": _percent, "seconds": _seconds, "pole": _pole}
    statements = judge_statements(study)
    titles = {row["number"]: row["title"] for row in published()["figure"]}
    count = {v: sum(j.verdict == v for j in statements) for v in ("agrees", "partly", "differs")}
    return environment.get_template("report.html.j2").render(
        study=study,
        statements=statements,
        count=count,
        modes=judge_modes(study),
        loops=judge_loops(study),
        corrections=published()["correction"],
        titles=titles,
        svg={key: Markup(inline_svg(path, key, titles.get(key))) for key, path in figures.items()},
    )


def write_report(study: Mapping[str, Any], figures: Mapping[str, Path], path: Path) -> Path:
    """Write `render_report` to `path`, as one finished file."""
    return write_whole(path, render_report(study, figures).encode("utf-8"))


def inline_svg(path: Path, key: str, title: str | None = None) -> str:
    """Return an SVG file as an element for a page: ids unique by `key`, colours of the theme.

    title : what a screen reader says of it; default the key.
    """
    text = path.read_text(encoding="utf-8")
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    prefix = "f" + re.sub(r"\W", "-", key) + "-"
    text = re.sub(r'\bid="', f'id="{prefix}', text)
    text = re.sub(r"url\(#", f"url(#{prefix}", text)
    text = re.sub(r'href="#', f'href="#{prefix}', text)
    for colour, variable in THEME.items():
        text = re.sub(re.escape(colour), variable, text, flags=re.IGNORECASE)
    head, _, body = text.partition(">")
    width = re.search(r'width="([\d.]+)pt"', head)
    head = re.sub(r'\s(?:width|height)="[^"]*"', "", head)
    style = f' style="max-width:{float(width.group(1)) * 4 / 3:.0f}px"' if width else ""
    return re.sub(
        r"\n\s*", "\n", f'{head} role="img" aria-label="{escape(title or f"figure {key}")}"{style}>{body}'
    ).strip()


def _number(value: float | None, digits: int = 3) -> str:
    if value is None:
        return "–"
    return f"{round(value, digits) + 0.0:.{digits}f}".replace("-", "−")  # + 0: no "−0.0"


def _percent(value: float | None, digits: int = 1) -> str:
    return "–" if value is None else f"{_number(100.0 * value, digits)} %"


def _seconds(value: float | None) -> str:
    return "not settled" if value is None else f"{value:.2f} s"


def _pole(value: Any) -> str:
    """Return a pole given as a real number or [re, im], in 1/s."""
    if value is None:
        return "–"
    if isinstance(value, (int, float)):
        return f"{value:.3g}".replace("-", "−")
    real, imaginary = value
    text = f"{real:.3g}" + (f" ± {abs(imaginary):.3g}j" if abs(imaginary) > 1e-9 else "")
    return text.replace("-", "−")
