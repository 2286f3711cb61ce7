"""The command `modes`: swing modes of a case with shapes, participation, sensitivities and plots."""

from __future__ import annotations

import json
from cmath import phase
from collections.abc import Mapping
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..command_usage import LATENCY_S, CaseName, naming
from .terminal import busy, print_table, two_numbers

if TYPE_CHECKING:
    from interarea.design.controllers.controller import Controller
    from interarea.design.delay.late_plant import LatePlant
    from interarea.design.linear.sparse_plant import SparsePlant
    from interarea.design.modes.modes import Mode, Modes
    from interarea.design.modes.sensitivity import Sensitivity
    from interarea.models.case.case import Case

CircuitsOut = Annotated[
    list[str] | None, typer.Option("--circuit-out", metavar="BRANCH", help="branch out of service")
]
Below = Annotated[
    float | None,
    typer.Option(
        "--below", metavar="RATIO", help="all modes below this damping ratio; 0.2 with --band alone"
    ),
]


def modes(
    case: CaseName,
    json_: Annotated[bool, typer.Option("--json", help="print JSON instead of tables")] = False,
    shapes: Annotated[bool, typer.Option("--shapes", help="speed of every machine in each mode")] = False,
    participation: Annotated[
        int, typer.Option("--participation", metavar="N", min=1, help="states to name per mode")
    ] = 3,
    sensitivity: Annotated[
        list[str] | None,
        typer.Option(
            "--sensitivity", metavar="PATH", help="of the case, as machines.G1.exciter.KA or redispatch.G1:G2"
        ),
    ] = None,
    tie_flow: Annotated[
        float, typer.Option("--tie-flow", metavar="MW", help="load moved across the tie")
    ] = 0.0,
    circuit_out: CircuitsOut = None,
    load_scale: Annotated[float, typer.Option("--load-scale", metavar="FACTOR", help="on every load")] = 1.0,
    margins: Annotated[
        bool, typer.Option("--margins", help="distance of the controls from their limits")
    ] = False,
    plot: Annotated[
        Path | None,
        typer.Option("--plot", metavar="DIR", help="draw the shapes, on a map where buses have locations"),
    ] = None,
    band: Annotated[
        str | None,
        typer.Option(
            "--band",
            metavar="LOW:HIGH",
            help="all modes between these frequencies, Hz, of any grid, counted independently",
        ),
    ] = None,
    below: Below = None,
    controller: Annotated[
        str | None,
        typer.Option(
            "--controller", metavar="NAME", help="add it: name, file or FMU", callback=naming("controller")
        ),
    ] = None,
    latency: Annotated[
        float,
        typer.Option("--latency", metavar="S", help="of the controller's signals, exact", callback=LATENCY_S),
    ] = 0.0,
    along: Annotated[
        str | None,
        typer.Option(
            "--along",
            metavar="KEY=FROM:TO[:POINTS]",
            help="modes over a parameter of case or controller",
        ),
    ] = None,
    save: Annotated[
        Path | None, typer.Option("--save", metavar="DIR", help="of --along: CSV, Parquet, A, B, C, D")
    ] = None,
) -> None:
    """Linearise the plant FMU of a case, at an operating point of choice, and name its swing modes."""
    around = _around(controller, latency, sensitivity)
    if (along, save) != (None, None):
        _refuse_beside("--along", margins=margins, sensitivity=sensitivity, shapes=shapes)
        loaded = at_point(case, tie_flow, circuit_out, load_scale)
        _locus(loaded, along, region_of(band, below), around, save, plot, json_)
        return
    _check_folders({"--plot": plot})
    if any(provided is not None for provided in (band, below, controller)):
        _refuse_beside("--band, --below or --controller", margins=margins)
        loaded = at_point(case, tie_flow, circuit_out, load_scale)
        region, paths = region_of(band, below), sensitivity or []
        _all_modes(loaded, *region, paths, around, participation, shapes, json_, plot)
        return
    from interarea.cosim.run.artefacts import linear_matrices
    from interarea.design.modes.growth import growth_of
    from interarea.design.modes.modes import modes_of
    from interarea.fmu_build.write.cache import default_cache

    cache = default_cache()
    with busy(f"linearising the plant FMU of {case}"):
        loaded = at_point(case, tie_flow, circuit_out, load_scale)
        limits = _margins(loaded) if margins else []
        system = linear_matrices(loaded, cache)
        result = modes_of(system, loaded.areas)
        moved: dict[str, Mapping[str, Sensitivity]] = {}
        if sensitivity:
            from interarea.cosim.designs.sensitivities import parameter_sensitivities

            moved = parameter_sensitivities(loaded, sensitivity, cache)
    files = _plots(result, loaded, plot)
    growth = result.growth or growth_of(system.A, system.state_labels)
    if json_:
        document = _as_dict(loaded, result, participation, moved, files)
        document = {"case": document.pop("case"), "growth": growth.as_dict(), **document}
        if margins:
            document["margins"] = limits
        typer.echo(json.dumps(document, indent=2, allow_nan=False))
        return
    typer.echo(growth.text)
    _print_modes(f"{loaded.name}: {system.nstates} states, swing modes", result, participation)
    if shapes:
        _print_shapes(result, loaded)
    for path, by_mode in moved.items():
        _print_sensitivity(path, by_mode)
    if margins:
        _print_margins(limits)
    for file in files:
        typer.echo(file)


