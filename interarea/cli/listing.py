"""The command `list`: what comes with the program and can be named without a path."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import Annotated

import typer

from interarea.models.bundled import bundled
from interarea.models.files import read_text

from .terminal import print_table

AsJson = Annotated[bool, typer.Option("--json", help="print JSON instead of a table")]


def list_bundled(
    json_: Annotated[bool, typer.Option("--json", help="print JSON instead of a table")] = False,
) -> None:
    """List everything bundled: cases, scenarios, controllers, designs, studies, and their commands."""
    result = titles()
    if json_:
        typer.echo(json.dumps(result, indent=2))
        return
    print_table(
        "what can be named without a path",
        ("kind", "name", "what it is"),
        [
            (kind if k == 0 else "", name, title)
            for kind, rows in result.items()
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


#: controllers that are designed for a case when they are asked for
DESIGNED = {
    "wdc": "the study's wide-area damping controller, designed for the case when it is asked for",
    "cc": "the study's conventional controller, likewise",
    "ftc": "the study's fault-tolerant controller, likewise",
}


def bundled_files() -> dict[str, dict[str, Path]]:
    """Return kind -> name -> file of all that is bundled; what is `DESIGNED` has none."""
    kinds = {"cases": "case", "scenarios": "scenario", "controllers": "controller"}
    kinds |= {"designs": "design", "studies": "study"}
    return {plural: bundled(kind) for plural, kind in kinds.items()}


def titles() -> dict[str, dict[str, str]]:
    """Return kind -> name -> title of all that is bundled; of each file as little is read as that needs."""
    files = bundled_files()
    return {
        "cases": {name: _title(p) for name, p in files["cases"].items()},
        "scenarios": {name: _title(p) for name, p in files["scenarios"].items()},
        "controllers": DESIGNED | {name: _order(p) for name, p in files["controllers"].items()},
        "designs": {name: f"how {name} was designed: {_family(p)}" for name, p in files["designs"].items()},
        "studies": {name: _title(p) for name, p in files["studies"].items()},
    }


def _order(file: Path) -> str:
    record = json.loads(file.read_text(encoding="utf-8"))
    members = record.get("members", ())
    what = f"a bank of {len(members)} controllers, one for each set of signals" if members else ""
    what = what or f"order {len(record['A'])}"
    return f"shipped for {record['design']['specification']['case']}, {what}"


def _title(file: Path) -> str:
    """Return the title of a TOML file, which is before the first table."""
    head = re.split(r"^\[", read_text(file), maxsplit=1, flags=re.MULTILINE)[0]
    return str(tomllib.loads(head).get("title", ""))


def _family(file: Path) -> str:
    table = tomllib.loads(file.read_text(encoding="utf-8"))
    return f"{len(table['point'])} operating points, {len(table['conditions'])} conditions each"


def cases(json_: AsJson = False) -> None:
    """List the bundled cases."""
    from interarea.models.case.case import case_names, load_case

    rows = {}
    for name in case_names():
        case = load_case(name)
        rows[name] = {"title": case.title, "machines": len(case.machines), "buses": len(case.buses)}
    if json_:
        typer.echo(json.dumps(rows, indent=2))
        return
    print_table(
        "bundled cases",
        ("case", "machines", "buses", "title"),
        [(n, str(r["machines"]), str(r["buses"]), str(r["title"])) for n, r in rows.items()],
    )
