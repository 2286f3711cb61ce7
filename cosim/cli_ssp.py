"""Commands that hand a scenario's whole loop to other tools: `ssp`, `container`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .terminal import busy

ScenarioFile = Annotated[
    str, typer.Argument(metavar="SCENARIO.toml", help="scenario file, or a bundled name", show_default=False)
]
Platforms = Annotated[
    str | None,
    typer.Option(
        "--platforms",
        metavar="LIST",
        help="platforms of the binaries, e.g. linux64,win64,darwin64,linux-arm64; default: this machine's",
    ),
]


def ssp(
    scenario: ScenarioFile,
    out: Annotated[Path, typer.Option("--out", metavar="FILE.ssp", show_default=False)],
    platforms: Platforms = None,
) -> None:
    """Write plant, channels and controller of a scenario, wired and parametrised, as one SSP 1.0 archive."""
    from .artefacts import default_cache
    from .scenario import load_scenario
    from .ssp import write_ssp

    loaded = load_scenario(scenario)
    with busy(f"writing {out}"):
        made = write_ssp(loaded, out, cache=default_cache(), platforms=names_of(platforms))
    typer.echo(made)


def names_of(platforms: str | None) -> list[str] | None:
    """Return the platforms of a comma-separated option, or None for this machine's.

    >>> names_of("linux64, win64")
    ['linux64', 'win64']
    """
    return None if platforms is None else [name.strip() for name in platforms.split(",") if name.strip()]


def container(
    scenario: ScenarioFile,
    out: Annotated[Path, typer.Option("--out", metavar="FILE.fmu", show_default=False)],
    platforms: Platforms = None,
) -> None:
    """Write plant, channels and controller of a scenario as one FMU that simulates by itself."""
    from .artefacts import default_cache
    from .container import write_container
    from .scenario import load_scenario

    loaded = load_scenario(scenario)
    with busy(f"writing {out}"):
        made = write_container(loaded, out, cache=default_cache(), platforms=names_of(platforms))
    typer.echo(made)
