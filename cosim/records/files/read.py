"""Records of measurements read: PMU csv, COMTRADE, channels of PSS/E, results of runs, pandas."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from interarea.models.arguments import checked_types
from interarea.models.devices.language.device import USUAL_HZ
from interarea.models.errors import nearest

from ..record import ANGLES, DEVIATION_HZ, UNITS, Array, Channel, Record, RecordError
from .even import even_times, longest_piece, on_axis, resampled
from .names import Raw, known_unit, known_units, other_channel
from .tables import Table, tables_of

if TYPE_CHECKING:
    import pandas as pd

FILL_S = 0.5  #: longest gap that is interpolated
PIECE_ROWS = 1 << 14  #: that are read at a time: 20 MB of 150 channels
_LEAST_HZ, _MOST_HZ = 40.0, 70.0  # of a grid's frequency, well beyond what its machines stand
#: unit -> the most that a channel can have in it, and the unit that it may have instead
_MOST = {"kV": (2000.0, "V"), "MW": (1e6, "W"), "Mvar": (1e6, "var"), "A": (1e6, "A")}
_NAMED = 3  # channels that a note names
#: magnitudes that loggers write where they have no value, and the least that no measured value has
_CODES = (*(10.0**n - 1.0 for n in range(3, 10)), 999.25, 999.9, 999.99, 9999.9, 9999.99, 32767.0, 32768.0)
_HUGE = 1e15
_INVALID = 0xC000  # of STAT: bits 15 and 14, the data are in error (IEEE C37.118.2)
_UNSYNCHRONISED = 0x2000


@checked_types
def read_record(
    source: str | Path | pd.DataFrame,
    *,
    units: Mapping[str, str] | None = None,
    rate_hz: float | None = None,
    window_s: tuple[float, float] | None = None,
    fill_s: float = FILL_S,
    frequency_hz: float = USUAL_HZ,
) -> Record:
    """Read a record of measurements; see `Record`.

    Parameters
    ----------
    source : PMU csv of the IEEE form (four header rows: place, F VM VA IM IA, unit, device), COMTRADE (.cfg,
        .cff), channels of PSS/E as csv, another csv with a header, trajectory.csv or .parquet of a run,
        or a DataFrame (index or first column: time; ``attrs["units"]``).
    units : name or quantity of a channel -> its unit, where the source is wrong or silent: ``{"VA": "rad"}``.
    rate_hz : resample to this rate, with a filter of zero phase. window_s : start and end, s.
    fill_s : longest gap that is interpolated. frequency_hz : rated, for deviations in pu (PSS/E).

    Raises
    ------
    UserError : another kind of file, a wrong scale, times that jump, or nothing that can be read.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> count = np.arange(60)
    >>> frame = pd.DataFrame({"Time": count / 30.0, "Bus 7 VM [kV]": 230.0 + np.sin(count)})
    >>> read_record(frame).table().loc[0].to_dict()
    {'name': 'Bus 7 VM', 'quantity': 'voltage', 'unit': 'kV', 'terminal': 'Bus 7'}
    """
    name = _named(source)
    if not 0.0 <= fill_s < inf:
        raise RecordError(f"{name}: fill_s = {fill_s:g} s, allowed: 0 or above")
    table = next(tables_of(source, _rated(name, frequency_hz)))
    record = _record(name, table, units or {}, fill_s, rate_hz, frequency_hz)
    return record if window_s is None else record.between(*window_s)


@dataclass(frozen=True)
class Piece:
    """A part of a file. start_s, end_s : since its first sample. record : its content, or why none."""

    start_s: float
    end_s: float
    record: Record | RecordError


def read_pieces(
    source: str | Path | pd.DataFrame,
    every_s: float,
    *,
    units: Mapping[str, str] | None = None,
    frequency_hz: float = USUAL_HZ,
) -> Iterator[Piece]:
    """Yield the parts of a file, `every_s` long, as records; csv and Parquet are never in memory as a whole.

    source, units, frequency_hz : as `read_record` takes them. A part that cannot be read, such as one with a
    gap, has the reason in place of its record. What no sample lies in is no part.

    Raises
    ------
    UserError : another kind of file, or a length that is not positive.
    """
    if not 0.0 < every_s < inf:
        raise RecordError(f"pieces of {every_s:g} s, allowed: above 0")
    name = _named(source)
    for start_s, table in _cut(tables_of(source, _rated(name, frequency_hz), PIECE_ROWS), every_s):
        try:
            record: Record | RecordError = _record(name, table, units or {}, FILL_S, None, frequency_hz)
        except RecordError as error:
            record = error
        yield Piece(start_s, start_s + every_s, record)


def _cut(tables: Iterator[Table], every_s: float) -> Iterator[tuple[float, Table]]:
    """Yield start, s, and table of each part; rows stay in the order of the file."""
    waiting: list[Table] = []
    part = 0
    for table in tables:
        while len(table.stamps):
            late = table.stamps >= (part + 1) * every_s - 1e-6
            many = int(np.argmax(late)) if late.any() else len(late)
            if many:
                waiting.append(_rows(table, slice(0, many)))
            table = _rows(table, slice(many, None))
            if late.any():
                if waiting:
                    yield part * every_s, _joined(waiting)
                    waiting = []
                part = max(part + 1, int((table.stamps[0] + 1e-6) // every_s))
    if waiting:
        yield part * every_s, _joined(waiting)


def _rows(table: Table, rows: slice) -> Table:
    return replace(table, stamps=table.stamps[rows], values=table.values[rows])


def _joined(tables: Sequence[Table]) -> Table:
    """Return tables of one file as one, with the columns that all of them have."""
    names = [{raw.channel.name for raw in t.raws} for t in tables]
    common = set.intersection(*names)
    columns = [[k for k, raw in enumerate(t.raws) if raw.channel.name in common] for t in tables]
    notes = list(dict.fromkeys(n for t in tables for n in t.notes))
    values = np.vstack([t.values[:, k] for t, k in zip(tables, columns, strict=True)])
    stamps = np.concatenate([t.stamps for t in tables])
    return replace(
        tables[0], stamps=stamps, values=values, raws=[tables[0].raws[k] for k in columns[0]], notes=notes
    )


def _named(source: object) -> str:
    return str(source) if isinstance(source, str | Path) else "the table"


def _rated(name: str, frequency_hz: float) -> float:
    if not 0.0 < frequency_hz < inf:
        raise RecordError(f"{name}: frequency_hz = {frequency_hz:g}, allowed: above 0, the grid's rated one")
    return frequency_hz


def _record(
    name: str,
    table: Table,
    units: Mapping[str, str],
    fill_s: float,
    rate_hz: float | None,
    frequency_hz: float,
) -> Record:
    """Return the record that a table holds.

    Raises
    ------
    RecordError : a wrong scale, times that jump, or nothing that moves.
    """
    raws = [_with_unit(_in_hertz(raw, frequency_hz), units, name, frequency_hz) for raw in table.raws]
    _check_units(units, raws, name)
    columns = [k for k, raw in enumerate(raws) if not _misfit(raw.channel)]
    misfits = [_misfit(raw.channel) for raw in raws if _misfit(raw.channel)]
    if not columns:
        raise RecordError(f"{name}: no channel is left, {'; '.join(misfits[:_NAMED])}")
    raws = [raws[k] for k in columns]
    values, coded = _without_codes(table.values[:, columns], raws)
    values = values * np.array([r.factor for r in raws]) + np.array([r.offset for r in raws])
    values, raws, flagged = _without_flagged(values, raws)
    _check_scales(name, values, raws)
    flagged += [*coded, *_without_dropouts(values, raws), *_without_units(raws)]
    used, place, step_s, remark = even_times(name, table.stamps)
    piece, cut = longest_piece(name, place, step_s, fill_s)
    values, raws, filled = on_axis(name, place[piece], values[used][piece], raws, step_s, fill_s)
    notes = [*table.notes, *misfits, *flagged, *remark, *cut, *filled]
    if rate_hz is not None:
        values, step_s, resampling = resampled(values, step_s, rate_hz, name)
        notes += [resampling] if resampling else []
    time_s = step_s * np.arange(len(values), dtype=np.float64)
    channels = tuple(r.channel for r in _distinct(raws))
    record = Record(name, time_s, values, channels, tuple(notes), table.start)
    if len(record.still()) == len(channels):
        raise RecordError(f"{name}: no channel varies in {record.length_s:g} s, wanted: signals that vary")
    return record


def _with_unit(raw: Raw, units: Mapping[str, str], source: str, frequency_hz: float) -> Raw:
    """Return a channel with the unit that the caller names for its name, its last word or its quantity."""
    channel = raw.channel
    unit = next(
        (units[k] for k in (channel.name, channel.name.split(" ")[-1], channel.quantity) if k in units), None
    )
    if unit is None:
        return raw
    if not known_unit(unit):
        raise RecordError(f"{source}: unit {unit!r} of {channel.name}, allowed: {known_units()}")
    raw = _in_hertz(other_channel(channel.name, unit, channel.quantity, channel.terminal), frequency_hz)
    if _misfit(raw.channel):
        raise RecordError(
            f"{source}: unit {unit!r} of {channel.name}, allowed: one of its quantity, {channel.quantity}: "
            f"{', '.join(UNITS[channel.quantity])}"
        )
    return raw


def _in_hertz(raw: Raw, frequency_hz: float) -> Raw:
    """Return a channel of a frequency in pu, near 1 or a deviation, as one in Hz."""
    if raw.channel.quantity != "frequency" or raw.channel.unit != "pu":
        return raw
    return replace(raw, channel=replace(raw.channel, unit="Hz"), factor=raw.factor * frequency_hz)


def _misfit(channel: Channel) -> str:
    """Return why a channel has a unit that its quantity cannot have, with the remedy; "" if it can."""
    allowed = UNITS[channel.quantity]
    if channel.unit in ("1", *allowed) or channel.quantity == "other":
        return ""
    return (
        f"{channel.name}: {channel.quantity} in {channel.unit}, allowed: {', '.join(allowed)}: left out; "
        f"{_remedy(channel.name, allowed[0])}"
    )


def _check_units(units: Mapping[str, str], raws: Sequence[Raw], source: str) -> None:
    names = {k for r in raws for k in (r.channel.name, r.channel.name.split(" ")[-1], r.channel.quantity)}
    for key in units:
        if key not in names:
            raise RecordError(
                f"{source}: units names {key!r}, which is not a channel or quantity; {nearest(key, names)}"
            )


def _without_flagged(values: Array, raws: list[Raw]) -> tuple[Array, list[Raw], list[str]]:
    """Return the values without those that a STAT word of their terminal calls wrong, and notes."""
    notes = []
    values = values.copy()
    for k, raw in enumerate(raws):
        if raw.channel.quantity != "status" or not np.nanmax(values[:, k], initial=0.0) > 1.0:
            continue
        word = np.nan_to_num(values[:, k]).astype(np.int64)
        same = [j for j, r in enumerate(raws) if j != k and r.channel.terminal == raw.channel.terminal]
        wrong = (word & _INVALID) != 0
        if wrong.any():
            values[np.ix_(wrong, same)] = np.nan
            notes.append(f"{raw.channel.name}: {int(wrong.sum())} samples are flagged as wrong: left out")
        late = int(((word & _UNSYNCHRONISED) != 0).sum())
        if late:
            notes.append(
                f"{raw.channel.name}: {late} samples without a synchronised clock: used, angles uncertain"
            )
    left = [k for k, r in enumerate(raws) if r.channel.quantity != "status"]
    return values[:, left], [raws[k] for k in left], notes


def _without_codes(values: Array, raws: Sequence[Raw]) -> tuple[Array, list[str]]:
    """Return the values of a file without codes for missing ones, and notes.

    A value of `_CODES`, or from `_HUGE` on, is one if it lies farther from all other values of its channel
    than these differ, and than half the largest of them.
    """
    values, notes = values.copy(), []
    size = np.abs(values)
    code = np.isin(size, _CODES) | (size >= _HUGE)
    for k, raw in enumerate(raws):
        column = values[:, k]
        if raw.channel.quantity == "status" or not code[:, k].any():
            continue
        there = column[np.isfinite(column) & ~code[:, k]]
        low, high = (there.min(), there.max()) if there.size else (0.0, 0.0)
        reach = max(high - low, 0.5 * max(-low, high))
        wrong = code[:, k] & ~((column >= low - reach) & (column <= high + reach))
        if wrong.any():
            codes = ", ".join(f"{value:.6g}" for value in np.unique(column[wrong]))
            notes.append(f"{raw.channel.name}: {int(wrong.sum())} samples are {codes}: taken as missing")
            column[wrong] = np.nan
    return values, notes


def _without_dropouts(values: Array, raws: Sequence[Raw]) -> list[str]:
    """Take impossible samples out of `values`, such as zeros of a frequency; return notes on them."""
    notes = []
    for k, raw in enumerate(raws):
        column, quantity = values[:, k], raw.channel.quantity
        there = column[np.isfinite(column)]
        if quantity == "frequency" and there.size and np.median(there) >= _LEAST_HZ:
            low, high, outside = _LEAST_HZ, _MOST_HZ, f"outside {_LEAST_HZ:g} to {_MOST_HZ:g} Hz"
        else:
            high, _ = _MOST.get(raw.channel.unit, (inf, ""))
            low = 0.0 if quantity in ("voltage", "current") else -high
            outside = f"outside {low:g} to {high:g} {raw.channel.unit}" if high < inf else "below 0"
        wrong = ~((column >= low) & (column <= high)) & ~np.isnan(column)
        if wrong.any():
            column[wrong] = np.nan
            notes.append(f"{raw.channel.name}: {int(wrong.sum())} samples are {outside}: left out")
    return notes


def _without_units(raws: Sequence[Raw]) -> list[str]:
    """Return notes where angles, or what has another unit than 1, have none."""
    silent = [r.channel for r in raws if r.channel.unit == "1" and UNITS[r.channel.quantity] != ("1",)]
    angles = [c.name for c in silent if c.quantity in ANGLES]
    others = [c.name for c in silent if c.quantity not in ANGLES]
    kinds = (
        (angles, "angles without a unit in the file are taken as rad"),
        (others, "without a known unit in the file, used as they are"),
    )
    return [f"{what}: {', '.join(names[:_NAMED])}" for names, what in kinds if names]


def _check_scales(source: str, values: Array, raws: Sequence[Raw]) -> None:
    """Raise for values that their unit cannot have."""
    for k, raw in enumerate(raws):
        channel, column = raw.channel, values[:, k]
        column = column[np.isfinite(column)]
        if not column.size:
            continue
        if channel.quantity == "voltage angle":
            _check_wraps(source, channel, column, raw.factor)
            continue
        middle = float(np.median(column))
        if channel.quantity == "frequency" and not (
            _LEAST_HZ <= middle <= _MOST_HZ or abs(middle) < DEVIATION_HZ
        ):
            raise _wrong_scale(source, channel, f"{middle:.4g} Hz", "40 to 70 Hz, or a deviation", "mHz")
        most, other = _MOST.get(channel.unit, (inf, ""))
        if not abs(middle) <= most:
            got, allowed = f"{middle:.4g} {channel.unit}", f"up to {most:g} {channel.unit}"
            raise _wrong_scale(source, channel, got, allowed, other)
        if channel.quantity in ("voltage", "current") and not middle >= 0.0:
            raise _wrong_scale(source, channel, f"{middle:.4g} {channel.unit}", "a magnitude from 0", "deg")


def _check_wraps(source: str, channel: Channel, column: Array, factor: float) -> None:
    """Raise where an angle wraps as one of the other unit does. factor : of the unit that was taken."""
    if factor < 1.0 and _wraps_in_radians(column / factor):
        raise _wrong_scale(source, channel, "degrees that jump by 6.283", "jumps by 360", "rad")
    if factor == 1.0 and np.max(np.abs(np.diff(column)), initial=0.0) > 100.0:
        raise _wrong_scale(source, channel, "radians that jump by 360", "jumps by 6.283", "deg")


def _wraps_in_radians(degrees: npt.NDArray[np.float64]) -> bool:
    jumps = np.abs(np.diff(degrees))
    return bool(np.sum(np.abs(jumps - 2.0 * np.pi) < 0.3) >= 2 and np.max(np.abs(degrees)) < 3.3)


def _wrong_scale(source: str, channel: Channel, got: str, allowed: str, unit: str) -> RecordError:
    key = channel.name.split(" ")[-1]
    return RecordError(f"{source}: {channel.name} is {got}, allowed: {allowed}; {_remedy(key, unit)}")


def _remedy(name: str, unit: str) -> str:
    """Return what to do where the file has a wrong unit, as it is typed and in Python."""
    return f"if the unit is wrong: --unit '{name}={unit}', in Python units={{{name!r}: {unit!r}}}"


def _distinct(raws: Sequence[Raw]) -> list[Raw]:
    """Return the channels with names of their own."""
    seen: dict[str, int] = {}
    channels = []
    for raw in raws:
        name = raw.channel.name
        seen[name] = seen.get(name, 0) + 1
        if seen[name] > 1:
            raw = replace(raw, channel=replace(raw.channel, name=f"{name} ({seen[name]})"))
        channels.append(raw)
    return channels
