"""interarea explore: a scenario's loop in one HTML page, to drag and see."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .terminal import busy


def explore(
    out: Annotated[
        Path, typer.Option("--out", metavar="FILE.html", help="page to write", show_default=False)
    ],
    subject: Annotated[
        str, typer.Argument(metavar="SCENARIO | CASE", help="a file, or a bundled name of either")
    ] = "two-area-thesis",
) -> None:
    """Write one HTML file in which the loop runs: drag delay, loss, controller or fault, and see.

    It needs no server and no network: the simulation is the container's C as WebAssembly.
    """
    from interarea.cosim.explorer.page import write_explorer
    from interarea.fmu_build.write.cache import default_cache

    from .destination import file_for

    file_for(out, suffix=".html")
    with busy(f"writing {out}"):
        made = write_explorer(subject, out, cache=default_cache())
    typer.echo(made)
