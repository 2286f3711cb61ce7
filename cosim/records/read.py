"""Records of measurements read: PMU csv, COMTRADE, channels of PSS/E, results of runs, pandas."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from interarea.models.documents import not_utf8, require_regular
from interarea.models.errors import nearest

from ..trajectory import TIME
from .comtrade import read_comtrade
from .even import even_times, longest_piece, on_axis, resampled
from .names import Raw, ieee_channel, known_unit, known_units, other_channel, own_channel, psse_channel
from .record import Array, Channel, Record, RecordError

if TYPE_CHECKING:
    import pandas as pd

WANTED = "a PMU csv, COMTRADE (.cfg, .cff), channels of PSS/E as csv, or trajectory.csv or .parquet of a run"
FILL_S = 0.5  #: longest gap that is interpolated
_HEADER_ROWS = 12  # in which a row that begins with a time is looked for
_TIME_CELL = re.compile(r"\s*\"?(time|t|timestamp|date ?time|zeit)(?![a-z])", re.IGNORECASE)
_MOST_TEXT = 0.05  # of the samples of a column: more are no number, and it is no channel
_IEEE_SAID = "PMU csv of the IEEE form; kV are taken from phase to ground, power as three phases"
_PSSE_SAID = "channels of PSS/E: FREQ as pu of {:g} Hz, powers of machines as pu of SBASE"
_OWN_SAID = "a run's csv names no units: taken as pu"
_INVALID = 0xC000  # of STAT: bits 15 and 14, the data are in error (IEEE C37.118.2)
_UNSYNCHRONISED = 0x2000


def read_record(
    source: str | Path | pd.DataFrame,
    *,
    units: Mapping[str, str] | None = None,
    rate_hz: float | None = None,
    window_s: tuple[float, float] | None = None,
    fill_s: float = FILL_S,
    frequency_hz: float = 60.0,
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
    name = "the table" if not isinstance(source, str | Path) else str(source)
    stamps, values, raws, notes, start = _loaded(source, frequency_hz)
    raws = [_with_unit(raw, units or {}, name) for raw in raws]
    _check_units(units or {}, raws, name)
    values = values * np.array([r.factor for r in raws]) + np.array([r.offset for r in raws])
    values, raws, flagged = _without_flagged(values, raws)
    _check_scales(name, values, raws)
    place, step_s, remark = even_times(name, stamps)
    piece, cut = longest_piece(name, place, step_s, fill_s)
    values, raws, filled = on_axis(name, place[piece], values[piece], raws, step_s, fill_s)
    notes = [*notes, *flagged, *remark, *cut, *filled]
    if rate_hz is not None:
        values, step_s, resampling = resampled(values, step_s, rate_hz, name)
        notes += [resampling] if resampling else []
    time_s = step_s * np.arange(len(values), dtype=np.float64)
    channels = tuple(r.channel for r in _distinct(raws))
    record = Record(name, time_s, values, channels, tuple(notes), start)
    if len(record.still()) == len(channels):
        raise RecordError(
            f"{name}: no channel moves in {record.length_s:g} s, wanted: signals of a grid that lives"
        )
    return record if window_s is None else record.between(*window_s)


def require_record(path: str | Path) -> None:
    """Require that a path is that of a regular file, which is not read. Raises RecordError."""
    require_regular(Path(path), WANTED, RecordError)


_Loaded = tuple[Array, Array, list[Raw], list[str], str]


def _loaded(source: Any, frequency_hz: float) -> _Loaded:
    if not isinstance(source, str | Path):
        if not hasattr(source, "columns"):
            raise RecordError(f"source: is {type(source).__name__}, wanted: {WANTED}, or a DataFrame")
        return _frame(source)
    path = Path(source)
    require_record(path)
    with path.open("rb") as file:
        head = file.read(4096)
    if head.startswith(b"PAR1"):
        return _parquet(path)
    if path.suffix.casefold() == ".dat":
        raise RecordError(
            f"{path}: holds the data of a COMTRADE record, wanted: its .cfg file, {path.stem}.cfg"
        )
    if path.suffix.casefold() in (".cfg", ".cff"):
        return _comtrade(path)
    if not head.strip():
        raise RecordError(f"{path}: is empty, wanted: {WANTED}")
    if what := not_utf8(head):
        if path.suffix.casefold() in (".out", ".outx"):
            what = "holds channels of PSS/E in its own form, wanted: csv, which its dyntools write"
        raise RecordError(f"{path}: {what}; {WANTED}")
    return _csv(path, frequency_hz)


def _csv(path: Path, frequency_hz: float) -> _Loaded:
    with path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
        sample = file.readline()
        separator = max(",;\t", key=sample.count)
        file.seek(0)
        rows = [
            row for row, _ in zip(csv.reader(file, delimiter=separator), range(_HEADER_ROWS), strict=False)
        ]
    header, first = _header(path, rows)
    stamps, values, texts, start = _numbers(path, first, len(rows[header]), separator)
    names, extra = [cell.strip() for cell in rows[header]], rows[header + 1 : first]
    raws, notes = _named_columns(names, extra, frequency_hz)
    keep = [k for k, share in enumerate(texts) if share <= _MOST_TEXT]
    if not keep:
        raise RecordError(f"{path}: no column holds numbers, wanted: {WANTED}")
    notes += [
        f"{raws[k].channel.name}: {s:.0%} of its cells are no number: left out"
        for k, s in enumerate(texts)
        if k not in keep
    ]
    return stamps, values[:, keep], [raws[k] for k in keep], notes, start


def _header(path: Path, rows: list[list[str]]) -> tuple[int, int]:
    """Return the row that names the columns and that of the first sample."""
    header = next((k for k, row in enumerate(rows) if len(row) > 1 and _TIME_CELL.match(row[0])), None)
    if header is None:
        raise RecordError(f"{path}: no row begins with Time and names columns, wanted: {WANTED}")
    first = next((k for k in range(header + 1, len(rows)) if _is_data(rows[k])), None)
    if first is None:
        raise RecordError(f"{path}: no samples follow the header, wanted: rows of a time and numbers")
    return header, first


def _is_data(row: Sequence[str]) -> bool:
    """Whether a row of a csv begins with a time and then has a number."""

    def number(cell: str) -> bool:
        try:
            float(cell)
        except ValueError:
            return False
        return True

    dated = bool(row) and re.match(r"\s*\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}[ T]\d", row[0])
    return bool(row) and (number(row[0]) or bool(dated)) and any(number(c) for c in row[1:])


def _numbers(path: Path, first: int, width: int, separator: str) -> tuple[Array, Array, list[float], str]:
    """Return times in s, values (samples, columns), the share of each column's cells that are no number."""
    import pandas as pd

    try:
        table = pd.read_csv(
            path, sep=separator, header=None, skiprows=first, names=list(range(width)), index_col=False,
            low_memory=False, skip_blank_lines=True, encoding="utf-8-sig", encoding_errors="replace",
            decimal="," if separator == ";" else ".",
        )  # fmt: skip
    except (pd.errors.ParserError, ValueError) as error:
        raise RecordError(
            f"{path}: rows of unlike length: {str(error).strip()}; wanted: {width} cells in each"
        ) from None
    if table.empty:
        raise RecordError(f"{path}: no samples, wanted: rows of a time and numbers")
    stamps, start = _times(path, table[0], first)
    columns, texts = [], []
    for k in range(1, width):
        numbers = pd.to_numeric(table[k], errors="coerce")
        texts.append(float((numbers.isna() & table[k].notna()).mean()))
        columns.append(numbers.to_numpy(dtype=float))
    return stamps, np.column_stack(columns), texts, start


