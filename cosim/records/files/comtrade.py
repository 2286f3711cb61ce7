"""COMTRADE: the files of disturbance recorders and PMUs, revisions 1991, 1999 and 2013 (IEEE C37.111).

A configuration (.cfg) says what the data (.dat) hold; a .cff file has both. The data are ASCII, binary
(16 bits), binary32 or float32; a value is a x + b of the number in the file. Samples without a time stamp
count by the sampling rates of the configuration.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ..record import Array, RecordError

#: data type -> type of an analog number, the number that means a missing one
_TYPES: dict[str, tuple[str, float]] = {
    "BINARY": ("<i2", -32768.0),
    "BINARY32": ("<i4", -2147483648.0),
    "FLOAT32": ("<f4", float(np.finfo("<f4").tiny)),
}
_MISSING_ASCII = 99999.0
_SPAN = 0.01  # of a record: a difference between its stamps and its rates
_MISSING_STAMP = 0xFFFFFFFF
_LINE_END = re.compile(rb"\r+\n|\n\r|\r")  # any but \n, such as those of a text written as text twice
_SECTION = re.compile(rb"-+\s*file type:\s*(\w+)(?:\s+(\w+))?(?:\s*:\s*\d+)?\s*-+\s*\r?\n", re.IGNORECASE)


@dataclass(frozen=True)
class Analog:
    """An analog channel of the configuration: value = ratio (a x + b) in `unit`.

    ratio : of its transformer, where the file has secondary values, else 1.
    """

    name: str
    circuit: str
    phase: str
    unit: str
    a: float
    b: float
    ratio: float = 1.0


@dataclass(frozen=True)
class Comtrade:
    """What a pair of files holds. time_s : (points,). analog, status : (points, channels)."""

    station: str
    device: str
    start: str
    frequency_hz: float
    analogs: tuple[Analog, ...]
    flags: tuple[str, ...]
    time_s: Array
    analog: Array
    status: npt.NDArray[np.bool_]
    timed_by: str
    samples: tuple[int, int]  #: number of the last one in the data, and by the configuration


class _Lines:
    """The lines of a configuration, one after the other; an error names the line and what it should hold."""

    def __init__(self, path: Path, data: bytes) -> None:
        text = _LINE_END.sub(b"\n", data).decode("utf-8", "replace").rstrip("\n\x1a")
        self._path, self._lines, self.number = path, text.split("\n"), 0

    def next(self, expected: str, least: int = 1) -> list[str]:
        self.number += 1
        if self.number > len(self._lines):
            raise RecordError(f"{self._path}: ends at line {self.number - 1}, wanted there: {expected}")
        fields = [field.strip() for field in self._lines[self.number - 1].strip("\x1a").split(",")]
        if len(fields) < least:
            raise self.wrong(expected, ",".join(fields))
        return fields

    def wrong(self, expected: str, got: str) -> RecordError:
        return RecordError(f"{self._path}: line {self.number} is {got[:60]!r}, wanted: {expected}")

    def number_of(self, text: str, expected: str, default: float | None = None) -> float:
        if text == "" and default is not None:
            return default
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise self.wrong(expected, text)
        return value

    @property
    def ended(self) -> bool:
        return self.number >= len(self._lines)


def read_comtrade(path: Path) -> Comtrade:
    """Read a .cfg with its .dat, or a .cff.

    Raises
    ------
    RecordError : a configuration or data that do not hold what the standard says; names the line.
    """
    if path.suffix.casefold() == ".cff":
        parts = _SECTION.split(path.read_bytes())
        sections = {parts[k].upper(): parts[k + 2] for k in range(1, len(parts) - 2, 3)}
        if not {b"CFG", b"DAT"} <= sections.keys():
            raise RecordError(
                f"{path}: not a COMTRADE .cff file, wanted: '--- file type: CFG ---' and DAT in it"
            )
        return _read(path, sections[b"CFG"], sections[b"DAT"])
    data = next((p for p in (path.with_suffix(s) for s in (".dat", ".DAT", ".Dat")) if p.is_file()), None)
    if data is None:
        raise RecordError(f"{path}: its data are missing, wanted: {path.with_suffix('.dat').name} beside it")
    return _read(path, path.read_bytes(), data.read_bytes())


def _read(path: Path, configuration: bytes, data: bytes) -> Comtrade:
    lines = _Lines(path, configuration)
    head = lines.next("station, device, revision", 2)
    count = lines.next("number of channels such as 8,6A,2D", 3)
    counts = re.fullmatch(r"(\d+),(\d+)A,(\d+)D", ",".join(count[:3]), re.IGNORECASE)
    if counts is None:
        raise lines.wrong("number of channels such as 8,6A,2D", ",".join(count))
    analogs = tuple(_analog(lines) for _ in range(int(counts[2])))
    flags = tuple(lines.next("a status channel", 2)[1] for _ in range(int(counts[3])))
    frequency_hz = lines.number_of(lines.next("line frequency")[0], "line frequency, Hz", 0.0)
    many = int(lines.number_of(lines.next("number of sampling rates")[0], "number of sampling rates"))
    rates = []
    for _ in range(max(1, many)):
        rate = lines.next("sampling rate, last sample", 2)
        rates.append(tuple(lines.number_of(field, "sampling rate, last sample") for field in rate[:2]))
    start = " ".join(lines.next("time of the first sample", 2)[:2])
    lines.next("time of the trigger", 2)
    kind = lines.next("ASCII, BINARY, BINARY32 or FLOAT32")[0].upper()
    if kind != "ASCII" and kind not in _TYPES:
        raise lines.wrong("ASCII, BINARY, BINARY32 or FLOAT32", kind)
    factor = 1.0 if lines.ended else lines.number_of(lines.next("factor of the stamps")[0], "factor", 1.0)
    numbers, stamps, values, status = (_ascii if kind == "ASCII" else _binary)(
        path, data, len(analogs), len(flags), kind
    )
    values = values * np.array([c.a for c in analogs]) + np.array([c.b for c in analogs])
    values = values * np.array([c.ratio for c in analogs])
    time_s, timed_by = _times(path, numbers, stamps, rates, factor * _tick_s(start))
    samples = (int(np.nanmax(numbers, initial=len(values))), int(rates[-1][1]))
    return Comtrade(
        *(head[0], head[1], start, frequency_hz, analogs, flags, time_s, values, status, timed_by, samples),
    )


def _analog(lines: _Lines) -> Analog:
    layout = "an analog channel: number, name, phase, circuit, unit, a, b, ..."
    field = lines.next(layout, 7)
    a, b = lines.number_of(field[5], layout), lines.number_of(field[6], layout, 0.0)
    ratio = 1.0
    if field[12:] and field[12].upper() == "S":
        primary, secondary = (lines.number_of(text, layout, 1.0) for text in field[10:12])
        if not (primary > 0.0 and secondary > 0.0):
            raise lines.wrong("a primary and a secondary ratio above 0", ",".join(field[10:12]))
        ratio = primary / secondary
    return Analog(field[1], field[3], field[2], field[4], a, b, ratio)


def _tick_s(start: str) -> float:
    """Return the unit of the time stamps: 1 ns where the first one is given to more than 6 digits."""
    return 1e-9 if re.search(r"\.\d{7,}", start) else 1e-6


def _ascii(
    path: Path, data: bytes, analogs: int, flags: int, kind: str
) -> tuple[Array, Array, Array, npt.NDArray[np.bool_]]:
    rows = [line.split(b",") for line in data.replace(b"\x1a", b"").splitlines() if line.strip()]
    width = 2 + analogs + flags
    for k, row in enumerate(rows, start=1):
        if len(row) != width:
            raise RecordError(
                f"{path}: data line {k} has {len(row)} fields, wanted: {width} as the .cfg says"
            )
    if not rows:
        raise RecordError(f"{path}: its data are empty, wanted: a line for each sample")
    numbers = np.array([[_number(path, k, field) for field in row] for k, row in enumerate(rows, start=1)])
    values = numbers[:, 2 : 2 + analogs]
    values[values == _MISSING_ASCII] = np.nan
    return numbers[:, 0], numbers[:, 1], values, numbers[:, 2 + analogs :] != 0.0


def _number(path: Path, line: int, field: bytes) -> float:
    try:
        return float(field.strip() or "nan")
    except ValueError:
        got = field.decode("utf-8", "replace").strip()[:60]
        raise RecordError(f"{path}: data line {line} has {got!r}, wanted: a number") from None


def _binary(
    path: Path, data: bytes, analogs: int, flags: int, kind: str
) -> tuple[Array, Array, Array, npt.NDArray[np.bool_]]:
    number, missing = _TYPES[kind]
    words = -(-flags // 16)
    row = np.dtype([("n", "<u4"), ("t", "<u4"), ("a", number, (analogs,)), ("d", "<u2", (words,))])
    count, rest = divmod(len(data), row.itemsize)
    if not count or rest:
        raise RecordError(
            f"{path}: its data have {len(data)} bytes, allowed: a multiple of the {row.itemsize} of a "
            f"{kind} sample of {analogs} analog and {flags} status channels; the file was cut, or the .cfg "
            "is of another"
        )
    table = np.frombuffer(data, row)
    with np.errstate(invalid="ignore"):  # of words that are no number
        values = table["a"].astype(float)
    values[values == missing] = np.nan
    bits = (table["d"][:, :, None] >> np.arange(16, dtype=np.uint16)) & 1
    stamps = np.where(table["t"] == _MISSING_STAMP, np.nan, table["t"].astype(float))
    return table["n"].astype(float), stamps, values, bits.reshape(count, -1)[:, :flags] != 0


def _times(
    path: Path, numbers: Array, stamps: Array, rates: list[tuple[float, ...]], tick_s: float
) -> tuple[Array, str]:
    """Return the time of each sample, by the rates where there are any, and by what it is, in words.

    By the rates a number that is not there is a missing sample, if the numbers rise.
    """
    back = np.flatnonzero((np.diff(numbers) < 0.0) & (np.diff(stamps) < 0.0))
    if back.size:
        k = int(back[0]) + 1
        raise RecordError(
            f"{path}: the time decreases from {stamps[k - 1] * tick_s:.6g} to {stamps[k] * tick_s:.6g} s at "
            f"sample {k + 1}, allowed: increasing times; split the file there and read each part"
        )
    if rates[0][0] > 0.0:
        rising = np.isfinite(numbers).all() and (np.diff(numbers) >= 1.0).all()
        place = numbers - numbers[0] if rising else np.arange(len(stamps), dtype=float)
        ends, times = [0.0], [0.0]
        for rate, last in [*rates, (rates[-1][0], place[-1] + 1.0)]:
            if not rate > 0.0:
                raise RecordError(
                    f"{path}: a sampling rate of {rate:g}, allowed: above 0, or no rates at all"
                )
            ends.append(max(last - 1.0, ends[-1]))
            times.append(times[-1] + (ends[-1] - ends[-2]) / rate)
        time_s = np.interp(place, ends, times)
        span_s = float(stamps[-1] - stamps[0]) * tick_s
        if not span_s > 0.0 or abs(time_s[-1] - span_s) <= _SPAN * span_s:
            return time_s, "its sampling rates"
        return time_s, f"its sampling rates, {time_s[-1]:.6g} s; its time stamps have {span_s:.6g} s"
    if np.isnan(stamps).any():
        raise RecordError(f"{path}: samples without a time stamp, and no sampling rate; wanted: one of them")
    return (stamps - stamps[0]) * tick_s, "its time stamps"
