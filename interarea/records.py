"""Public functions on records of measurements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING

from interarea.cosim.records.brought import brought
from interarea.cosim.records.files.read import read_pieces, read_record
from interarea.cosim.records.fit import Fit, fitted
from interarea.cosim.records.meter import Meter
from interarea.cosim.records.meter import meter as metered
from interarea.cosim.records.record import Record, RecordError, rated_hz
from interarea.cosim.records.trend import EVERY_S, Trend, trend
from interarea.fmu_build.write.cache import default_cache
from interarea.grids import case_like
from interarea.models.arguments import checked_types

if TYPE_CHECKING:
    import pandas as pd

    from interarea.design.modes.modes import Mode
    from interarea.models.case.case import Case


@checked_types
def meter(
    record: Record | str | Path | pd.DataFrame,
    case: Case | str | Path | None = None,
    *,
    beside: Record | str | Path | pd.DataFrame | None = None,
    band_hz: tuple[float, float] = (0.1, 2.5),
    quantity: str | None = None,
    channels: Sequence[str] = (),
) -> Meter:
    """Return the oscillations of a record, their damping, and whether they are forced.

    As the command ``interarea meter`` does.

    Parameters
    ----------
    record : a `Record`, or an argument of `read_record`.
    case : its modes name the oscillations: a `Case`, a bundled name or a file.
    beside : a record without the controller that `record` has: the result also has `differences` of the
        damping ratios with intervals, a `sentence` on them, and `beside`, the result of that record.
    band_hz : frequency band, Hz. quantity, channels : to be analysed.

    Raises
    ------
    UserError : no oscillation, records too short, or the same record twice.
    """
    grid = None if case is None else case_like(case)
    frequency_hz = rated_hz(grid)
    modes = () if grid is None else modes_in(grid, band_hz)
    one = _record(record, frequency_hz)
    if beside is None:
        return metered(one, band_hz=band_hz, quantity=quantity, channels=channels, modes=modes)
    other = _record(beside, frequency_hz)
    return brought(one, other, band_hz=band_hz, quantity=quantity, channels=channels, modes=modes)


@checked_types
def damping_trend(
    record: str | Path | pd.DataFrame,
    case: Case | str | Path | None = None,
    *,
    every_s: float = EVERY_S,
    window_s: tuple[float, float] | None = None,
    units: Mapping[str, str] | None = None,
    band_hz: tuple[float, float] = (0.1, 2.5),
    quantity: str | None = None,
    channels: Sequence[str] = (),
) -> Trend:
    """Analyse each part of a long record, and track its oscillations from part to part.

    As ``interarea meter FILE --every SECONDS`` does. A csv or Parquet file is read part by part.

    Parameters
    ----------
    record : a path or a DataFrame. every_s : length of a part, s; the remainder at the end is also a part.
    window_s : parts outside are omitted, s. units : as in `read_record`.
    case, band_hz, quantity, channels : as in `meter`.

    Raises
    ------
    UserError : another kind of file, a window that ends before it starts, or no part can be metered, with
        the first reason.
    """
    grid = None if case is None else case_like(case)
    frequency_hz = rated_hz(grid)
    modes = () if grid is None else modes_in(grid, band_hz)
    low, high = (-inf, inf) if window_s is None else window_s
    if not low < high:
        raise RecordError(f"window_s = ({low:g}, {high:g}), allowed: the first below the second")
    pieces = (
        piece
        for piece in read_pieces(record, every_s, units=units, frequency_hz=frequency_hz)
        if low <= piece.start_s and piece.end_s <= high
    )
    return trend(pieces, every_s, band_hz=band_hz, quantity=quantity, channels=channels, modes=modes)


def modes_in(case: Case, band_hz: tuple[float, float]) -> tuple[Mode, ...]:
    """Return all modes of a case in a band with a damping ratio below 0.3."""
    from interarea.cosim.run.artefacts import sparse_linear_plant
    from interarea.design.modes.all_modes import all_modes

    plant = sparse_linear_plant(case, default_cache())
    return all_modes(plant, case.areas, band_hz=band_hz, below=0.3).modes


def _record(source: Record | str | Path | pd.DataFrame, frequency_hz: float) -> Record:
    return source if isinstance(source, Record) else read_record(source, frequency_hz=frequency_hz)


@checked_types
def fit(
    record: Record | str | Path | pd.DataFrame,
    case: Case | str | Path,
    machine: str,
    parameters: Sequence[str] = (),
    *,
    rest_s: float = 0.5,
) -> Fit:
    """Apply a record's voltage and angle to a single machine with its controls; fit parameters to P and Q.

    As the command ``interarea fit`` does.

    Parameters
    ----------
    record : a `Record`, or what `read_record` takes.
    case, machine : the machine in its case. parameters : such as ``H``, ``exciter.KA``, six at most; none:
        no fit. `kept_as_is` names those that the record does not determine.
    rest_s : duration of the steady state at the start of the record, s.

    Raises
    ------
    UserError : no such machine or parameter, a missing measurement, a record too short.
    """
    grid = case_like(case)
    one = _record(record, grid.frequency_hz)
    return fitted(one, grid, machine, default_cache(), parameters=parameters, rest_s=rest_s)