def _locus(
    case: Case,
    along: str | None,
    region: tuple[tuple[float, float], float],
    around: tuple[str, float] | None,
    save: Path | None,
    plot: Path | None,
    as_json: bool,
) -> None:
    """Print, save and draw the modes over a parameter."""
    from interarea.locus import LocusError, along_of, draw_locus, locus_of, locus_table, save_locus
    from interarea.models.files import together

    if along is None:
        raise LocusError("--save writes the results of --along; give --along KEY=FROM:TO")
    key, values = along_of(along)
    _check_folders({"--save": save, "--plot": plot})
    controller, latency_s = (None, 0.0) if around is None else (_single(around[0]), around[1])
    with busy(f"modes of {case.name} at {len(values)} values of {key}"), together():
        locus = locus_of(case, key, values, region, controller=controller, latency_s=latency_s)
        files = [] if save is None else save_locus(locus, case, save)
        files += [] if plot is None else [draw_locus(locus, plot)]
    if as_json:
        document = {"case": case.name, "key": key, "rows": locus.rows(), "files": [*map(str, files)]}
        typer.echo(json.dumps(document, indent=2, allow_nan=False))
        return
    (low, high), below = region
    title = f"{case.name}: modes from {low:g} to {high:g} Hz below a damping ratio of {below:g} along {key}"
    print_table(title, *locus_table(locus))
    for file in files:
        typer.echo(file)


def at_point(case: str, tie_flow: float, circuit_out: list[str] | None, load_scale: float) -> Case:
    """Return a case at the operating point asked for."""
    from interarea.models.case.case import load_case
    from interarea.models.case.variants import operating_variant

    loaded = load_case(case)
    if not (tie_flow or circuit_out or load_scale != 1.0):
        return loaded
    return operating_variant(loaded, tie_flow_mw=tie_flow, out=circuit_out or (), load_scale=load_scale)


def _around(
    controller: str | None, latency_s: float, sensitivity: list[str] | None
) -> tuple[str, float] | None:
    """Return the controller and its latency, if one is given."""
    from interarea.design.modes.modes import ModeError

    if controller is None:
        if latency_s:
            raise ModeError(f"--latency {latency_s:g} needs a controller; name one with --controller")
        return None
    if sensitivity:
        raise ModeError("--sensitivity with --controller: cannot be combined; omit one")
    return controller, latency_s


def _check_folders(folders: Mapping[str, Path | None]) -> None:
    from .destination import folder_for

    for option, folder in folders.items():
        if folder is not None:
            folder_for(folder, option)


def _refuse_beside(option: str, **provided: object) -> None:
    """Refuse what belongs to the named swing modes of a small grid at one operating point."""
    from interarea.design.modes.modes import ModeError

    named = [f"--{name}" for name, value in provided.items() if value]
    if named:
        raise ModeError(f"{named[0]} with {option}: cannot be combined; omit one")


