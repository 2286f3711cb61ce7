"""interarea run: one scenario, how it is stepped, and whether its delays are those stated."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..command_usage import UsageMistake
from .terminal import busy, note, say_warning, stage_progress

if TYPE_CHECKING:
    from interarea.cosim.results.latency_test import SelfTest
    from interarea.cosim.results.result import Result
    from interarea.cosim.scenario.scenario import Scenario
    from interarea.models.case.case import Case

_GUARDED = "INTERAREA_GUARDED"  #: in the environment of a run that has a process of its own: its parent's id
_FILES = (
    *("trajectory.csv", "trajectory.parquet", "ledger.json", "scenario.toml", "run.json", "fmu_log.txt"),
    *("metrics.json", "run.svg", "report.html"),
)
_OWN_S = 0.3  # in which a child that has got a terminal's signal itself ends


def run(
    scenario: Annotated[
        str,
        typer.Argument(
            metavar="SCENARIO", help="scenario file, SSP archive or bundled name", show_default=False
        ),
    ],
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="folder for the results", show_default=False)
    ] = None,
    explain: Annotated[
        bool, typer.Option("--explain", help="print step, stepping order, delay and packet ledgers")
    ] = False,
    explore: Annotated[
        bool, typer.Option("--explore", help="also write explorer.html: the run as an interactive page")
    ] = False,
    json_: Annotated[bool, typer.Option("--json", help="print the metrics as JSON, files on stderr")] = False,
    self_test: Annotated[
        bool,
        typer.Option(
            "--self-test", help="measure the latency of every connection; exit code 1 if it differs"
        ),
    ] = False,
    record: Annotated[
        list[str] | None,
        typer.Option("--record", metavar="NAME", help="signal or pattern to write; repeatable; default: all"),
    ] = None,
    every: Annotated[
        int | None, typer.Option("--every", min=1, metavar="N", help="write every N-th point, and the last")
    ] = None,
    strict: Annotated[
        bool | None,
        typer.Option("--strict", help="reject FMUs that violate the standard even without consequences"),
    ] = None,
) -> None:
    """Co-simulate one scenario; writes trajectory, ledgers, metrics and a plot.

    The exit code is 1 if the run is not as [expect] of the scenario states; each difference is printed.
    An SSP archive of any tool runs unchanged: start values, nested systems, third-party FMUs in a process
    each. Without --out it prints the delay and packet ledgers and one line of results, and writes nothing.
    With --self-test and no --out it runs the self-test only. --record, --every and --strict override the keys
    of the scenario with these names. The trajectory is written during the run.
    """
    from .destination import folder_for

    if out is None:
        _refuse_unused({"--explore": explore, "--record": record, "--every": every})
    else:
        folder_for(out, files=(*_FILES, "explorer.html"))
    code = _run_apart(Path(scenario), out)
    if code is not None:
        raise typer.Exit(code)
    from interarea.cosim.run.names import refuse_wrong_names
    from interarea.cosim.scenario.scenario import load_scenario

    provided = {"record": tuple(record) if record else None, "every": every, "strict": strict}
    loaded = load_scenario(scenario).model_copy(update={k: v for k, v in provided.items() if v is not None})
    refuse_wrong_names(loaded)
    tested, met = None, True
    if self_test:
        with busy(f"measuring the connections of {scenario}"):
            tested = _tested(loaded)
        typer.echo(tested)
    if out is not None:
        pages = []
        if explore:
            with busy(f"writing {out / 'explorer.html'}"):
                pages.append(_explored(loaded, out / "explorer.html"))
        with stage_progress((f"running {scenario}",)) as report:
            result, files = _written(loaded, out, partial(report, f"running {scenario}"), *pages)
        files += pages
        if explain:
            typer.echo(result.explain())
        met = _tell(loaded, result, files, json_)
    elif not self_test:
        met = _shown(loaded, explain=explain, json_=json_)
    if not met or (tested is not None and not tested.passed):
        raise typer.Exit(1)


def _refuse_unused(options: Mapping[str, object]) -> None:
    """Reject options about files if none is written."""
    for option, value in options.items():
        if value:
            raise UsageMistake(f"run: {option} needs a folder for the results, wanted: --out DIR")


def _shown(scenario: Scenario, *, explain: bool, json_: bool) -> bool:
    """Run a scenario and print what it gives, with its ledgers; return whether it is what is expected."""
    stage = f"running {scenario.name}"
    with stage_progress((stage,)) as report:
        result = _run(scenario, partial(report, stage))
    (note if json_ else typer.echo)(result.explain() if explain else f"{result.ledger}\n\n{result.packets}")
    met = _tell(scenario, result, [], json_)
    note("no files written; --out DIR writes trajectory, metrics, ledger and a page")
    return met


def _run(scenario: Scenario, tell: Callable[[float], object]) -> Result:
    """Run a scenario, in one FMU where it asks for that. tell : takes the share done, first once FMUs exist.

    What runs it is loaded here: a mistake in the file is reported before.
    """
    from interarea.cosim.export.joint import run_joint
    from interarea.cosim.run.run import run_system
    from interarea.fmu_build.write.cache import default_cache

    runs = run_joint if scenario.master.joint else run_system
    result: Result = runs(scenario, cache=default_cache(), progress=_shares(tell))
    tell(1.0)
    return result


def _written(
    scenario: Scenario, out: Path, tell: Callable[[float], object], explorer: Path | None = None
) -> tuple[Result, list[Path]]:
    """Do what `_run` does and write what it gives into `out`, the trajectory while it runs.

    explorer : the page beside it that the report links.
    """
    from interarea.cosim.plots.loading import load_plots

    load_plots()
    from interarea.cosim.results.run import Run
    from interarea.cosim.run.run import write_run
    from interarea.fmu_build.write.cache import default_cache

    link = "" if explorer is None else explorer.name
    if scenario.master.joint:
        result = _run(scenario, tell)
        assert isinstance(result, Run)  # it has a case
        return result, result.save(out, explorer=link)
    written = write_run(scenario, out, cache=default_cache(), progress=_shares(tell), explorer=link)
    tell(1.0)
    return written


def _shares(tell: Callable[[float], object]) -> Callable[[float, float], object]:
    return lambda now_s, end_s: tell(min(now_s / end_s, 0.99))


def _explored(scenario: Scenario, page: Path) -> Path:
    from interarea.cosim.explorer.page import write_explorer
    from interarea.fmu_build.write.cache import default_cache

    return write_explorer(scenario, page, cache=default_cache())


def _tell(scenario: Scenario, result: Result, files: list[Path], json_: bool) -> bool:
    """Print what a run has written, as JSON its metrics in their place, its warnings and what it shows.

    Return whether it did what the scenario expects.
    """
    from interarea.cosim.results.run import Run

    for file in files:
        (note if json_ else typer.echo)(file)
    if json_ and isinstance(result, Run):
        typer.echo(json.dumps(result.metrics.as_dict(), indent=2, allow_nan=False))
    for line in result.warnings:
        say_warning(line)
    if isinstance(result, Run):
        note(result.summary)
        if scenario.controller != "none":
            typer.echo(_survived(scenario, scenario.as_stated(result.case)), err=True)
    unmet = result.unmet if isinstance(result, Run) else ()
    for line in unmet:
        typer.echo(f"not as expected: {line}", err=True)
    return not unmet


def _third_party_fmus(scenario: Path) -> list[str]:
    """Names of the FMUs that this program did not write and that have no process of their own.

    Looks at the file itself: what checks and runs scenarios is loaded by the process that does.

    Raises
    ------
    ScenarioError : the file is no TOML, or plainly of another kind.
    """
    from interarea.cosim.errors import ScenarioError
    from interarea.cosim.toml_file import read_toml
    from interarea.fmu_build.open.archive import built_by_this_package

    # a bundled name; an SSP, whose FMUs have a process each; or what is wrong is said when it is loaded
    if not scenario.exists() or scenario.suffix.lower() == ".ssp":
        return []
    table = read_toml(scenario, "scenario", ScenarioError)
    tables = table.get("fmus")
    rows = tables.items() if isinstance(tables, dict) else ()
    files = {n: row.get("file") for n, row in rows if isinstance(row, dict) and not row.get("isolate")}
    files["controller"] = table.get("controller")
    paths = {n: scenario.parent / f for n, f in files.items() if isinstance(f, str) and f.endswith(".fmu")}
    return [name for name, path in paths.items() if path.is_file() and not built_by_this_package(path)]


def _run_apart(scenario: Path, out: Path | None) -> int | None:
    """Have a process of its own run what may crash it; return its exit code, None where this one has to."""
    foreign = _third_party_fmus(scenario)
    if not foreign:
        return None
    if _GUARDED in os.environ:
        from interarea.models.processes import end_with_parent

        end_with_parent(int(os.environ[_GUARDED]))
        return None
    note(f"{', '.join(foreign)}: third-party FMU, so the run has a separate process, which the FMU may crash")
    return _run_beside(foreign, out)


def _run_beside(foreign: list[str], out: Path | None) -> int:
    """Give this command to a process of its own; return its exit code.

    Raises StepError where something ended that process.
    """
    import signal
    import subprocess

    from interarea.cosim.errors import StepError

    command = [sys.executable, "-m", "interarea", *sys.argv[1:]]
    child = subprocess.Popen(command, env={**os.environ, _GUARDED: str(os.getpid())})
    stops: list[int] = []

    def pass_on(number: int, _frame: object) -> None:
        """Let the child end in order; Ctrl-C in a terminal has reached it already."""
        stops.append(number)
        time.sleep(_OWN_S)
        child.send_signal(number)

    names = [name for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
    numbers = [n for n in (getattr(signal, name) for name in names) if signal.getsignal(n) != signal.SIG_IGN]
    before = {number: signal.signal(number, pass_on) for number in numbers}
    try:
        code = child.wait()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if stops and code != 0:
        return 128 + stops[0]
    if 0 <= code < 256:
        return code
    if out is not None:
        from interarea.models.files import remove_left

        remove_left(out)
    try:
        what = signal.Signals(-code).name
    except ValueError:  # Windows: a number such as 0xC0000005
        what = f"code {code & 0xFFFFFFFF:#x}"
    raise StepError(
        f"the FMU ended the process of the run ({what})",
        instance=", ".join(foreign),
        call="the run",
        time_s=None,
        advice="with isolate = true the message names instance, call and time",
    )


def _tested(scenario: Scenario) -> SelfTest:
    from interarea.cosim.run.run import system_of

    return system_of(scenario).self_test()


def _survived(scenario: Scenario, case: Case) -> str:
    """What the controller's record holds of losses, latencies and faults: a run shows one of them at most."""
    from interarea.cosim.designs.certificate_words import bundled_certificate, first_failures
    from interarea.cosim.run.controllers import controller_of
    from interarea.design.controllers.controller import ControllerError
    from interarea.fmu_build.write.cache import default_cache

    known = bundled_certificate(scenario.controller, case.hash)
    if known is not None:
        return first_failures(known)
    try:
        controller = controller_of(scenario.controller_path or scenario.controller, case, default_cache())
    except ControllerError:  # an FMU that is no linear controller: no record
        controller = None
    return first_failures(None if controller is None else controller.certificate)
