"""The command `study`: the whole study of a case."""

from __future__ import annotations

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
) -> None:
    """Run a whole study: FMUs, designs, co-simulations, figures, report.html and study.json."""
    from interarea.cosim.designs.acceptance import first_failures, kept_certificate
    from interarea.cosim.scenario.names import CONTROLLER_NAMES
    from interarea.cosim.study.study import STAGES, run_study

    from .destination import folder_for

    folder_for(out)
    with stage_progress(STAGES) as progress:
        summary = run_study(name, out, progress, second_solver=second_solver)
    typer.echo(out / "study.json")
    typer.echo(out / "report.html")
    verdicts = [row["verdict"] for row in summary.get("printed", {}).get("verdicts", [])]
    counts = ", ".join(f"{verdicts.count(k)} {k}" for k in ("agrees", "partly", "differs"))
    note(f"printed statements: {counts}")
    for controller in CONTROLLER_NAMES:
        known = kept_certificate(controller, summary["provenance"]["case_hash"])
        note(f"{controller}: {first_failures(known)}")
