"""Command `check`: an FMU or SSP, ours or not, held against the standards and its own description."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from .terminal import busy


def check(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="FMU or SSP file", show_default=False)],
    json_: Annotated[bool, typer.Option("--json", help="print JSON instead of lines")] = False,
    run: Annotated[
        bool, typer.Option("--run/--no-run", help="load the FMU's binary and see how it behaves")
    ] = True,
) -> None:
    """Check an FMU or SSP; one line per finding with its rule and fix; exit code 1 if there are any."""
    from interarea.fmu_build.check.check import check_file

    with busy(f"checking {file}"):
        report = check_file(file, run=run)
    if json_:
        typer.echo(json.dumps(report.as_dict(), indent=2))
    else:
        for finding in report.findings:
            typer.echo(finding.line())
        for note in report.notes:
            typer.echo(f"note: {note}", err=True)
        typer.echo(f"{file}: {report.verdict}")
    if not report.clean:
        raise typer.Exit(1)
