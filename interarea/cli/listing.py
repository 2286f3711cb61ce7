"""The command `list`: what comes with the program and can be named without a path."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated

import typer

from .terminal import print_table

if TYPE_CHECKING:
    from interarea.cosim.designs.design_file import DesignTable


def list_bundled(
    json_: Annotated[bool, typer.Option("--json", help="print JSON instead of a table")] = False,
) -> None:
    """List what is bundled: cases, scenarios, controllers, designs, studies, and what takes them."""
    found = bundled()
    if json_:
        typer.echo(json.dumps(found, indent=2))
        return
    print_table(
        "what can be named without a path",
        ("kind", "name", "what it is"),
        [
            (kind if k == 0 else "", name, title)
            for kind, rows in found.items()
            for k, (name, title) in enumerate(rows.items())
        ],
    )
    for kind, commands in COMMANDS.items():
        typer.echo(f"{kind + ':':<12} {commands}")


#: kind -> where its names go
COMMANDS = {
    "cases": "interarea modes | loops | export | build CASE; case = in a scenario",
    "scenarios": "interarea run | ssp | container SCENARIO",
    "controllers": "interarea certify CONTROLLER | build CASE --controller; controller = in a scenario",
    "designs": "interarea design DESIGN --out FILE.json",
    "studies": "interarea study STUDY --out DIR",
}


def bundled() -> dict[str, dict[str, str]]:
    """Return kind -> name -> title of all that is bundled."""
    from interarea.cosim.designs.design_file import design_names, load_design
    from interarea.cosim.scenario.scenario import load_scenario, scenario_names
    from interarea.cosim.study.spec import load_study, study_names
    from interarea.design.controllers.bundled import shipped_controller, shipped_names
    from interarea.models.case.case import case_names, load_case

    return {
        "cases": {name: load_case(name).title for name in case_names()},
        "scenarios": {name: load_scenario(name).title for name in scenario_names()},
        "controllers": {
            "wdc": "the study's wide-area damping controller, designed for the case when it is asked for",
            "cc": "the study's conventional controller, likewise",
            "ftc": "the study's fault-tolerant controller, likewise",
            "active": "a bank of controllers behind a supervisor that follows lost signals",
            **{name: _order(shipped_controller(name).system.nstates) for name in shipped_names()},
        },
        "designs": {
            name: f"how {name} was designed: {_family(load_design(name))}" for name in design_names()
        },
        "studies": {name: str(load_study(name)["title"]) for name in study_names()},
    }


def _order(states: int) -> str:
    return f"shipped for two-area-thesis, order {states}"


def _family(table: DesignTable) -> str:
    return f"{len(table.point)} operating points, {len(table.conditions)} conditions each"
