"""One page for one run: what it was, how it went, every number with its method, and what made it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from ..plots.html import page_environment, page_figure
from .record import scenario_text
from .run_figure import Ran

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .metrics import Metrics


class Reported(Ran, Protocol):
    """What the page tells of: what is drawn, with its numbers and ledgers."""

    @property
    def metrics(self) -> Metrics: ...
    @property
    def made_from(self) -> dict[str, Any]: ...


#: metric -> its words and unit, in the order of the page
_NUMBERS = {
    "settling_time_s": "settling time (s), to 2 % of the peak",
    "peak_pu": "largest swing (pu)",
    "energy_pu2s": "integral of the squared swing (pu² s)",
    "effort_pu2s": "integral of the squared control (pu² s)",
    "fit_error": "error of the ring-down fit",
}


def run_page(run: Reported, drawn: Figure, explorer: str = "") -> str:
    """Return the page of a run.

    drawn : its `plot`.
    explorer : address of the page on which the same run can be dragged; "" where there is none.
    """
    m = run.metrics
    modes = [
        (name, zeta, m.frequency_hz[name], m.ring_down.get(name))
        for name, zeta in sorted(m.damping_ratio.items(), key=lambda item: item[1])
    ]
    numbers = [(words, getattr(m, key), m.methods.get(key, "")) for key, words in _NUMBERS.items()]
    return (
        page_environment(Path(__file__).parent)
        .get_template("run.html.j2")
        .render(
            title=run.scenario.title or run.scenario.name,
            run=run,
            metrics=m,
            modes=modes,
            numbers=numbers,
            stop_s=float(run.trajectory.time_s[-1]),
            figure=page_figure(drawn, "run", run.summary),
            record=run.made_from,
            scenario=scenario_text(run.scenario),
            explorer=explorer,
        )
    )
