"""interarea compare: one scenario with several controllers, on one page."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Annotated, Any

import typer

from .terminal import note, print_table, stage_progress

_COLUMNS = {
    "least_damping_ratio": "least damping",
    "least_frequency_hz": "Hz",
    "least_mode": "of",
    "inter_area_damping_ratio": "inter-area",
    "inter_area_frequency_hz": "Hz",
    "settling_time_s": "settled (s)",
    "peak_pu": "peak (pu)",
}


def compare(
    controllers: Annotated[
        list[str],
        typer.Argument(
            metavar="CONTROLLER...", help="names that `interarea list` shows, JSON files, FMUs, none"
        ),
    ],
    scenario: Annotated[
        str, typer.Option("--scenario", metavar="SCENARIO", help="scenario file, or a bundled name")
    ] = "wide-area-damping",
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="folder for compare.html and the runs", show_default=False),
    ] = None,
    json_: Annotated[bool, typer.Option("--json", help="print JSON instead of a table")] = False,
) -> None:
    """Run one scenario with several controllers: metrics, curves and roots over latency on one page."""
    from .destination import folder_for

    if out is not None:
        folder_for(out, files=("compare.json", "compare.html"))
    from interarea.cosim.scenario.names import require_controller
    from interarea.cosim.scenario.scenario import load_scenario

    loaded = load_scenario(scenario)
    for name in controllers:
        require_controller(name, Path() if Path(name).exists() else loaded.folder)
    # a mistake in the file, or a name, is reported before what runs it is loaded
    from interarea.cosim.plots.loading import load_plots

    load_plots()
    from interarea.cosim.run.compare import compared_name
    from interarea.simulation import compare as compare_runs

    stages = {compared_name(c): c for c in controllers}
    with stage_progress(controllers) as progress:
        result = compare_runs(controllers, scenario, progress=lambda name, done: progress(stages[name], done))
    files: list[Path] = []
    if out is not None:
        command = ["interarea", "compare", *controllers, "--scenario", scenario, "--out", str(out)]
        files = result.save(out, command=shlex.join(command))[-2:]
    document = result.as_dict()
    if json_:
        typer.echo(json.dumps(document, indent=2, allow_nan=False))
    else:
        print_table(
            f"{loaded.title or loaded.name} (roots of the linear loop where known)",
            ("controller", "verdict", *_COLUMNS.values()),
            [
                (r["controller"], r["verdict"], *map(_cell, (r[k] for k in _COLUMNS)))
                for r in document["controllers"]
            ],
        )
        for name, message in result.worth.items():
            typer.echo(f"{name}: {message}")
    for file in files:
        (note if json_ else typer.echo)(file)


def _cell(value: Any) -> str:
    return "-" if value is None or value == "" else value if isinstance(value, str) else f"{value:.3g}"
