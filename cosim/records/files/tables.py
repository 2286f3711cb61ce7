"""Tables of numbers as files of measurements have them, whole or by rows: csv, Parquet, COMTRADE, pandas."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from interarea.models.documents import not_utf8, require_regular

from ...trajectory import TIME
from ..record import UNITS, Array, Channel, RecordError
from .clock import Clock, begins_with_time, dated, time_in_two
from .comtrade import read_comtrade
from .names import (
    Raw,
    ieee_channel,
    known_unit,
    other_channel,
    own_channel,
    psse_channel,
    time_unit_s,
    with_square_brackets,
)

if TYPE_CHECKING:
    import pandas as pd

ACCEPTED = (
    "a PMU csv, COMTRADE (.cfg, .cff), channels of PSS/E as csv, or trajectory.csv or .parquet of a run"
)
_HEADER_ROWS = 12  # in which a row that begins with a time is looked for
_DECIMAL_COMMA = re.compile(r"\s*[-+]?\d*,\d+(?:[eE][-+]?\d+)?\s*")
_MOST_TEXT = 0.05  # of the samples of a column: more are no number, and it is no channel
_IEEE_SAID = "PMU csv of the IEEE form; kV are phase to ground, power is of three phases"
_PSSE_SAID = "channels of PSS/E: FREQ as pu of {:g} Hz, powers of machines as pu of SBASE"
_OWN_SAID = "a run's csv has no units: rad of angles and pu assumed"


@dataclass(frozen=True, eq=False)
class Table:
    """Rows of a file. stamps : (rows,), s from the first stamp of the file. values : (rows, columns), raw.

    raws : the columns. start : the first stamp of the file where it is a date, else "".
    """

    stamps: Array
    values: Array
    raws: list[Raw]
    notes: list[str]
    start: str


def require_record(path: str | Path) -> None:
    """Require that a path is that of a regular file, which is not read. Raises RecordError."""
    require_regular(Path(path), ACCEPTED, RecordError)


def tables_of(source: Any, frequency_hz: float, rows: int | None = None) -> Iterator[Table]:
    """Yield the tables of a source one after the other: of so many rows where the format allows, or one.

    source : a path or a DataFrame. frequency_hz : rated, for deviations in pu (PSS/E). COMTRADE and frames
    come whole.

    Raises
    ------
    RecordError : another kind of file, or one that is damaged.
    """
    if not isinstance(source, str | Path):
        if not hasattr(source, "columns"):
            raise RecordError(f"source: is {type(source).__name__}, wanted: {ACCEPTED}, or a DataFrame")
        yield _frame(source, Clock("the table"))
        return
    path = Path(source)
    require_record(path)
    with path.open("rb") as file:
        head = file.read(4096)
    if head.startswith(b"PAR1"):
        yield from _parquet(path, rows)
    elif path.suffix.casefold() == ".dat":
        raise RecordError(
            f"{path}: holds the data of a COMTRADE record, wanted: its .cfg file, {path.stem}.cfg"
        )
    elif path.suffix.casefold() in (".cfg", ".cff"):
        yield _comtrade(path)
    elif not head.strip():
        raise RecordError(f"{path}: is empty, wanted: {ACCEPTED}")
    elif what := not_utf8(head):
        if path.suffix.casefold() in (".out", ".outx"):
            what = "holds channels of PSS/E in its own form, wanted: csv, which its dyntools write"
        raise RecordError(f"{path}: {what}; {ACCEPTED}")
    else:
        yield from _csv(path, frequency_hz, rows)


def _csv(path: Path, frequency_hz: float, rows: int | None) -> Iterator[Table]:
    numbered = _top(path)
    lines = [line for _, line in numbered]
    sample = next((line for line in lines if begins_with_time(line)), lines[0])
    separator = max(",;\t", key=sample.count)
    top = list(csv.reader(lines, delimiter=separator))
    decimal = _decimal(separator, top)
    header, first = _header(path, top, decimal)
    names = [cell.strip() or f"column {k + 1}" for k, cell in enumerate(top[header])]
    spare = _spare_cells(path, top, first, len(names))
    form = _Form(numbered[first][0], len(names), spare, separator, decimal)
    after = 2 if time_in_two(names) else 1  # the columns of the time
    names, *extra = ([row[0], *row[after:]] for row in (names, *top[header + 1 : first]))
    raws, notes = _named_columns(path, names, extra, frequency_hz)
    clock = Clock(path, time_unit_s(names[0], *(row[0] for row in extra)))
    skipped = form.first
    for frame in _frames(path, form, rows):
        stamps = clock.seconds(frame[0] if after == 1 else clock.joined(frame[0], frame[1]), skipped)
        skipped += len(frame)
        values, texts = _numbers(frame.iloc[:, after:])
        keep, left_out = _of_numbers(path, raws, texts)
        yield Table(stamps, values[:, keep], [raws[k] for k in keep], [*notes, *left_out], clock.start)


def _of_numbers(path: Path, raws: Sequence[Raw], texts: Sequence[float]) -> tuple[list[int], list[str]]:
    """Return which columns hold numbers, and notes on the others. texts : share of cells without one."""
    keep = [k for k, share in enumerate(texts) if share <= _MOST_TEXT]
    if not keep:
        raise RecordError(f"{path}: no column holds numbers, wanted: {ACCEPTED}")
    return keep, [
        f"{raws[k].channel.name}: {share:.0%} of its cells are not numbers: left out"
        for k, share in enumerate(texts)
        if k not in keep
    ]


def _top(path: Path) -> list[tuple[int, str]]:
    """Return number and text of the first lines that are not blank."""
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        lines = zip(range(2 * _HEADER_ROWS), file, strict=False)
        return [(k, line) for k, line in lines if line.strip()][:_HEADER_ROWS]


@dataclass(frozen=True)
class _Form:
    """How the samples of a csv stand: from line `first` on, `width` cells each and `spare` empty ones."""

    first: int
    width: int
    spare: int
    separator: str
    decimal: str


def _decimal(separator: str, rows: Sequence[Sequence[str]]) -> str:
    """Return the decimal sign of a csv: a comma only where that does not separate cells."""
    seen = separator == "\t" and any(_DECIMAL_COMMA.fullmatch(cell) for row in rows for cell in row)
    return "," if separator == ";" or seen else "."


def _spare_cells(path: Path, rows: Sequence[Sequence[str]], first: int, width: int) -> int:
    """Return how many empty cells follow those under the header; RecordError where they are not empty."""
    for k, row in enumerate(rows[first:], first + 1):
        if any(cell.strip() for cell in row[width:]):
            raise RecordError(
                f"{path}: row {k} has {len(row)} cells and the header {width}, wanted: as many in each; "
                "numbers with a decimal comma need ; between the cells"
            )
    return max((len(row) - width for row in rows[first:]), default=0)


def _frames(path: Path, form: _Form, rows: int | None) -> Iterator[pd.DataFrame]:
    """Yield the rows of a csv as they are, `rows` at a time."""
    import pandas as pd

    width = form.width + max(form.spare, 0)
    try:
        # opened here, because pandas miscounts the lines of other ends that it leaves out
        with path.open(encoding="utf-8-sig", errors="replace") as file:
            for _ in range(form.first):
                next(file)
            reader = pd.read_csv(
                file, sep=form.separator, header=None, names=list(range(width)), index_col=False,
                low_memory=False, skip_blank_lines=True, decimal=form.decimal, chunksize=rows, iterator=True,
            )  # fmt: skip
            for frame in reader if rows else (reader.read(),):
                if frame.empty:
                    raise RecordError(f"{path}: no samples, wanted: rows of a time and numbers")
                yield frame.iloc[:, : form.width]
    except RecordError:
        raise
    except (pd.errors.ParserError, ValueError) as error:
        raise RecordError(
            f"{path}: rows of different lengths: {str(error).strip()}; wanted: {form.width} cells in each"
        ) from None


def _numbers(frame: pd.DataFrame) -> tuple[Array, list[float]]:
    """Return values (samples, columns), and of each column the share of cells without a number."""
    import pandas as pd

    columns, texts = [], []
    for _, column in frame.items():
        numbers = pd.to_numeric(column, errors="coerce")
        texts.append(float((numbers.isna() & column.notna()).mean()))
        columns.append(numbers.to_numpy(dtype=float))
    return np.column_stack(columns), texts


def _header(path: Path, rows: list[list[str]], decimal: str) -> tuple[int, int]:
    """Return the row that names the columns and that of the first sample."""
    header = next((k for k, row in enumerate(rows) if len(row) > 1 and begins_with_time(row[0])), None)
    if header is None:
        raise RecordError(f"{path}: no row begins with Time and names columns, wanted: {ACCEPTED}")
    first = next((k for k in range(header + 1, len(rows)) if _is_data(rows[k], decimal)), None)
    if first is None:
        seen = f": row {header + 2} is {','.join(rows[header + 1])[:60]!r}" if len(rows) > header + 1 else ""
        raise RecordError(
            f"{path}: no samples follow the header{seen}, wanted: rows of a time (s, or date and time) and "
            "numbers"
        )
    return header, first


def _is_data(row: Sequence[str], decimal: str) -> bool:
    """Whether a row of a csv begins with a time and then has a number."""

    def number(cell: str) -> bool:
        try:
            float(cell.replace(decimal, "."))
        except ValueError:
            return False
        return True

    return bool(row) and (number(row[0]) or dated(row[0])) and any(number(c) for c in row[1:])


def _named_columns(
    path: Path, names: list[str], extra: list[list[str]], frequency_hz: float
) -> tuple[list[Raw], list[str]]:
    """Return the channels of the columns after the first, by the rows between their names and the samples."""
    if len(extra) >= 2 and _kinds(extra[0]):
        return _ieee_columns(path, names, extra), [_IEEE_SAID]
    psse = [psse_channel(name, frequency_hz) for name in names[1:]]
    if sum(raw is not None for raw in psse) > len(psse) / 2:
        channels = [raw or other_channel(name) for raw, name in zip(psse, names[1:], strict=True)]
        return channels, [_PSSE_SAID.format(frequency_hz)]
    if names[0] == TIME:
        return [own_channel(n, "") or other_channel(n) for n in names[1:]], [_OWN_SAID]
    units = _units_row(extra, len(names))
    named = zip(with_square_brackets(names[1:]), units[1:], strict=True)
    return [other_channel(n, u) for n, u in named], []


def _ieee_columns(path: Path, names: list[str], extra: list[list[str]]) -> list[Raw]:
    """Return the channels of the IEEE form, by its rows of quantities, units and devices."""
    least, devices = min(len(row) for row in extra[:2]), extra[2] if len(extra) > 2 else []
    if not least >= len(names):
        raise RecordError(
            f"{path}: {len(names)} columns, but quantities or units for {least} of them, wanted: the rows "
            "below their names with a cell for each"
        )
    columns = range(1, len(names))
    return [ieee_channel(_place(names, devices, k), extra[0][k], extra[1][k]) for k in columns]


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


def _parquet(path: Path, rows: int | None) -> Iterator[Table]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    clock = Clock(path)

    def frames() -> Iterator[pd.DataFrame]:
        # buffered ahead, every group of rows that was read would stay in memory
        with pq.ParquetFile(path, pre_buffer=False, page_checksum_verification=True) as file:
            units = {f.name: (f.metadata or {}).get(b"unit", b"").decode() for f in file.schema_arrow}
            for batch in file.iter_batches(rows) if rows else [file.read()]:
                frame = batch.to_pandas()
                frame.attrs["units"] = units
                yield frame

    parts = frames()
    while True:
        try:
            frame = next(parts, None)
        except (pa.ArrowException, OSError, ValueError, LookupError, TypeError, AttributeError) as error:
            # the last four: of what pandas noted in the file
            said = (str(error).splitlines() or [type(error).__name__])[0]
            raise RecordError(f"{path}: is damaged, {said}; wanted: {ACCEPTED}") from None
        if frame is None:
            return
        yield _frame(frame, clock)


def _frame(frame: pd.DataFrame, clock: Clock) -> Table:
    """Return what a DataFrame holds, by its attrs or the names of its columns."""
    import pandas as pd

    if frame.empty:
        raise RecordError(f"{clock.source}: no samples, wanted: rows of a time and numbers")
    units, quantities, terminals = (
        _words(frame, keys, clock.source) for keys in (("units", "unit"), ("quantity",), ("terminal",))
    )
    column, frame = _without_time(frame, clock)
    clock.unit_s = time_unit_s(str(column.name), str(units.get(column.name, "")))
    stamps = clock.seconds(column.reset_index(drop=True))
    raws, columns = [], []
    for k, (c, name) in enumerate(
        zip(frame.columns, with_square_brackets(list(map(str, frame.columns))), strict=True)
    ):
        kind = frame.dtypes.iloc[k]
        if not (pd.api.types.is_numeric_dtype(kind) or pd.api.types.is_bool_dtype(kind)):
            continue
        known = quantities.get(c, ""), terminals.get(c, "")
        unit = units.get(c, "")
        own = None if any(known) else own_channel(name, unit)
        raws.append(own or other_channel(name, unit, *known))
        columns.append(frame.iloc[:, k].to_numpy(dtype=float))
    if not columns:
        raise RecordError(f"{clock.source}: no column of numbers beside the time, wanted: measurements")
    return Table(stamps, np.column_stack(columns), raws, [], clock.start)


def _without_time(frame: pd.DataFrame, clock: Clock) -> tuple[pd.Series[Any], pd.DataFrame]:
    """Return the times of a DataFrame, and its other columns, none of complex numbers."""
    times = [k for k, c in enumerate(frame.columns) if begins_with_time(str(c)) or str(c) == TIME]
    if times:
        column, frame = _column_of_times(frame, times[0], clock)
    elif frame.index.dtype.kind in "fMm" or str(frame.index.name) == TIME:
        column = frame.index.to_series()
    else:
        raise RecordError(f"{clock.source}: no column Time and no index of times, wanted: one of them")
    if column.dtype.kind == "m":
        column = column.dt.total_seconds().rename(TIME)
    if wrong := [str(c.name) for c in (column, *(c for _, c in frame.items())) if c.dtype.kind == "c"]:
        raise RecordError(
            f"{clock.source}: {wrong[0]!r} has complex numbers, wanted: real ones, as magnitude and angle"
        )
    return column, frame


def _column_of_times(frame: pd.DataFrame, k: int, clock: Clock) -> tuple[pd.Series[Any], pd.DataFrame]:
    """Return the times that begin at column k of a DataFrame, and its other columns."""
    two = time_in_two([str(c) for c in frame.columns[k:]])
    others = frame.iloc[:, [j for j in range(frame.shape[1]) if not k <= j <= k + two]]
    if not two:
        return frame.iloc[:, k], others
    return clock.joined(frame.iloc[:, k], frame.iloc[:, k + 1]).rename(frame.columns[k]), others


def _words(frame: pd.DataFrame, keys: Sequence[str], source: object) -> Mapping[Any, str]:
    """Return what the first of some keys of a DataFrame's attrs says of its columns."""
    key = next((k for k in keys if k in frame.attrs), keys[0])
    words = frame.attrs.get(key, {})
    if not isinstance(words, Mapping) or not all(isinstance(word, str) for word in words.values()):
        raise RecordError(f"{source}: attrs[{key!r}] is {str(words)[:40]}, wanted: a text for each column")
    if key == "quantity" and (wrong := sorted(set(words.values()) - UNITS.keys() - {""})):
        raise RecordError(f"{source}: attrs['quantity'] has {wrong[0]!r}, allowed: {', '.join(UNITS)}")
    return words


def _comtrade(path: Path) -> Table:
    data = read_comtrade(path)
    raws = []
    for c in data.analogs:
        raw = other_channel(c.name, c.unit, terminal=c.circuit)
        raws.append(replace(raw, channel=replace(raw.channel, name=c.name)))
    flags = [Raw(Channel(n, "status", "1", "")) for n in data.flags]
    notes = [f"COMTRADE of {data.station or 'no station'}, time by {data.timed_by}"]
    last, declared = data.samples
    if 0 < declared != last:
        notes.append(f"its last sample is number {last}, by its configuration {declared}")
    if secondary := [c.name for c in data.analogs if c.ratio != 1.0]:
        notes.append(f"secondary values, taken times the ratio of their transformer: {', '.join(secondary)}")
    values = np.hstack([data.analog, data.status])
    return Table(data.time_s, values, [*raws, *flags], notes, data.start)
