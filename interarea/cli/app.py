"""The command `interarea`: results on stdout, progress on stderr, a user's mistake in one line.

A command's module is imported when the command is called: help and completion need the table below alone.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperCommand, TyperGroup

from .. import __version__
from .. import command_usage as usage
from ..command_help import SUMMARIES, last_lines
from .terminal import complain, say_warning, set_level, steady_streams

INTERRUPTED = 130  #: exit code after Ctrl-C, as shells have it; of another signal N 128 + N

#: command -> module:function, and the first line of its help (the function's docstring)
COMMANDS = {
    "list": (
        "listing:list_bundled",
        "List everything bundled: cases, scenarios, controllers, designs, studies, and their commands.",
    ),
    "cases": (
        "listing:cases",
        "List the bundled cases.",
    ),
    "show": (
        "new:show",
        "Print the file of a bundled case, scenario, controller, design or study, with its source.",
    ),
    "new": (
        "new:new",
        "Write a commented template: scenario, case, device, controller, design, sweep, study, ...",
    ),
    "device": (
        "new:device",
        "Show one device: diagram, equilibrium at an operating point, poles, step response.",
    ),
    "modes": (
        "modes:modes",
        "Linearise the plant FMU of a case, at an operating point of choice, and name its swing modes.",
    ),
    "loops": (
        "loops:loops",
        "Rank every signal at every actuator for the inter-area modes, or others of a band; any grid.",
    ),
    "run": (
        "run:run",
        "Co-simulate one scenario; writes trajectory, ledgers, metrics and a plot.",
    ),
    "compare": (
        "compare:compare",
        "Run one scenario with several controllers: metrics, curves and roots over latency on one page.",
    ),
    "sweep": (
        "sweep:sweep",
        "Run a scenario over many parameters; an interrupted sweep resumes.",
    ),
    "maps": (
        "sweep:maps",
        "Draw the maps of a sweep on one page: stability, certified and simulated margins, worst runs.",
    ),
    "screen": (
        "sweep:screen",
        "Fault every bus of a grid, or trip every branch; write one page, worst first, with clearing times.",
    ),
    "explore": (
        "export:explore",
        "Write one HTML file that simulates the loop, with adjustable delay, loss, controller and fault.",
    ),
    "design": (
        "design:design",
        "Design a controller from a design file or a grid; exit code 1 if it misses a requirement.",
    ),
    "certify": (
        "design:certify",
        "Recompute a controller's certificate on full linear plants, exact latency; exit code 1 if it fails.",
    ),
    "build": (
        "export:build",
        "Build the plant FMU of a case, complete: documentation, sources and cross-check files.",
    ),
    "ssp": (
        "export:ssp",
        "Write plant, channels, controller, connections and parameters of a scenario as an SSP 1.0 archive.",
    ),
    "container": (
        "export:container",
        "Write plant, channels and controller of a scenario as one FMU without inputs.",
    ),
    "check": (
        "export:check",
        "Check an FMU, SSP or DLL; one line per finding with its rule and fix; exit code 1 if there are any.",
    ),
    "import": (
        "grids:import_grid",
        "Read a grid, solve its power flow, write a case file; print what was read, assumed and dropped.",
    ),
    "export": (
        "grids:export",
        "Write a case, at any operating point, as one file; list what its format cannot represent.",
    ),
    "meter": (
        "records.meter:meter",
        "Analyse a record: oscillations, damping by two methods, forced or modal, matching mode of a case.",
    ),
    "locate": (
        "records.locate:locate",
        "Locate an oscillation by the energy flow at each terminal and, with --case, by the grid's model.",
    ),
    "fit": (
        "records.fit:fit",
        "Apply a record to a single machine with its controls; fit its parameters; name undetermined ones.",
    ),
    "cache": (
        "cache:cache",
        "Show, check or trim the cache of FMUs and designs.",
    ),
    "study": (
        "study:study",
        "Run a whole study, or study a grid: modes, a design for it, faults, report.html, study.json.",
    ),
}
_SETTINGS: dict[str, Any] = {
    "pretty_exceptions_enable": False,
    "rich_markup_mode": None,
    "context_settings": {"help_option_names": ["-h", "--help"]},
}


class _QuickHelp:
    """A `--help` that is False where it is not given: for the None that it has else typer loads pydantic."""

    def get_help_option(self, ctx: Any) -> Any:
        option = super().get_help_option(ctx)  # type: ignore[misc]
        if option is not None:
            option.default = False
        return option


class _Command(_QuickHelp, TyperCommand):
    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Refuse words that typer would take, or refuse in several lines."""
        usage.check_words(self, args)
        with _one_line(args, self):
            rest = super().parse_args(ctx, list(args))
        usage.check_numbers(self, ctx.params)
        return rest

    def invoke(self, ctx: Any) -> Any:
        """Refuse names of nothing before anything is loaded for them."""
        usage.check_names(ctx)
        return super().invoke(ctx)


