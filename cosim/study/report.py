"""One self-contained page: each printed table and figure beside ours, what agrees, what does not and why.

Figures are inlined as SVG whose colours follow the page's light or dark theme;
nothing is loaded from anywhere and nothing depends on the clock, so the same
study gives the same bytes.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from markupsafe import Markup

from interarea.models.files import write_whole

from ..plots.html import page_environment


def render_report(study: Mapping[str, Any], figures: Mapping[str, Path]) -> str:
    """Return the page for `study` (as in study.json) with `figures`: key -> file of what the page shows."""
    environment = page_environment(Path(__file__).parent)
    environment.filters |= {"number": _number, "percent": _percent, "seconds": _seconds, "pole": _pole}
    nothing: dict[str, Any] = {"verdicts": [], "modes": [], "loops": [], "corrections": []}
    printed = study.get("printed", nothing)
    verdicts = [row["verdict"] for row in printed["verdicts"]]
    return environment.get_template("report.html.j2").render(
        study=study,
        printed=printed,
        count={verdict: verdicts.count(verdict) for verdict in ("agrees", "partly", "differs")},
        svg={key: Markup(path.read_text(encoding="utf-8")) for key, path in figures.items()},  # our own
    )


def write_report(study: Mapping[str, Any], figures: Mapping[str, Path], path: Path) -> Path:
    """Write `render_report` to `path`, as one finished file."""
    return write_whole(path, render_report(study, figures).encode("utf-8"))


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