def region_of(band: str | None, below: float | None) -> tuple[tuple[float, float], float]:
    """Return the two frequencies (Hz) of `LOW:HIGH` and the damping ratio, where the modes are wanted."""
    from interarea.design.modes.modes import ModeError

    region = two_numbers(band or "0.1:2.5", "--band", "LOW:HIGH in Hz, such as 0.1:2.5", ModeError)
    return region, 0.2 if below is None else below


def _all_modes(
    case: Case,
    band_hz: tuple[float, float],
    below: float,
    paths: list[str],
    around: tuple[str, float] | None,
    count: int,
    shapes: bool,
    as_json: bool,
    plot: Path | None,
) -> None:
    """Print every mode of a region with the independent count; around : a controller, and its latency."""
    from interarea.cosim.designs.sensitivities import all_mode_sensitivities
    from interarea.cosim.run.artefacts import sparse_linear_plant
    from interarea.design.modes.all_modes import all_modes
    from interarea.design.modes.growth import growth_of_plant
    from interarea.fmu_build.write.cache import default_cache

    with busy(f"all modes of {case.name}"):
        plant = sparse_linear_plant(case, default_cache())
        loop = None if around is None else _with_controller(case, plant, *around, band_hz[1])
        result = all_modes(plant, case.areas, band_hz=band_hz, below=below, loop=loop)
        eigenvalues = [mode.eigenvalue for mode in result.modes]
        growth = growth_of_plant(plant, loop, eigenvalues)
        moved = all_mode_sensitivities(case, result.modes, paths if result.modes else [], default_cache())
        by_name = {mode.name: mode for mode in result.modes}
        files = _plots(by_name, case, plot)
    if as_json:
        states = plant.nstates
        document = {
            "case": case.name,
            "growth": growth.as_dict(),
            "states": states,
            **result.as_dict(count, shapes=shapes),
        }
        document |= {"controller": around and around[0], "latency_s": around and around[1]}
        document["sensitivity"] = _sensitivity_dict(moved)
        document["plots"] = [str(file) for file in files]
        typer.echo(json.dumps(document, indent=2, allow_nan=False))
        return
    low, high = result.band_hz
    title = (
        f"{case.name}: {plant.nstates} states, modes from {low:g} to {high:g} Hz below a damping ratio of "
    )
    title += f"{result.below:g}: {len(by_name)}, counted independently: {result.counted}"
    if around is not None:
        title += f"; with {around[0]}, signals {around[1]:g} s late"
    typer.echo(growth.text)
    _print_modes(title, by_name, count)
    for line in (*result.moved, *result.remarks):
        typer.echo(line)
    if shapes:
        _print_shapes(by_name, case)
    for path, by_mode in moved.items():
        _print_sensitivity(path, by_mode)
    for file in files:
        typer.echo(file)


def _with_controller(
    case: Case, plant: SparsePlant, name: str, latency_s: float, high_hz: float
) -> LatePlant:
    """Return the plant with a controller around it, all its signals late."""
    from interarea.design.delay.late_plant import LatePlant

    controller = _single(name)
    late = dict.fromkeys(controller.inputs, latency_s)
    return LatePlant(plant, controller.system, late, omega_b=case.omega_b, high_hz=high_hz)


def _single(name: str) -> Controller:
    """Return the controller of a name, which is no bank."""
    from interarea.design.controllers.controller import Controller
    from interarea.design.modes.modes import ModeError
    from interarea.synthesis import load_controller

    controller = load_controller(name)
    if not isinstance(controller, Controller):
        raise ModeError(f"--controller {name}: a bank switches between controllers; name a single controller")
    return controller


