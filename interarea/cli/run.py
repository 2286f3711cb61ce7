"""interarea run: one scenario, how it is stepped, and whether its delays are those stated."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .terminal import busy, note

if TYPE_CHECKING:
    from interarea.cosim.results.latency_test import SelfTest
    from interarea.cosim.scenario.scenario import Scenario
    from interarea.models.case.case import Case


def run(
    scenario: Annotated[
        str,
        typer.Argument(metavar="SCENARIO.toml", help="scenario file, or a bundled name", show_default=False),
    ],
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="folder for the results", show_default=False)
    ] = None,
    explain: Annotated[
        bool, typer.Option("--explain", help="print step, stepping order, delay and packet ledgers")
    ] = False,
    explore: Annotated[
        bool, typer.Option("--explore", help="write explorer.html too: the run as a page to drag")
    ] = False,
    self_test: Annotated[
        bool,
        typer.Option(
            "--self-test", help="measure the latency of every connection; exit code 1 if not as stated"
        ),
    ] = False,
) -> None:
    """Co-simulate one scenario; writes trajectory, ledgers, metrics and a plot.

    With --self-test and no --out only the self-test is done.
    """
    from interarea.cosim.scenario.scenario import load_scenario

    from .destination import folder_for

    if out is None and not self_test:
        raise typer.BadParameter("a folder for the results is needed, or --self-test", param_hint="--out")
    if out is not None:
        folder_for(out)
    loaded = load_scenario(scenario)
    # a mistake in the file is told before what runs it is loaded
    from interarea.cosim.export.joint import run_joint
    from interarea.cosim.results.run import Run
    from interarea.cosim.run.run import run_system
    from interarea.fmu_build.write.cache import default_cache

    tested = None
    if self_test:
        with busy(f"measuring the connections of {scenario}"):
            tested = _tested(loaded)
        typer.echo(tested)
    if out is not None:
        with busy(f"running {scenario}"):
            run_it = run_joint if loaded.master.joint else run_system
            result = run_it(loaded, cache=default_cache())
            files = result.save(out)
        if explore:
            from interarea.cosim.explorer.page import write_explorer

            with busy(f"writing {out / 'explorer.html'}"):
                files.append(write_explorer(loaded, out / "explorer.html", cache=default_cache()))
        if explain:
            typer.echo(result.explain())
        for file in files:
            typer.echo(file)
        if isinstance(result, Run):
            note(result.summary)
            if loaded.controller != "none":
                typer.echo(_survived(loaded, loaded.as_given(result.case)), err=True)
    if tested is not None and not tested.passed:
        raise typer.Exit(1)


def _tested(scenario: Scenario) -> SelfTest:
    from interarea.cosim.run.run import system_of

    return system_of(scenario).self_test()


def _survived(scenario: Scenario, case: Case) -> str:
    """What the controller's record holds of losses, latencies and faults: a run shows one of them at most."""
    from interarea.cosim.designs.acceptance import first_failures, kept_certificate
    from interarea.cosim.run.controllers import controller_of
    from interarea.design.controllers.controller import ControllerError
    from interarea.fmu_build.write.cache import default_cache

    known = kept_certificate(scenario.controller, case.hash)
    if known is not None:
        return first_failures(known)
    try:
        made = controller_of(scenario.controller_path or scenario.controller, case, default_cache())
    except ControllerError:  # an FMU that is no linear controller: no record
        made = None
    return first_failures(made and made.certificate)
