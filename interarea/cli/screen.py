"""Command `screen`: a fault at each bus of a grid, or a trip of each branch, worst first."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Annotated

import typer

from interarea.cosim.errors import SweepError


def screen(
    grid: Annotated[
        str, typer.Argument(metavar="GRID", help="case: bundled name or file", show_default=False)
    ],
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="folder for the results", show_default=False)
    ],
    trips: Annotated[bool, typer.Option("--trips", help="open each branch in place of faults")] = False,
    bus: Annotated[
        list[int] | None, typer.Option("--bus", metavar="NUMBER", help="only this bus; may be repeated")
    ] = None,
    branch: Annotated[
        list[str] | None,
        typer.Option("--branch", metavar="NAME", help="only this branch, with --trips; may be repeated"),
    ] = None,
    outage: Annotated[
        list[str] | None,
        typer.Option("--outage", metavar="BRANCH", help="once more with this one out; may be repeated"),
    ] = None,
    controller: Annotated[
        list[str] | None,
        typer.Option("--controller", metavar="NAME", help="beside none; may be repeated"),
    ] = None,
    clearing: Annotated[
        str, typer.Option("--clearing", metavar="TIME", help='of a fault: "6 cycles" or "0.1 s"')
    ] = "6 cycles",
    clearing_times: Annotated[
        bool, typer.Option("--clearing-times", help="search the longest fault that keeps synchronism")
    ] = False,
    stop: Annotated[float, typer.Option("--stop", metavar="S", help="length of a run")] = 10.0,
    step: Annotated[
        float | None,
        typer.Option("--step", metavar="S", help="communication step; default: 0.04, less with a controller"),
    ] = None,
    solver_step: Annotated[
        float | None,
        typer.Option("--solver-step", metavar="S", help="longest step of the plant; default: its own"),
    ] = None,
    workers: Annotated[
        int | None, typer.Option("--workers", metavar="N", help="processes; default: one for each core")
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option("--scheduler", metavar="tcp://HOST:PORT", help="dask scheduler whose workers compute"),
    ] = None,
) -> None:
    """Fault every bus of a grid, or trip every branch; one page, worst first, with clearing times."""
    from interarea.cosim.screen.page import write_screening
    from interarea.cosim.screen.screening import Screening, run_screening

    from .destination import folder_for
    from .sweep import Display, check_workers

    check_workers(workers, scheduler)
    if (bus and trips) or (branch and not trips):
        raise SweepError("--bus is of faults and --branch of --trips, allowed: the one that fits")
    folder_for(out)
    screening = Screening(
        case=grid,
        kind="trip" if trips else "fault",
        buses=tuple(bus or ()),
        branches=tuple(branch or ()),
        outages=tuple(outage or ()),
        controllers=tuple(controller or ()),
        clearing_s=_seconds(clearing, grid),
        stop_s=stop,
        step_s=step,
        solver_step_s=solver_step,
    )
    show = Display()
    try:
        found = run_screening(
            screening, out, clearing=clearing_times, workers=workers, scheduler=scheduler, progress=show
        )
    except KeyboardInterrupt:
        show.end()
        print(f"the same command goes on with what is in {out}", file=sys.stderr)
        raise
    show.end()
    page = write_screening(screening, found, out)
    for name in dict.fromkeys(one.controller for one in found):
        mine = [one.verdict for one in found if one.controller == name]
        failed = f", {mine.count('failed')} failed" if "failed" in mine else ""
        typer.echo(f"controller {name}: {mine.count('lost')} of {len(mine)} lose synchronism{failed}")
    typer.echo(page)
    if all(one.verdict == "failed" for one in found):
        print(f"first reason: {found[0].reason}", file=sys.stderr)
        raise typer.Exit(1)


def _seconds(text: str, grid: str) -> float:
    """Return a time in words, of the grid's frequency where it is in cycles."""
    from interarea.cosim.scenario.scenario import load_scenario
    from interarea.models.case.case import load_case

    found = re.fullmatch(r"\s*(\d+(?:\.\d*)?)\s*(s|ms|cycles?)\s*", text)
    if found is None or not float(found[1]) > 0.0:
        raise SweepError(
            f'--clearing = {text}, allowed: a time above 0 such as "6 cycles", "100 ms", "0.1 s"'
        )
    if found[2] in ("s", "ms"):
        return float(found[1]) * (1.0 if found[2] == "s" else 1e-3)
    case = load_case(load_scenario({"case": grid, "stop_s": 1.0}).case_path)
    return float(found[1]) / case.frequency_hz
