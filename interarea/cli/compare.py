"""interarea compare: one scenario with several controllers, on one page."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .terminal import note, print_table, stage_progress

if TYPE_CHECKING:
    from interarea.cosim.scenario.scenario import Scenario

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
        folder_for(out)
    from interarea.cosim.scenario.scenario import load_scenario

    loaded = load_scenario(scenario)
    # a mistake in the file is reported before what runs it is loaded
    from interarea.cosim.results.record import write_json
    from interarea.cosim.run.compare import compare_controllers, write_comparison
    from interarea.fmu_build.write.cache import default_cache
    from interarea.models.files import together

    with stage_progress(controllers) as progress:
        stages = {Path(c).stem if Path(c).suffix else c: c for c in controllers}
        result = compare_controllers(
            loaded,
            controllers,
            cache=default_cache(),
            progress=lambda name, done: progress(stages[name], done),
        )
    rows = [one.row() for one in result]
    worth = _worth(loaded, controllers)
    document = {
        "scenario": loaded.name,
        "controllers": rows,
        "roots": {o.name: o.roots() for o in result},
        "worth": worth,
    }
    files: list[Path] = []
    if out is not None:
        command = shlex.join(
            ["interarea", "compare", *controllers, "--scenario", scenario, "--out", str(out)]
        )
        with together():
            for one in result:
                one.run.save(out / one.name)
            files = [out / "compare.json", write_comparison(result, loaded, out / "compare.html", command)]
            write_json(document, files[0])
    if json_:
        typer.echo(json.dumps(document, indent=2, allow_nan=False))
    else:
        print_table(
            f"{loaded.title or loaded.name} (roots of the linear loop where known)",
            ("controller", "verdict", *_COLUMNS.values()),
            [(r["controller"], r["verdict"], *map(_cell, (r[k] for k in _COLUMNS))) for r in rows],
        )
        for name, message in worth.items():
            typer.echo(f"{name}: {message}")
    for file in files:
        (note if json_ else typer.echo)(file)


def _worth(scenario: Scenario, controllers: list[str]) -> dict[str, str]:
    """Return controller -> what its signals are worth in the linear loop of the scenario, in a sentence."""
    from interarea.cosim.designs.worth import worth_at
    from interarea.design.controllers.controller import Controller
    from interarea.fmu_build.write.cache import default_cache
    from interarea.synthesis import load_controller

    case = scenario.load_case()
    late = {c.signal: c.latency_s for c in scenario.channels.values()}
    sentences = {}
    for name in controllers:
        loaded = None if name == "none" else load_controller(name, case=case)
        if isinstance(loaded, Controller):
            sentences[loaded.name] = worth_at(case, loaded, default_cache(), latency_s_of=late).sentence
    return sentences


def _cell(value: Any) -> str:
    return "-" if value is None or value == "" else value if isinstance(value, str) else f"{value:.3g}"
