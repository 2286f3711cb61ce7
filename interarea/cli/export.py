"""What leaves: `build`, a whole loop as `ssp`, `container` or page to `explore`; `check` of any FMU."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from interarea.fmu_build.errors import BuildError

from ..command_usage import ABOVE_0_S, CaseName, naming
from .study import OutFolder
from .terminal import FileAsJson, busy, steps, tell_file

if TYPE_CHECKING:
    from interarea.models.blocks.variables import Block

ScenarioFile = Annotated[
    str,
    typer.Argument(
        metavar="SCENARIO.toml",
        help="scenario file, or a bundled name",
        show_default=False,
        callback=naming("scenario"),
    ),
]
Platforms = Annotated[
    str | None,
    typer.Option(
        "--platforms",
        metavar="LIST",
        help="platforms of the binaries, e.g. linux64,win64,darwin64,linux-arm64; default: this machine's",
    ),
]

SampleTime = Annotated[
    float | None,
    typer.Option(
        "--sample-time",
        metavar="S",
        help="interval at which a tool calls a DLL, s; 0.001",
        callback=ABOVE_0_S,
    ),
]


def build(
    case: CaseName,
    out: OutFolder,
    controller: Annotated[
        str | None,
        typer.Option(
            "--controller",
            metavar="CONTROLLER",
            help="also build the FMUs of this controller and of a channel",
            callback=naming("controller"),
        ),
    ] = None,
    show: Annotated[
        list[str] | None,
        typer.Option(
            "--show", metavar="PATTERN", help="additional outputs, such as 'G1_*', 'bus7.v', 'branch[7-8].p'"
        ),
    ] = None,
    platforms: Platforms = None,
    dll: Annotated[
        str | None,
        typer.Option(
            "--dll",
            metavar="LIST",
            help="also controller, channel and PMU as IEEE/CIGRE DLLs, for win64,win32,linux64",
        ),
    ] = None,
    sample_time: SampleTime = None,
    json_: Annotated[bool, typer.Option("--json", help="print JSON instead of lines")] = False,
) -> None:
    """Build the plant FMU of a case, complete: documentation, sources and cross-check files."""
    from interarea.cosim.run.controllers import controller_of
    from interarea.fmu_build.open.cross_check import complete_fmu
    from interarea.fmu_build.write.cache import default_cache, place
    from interarea.fmu_build.write.package import block_fmu
    from interarea.models.blocks.channel import channel_block
    from interarea.models.blocks.plant import plant_block
    from interarea.models.blocks.pmu import pmu_block
    from interarea.models.case.case import load_case
    from interarea.models.files import together

    from .destination import folder_for

    to = _dll_platforms(dll)

    cache = default_cache()
    loaded = load_case(case)
    folder_for(out)
    sample_s = _sample_s(sample_time, dll)
    blocks = {loaded.name: plant_block(loaded, show=show)}
    if controller is not None:
        result = controller_of(controller, loaded, cache)
        if result is not None:
            blocks |= {"channel": channel_block(), result.name: result.block(loaded.omega_b)}
    parts, files = [b for b in blocks.values() if b.kind != "plant"], {}
    if dll is not None and not parts:
        raise BuildError("--dll: no controller was named; allowed: with --controller CONTROLLER")
    with steps([f"{name}.fmu" for name in blocks]) as report, together():
        for name, block in blocks.items():
            report(f"{name}.fmu")
            fmu = complete_fmu(block_fmu(block, cache, platforms=names_of(platforms)), cache)
            files[name] = str(place(fmu, out / f"{name}.fmu"))
        dlls = _dlls([*parts, pmu_block()], out, to, sample_s, cache)
    if json_:
        typer.echo(
            json.dumps({"case": loaded.name, "fmus": files} | ({"dlls": dlls} if dll else {}), indent=2)
        )
        return
    for file in (*files.values(), *dlls):
        typer.echo(file)


def _sample_s(requested_s: float | None, dll: str | None) -> float:
    """Return the interval at which a DLL is called, s."""
    if requested_s is not None and dll is None:
        raise BuildError(f"--sample-time {requested_s:g}: an option of a DLL; give --dll too, or omit it")
    return 0.001 if requested_s is None else requested_s


def _dll_platforms(names: str | None) -> list[str]:
    """Return the platforms of ``--dll``, before anything is built."""
    from interarea.fmu_build.write.compile import platform_of
    from interarea.fmu_build.write.real_code import DLL_PLATFORMS

    platforms = names_of(names)
    if platforms == []:
        raise BuildError(f"--dll {names}: names no platform; allowed: {', '.join(DLL_PLATFORMS)}")
    for platform in platforms or ():
        platform_of(platform, DLL_PLATFORMS)
    return platforms or []


def _dlls(
    blocks: list[Block], out: Path, platforms: list[str], sample_time_s: float, cache: Path
) -> list[str]:
    """Write each block as a DLL of each platform, ``OUT/PLATFORM/NAME.dll``."""
    from interarea.fmu_build.write.real_code import DLL_PLATFORMS, build_dll

    from .destination import file_for

    files = []
    for platform in platforms:
        for block in blocks:
            file = file_for(out / platform / f"{block.name}{DLL_PLATFORMS[platform].suffix}")
            with busy(f"{block.name} for {platform}"):
                build_dll(block, file, platform=platform, sample_time_s=sample_time_s, cache=cache)
            files.append(str(file))
    return files


def ssp(
    scenario: ScenarioFile,
    out: Annotated[
        Path, typer.Option("--out", metavar="FILE.ssp", help="archive to write", show_default=False)
    ],
    platforms: Platforms = None,
    json_: FileAsJson = False,
) -> None:
    """Write plant, channels, controller, connections and parameters of a scenario as an SSP 1.0 archive."""
    from interarea.cosim.export.ssp import write_ssp

    tell_file(_written(write_ssp, ".ssp", scenario, out, platforms), json_)


def names_of(platforms: str | None) -> list[str] | None:
    """Return the platforms of a comma-separated option, or None for this machine's.

    >>> names_of("linux64, win64")
    ['linux64', 'win64']
    """
    return None if platforms is None else [name.strip() for name in platforms.split(",") if name.strip()]


def container(
    scenario: ScenarioFile,
    out: Annotated[
        Path, typer.Option("--out", metavar="FILE.fmu", help="FMU or DLL to write", show_default=False)
    ],
    platforms: Platforms = None,
    dll: Annotated[
        str | None,
        typer.Option(
            "--dll",
            metavar="PLATFORM",
            help="all from plant outputs to inputs as one IEEE/CIGRE DLL: win64, win32, linux64",
        ),
    ] = None,
    sample_time: SampleTime = None,
    json_: FileAsJson = False,
) -> None:
    """Write plant, channels and controller of a scenario as one FMU without inputs."""
    from interarea.cosim.export.container import chain_of, write_container
    from interarea.fmu_build.write.compile import platform_of
    from interarea.fmu_build.write.real_code import DLL_PLATFORMS, build_dll

    sample_s = _sample_s(sample_time, dll)

    def write_chain(loaded: Any, path: Path, *, cache: Path, platforms: object) -> Path:
        chain = chain_of(loaded, cache=cache)
        return build_dll(chain, path, platform=str(dll), sample_time_s=sample_s, cache=cache)

    if dll is None:
        tell_file(_written(write_container, ".fmu", scenario, out, platforms), json_)
    elif platforms is not None:
        raise BuildError(f"--platforms {platforms}: an option of an FMU; omit --dll or this option")
    else:
        tell_file(_written(write_chain, platform_of(dll, DLL_PLATFORMS).suffix, scenario, out, None), json_)


def _written(
    writer: Callable[..., Path], suffix: str, scenario: str, out: Path, platforms: str | None
) -> Path:
    """Have `writer` turn a scenario into the file `out`."""
    from interarea.cosim.scenario.scenario import load_scenario
    from interarea.fmu_build.write.cache import default_cache

    from .destination import file_for

    loaded = load_scenario(scenario)
    file_for(out, suffix=suffix)
    with busy(f"writing {out}"):
        return writer(loaded, out, cache=default_cache(), platforms=names_of(platforms))


def check(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="FMU, SSP or IEEE/CIGRE DLL", show_default=False)
    ],
    json_: Annotated[bool, typer.Option("--json", help="print JSON instead of lines")] = False,
    run: Annotated[
        bool, typer.Option("--run/--no-run", help="load the FMU's binary and test its behaviour")
    ] = True,
) -> None:
    """Check an FMU, SSP or DLL; one line per finding with its rule and fix; exit code 1 if there are any."""
    from interarea.fmu_build.check.check import check_file

    with busy(f"checking {file}"):
        report = check_file(file, run=run)
    if json_:
        typer.echo(json.dumps(report.as_dict(), indent=2))
    else:
        for finding in report.findings:
            typer.echo(finding.line())
        for note in report.notes:
            typer.echo(f"note: {note}", err=True)
        typer.echo(f"{file}: {report.verdict}")
    if not report.clean:
        raise typer.Exit(1)


def explore(
    out: Annotated[
        Path, typer.Option("--out", metavar="FILE.html", help="page to write", show_default=False)
    ],
    subject: Annotated[
        str,
        typer.Argument(
            metavar="SCENARIO | CASE", help="a file, or a bundled name of either", callback=naming("subject")
        ),
    ] = "two-area-thesis",
    json_: FileAsJson = False,
) -> None:
    """Write one HTML file that simulates the loop, with adjustable delay, loss, controller and fault.

    It needs no server and no network: the simulation is the container's C as WebAssembly.
    """
    from interarea.cosim.explorer.page import write_explorer
    from interarea.fmu_build.write.cache import default_cache

    from .destination import file_for

    file_for(out, suffix=".html")
    with busy(f"writing {out}"):
        explorer = write_explorer(subject, out, cache=default_cache())
    tell_file(explorer, json_)