def _times(source: object, column: Any, skipped: int = 0) -> tuple[Array, str]:
    """Return times as seconds from the first, and what the first was where it is a date."""
    import pandas as pd

    numbers = pd.to_numeric(column, errors="coerce")
    if numbers.notna().all():
        values = numbers.to_numpy(dtype=float)
        if pd.api.types.is_datetime64_any_dtype(column):
            values = pd.DatetimeIndex(column).as_unit("ns").asi8 / 1e9
            return values - values[0], str(column.iloc[0])
        return values - values[0], ""
    if numbers.notna().mean() > 0.5:
        dates = numbers
    else:
        dates = pd.to_datetime(column, errors="coerce", format="mixed")
    if dates.isna().any():
        row = int(np.flatnonzero(dates.isna())[0])
        raise RecordError(
            f"{source}: row {skipped + row + 1} has {str(column.iloc[row])[:40]!r} for its time, "
            "wanted: seconds or a date"
        )
    ticks = pd.DatetimeIndex(dates).as_unit("ns").asi8
    return (ticks - ticks[0]) / 1e9, str(dates.iloc[0])


def _named_columns(
    names: list[str], extra: list[list[str]], frequency_hz: float
) -> tuple[list[Raw], list[str]]:
    """Return the channels of the columns after the first, by the rows between their names and the samples."""
    if len(extra) >= 2 and _kinds(extra[0]):
        devices = extra[2] if len(extra) > 2 else []
        columns = range(1, len(names))
        return [ieee_channel(_place(names, devices, k), extra[0][k], extra[1][k]) for k in columns], [
            _IEEE_SAID
        ]
    psse = [psse_channel(name, frequency_hz) for name in names[1:]]
    if sum(raw is not None for raw in psse) > len(psse) / 2:
        channels = [raw or other_channel(name) for raw, name in zip(psse, names[1:], strict=True)]
        return channels, [_PSSE_SAID.format(frequency_hz)]
    if names[0] == TIME:
        return [own_channel(n, "pu") or other_channel(n) for n in names[1:]], [_OWN_SAID]
    units = _units_row(extra, len(names))
    return [other_channel(n, u) for n, u in zip(names[1:], units[1:], strict=True)], []


