"""The command `locate`: through which terminal an oscillation comes in, and at which place of a grid."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated

import typer

from ...command_usage import UsageMistake, within
from ..terminal import busy, note, print_table
from .options import Band, CaseName, RecordFile, Units, Window, band_of, case_named, opened

if TYPE_CHECKING:
    from pathlib import Path

    from interarea.cosim.records.energy import Source
    from interarea.cosim.records.model_source import ModelSource
    from interarea.cosim.records.record import Record
    from interarea.models.case.case import Case

_SHOWN = 12  #: terminals


def locate(
    file: RecordFile,
    case: CaseName = None,
    band: Band = None,
    frequency: Annotated[
        float | None,
        typer.Option(
            "--frequency",
            metavar="HZ",
            help="of the oscillation; default: the largest",
            callback=within(above=0.0, unit="Hz"),
        ),
    ] = None,
    window: Window = None,
    unit: Units = None,
    json_: Annotated[bool, typer.Option("--json", help="print JSON instead of a table")] = False,
) -> None:
    """Locate an oscillation by the energy flow at each terminal and, with --case, by the grid's model."""
    region = band_of(band)
    if band is not None and frequency is not None:
        raise UsageMistake(
            f"locate: --band {band} with --frequency {frequency:g}: the band is searched, the frequency "
            "is given, allowed: one of them"
        )
    grid = case_named(case)
    record = opened(file, window, unit, grid)
    flow, failed = _by_energy(file, record, region, frequency, grid)
    model = None
    if grid is not None:
        from interarea.cosim.records.model_source import source_by_model
        from interarea.cosim.run.artefacts import sparse_linear_plant
        from interarea.fmu_build.write.cache import default_cache

        with busy(f"sources in {grid.name}"):
            plant = sparse_linear_plant(grid, default_cache())
            line = frequency if flow is None else flow.frequency_hz
            model = source_by_model(record, grid, plant, frequency_hz=line, band_hz=region)
    for line in (
        *((failed,) if failed else ()),
        *(flow.notes if flow else ()),
        *(model.notes if model else ()),
    ):
        note(f"{file.name}: {line}")
    if json_:
        shown = {**(flow.as_dict() if flow else {}), **({"model": model.as_dict()} if model else {})}
        typer.echo(json.dumps(shown, indent=2, allow_nan=False))
        return
    if flow is not None:
        _print(flow)
    if model is not None:
        _print_model(model)


def _by_energy(
    file: Path, record: Record, band: tuple[float, float], frequency: float | None, grid: Case | None
) -> tuple[Source | None, str]:
    """Return what the energy flow says, or why it says nothing where the model is asked as well."""
    from interarea.cosim.records.energy import located
    from interarea.cosim.records.record import RecordError

    places = {m.name: f"bus{m.bus}" for m in grid.machines} if grid else {}
    places |= {f"branch[{b.name}]": f"bus{b.from_bus}" for b in grid.branches} if grid else {}
    try:
        with busy(f"energy flow of {file.name}"):
            rated_hz = grid.frequency_hz if grid else None
            flow = located(record, band_hz=band, frequency_hz=frequency, at=places, rated_hz=rated_hz)
            return flow, ""
    except RecordError as error:
        if grid is None:
            raise
        return None, f"no energy flow: {error}"


def _print_model(result: ModelSource) -> None:
    title = f"{result.case}: {result.frequency_hz:.4f} Hz, {result.channels} channels"
    rows = [
        (
            " and ".join(c.places),
            " and ".join(c.kinds),
            " and ".join(f"{a:.3g} {unit}" for a, unit in zip(c.amplitude, c.units, strict=True)),
            f"{c.unexplained:.2%}",
        )
        for c in result.candidates
    ]
    print_table(title, ("source", "kind", "amplitude", "unexplained"), rows)
    typer.echo(f"by the model: {result.source.text if result.source else 'not named'}; {result.why}")


def _print(result: Source) -> None:
    title = f"{result.source_file}: {result.length_s:g} s, {result.frequency_hz:.4f} Hz"
    rows = [
        (f.terminal, f"{f.slope:+.4g}", f"{f.halves[0]:+.3g}, {f.halves[1]:+.3g}", f"{f.rms:.3g}")
        for f in result.flows[:_SHOWN]
    ]
    print_table(title, ("terminal", f"energy out of the bus, {result.unit}", "halves", "rms of P"), rows)
    for line in result.lines:
        typer.echo(line.text)
    typer.echo(f"by the energy flow: {result.source or 'not named'}; {result.why}")
