"""The command `study`: the whole study of a case."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from .terminal import note, stage_progress

OutFolder = Annotated[
    Path, typer.Option("--out", metavar="DIR", help="folder for the results", show_default=False)
]


def study(
    out: OutFolder,
    name: Annotated[str, typer.Argument(metavar="NAME", help="bundled study or TOML file")] = "thesis",
    second_solver: Annotated[
        bool, typer.Option(help="solve every LMI by cvxpy with Clarabel too, in a process beside")
    ] = True,
    json_: Annotated[bool, typer.Option("--json", help="print JSON instead of the files' names")] = False,
) -> None:
    """Run a whole study: FMUs, designs, co-simulations, figures, report.html and study.json."""
    from interarea.cosim.designs.certificate_words import first_failures, kept_certificate
    from interarea.cosim.scenario.names import CONTROLLER_NAMES
    from interarea.cosim.study.study import STAGES, run_study

    from .destination import folder_for

    folder_for(out)
    with stage_progress(STAGES) as progress:
        summary = run_study(name, out, progress, second_solver=second_solver)
    verdicts = [row["verdict"] for row in summary.get("printed", {}).get("verdicts", [])]
    count = {k: verdicts.count(k) for k in ("agrees", "partly", "differs")}
    files = [str(out / name) for name in ("study.json", "report.html")]
    if json_:
        typer.echo(json.dumps({"study": name, "statements": count, "files": files}, indent=2))
    else:
        for file in files:
            typer.echo(file)
    note(f"printed statements: {', '.join(f'{number} {verdict}' for verdict, number in count.items())}")
    for controller in CONTROLLER_NAMES:
        known = kept_certificate(controller, summary["provenance"]["case_hash"])
        note(f"{controller}: {first_failures(known)}")
