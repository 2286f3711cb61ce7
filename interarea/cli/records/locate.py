"""The command `locate`: through which terminal an oscillation comes in."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated

import typer

from ..terminal import busy, note, print_table
from .options import Band, CaseName, RecordFile, Units, Window, band_of, opened

if TYPE_CHECKING:
    from interarea.cosim.records.energy import Source

_SHOWN = 12  #: terminals


def locate(
    file: RecordFile,
    case: CaseName = None,
    band: Band = None,
    frequency: Annotated[
        float | None,
        typer.Option("--frequency", metavar="HZ", help="of the oscillation; the largest by itself"),
    ] = None,
    window: Window = None,
    unit: Units = None,
    json_: Annotated[bool, typer.Option("--json", help="print JSON instead of a table")] = False,
) -> None:
    """Locate an oscillation by the dissipating energy flow at each terminal, with checks."""
    from interarea.cosim.records.energy import located

    region = band_of(band)
    places, frequency_hz = _places(case)
    record = opened(file, window, unit, frequency_hz)
    with busy(f"energy flow of {file.name}"):
        result = located(record, band_hz=region, frequency_hz=frequency, at=places)
    for line in result.notes:
        note(f"{file.name}: {line}")
    if json_:
        typer.echo(json.dumps(result.as_dict(), indent=2, allow_nan=False))
        return
    _print(result)


def _places(case: str | None) -> tuple[dict[str, str], float]:
    """Return for each machine and branch of a case the bus that has its voltage; its frequency, Hz."""
    if case is None:
        return {}, 60.0
    from interarea.models.case.case import load_case

    loaded = load_case(case)
    places = {m.name: f"bus{m.bus}" for m in loaded.machines}
    places |= {f"branch[{b.name}]": f"bus{b.from_bus}" for b in loaded.branches}
    return places, loaded.frequency_hz


def _print(result: Source) -> None:
    title = f"{result.source_file}: {result.length_s:g} s, {result.frequency_hz:.4f} Hz"
    rows = [
        (f.terminal, f"{f.slope:+.4g}", f"{f.halves[0]:+.3g}, {f.halves[1]:+.3g}", f"{f.rms:.3g}")
        for f in result.flows[:_SHOWN]
    ]
    print_table(title, ("terminal", f"energy out of the bus, {result.unit}", "halves", "rms of P"), rows)
    for a, b, apart in result.lines:
        typer.echo(f"the ends {a} and {b} agree to {apart:.1%}")
    typer.echo(f"source: {result.source or 'not named'}; {result.why}")