@contextmanager
def _one_line(words: Sequence[str], command: Any = None) -> Iterator[None]:
    """Raise what typer says of a command's words as UsageMistake; help in place of an error stays."""
    try:
        yield
    except usage.Error as error:
        if type(error).__name__ == "NoArgsIsHelpError":
            raise
        raise usage.mistake(error, words, command) from None


def load(name: str) -> Any:
    """Import the module of a command and return the command, with the options that all have."""
    module, _, function = COMMANDS[name][0].partition(":")
    single = typer.Typer(add_completion=False, **_SETTINGS)
    single.command(name, cls=_Command)(getattr(import_module(f"{__package__}.{module}"), function))
    command, shared = typer.main.get_command(single), typer.Typer(add_completion=False, **_SETTINGS)
    shared.command()(_shared_options)
    command.params += [p for p in typer.main.get_command(shared).params if p.name in ("quiet", "verbose")]
    command.epilog = last_lines(name)
    return command


def _shared_options(
    quiet: Annotated[
        bool,
        typer.Option(
            "--quiet", callback=set_level("quiet"), expose_value=False, help="results and errors only"
        ),
    ] = False,
    verbose: Annotated[
        bool,
        typer.Option(
            "--verbose",
            callback=set_level("verbose"),
            expose_value=False,
            help="time of each step, use of the cache, tracebacks",
        ),
    ] = False,
) -> None:
    """Take part in no command: its options are added to each."""


class _Commands(_QuickHelp, TyperGroup):
    """The commands by their lines of help; the one that is called is imported."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        for name, line in SUMMARIES.items():
            self.add_command(TyperCommand(name=name, help=line, rich_markup_mode=None), name)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        if args and args[0] in COMMANDS:
            self.add_command(load(args[0]), args[0])
        with _one_line(args):
            return super().resolve_command(ctx, args)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        with _one_line(args):
            return super().parse_args(ctx, args)


def _completion() -> bool:
    """Whether this call may be about shell completion; its two options make typer load pydantic."""
    return len(sys.argv) < 2 or sys.argv[1].startswith("-") or "_INTERAREA_COMPLETE" in os.environ


app = typer.Typer(
    name="interarea", cls=_Commands, no_args_is_help=True, add_completion=_completion(), **_SETTINGS
)


def _version(requested: bool) -> None:
    if requested:
        typer.echo(f"interarea {__version__}")
        raise typer.Exit


@app.callback()
def program(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="print the version")
    ] = False,
) -> None:
    """Wide-area damping of inter-area oscillations: plant and controllers as FMUs, co-simulated."""


def main(stops: Sequence[int] = ()) -> None:
    """Run the command line: exit code 0, 2 for a mistake of the user, 1 for a fault of ours.

    stops : signals to stop, as they come: a module in C that is being loaded makes another error of one.
    """
    steady_streams()
    warnings.showwarning = say_warning
    try:
        app(prog_name="interarea")
    except KeyboardInterrupt:
        _stopped(stops)
    except SystemExit as ended:
        if ended.code == INTERRUPTED:
            _stopped(stops)
        raise
    except BaseException as error:  # every error ends here as one line; a panic in Rust is no Exception
        if stops:
            _stopped(stops)
        sys.exit(complain(error))


def _stopped(stops: Sequence[int]) -> NoReturn:
    if (processes := sys.modules.get("interarea.models.processes")) is not None:
        processes.end_commands()  # Python waits for the threads that wait for them
    with suppress(OSError):  # a terminal that is gone
        print("interarea: stopped", file=sys.stderr)
    sys.exit(128 + stops[0] if stops else INTERRUPTED)


if __name__ == "__main__":
    main()
