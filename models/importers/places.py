"""Places of buses on the map from a CSV file."""

from __future__ import annotations

import csv
from pathlib import Path

from ..errors import CaseError
from .raw.text import read_lines
from .static import StaticGrid

_COLUMNS = {
    "bus": ("bus", "number", "bus_number", "busnum", "i"),
    "latitude": ("latitude", "lat", "latitude_deg", "y"),
    "longitude": ("longitude", "lon", "long", "lng", "longitude_deg", "x"),
}


def read_places(path: Path, grid: StaticGrid) -> None:
    """Put latitude and longitude of the buses in the CSV `path` into `grid`; rows of other buses are passed.

    The first row names the columns: bus, latitude, longitude (degrees).

    Raises
    ------
    CaseError : unreadable, a column missing, a value that is no place; with file and line.
    """
    rows = list(csv.reader(read_lines(path)))
    head = [word.strip().lower() for word in rows[0]] if rows else []
    at = {}
    for column, words in _COLUMNS.items():
        result = next((k for k, word in enumerate(head) if word in words), None)
        if result is None:
            raise CaseError(f"{path}:1: no column {column!r} in {head}, allowed: bus, latitude, longitude")
        at[column] = result
    for line, row in enumerate(rows[1:], 2):
        if not any(word.strip() for word in row):
            continue
        try:
            number = int(float(row[at["bus"]]))
            place = (float(row[at["latitude"]]), float(row[at["longitude"]]))
        except (ValueError, IndexError, OverflowError):
            raise CaseError(f"{path}:{line}: {','.join(row)}: allowed: a bus and two numbers") from None
        if not (abs(place[0]) <= 90.0 and abs(place[1]) <= 180.0):
            raise CaseError(f"{path}:{line}: {place[0]:g}, {place[1]:g}: allowed: degrees on the globe")
        if number in grid.buses:
            grid.buses[number].position = place
