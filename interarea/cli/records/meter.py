"""The command `meter`: how damped a record is, and whether what swings in it is forced."""

from __future__ import annotations

import json
from cmath import phase
from math import degrees
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from ...command_usage import ABOVE_0_S, naming
from ..terminal import busy, note, print_table
from .options import (
    Band,
    CaseName,
    RecordFile,
    Units,
    Window,
    band_of,
    case_named,
    opened,
    units_of,
    window_of,
)

if TYPE_CHECKING:
    from interarea.cosim.records.brought import Brought
    from interarea.cosim.records.meter import Meter, Swing
    from interarea.cosim.records.trend import Track, Trend
    from interarea.models.case.case import Case

_SHOWN = 4  #: terminals of a shape
_OFTEN = 0.05  #: of the parts: a swing in fewer is counted alone
_REFUSED_SHOWN = 5


def meter(
    file: RecordFile,
    case: CaseName = None,
    band: Band = None,
    quantity: Annotated[
        str | None,
        typer.Option(
            "--quantity",
            metavar="NAME",
            help="speed, frequency, active power, rotor angle, voltage angle, voltage",
        ),
    ] = None,
    channel: Annotated[
        list[str] | None,
        typer.Option("--channel", metavar="NAME", help="analyse this channel alone; repeatable"),
    ] = None,
    beside: Annotated[
        Path | None,
        typer.Option(
            "--beside",
            metavar="FILE",
            help="record without the controller of FILE: prints the change of damping",
            callback=naming("record"),
        ),
    ] = None,
    every: Annotated[
        float | None,
        typer.Option(
            "--every",
            metavar="SECONDS",
            callback=ABOVE_0_S,
            help="track each oscillation through parts of this length, such as 600, in a long file",
        ),
    ] = None,
    window: Window = None,
    unit: Units = None,
    json_: Annotated[bool, typer.Option("--json", help="print JSON instead of a table")] = False,
) -> None:
    """Analyse a record: oscillations, damping by two methods, forced or modal, matching mode of a case."""
    region = band_of(band)
    grid = case_named(case)
    if every is not None:
        looked_at = {"band_hz": region, "quantity": quantity, "channels": channel or ()}
        _trend(file, grid, every, beside, window, unit, looked_at, json_)
        return
    record = opened(file, window, unit, grid)
    other = None if beside is None else opened(beside, None, unit, grid)
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


def _trend(
    file: Path,
    grid: Case | None,
    every_s: float,
    beside: Path | None,
    window: str | None,
    units: list[str] | None,
    looked_at: dict[str, Any],
    json_: bool,
) -> None:
    """Print what became of each swing over the parts of a file."""
    from interarea.cosim.records.record import RecordError
    from interarea.records import damping_trend

    if beside is not None:
        raise RecordError("--every and --beside: allowed: one of them; meter each record separately")
    with busy(f"metering {file.name}"):
        result = damping_trend(
            file, grid, every_s=every_s, window_s=window_of(window), units=units_of(units), **looked_at
        )
    for line in result.notes:
        note(f"{file.name}: {line}")
    if json_:
        typer.echo(json.dumps(result.as_dict(), indent=2, allow_nan=False))
        return
    refused = [part for part in result.parts if part.meter is None]
    for part in refused[:_REFUSED_SHOWN]:
        note(f"{_clock(result, part.start_s)}: {part.why}")
    if len(refused) > _REFUSED_SHOWN:
        note(f"... and {len(refused) - _REFUSED_SHOWN} more parts without a result; --json has them")
    shown = [t for t in result.tracks if len(t.swings) >= _OFTEN * len(result.parts) or t.forced]
    print_table(
        f"{result.source}: {len(result.parts)} parts of {result.every_s:g} s, {result.quantity}; "
        "intervals of 95 %",
        ("Hz", "mode", "parts", "damping ratio, median", "least, at", "forced", "rms, largest, at"),
        [_track_row(result, track) for track in shown],
    )
    if rare := len(result.tracks) - len(shown):
        typer.echo(f"{rare} more swings, each in fewer than {_OFTEN:.0%} of the parts; --json has them")


def _track_row(result: Trend, track: Track) -> tuple[str, ...]:
    estimates = track.estimates
    middle, least = "-", "-"
    if estimates:
        middle = f"{median(e.damping_ratio for e in estimates.values()):.4f}"
        part = min(estimates, key=lambda k: estimates[k].damping_ratio)
        low, high = estimates[part].damping_interval
        when = _clock(result, result.parts[part].start_s)
        least = f"{estimates[part].damping_ratio:.4f} ({low:.4f} to {high:.4f}), {when}"
    starts = [_clock(result, result.parts[k].start_s) for k in track.forced]
    forced = f"{len(starts)}: {starts[0]} to {starts[-1]}" if starts else ""
    largest = max(track.swings, key=lambda k: track.swings[k].amplitude)
    when = _clock(result, result.parts[largest].start_s)
    return (
        f"{track.frequency_hz:.3f}",
        track.mode,
        f"{len(track.swings)} of {len(result.parts)}",
        middle,
        least,
        forced,
        f"{track.swings[largest].amplitude:.3g} {result.unit}, {when}",
    )


def _clock(result: Trend, start_s: float) -> str:
    """Return when a part begins: a time of day where the file has dates, else since its first sample."""
    if result.start:
        from pandas import Timedelta, Timestamp

        return str((Timestamp(result.start) + Timedelta(seconds=start_s)).strftime("%d %H:%M:%S"))
    minutes, seconds = divmod(round(start_s), 60)
    return f"{minutes // 60:d}:{minutes % 60:02d}:{seconds:02d}"


def _print_brought(result: Brought, case: str | None) -> None:
    _print(result.beside, case)
    for line in (*(d.sentence for d in result.differences), *result.new):
        typer.echo(line)


def _print(result: Meter, case: str | None) -> None:
    rows = [row for swing in result.swings for row in _rows(swing, result.unit, case)]
    title = f"{result.source}: {result.length_s:g} s, {result.kind}, {result.quantity}; intervals of 95 %"
    if not rows:
        typer.echo(f"{title}: no oscillation identified")
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