def _as_dict(
    case: Case,
    result: Modes,
    count: int,
    moved: Mapping[str, Mapping[str, Sensitivity]],
    files: list[Path],
) -> dict[str, Any]:
    from interarea.cosim.study.rows import mode_rows

    rows = mode_rows(result)
    for name, mode in result.items():
        rows[name]["participation"] = mode.most(count)
        rows[name]["shape"] = {
            machine: {"size": abs(z), "angle_deg": degrees(phase(z))} for machine, z in mode.shape.items()
        }
    values = [[float(z.real), float(z.imag)] for z in result.eigenvalues]
    return {
        "case": case.name,
        "states": len(values),
        "eigenvalues": values,
        "modes": rows,
        "sensitivity": _sensitivity_dict(moved),
        "plots": [str(file) for file in files],
    }


def _print_modes(title: str, result: Mapping[str, Mode], count: int) -> None:
    print_table(
        title,
        ("mode", "frequency (Hz)", "damping ratio", "eigenvalue (1/s)", "takes part most"),
        [
            (
                name,
                f"{mode.frequency_hz:.4f}",
                f"{mode.damping_ratio:.4f}",
                f"{mode.eigenvalue.real:.4f} ± {mode.eigenvalue.imag:.4f}j",
                ", ".join(f"{state} {share:.3f}" for state, share in mode.most(count).items()),
            )
            for name, mode in result.items()
        ],
    )
    for mode in result.values():
        if mode.caveat:
            typer.echo(mode.caveat)
    if not result:
        typer.echo("no mode; a single machine has no swing mode, --band lists other modes")


def _size_and_angle(entry: complex) -> str:
    return f"{abs(entry):.2f} {round(degrees(phase(entry))):+d}°"


def _print_shapes(result: Mapping[str, Mode], case: Case) -> None:
    machines = [m.name for m in case.machines]
    if not result:
        return
    print_table(
        "speeds of the machines (size, angle in degrees)",
        ("mode", *machines),
        [
            (name, *(_size_and_angle(mode.shape[machine]) for machine in machines))
            for name, mode in result.items()
        ],
    )


def _sensitivity_dict(moved: Mapping[str, Mapping[str, Sensitivity]]) -> dict[str, Any]:
    return {
        path: {
            name: {
                "value": s.value,
                "derivative": [s.derivative.real, s.derivative.imag],
                "error": s.error,
                "frequency_hz": s.frequency_slope,
                "damping_ratio": s.damping_slope,
            }
            for name, s in by_mode.items()
        }
        for path, by_mode in moved.items()
    }


def _print_sensitivity(path: str, by_mode: Mapping[str, Sensitivity]) -> None:
    if not by_mode:
        return
    value = next(iter(by_mode.values())).value
    step, unit = (value / 100.0, "1 %") if value else (1.0, "unit")
    if path.startswith("redispatch."):
        step, unit = 100.0, "100 MW"
    print_table(
        f"sensitivity to {path} = {value:g}",
        ("mode", "d eigenvalue / d parameter", f"frequency (Hz per {unit})", f"damping ratio per {unit}"),
        [
            (
                name,
                f"{s.derivative.real:+.4g} {s.derivative.imag:+.4g}j",
                f"{s.frequency_slope * step:+.2e}",
                f"{s.damping_slope * step:+.2e}",
            )
            for name, s in by_mode.items()
        ],
    )


def _margins(case: Case) -> list[dict[str, Any]]:
    from interarea.grids import margins_at_rest

    return margins_at_rest(case)


def _print_margins(rows: list[dict[str, Any]]) -> None:
    """Print `rows` as a table."""

    def shown(value: float | None) -> str:
        return "-" if value is None else f"{value:.4g}"

    print_table(
        "limits of the controls at the equilibrium, nearest first",
        ("control", "kind", "signal", "equilibrium", "least", "largest", "nearest", "margin"),
        [
            (
                row["control"],
                row["kind"],
                row["signal"],
                *(shown(row[key]) for key in ("value", "low", "high")),
                row["nearest"],
                shown(row["margin"]),
            )
            for row in rows
        ],
    )


def _plots(result: Mapping[str, Mode], case: Case, folder: Path | None) -> list[Path]:
    """Write one plot a mode, if a folder is given."""
    if folder is None:
        return []
    from interarea.cosim.plots.mode_map import save_shapes

    return save_shapes(result, case, folder)
