"""The summary and the example that `--help` prints for each command."""

from __future__ import annotations

#: command -> its line in `interarea --help`: at most 62 characters, so that 80 columns hold it
SUMMARIES = {
    "list": "List everything bundled: cases, scenarios, designs, studies.",
    "cases": "List the bundled cases.",
    "show": "Print a bundled file with its source.",
    "new": "Write a commented file to start from.",
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
    "check": "Check an FMU or SSP file against the standard.",
    "import": "Read a grid, solve its power flow, write a case file.",
    "export": "Write a case as RAW, DYR, MATPOWER or TOML.",
    "meter": "Meter a record: what swings, how damped, forced or modal.",
    "cache": "Show, check or trim the cache of FMUs and designs.",
    "study": "Run a whole study and write its report.",
}

#: command -> an example, the last line of its own `--help` and its example in the page of commands
EXAMPLES = {
    "list": "interarea list --json",
    "cases": "interarea cases",
    "show": "interarea show lost-signal",
    "new": "interarea new scenario --out mine.toml",
    "modes": "interarea modes nets-nyps --band 0.1:2.5 --below 0.1",
    "loops": "interarea loops nets-nyps --below 0.2 --together 4 --latency 0.1",
    "run": "interarea run lost-signal --out out/run --explain",
    "compare": "interarea compare none robust --scenario wide-area-damping --out out/compared",
    "sweep": "interarea sweep examples/latency_loss.toml --out out/sweep",
    "maps": "interarea maps out/sweep",
    "screen": "interarea screen two-area-thesis --clearing-times --out out/screen",
    "explore": "interarea explore two-area-thesis --out page.html",
    "design": "interarea design robust --out robust.json",
    "certify": "interarea certify robust --acceptance",
    "build": "interarea build two-area-thesis --platforms linux64,win64 --out fmus",
    "ssp": "interarea ssp lost-signal --out loop.ssp",
    "container": "interarea container lost-signal --out loop.fmu",
    "check": "interarea check loop.ssp",
    "import": "interarea import grid.raw --dyr grid.dyr --out grid.toml",
    "export": "interarea export new-england --out grid.raw",
    "device": "interarea device tgov1 --set R=0.05 --set T1=0.5 --set T2=2 --set T3=7",
    "meter": "interarea meter pmu.csv --case grid.toml --band 0.1:2",
    "cache": "interarea cache --check",
    "study": "interarea study thesis --out out/thesis --no-second-solver",
}
