"""What the commands on records share: which file, how it is read, and what was assumed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ...command_usage import naming
from ..terminal import note, two_numbers

if TYPE_CHECKING:
    from interarea.cosim.records.record import Record
    from interarea.models.case.case import Case

RecordFile = Annotated[
    Path,
    typer.Argument(
        metavar="FILE",
        help="PMU csv, COMTRADE (.cfg, .cff), channels of PSS/E as csv, trajectory.csv or .parquet of a run",
        show_default=False,
        callback=naming("record"),
    ),
]
CaseName = Annotated[
    str | None,
    typer.Option(
        "--case",
        metavar="CASE",
        help="bundled case or TOML file of the same grid",
        callback=naming("case"),
    ),
]
Band = Annotated[
    str | None, typer.Option("--band", metavar="LOW:HIGH", help="frequency band, Hz; default 0.1:2.5")
]
Window = Annotated[
    str | None, typer.Option("--window", metavar="START:END", help="part of the record to use, s")
]
Units = Annotated[
    list[str] | None,
    typer.Option(
        "--unit", metavar="WHAT=UNIT", help="unit of a channel or quantity, as VA=rad, if the file is wrong"
    ),
]


def opened(file: Path, window: str | None, units: list[str] | None, grid: Case | None) -> Record:
    """Return the record of a file; say on stderr what was assumed."""
    from interarea.cosim.records.files.read import read_record
    from interarea.cosim.records.record import rated_hz

    span = window_of(window)
    record = read_record(file, units=units_of(units), window_s=span, frequency_hz=rated_hz(grid))
    for line in record.notes:
        note(f"{file.name}: {line}")
    return record


def units_of(units: list[str] | None) -> dict[str, str]:
    """Return channel or quantity -> unit, of each `--unit`."""
    from interarea.cosim.records.record import RecordError

    named = {}
    for text in units or ():
        what, equals, unit = text.partition("=")
        if not equals:
            raise RecordError(f"--unit {text!r}, wanted WHAT=UNIT, such as VA=rad")
        named[what.strip()] = unit.strip()
    return named


def window_of(text: str | None) -> tuple[float, float] | None:
    """Return start and end, s, of `--window`; None without it."""
    return None if text is None else _numbers(text, "--window", "START:END in s, such as 10:70")


def case_named(name: str | None) -> Case | None:
    """Return the case of `--case`; None without it."""
    if name is None:
        return None
    from interarea.models.case.case import load_case

    return load_case(name)


def band_of(text: str | None) -> tuple[float, float]:
    """Return the frequencies (Hz) of `--band`, or those looked at without it."""
    from interarea.cosim.records.record import BAND_HZ, RecordError

    band = BAND_HZ if text is None else _numbers(text, "--band", "LOW:HIGH in Hz, such as 0.1:2.5")
    if not band[0] >= 0.0:
        raise RecordError(f"--band {text!r}, allowed: frequencies of 0 or more, in Hz")
    return band


def _numbers(text: str, option: str, expected: str) -> tuple[float, float]:
    """Return the two numbers of LOW:HIGH, the first below the second."""
    from interarea.cosim.records.record import RecordError

    low, high = two_numbers(text, option, expected, RecordError)
    if not low < high:
        raise RecordError(f"{option} {text!r}, allowed: the first below the second")
    return low, high