def _units_row(extra: list[list[str]], width: int) -> list[str]:
    """Return the row of units below the names, or empty texts where there is none."""
    row = [*(extra[0] if extra else []), *[""] * width][:width]
    return row if sum(known_unit(c) and bool(c.strip()) for c in row) > width / 2 else [""] * width


def _kinds(row: list[str]) -> bool:
    known = {"F", "VM", "VA", "IM", "IA", "P", "Q", "STAT"}
    return sum(cell.strip().upper() in known for cell in row[1:]) > (len(row) - 1) / 2


def _place(names: list[str], devices: list[str], k: int) -> str:
    """Return the terminal of a column: its place, with the device where that says more."""
    device = devices[k].strip() if k < len(devices) else ""
    return names[k] if not device or device in names[k] else f"{names[k]} {device}"


def _parquet(path: Path) -> _Loaded:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table = pq.read_table(path)
    except (pa.ArrowException, OSError) as error:
        raise RecordError(f"{path}: is damaged, {str(error).splitlines()[0]}; wanted: {WANTED}") from None
    units = {f.name: (f.metadata or {}).get(b"unit", b"").decode() for f in table.schema}
    frame = table.to_pandas()
    frame.attrs["units"] = units
    return _frame(frame, str(path))


def _frame(frame: pd.DataFrame, name: str = "the table") -> _Loaded:
    """Return what a DataFrame holds, by its attrs or the names of its columns."""
    import pandas as pd

    attrs = dict(frame.attrs)
    units = attrs.get("units", attrs.get("unit", {}))
    times = [c for c in frame.columns if _TIME_CELL.match(str(c)) or str(c) == TIME]
    if times:
        column, frame = frame[times[0]], frame.drop(columns=times[:1])
    elif frame.index.dtype.kind in "fM" or str(frame.index.name) == TIME:
        column = frame.index.to_series()
    else:
        raise RecordError(f"{name}: no column Time and no index of times, wanted: one of them")
    stamps, start = _times(name, column.reset_index(drop=True))
    raws, columns = [], []
    for c in frame.columns:
        if not (pd.api.types.is_numeric_dtype(frame[c]) or pd.api.types.is_bool_dtype(frame[c])):
            continue
        known = attrs.get("quantity", {}).get(c, ""), attrs.get("terminal", {}).get(c, "")
        unit = units.get(c, "")
        own = None if any(known) else own_channel(str(c), unit)
        raws.append(own or other_channel(str(c), unit, *known))
        columns.append(frame[c].to_numpy(dtype=float))
    if not columns:
        raise RecordError(f"{name}: no column of numbers beside the time, wanted: measurements")
    return stamps, np.column_stack(columns), raws, [], start


def _comtrade(path: Path) -> _Loaded:
    data = read_comtrade(path)
    raws = []
    for c in data.analogs:
        raw = other_channel(c.name, c.unit, terminal=c.circuit)
        raws.append(replace(raw, channel=replace(raw.channel, name=c.name)))
    flags = [Raw(Channel(n, "status", "1", "")) for n in data.flags]
    stamps = "its time stamps" if data.stamped else "its sampling rates"
    notes = [f"COMTRADE of {data.station or 'no station'}, time by {stamps}"]
    return data.time_s, np.hstack([data.analog, data.status]), [*raws, *flags], notes, data.start


def _with_unit(raw: Raw, units: Mapping[str, str], source: str) -> Raw:
    """Return a channel with the unit that the caller names for its name, its last word or its quantity."""
    channel = raw.channel
    unit = next(
        (units[k] for k in (channel.name, channel.name.split(" ")[-1], channel.quantity) if k in units), None
    )
    if unit is None:
        return raw
    if not known_unit(unit):
        raise RecordError(f"{source}: units[...] = {unit!r}, allowed: {known_units()}")
    return other_channel(channel.name, unit, channel.quantity, channel.terminal)


def _check_units(units: Mapping[str, str], raws: Sequence[Raw], source: str) -> None:
    names = {k for r in raws for k in (r.channel.name, r.channel.name.split(" ")[-1], r.channel.quantity)}
    for key in units:
        if key not in names:
            raise RecordError(
                f"{source}: units names {key!r}, which no channel or quantity is; {nearest(key, names)}"
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
                f"{raw.channel.name}: {late} samples without a synchronised clock: taken, angles uncertain"
            )
    left = [k for k, r in enumerate(raws) if r.channel.quantity != "status"]
    return values[:, left], [raws[k] for k in left], notes


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
        if channel.quantity == "frequency" and not (40.0 <= middle <= 70.0 or abs(middle) < 5.0):
            raise _wrong_scale(source, channel, f"{middle:.4g} Hz", "40 to 70 Hz, or a deviation", "mHz")
        if channel.unit == "kV" and not middle <= 2000.0:
            raise _wrong_scale(source, channel, f"{middle:.4g} kV", "up to 2000 kV", "V")
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
    return RecordError(
        f"{source}: {channel.name} is {got}, allowed: {allowed}; "
        f"if the unit is wrong say so, as units = {{{key!r}: {unit!r}}}"
    )


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
