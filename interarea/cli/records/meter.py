"""The command `meter`: how damped a record is, and whether what swings in it is forced."""

from __future__ import annotations

import json
from cmath import phase
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from ...command_usage import naming
from ..terminal import busy, note, print_table
from .options import Band, CaseName, RecordFile, Units, Window, band_of, case_named, opened

if TYPE_CHECKING:
    from interarea.cosim.records.brought import Brought
    from interarea.cosim.records.meter import Meter, Swing

_SHOWN = 4  #: terminals of a shape


def meter(
    file: RecordFile,
    case: CaseName = None,
    band: Band = None,
    quantity: Annotated[
        str | None,
        typer.Option(
            "--quantity", metavar="NAME", help="speed, frequency, active power, voltage angle, voltage"
        ),
    ] = None,
    channel: Annotated[
        list[str] | None, typer.Option("--channel", metavar="NAME", help="look at this channel alone; repeat")
    ] = None,
    beside: Annotated[
        Path | None,
        typer.Option(
            "--beside",
            metavar="FILE",
            help="the record without the controller that FILE has: what damping it brought",
            callback=naming("record"),
        ),
    ] = None,
    window: Window = None,
    unit: Units = None,
    json_: Annotated[bool, typer.Option("--json", help="print JSON instead of a table")] = False,
) -> None:
    """Meter a record: what swings, how damped by two methods, forced or modal, which mode of a case."""
    region = band_of(band)
    grid = case_named(case)
    frequency_hz = grid.frequency_hz if grid else 60.0
    record = opened(file, window, unit, frequency_hz)
    other = None if beside is None else opened(beside, None, unit, frequency_hz)
    from interarea.records import meter as metered

    with busy(f"metering {file.name}"):
        result = metered(
            record, grid, beside=other, band_hz=region, quantity=quantity, channels=channel or ()
        )
    for line in result.notes[len(record.notes) :]:
        note(f"{file.name}: {line}")
    if json_:
        typer.echo(json.dumps(result.as_dict(), indent=2, allow_nan=False))
        return
    _print(result, case)
    if other is not None:
        _print_brought(cast("Brought", result), case)


def _print_brought(result: Brought, case: str | None) -> None:
    _print(result.beside, case)
    for line in (*(d.sentence for d in result.differences), *result.new):
        typer.echo(line)


def _print(result: Meter, case: str | None) -> None:
    rows = [row for swing in result.swings for row in _rows(swing, result.unit, case)]
    title = f"{result.source}: {result.length_s:g} s, {result.kind}, {result.quantity}; intervals of 95 %"
    if not rows:
        typer.echo(f"{title}: nothing stands out")
        return
    print_table(title, ("Hz", "kind", "damping ratio", "method", "rms", "mode", "shape, why"), rows)


def _rows(swing: Swing, unit: str, case: str | None) -> list[tuple[str, ...]]:
    mode = (
        f"{swing.mode} ({swing.mode_damping:.3f} in the case)" if swing.mode else "none of it" if case else ""
    )
    top = sorted(swing.shape.items(), key=lambda item: -abs(item[1]))[:_SHOWN]
    shape = ", ".join(f"{name} {abs(z):.2f} {round(degrees(phase(z))):+d}°" for name, z in top)
    details = (f"{swing.amplitude:.3g} {unit}", mode, f"{shape}; {swing.why}")
    if not swing.estimates:
        return [(f"{swing.frequency_hz:.4f}", swing.kind, "-", "", *details)]
    rows: list[tuple[str, ...]] = []
    for k, e in enumerate(swing.estimates):
        low, high = e.damping_interval
        ratio = f"{e.damping_ratio:.4f} ({low:.4f} to {high:.4f})"
        rest = details if k == 0 else ("", "", "")
        rows.append((f"{e.frequency_hz:.4f}", swing.kind if k == 0 else "", ratio, e.method, *rest))
    return rows
