"""Commands `sweep`, `maps` and `screen`: many runs of one scenario, and what they show."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from interarea.cosim.errors import SweepError
from interarea.models.bundled import bundled_elsewhere
from interarea.models.documents import require_regular
from interarea.progress import tell_runs

from ..command_usage import ABOVE_0_S, naming, within
from .study import OutFolder
from .terminal import busy, stage_progress

if TYPE_CHECKING:
    from interarea.cosim.screen.screening import Screened, Screening
    from interarea.cosim.sweep.front import Progress

Workers = Annotated[
    int | None,
    typer.Option(
        "--workers",
        metavar="N",
        help="processes; default: one for each core",
        show_default=False,
        callback=within(least=1),
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option("--scheduler", metavar="tcp://HOST:PORT", help="dask scheduler whose workers compute"),
]
_ADDRESS = re.compile(r"[a-z]+://[^/\s]+:\d+")


def sweep(
    spec: Annotated[Path, typer.Argument(metavar="SWEEP.toml", help="sweep file", show_default=False)],
    out: OutFolder,
    workers: Workers = None,
    scheduler: Scheduler = None,
    retry: Annotated[
        str | None, typer.Option("--retry", metavar="failed", help="also repeat runs that failed before")
    ] = None,
    large: Annotated[bool, typer.Option("--large", help="confirm a very large number of runs")] = False,
    json_: Annotated[bool, typer.Option("--json", help="print JSON instead of lines")] = False,
) -> None:
    """Run a scenario over many parameters; an interrupted sweep resumes."""
    from .destination import folder_for

    check_workers(workers, scheduler)
    if retry not in (None, "failed"):
        raise SweepError(f"--retry = {retry}, allowed: failed")
    folder_for(out)
    if not spec.exists() and (other := bundled_elsewhere(str(spec), "sweep")) is not None:
        raise SweepError(f"{spec} {other}")
    require_regular(spec, "a sweep file", SweepError)  # before what takes seconds to load
    from interarea.cosim.sweep.spec import load_sweep

    loaded = load_sweep(spec)
    _require_regular_plan(out)
    from interarea.cosim.sweep.front import run_sweep

    with sweeping(out) as show:
        summary = run_sweep(
            loaded,
            out,
            workers=workers,
            scheduler=scheduler,
            large=large,
            progress=show,
            retry="failed" if retry else None,
        )
    if summary["failed"]:
        print(_commonest(out), file=sys.stderr)
    if json_:
        typer.echo(json.dumps({**summary, "folder": str(out)}, indent=2))
    else:
        _tell(summary)
        typer.echo(out)
    if not summary["ok"]:
        raise typer.Exit(1)


def _require_regular_plan(folder: Path) -> None:
    """Refuse folders and devices in the places of the files that say of what sweep the results are."""
    for file in (folder / "manifest.json", folder / "sweep.json"):
        if file.exists():
            require_regular(file, "a file of a sweep's results", SweepError)


def _tell(summary: Mapping[str, Any]) -> None:
    failures = ", ".join(f"{count} {kind}" for kind, count in summary["failures"].items())
    typer.echo(
        f"{summary['runs']} runs: {summary['ok']} ok ({summary['stable']} stable, "
        f"{summary['unstable']} not), {summary['failed']} failed{f' ({failures})' if failures else ''}"
        + (f"; {summary['forked']} continued from a saved state" if summary["forked"] else "")
    )


def check_workers(workers: int | None, scheduler: str | None) -> None:
    """Refuse what cannot compute, before anything is begun."""
    if workers is not None and scheduler is not None:
        raise SweepError(
            "--workers and --scheduler: the scheduler has its own workers, allowed: one of the two"
        )
    if scheduler is not None and not _ADDRESS.fullmatch(scheduler):
        raise SweepError(
            f"--scheduler = {scheduler}, allowed: tcp://HOST:PORT, as `dask scheduler` prints it"
        )


def _commonest(out: Path) -> str:
    """Return why most of the runs that failed did."""
    from interarea.cosim.sweep.parts import read_rows

    rows = read_rows(out)
    reasons = rows.loc[rows.status == "failed", "reason"].value_counts()
    return f"most frequent reason, {reasons.iloc[0]} of {reasons.sum()}: {reasons.index[0]}"


def maps(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="results of a sweep", show_default=False)],
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="FILE.html", help="default: DIR/maps.html", show_default=False),
    ] = None,
    worst: Annotated[
        int,
        typer.Option(
            "--worst", metavar="N", help="number of worst runs to draw", callback=within(least=0, most=50)
        ),
    ] = 6,
    workers: Workers = None,
    json_: Annotated[bool, typer.Option("--json", help="print JSON instead of the page's name")] = False,
) -> None:
    """Draw the maps of a sweep on one page: stability, certified and simulated margins, worst runs."""
    from .destination import file_for

    if folder.exists() and not folder.is_dir():
        raise SweepError(f"{folder}: is a file, wanted: the folder of a sweep's results (its --out)")
    if not folder.exists():
        raise SweepError(f"{folder}: no such folder, wanted: that of a sweep's results (its --out)")
    page = file_for(out or folder / "maps.html", suffix=".html")
    _require_regular_plan(folder)
    from interarea.cosim.maps.page import STEPS, explorer_beside, write_maps

    file_for(explorer_beside(page))
    with stage_progress(STEPS) as report:
        page = write_maps(folder, page, worst=worst, workers=workers, progress=report)
    if json_:
        from interarea.cosim.sweep.parts import summary_of

        typer.echo(json.dumps({"page": str(page), "runs": summary_of(folder)}, indent=2))
    else:
        typer.echo(page)


def screen(
    grid: Annotated[
        str,
        typer.Argument(
            metavar="GRID",
            help="case: bundled name or file",
            show_default=False,
            callback=naming("case"),
        ),
    ],
    out: OutFolder,
    trips: Annotated[bool, typer.Option("--trips", help="trip each branch instead of a fault")] = False,
    bus: Annotated[
        list[int] | None, typer.Option("--bus", metavar="NUMBER", help="only this bus; repeatable")
    ] = None,
    branch: Annotated[
        list[str] | None,
        typer.Option("--branch", metavar="NAME", help="only this branch, with --trips; repeatable"),
    ] = None,
    outage: Annotated[
        list[str] | None,
        typer.Option("--outage", metavar="BRANCH", help="also with this branch out; repeatable"),
    ] = None,
    controller: Annotated[
        list[str] | None,
        typer.Option(
            "--controller",
            metavar="NAME",
            help="in addition to none; repeatable",
            callback=naming("controller"),
        ),
    ] = None,
    clearing: Annotated[
        str, typer.Option("--clearing", metavar="TIME", help='of a fault: "6 cycles" or "0.1 s"')
    ] = "6 cycles",
    clearing_times: Annotated[
        bool, typer.Option("--clearing-times", help="search the longest fault that keeps synchronism")
    ] = False,
    stop: Annotated[
        float, typer.Option("--stop", metavar="S", help="length of a run", callback=ABOVE_0_S)
    ] = 10.0,
    step: Annotated[
        float | None,
        typer.Option(
            "--step",
            metavar="S",
            help="communication step; default: 0.04, less with a controller",
            callback=ABOVE_0_S,
        ),
    ] = None,
    solver_step: Annotated[
        float | None,
        typer.Option(
            "--solver-step",
            metavar="S",
            help="longest step of the plant; default: its own, with 100 runs or more the longest of 10, 5 "
            "and 2.5 ms that leaves the results of three of them unchanged",
            callback=ABOVE_0_S,
        ),
    ] = None,
    explore: Annotated[
        bool,
        typer.Option("--explore", help="also write explorer.html: each disturbance as an interactive page"),
    ] = False,
    workers: Workers = None,
    scheduler: Scheduler = None,
    json_: Annotated[bool, typer.Option("--json", help="print JSON instead of lines")] = False,
) -> None:
    """Fault every bus of a grid, or trip every branch; write one page, worst first, with clearing times.

    The exit code is 1 if every run of a controller fails.
    """
    from interarea.cosim.screen.page import Explorer, write_grid, write_screening
    from interarea.cosim.screen.screening import Screening, run_screening
    from interarea.fmu_build.write.cache import default_cache

    from .destination import folder_for

    check_workers(workers, scheduler)
    if (bus and trips) or (branch and not trips):
        raise SweepError("--bus belongs to faults and --branch to --trips, allowed: the matching one")
    pages = ("screen.json", "screen.csv", "screen.html", *(["explorer.html"] if explore else []))
    folder_for(out, files=pages)
    case = Screening(grid).load()
    screening = Screening(
        case=grid,
        kind="trip" if trips else "fault",
        buses=tuple(bus or ()),
        branches=tuple(branch or ()),
        outages=tuple(outage or ()),
        controllers=tuple(controller or ()),
        clearing_s=_seconds(clearing, case.frequency_hz),
        stop_s=stop,
        step_s=step,
        solver_step_s=solver_step,
    )
    options: dict[str, Any] = {"workers": workers, "scheduler": scheduler, "case": case}
    screening = _with_step(screening, out, tell=not json_, **options)
    with sweeping(out) as show:
        result = run_screening(screening, out, clearing=clearing_times, progress=show, **options)
    explorer = Explorer()
    if explore:
        with busy(f"writing {out / 'explorer.html'}"):
            explorer = write_grid(screening, out, default_cache())
    page = write_screening(screening, result, out, explorer)
    if json_:
        rows = json.loads(page.with_suffix(".json").read_text(encoding="utf-8"))
        typer.echo(json.dumps({"page": str(page), **rows}, indent=2, allow_nan=False))
    else:
        _tell_losses(result)
        typer.echo(page)
    if _none_ran(result):
        raise typer.Exit(1)


def _with_step(screening: Screening, out: Path, *, tell: bool, **options: Any) -> Screening:
    """Return the screening with the plant's step where that is chosen; `tell`: print why that one."""
    from interarea.cosim.screen.solver_step import choose_step

    with sweeping(out) as show:
        choice = choose_step(screening, out, progress=show, **options)
    if choice is None:
        return screening
    if tell:
        typer.echo(str(choice))
    return replace(
        screening, solver_step_s=choice.step_s, step_reason=str(choice), repeat_step_s=choice.own_s
    )


