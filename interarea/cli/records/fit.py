"""The command `fit`: a machine with its controls beside a record, and parameters fitted to it."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated

import typer

from ...command_usage import ABOVE_0_S, naming
from ..terminal import busy, note, print_table
from .options import RecordFile, Units, Window, opened

if TYPE_CHECKING:
    from interarea.cosim.records.fit import Fit


def fit(
    file: RecordFile,
    case: Annotated[
        str,
        typer.Option(
            "--case",
            metavar="CASE",
            help="bundled case or TOML file with the machine",
            callback=naming("case"),
        ),
    ],
    machine: Annotated[
        str, typer.Option("--machine", metavar="NAME", help="machine of the case that was recorded")
    ],
    parameters: Annotated[
        str, typer.Option("--parameters", metavar="KEY,KEY", help="such as H,exciter.KA; none: no fit")
    ] = "",
    rest: Annotated[
        float,
        typer.Option(
            "--rest",
            metavar="S",
            help="duration of the steady state at the start of the record, s",
            callback=ABOVE_0_S,
        ),
    ] = 0.5,
    window: Window = None,
    unit: Units = None,
    json_: Annotated[bool, typer.Option("--json", help="print JSON instead of a table")] = False,
) -> None:
    """Apply a record to a single machine with its controls; fit its parameters; name undetermined ones."""
    from interarea.models.case.case import load_case

    grid = load_case(case)
    record = opened(file, window, unit, grid)
    keys = [key.strip() for key in parameters.split(",")] if parameters else []
    from interarea.records import fit as fitted

    with busy(f"{machine} compared with {file.name}"):
        result = fitted(record, grid, machine, keys, rest_s=rest)
    for line in result.notes[len(record.notes) :]:
        note(f"{file.name}: {line}")
    if json_:
        typer.echo(json.dumps(result.as_dict(), indent=2, allow_nan=False))
        return
    _print(result)


def _print(result: Fit) -> None:
    if result.parameters:
        rows = [
            (
                p.name,
                f"{p.start:.5g}",
                f"{p.value:.5g}",
                f"{p.deviation:.2g}",
                f"{p.interval[0]:.5g} to {p.interval[1]:.5g}",
            )
            for p in result.parameters
        ]
        title = f"{result.machine} fitted to {result.source}; intervals of 95 %"
        print_table(title, ("parameter", "in the case", "fitted", "deviation", "interval"), rows)
    for name, why in result.kept_as_is.items():
        typer.echo(f"{name}: {why}")
    words = "; fitted: P {:.1%}, Q {:.1%}".format(*result.fitted) if result.parameters else ""
    typer.echo("misfit relative to the variation: P {:.1%}, Q {:.1%}".format(*result.misfit) + words)
