"""The summary and the example that `--help` prints for each command."""

from __future__ import annotations

#: command -> its line in `interarea --help`: at most 62 characters, so that 80 columns hold it
SUMMARIES = {
    "list": "List everything bundled: cases, scenarios, designs, studies.",
    "cases": "List the bundled cases.",
    "show": "Print a bundled file with its source.",
    "new": "Write a commented template file.",
    "device": "Show one device: diagram, equilibrium, poles, step response.",
    "modes": "Name the swing modes of a case at an operating point.",
    "loops": "Rank signals and actuators for the inter-area modes.",
    "run": "Co-simulate a scenario; write trajectory, metrics and a plot.",
    "compare": "Run a scenario with several controllers; write one page.",
    "sweep": "Run a scenario over many parameters, or resume a sweep.",
    "maps": "Draw the maps of a sweep: stability, margins, worst runs.",
    "screen": "Fault every bus of a grid or trip every branch; worst first.",
    "explore": "Write an interactive HTML page that simulates the loop.",
    "design": "Design a fixed-order controller for a family of plants.",
    "certify": "Recompute a controller's certificate on the full plants.",
    "build": "Build the plant FMU of a case, with documentation.",
    "ssp": "Write a scenario as an SSP 1.0 archive.",
    "container": "Write a scenario as one FMU that contains the others.",
    "check": "Check an FMU, SSP or DLL against its standard.",
    "import": "Read a grid, solve its power flow, write a case file.",
    "export": "Write a case as RAW, DYR, MATPOWER or TOML.",
    "meter": "Analyse a record: oscillations, damping, forced or modal.",
    "locate": "Locate an oscillation by energy flow at each terminal.",
    "fit": "Fit a machine with its controls to a record of it.",
    "cache": "Show, check or trim the cache of FMUs and designs.",
    "study": "Run a whole study and write its report.",
}

#: command -> an example, the last line of its own `--help` and its example in the page of commands
EXAMPLES = {
    "list": "interarea list --json",
    "cases": "interarea cases",
    "show": "interarea show lost-signal",
    "new": "interarea new sweep --out sweep.toml",
    "modes": "interarea modes two-area-thesis --band 0.1:2.5 --below 0.1",
    "loops": "interarea loops two-area-thesis --below 0.2 --together 2 --latency 0.1",
    "run": "interarea run lost-signal --out out/run --explain",
    "compare": "interarea compare none wide_area --scenario ring-down --out out/compared",
    "sweep": "interarea sweep sweep.toml --out out/sweep",
    "maps": "interarea maps out/sweep",
    "screen": "interarea screen two-area-thesis --bus 8 --clearing-times --out out/screen",
    "explore": "interarea explore two-area-thesis --out page.html",
    "design": "interarea design mine.toml --no-worth --out mine.json",
    "certify": "interarea certify wide_area --page certificate.html",
    "build": "interarea build two-area-thesis --platforms linux64,win64 --out fmus",
    "ssp": "interarea ssp lost-signal --out loop.ssp",
    "container": "interarea container lost-signal --out loop.fmu",
    "check": "interarea check loop.ssp",
    "import": "interarea import grid.raw --dyr grid.dyr --out grid.toml",
    "export": "interarea export new-england --out grid.raw",
    "device": "interarea device tgov1 --set R=0.05 --set T1=0.5 --set T2=2 --set T3=7",
    "meter": "interarea meter out/run/trajectory.parquet --case two-area-thesis",
    "locate": "interarea locate out/run/trajectory.parquet --frequency 0.6",
    "fit": "interarea fit fault/trajectory.parquet --case two-area-thesis --machine G1",
    "cache": "interarea cache --check",
    "study": "interarea study thesis --out out/thesis --no-second-solver",
}

#: command -> the command that writes the file read by its example
READS = {
    "sweep": EXAMPLES["new"],
    "design": "interarea new design --out mine.toml",
    "maps": EXAMPLES["sweep"],
    "check": EXAMPLES["ssp"],
    "import": EXAMPLES["export"],
    "meter": EXAMPLES["run"],
    "locate": EXAMPLES["run"],
    "fit": "interarea run fault --out fault",
}


def last_lines(name: str) -> str:
    """Return the end of a command's help: its example on one line, and the command to run before it."""
    before = f", after `{READS[name]}`" if name in READS else ""
    return f"\b\nExample{before}:\n  {EXAMPLES[name]}"  # \b: the lines stay as they are