def _none_ran(result: Sequence[Screened]) -> bool:
    """Whether every run of a controller failed."""
    ran = {one.controller for one in result if one.verdict != "failed"}
    return any(one.controller not in ran for one in result)


def _tell_losses(result: Sequence[Screened]) -> None:
    """Print with each controller how many of the events lose synchronism."""
    from interarea.cosim.screen.page import NO_SUCCESS

    for name in dict.fromkeys(one.controller for one in result):
        own = [one for one in result if one.controller == name]
        reasons = [one.reason for one in own if one.verdict == "failed"]
        failed = f", {len(reasons)} failed, first reason: {reasons[0]}" if reasons else ""
        swinging = sum(one.came_to in NO_SUCCESS for one in own)
        swings = f", {swinging} keep synchronism with a swing that does not decay" if swinging else ""
        lost = sum(one.verdict == "lost" for one in own)
        count = f"{lost} of {len(own) - len(reasons)} lose synchronism"
        typer.echo(f"controller {name}: {count}{swings}{failed}")


def _seconds(text: str, frequency_hz: float) -> float:
    """Return a time in words, of the grid's frequency where it is in cycles."""
    from interarea.models.documents import in_seconds

    time = in_seconds({"clearing_s": text}, lambda: frequency_hz)["clearing_s"]
    if isinstance(time, str) or not time > 0.0:
        raise SweepError(
            f'--clearing = {text}, allowed: a time above 0 such as "6 cycles", "100 ms", "0.1 s"'
        )
    return float(time)


@contextmanager
def sweeping(out: Path) -> Iterator[Callable[[Progress], None]]:
    """Show how many runs are done; on an interruption say that it continues with what is in `out`."""
    with stage_progress(("runs",)) as report:
        try:
            yield partial(tell_runs, report)
        except KeyboardInterrupt:
            print(f"the same command resumes from the results in {out}", file=sys.stderr)
            raise
