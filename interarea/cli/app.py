"""The command `interarea`: results on stdout, progress on stderr, a user's mistake in one line."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from .cache import cache
from .check import check
from .design import certify, design
from .explore import explore
from .export import build, container, ssp
from .grids import export, import_grid
from .listing import list_bundled
from .modes import modes
from .run import run
from .sweep import maps, sweep
from .terminal import busy, complain, print_table, stage_progress, steady_streams

if TYPE_CHECKING:
    import control

    from interarea.design.modes.modes import Modes
    from interarea.models.case.case import Case

INTERRUPTED = 130  #: exit code after Ctrl-C, as shells have it

app = typer.Typer(
    name="interarea",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

CaseName = Annotated[
    str, typer.Argument(metavar="CASE", help="bundled case or TOML file", show_default=False)
]
OutFolder = Annotated[
    Path, typer.Option("--out", metavar="DIR", help="folder for the results", show_default=False)
]
AsJson = Annotated[bool, typer.Option("--json", help="print JSON instead of a table")]


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"interarea {version('interarea')}")
        raise typer.Exit


@app.callback()
def program(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="print the version")
    ] = False,
) -> None:
    """Wide-area damping of inter-area oscillations: plant and controllers as FMUs, co-simulated."""


app.command("list")(list_bundled)


@app.command()
def cases(json_: AsJson = False) -> None:
    """List the bundled cases."""
    from interarea.models.case.case import case_names, load_case

    rows = {}
    for name in case_names():
        case = load_case(name)
        rows[name] = {"title": case.title, "machines": len(case.machines), "buses": len(case.buses)}
    if json_:
        return _print_json(rows)
    print_table(
        "bundled cases",
        ("case", "machines", "buses", "title"),
        [(n, str(r["machines"]), str(r["buses"]), str(r["title"])) for n, r in rows.items()],
    )
    return None


@app.command()
def loops(case: CaseName, json_: AsJson = False) -> None:
    """Rank actuators and signals for the inter-area mode of a case."""
    from interarea.cosim.study.rows import loop_rows
    from interarea.design.linear.linearise import remove_reference
    from interarea.design.modes.loop_selection import rank_loops
    from interarea.design.modes.modes import modes_of

    loaded, system, _ = _modes(case)
    relative = remove_reference(system)
    mode = modes_of(relative, loaded.areas).inter_area
    ranked = loop_rows(rank_loops(relative, mode, areas=loaded.areas))
    if json_:
        return _print_json({"case": loaded.name, **ranked})
    print_table(
        f"{loaded.name}: loops for the inter-area mode",
        ("actuator", "signal", "index", "geometric"),
        [
            (r["actuator"], r["signal"], f"{r['index']:.4f}", f"{r['geometric']:.4f}")
            for r in ranked["ranking"]
        ],
    )
    for line in ranked["coordinates"].split("; "):  # what the two columns are
        typer.echo(line)
    return None


@app.command()
def study(
    out: OutFolder,
    name: Annotated[str, typer.Argument(metavar="NAME", help="bundled study or TOML file")] = "thesis",
) -> None:
    """Run a whole study: FMUs, designs, co-simulations, figures, report.html and study.json."""
    from interarea.cosim.study.study import STAGES, run_study

    from .destination import folder_for

    folder_for(out)
    with stage_progress(STAGES) as progress:
        summary = run_study(name, out, progress)
    typer.echo(out / "study.json")
    typer.echo(out / "report.html")
    verdicts = [row["verdict"] for row in summary.get("printed", {}).get("verdicts", [])]
    counts = ", ".join(f"{verdicts.count(k)} {k}" for k in ("agrees", "partly", "differs"))
    typer.echo(f"printed statements: {counts}", err=True)


app.command()(modes)
app.command("import")(import_grid)
app.command()(export)
app.command()(run)
app.command()(design)
app.command()(certify)
app.command()(check)
app.command()(build)
app.command()(ssp)
app.command()(container)
app.command()(explore)
app.command()(sweep)
app.command()(maps)
app.command()(cache)


def _modes(name: str) -> tuple[Case, control.StateSpace, Modes]:
    from interarea.cosim.run.artefacts import linear_plant
    from interarea.design.modes.modes import modes_of
    from interarea.fmu_build.write.cache import default_cache
    from interarea.models.case.case import load_case

    with busy(f"linearising the plant FMU of {name}"):
        case = load_case(name)
        system = linear_plant(case, default_cache())
        return case, system, modes_of(system, case.areas)


def _print_json(value: Mapping[str, Any]) -> None:
    typer.echo(json.dumps(value, indent=2, allow_nan=False))


def main() -> None:
    """Run the command line: exit code 0, 2 for a mistake of the user, 1 for a fault of ours."""
    steady_streams()
    try:
        app()
    except KeyboardInterrupt:
        _stopped()
    except SystemExit as ended:
        if ended.code == INTERRUPTED:
            _stopped()
        raise
    except Exception as error:  # the one place where every error ends as one line
        sys.exit(complain(error))


def _stopped() -> NoReturn:
    print("interarea: stopped", file=sys.stderr)
    sys.exit(INTERRUPTED)


if __name__ == "__main__":
    main()
