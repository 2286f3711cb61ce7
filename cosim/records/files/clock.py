"""Times of samples: numbers, dates, or both parts of a date, in seconds from the first one."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..record import Array, RecordError

_TIME_CELL = re.compile(
    r"\s*\"?(?:(?:time|t|timestamp|date ?time|zeit(?:stempel)?|utc|soc)(?![a-z])"
    r"|(?:date|datum)\"?\s*(?:[,;\t]|$))",  # of a title such as Date: 28.04.2025 it is no name
    re.IGNORECASE,
)
#: names of two columns that are one time: day and time of day; second and fraction of it (C37.118)
_IN_TWO = re.compile(
    r"(?:date|datum)[,](?:time|zeit|uhrzeit|utc)\b.*|soc[,]frac[ _]?(?:of[ _]?)?sec(?:onds?)?", re.IGNORECASE
)
_FRACTIONS = (1.0, 1e3, 1e6, 2.0**24, 1e9)  #: of a second, as files count them
_YEARS = (1900, 2200)  # of a date of a sample


@dataclass
class Clock:
    """Turns stamps into seconds from the first one that it is given. start : that one, where it is a date.

    unit_s : of stamps that are numbers.
    """

    source: object
    unit_s: float = 1.0
    start: str = ""
    _first: Any = field(default=None, repr=False)
    _fractions: float = field(default=1.0, repr=False)

    def seconds(self, column: Any, skipped: int = 0) -> Array:
        """Return times, s. column : pandas Series of numbers or dates. skipped : rows before it.

        Raises
        ------
        RecordError : a cell that is neither.
        """
        import pandas as pd

        dates = column
        if not pd.api.types.is_datetime64_any_dtype(column):
            numbers = pd.to_numeric(column, errors="coerce")
            numbers = numbers.where(np.isfinite(numbers))
            if numbers.notna().all():
                return np.asarray(self._since(numbers.to_numpy(dtype=float), "") * self.unit_s)
            mostly = numbers.notna().mean() > 0.5
            dates = numbers if mostly else _dates(column)
        wrong = np.asarray(dates.isna())
        if not wrong.any():
            years = pd.DatetimeIndex(dates).year
            wrong = np.asarray((years < _YEARS[0]) | (years > _YEARS[1]))
        if wrong.any():
            row = int(np.flatnonzero(wrong)[0])
            raise RecordError(
                f"{self.source}: row {skipped + row + 1} has {str(column.iloc[row])[:40]!r} for its time, "
                "wanted: seconds or a date"
            )
        return np.asarray(self._since(pd.DatetimeIndex(dates).as_unit("ns").asi8, str(dates.iloc[0])) / 1e9)

    def joined(self, first: Any, second: Any) -> Any:
        """Return the pandas Series of times of two columns: day and time of day, or second and fraction.

        A fraction is a count of the smallest of `_FRACTIONS` above all of them.
        """
        import pandas as pd

        numbers, parts = (pd.to_numeric(column, errors="coerce") for column in (first, second))
        if numbers.notna().all() and parts.notna().all():
            least = next((n for n in _FRACTIONS if parts.max() < n), 1.0)
            self._fractions = max(self._fractions, least)
            return numbers + parts / self._fractions
        return first.astype(str).str.strip() + " " + second.astype(str).str.strip()

    def _since(self, values: Any, start: str) -> Any:
        if self._first is None:
            self._first, self.start = values[0], start
        return values - self._first


def _dates(column: Any) -> Any:
    """Return a column of texts as dates, NaT where one is none; in UTC if the zone changes, as in spring.

    Of 05.04.2025 the day comes first, of 04/05/2025 the month.
    """
    import pandas as pd

    first = re.match(r"\s*\d{1,2}\.\d{1,2}\.\d{4}", str(column.iloc[0])) is not None
    try:
        return pd.to_datetime(column, errors="coerce", format="mixed", dayfirst=first)
    except ValueError:
        return pd.to_datetime(column, errors="coerce", format="mixed", dayfirst=first, utc=True)


def begins_with_time(text: str) -> bool:
    """Whether a row of names or its first cell begins with a word for time."""
    return _TIME_CELL.match(text) is not None


def dated(cell: str) -> bool:
    """Whether a cell of samples begins with a date."""
    return re.match(r"\s*\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}(?:[ T]\d|\s*$)", cell) is not None


def time_in_two(names: Sequence[str]) -> bool:
    """Whether the first two of some columns are one time, such as Date and Time, or SOC and FRACSEC.

    >>> time_in_two(["Date", "Time (UTC)", "F"]), time_in_two(["SOC", "FRACSEC"]), time_in_two(["Time", "F"])
    (True, True, False)
    """
    return _IN_TWO.fullmatch(",".join(name.strip(' "') for name in names[:2])) is not None
