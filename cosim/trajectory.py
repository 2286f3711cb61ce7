"""Results of a run: named series with units on one time axis."""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np
import numpy.typing as npt

from interarea.fmu_build.open.ports import Port
from interarea.models.errors import nearest

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

TIME = "time_s"


class Trajectory:
    """Recorded outputs: column ``time_s``, then ``INSTANCE.VARIABLE``; `units` and `descriptions` by column.

    `data` is the same as a table, with `units` in ``data.attrs["units"]`` too; it is made when it is asked
    for. `engine` says what stepped: kernel or python (`Master.ran`).
    """

    def __init__(
        self,
        columns: Mapping[str, npt.NDArray[Any]],
        units: Mapping[str, str],
        descriptions: Mapping[str, str] | None = None,
        engine: str = "",
    ) -> None:
        self._columns = dict(columns)
        self.units, self.descriptions, self.engine = dict(units), dict(descriptions or {}), engine

    def __repr__(self) -> str:
        time = self.time_s
        span = f"{time[0]:g} to {time[-1]:g} s" if len(time) else "empty"
        return f"Trajectory({span}, {len(time)} points, {len(self._columns) - 1} signals)"

    def __contains__(self, column: str) -> bool:
        return column in self._columns

    @classmethod
    def of_records(
        cls,
        times_s: npt.NDArray[np.float64],
        records: npt.NDArray[np.float64],
        columns: Sequence[str],
        ports: Sequence[Port],
        *,
        engine: str = "",
    ) -> Trajectory:
        """Return the trajectory of recorded outputs; integers and Booleans get their own types."""
        table = np.empty((1 + len(columns), len(times_s)))
        table[0], table[1:] = times_s, records.T
        data = dict(zip(columns, table[1:], strict=True))
        data |= {n: _typed(data[n], p) for n, p in zip(columns, ports, strict=True) if p.type != "Real"}
        units = {n: "1" if p.unit is None else p.unit.name for n, p in zip(columns, ports, strict=True)}
        texts = {n: p.description for n, p in zip(columns, ports, strict=True)}
        return cls({TIME: table[0]} | data, {TIME: "s"} | units, texts, engine)

    @cached_property
    def data(self) -> pd.DataFrame:
        """A DataFrame with these columns."""
        import pandas as pd

        data = pd.DataFrame(self._columns, copy=False)
        data.attrs["units"] = dict(self.units)
        return data

    def __getitem__(self, column: str) -> npt.NDArray[np.float64]:
        """Return one column as an array; the error names the nearest columns."""
        if column not in self._columns:
            raise KeyError(f"no column {column!r}; {nearest(column, self._columns)}")
        return self._columns[column]

    def reals_of(self, instance: str) -> list[str]:
        """Return the columns of an instance that hold Reals: of a controller, its control signals."""
        return [
            name
            for name, values in self._columns.items()
            if name.startswith(f"{instance}.") and values.dtype.kind == "f"
        ]

    @property
    def time_s(self) -> npt.NDArray[np.float64]:
        return self[TIME]

    def thinned(self, names: Sequence[str], first: int, every: int) -> Trajectory:
        """Return some columns at each `every`-th point from number `first` on."""
        columns = {name: self._columns[name][first::every] for name in names}
        return Trajectory(columns, {n: self.units[n] for n in names}, self.descriptions, self.engine)

    def table(self) -> pa.Table:
        """Return an Arrow table whose schema carries unit and description of each column; NaN is null."""
        import pyarrow as pa

        arrays, fields = [], []
        for name, values in self._columns.items():
            extra = {"unit": self.units[name], "description": self.descriptions.get(name, "")}
            arrays.append(_arrow(values))
            fields.append(pa.field(name, arrays[-1].type, metadata={k: v for k, v in extra.items() if v}))
        notes = {b"units": json.dumps(self.units).encode()}
        return pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata=notes))

    def write_rows(self, file: TextIO, header: bool) -> None:
        """Write the points as CSV, 17 digits each; NaN is an empty cell. header : the names first."""
        if header:
            csv.writer(file, lineterminator=os.linesep).writerow(self._columns)
        columns, formats = [], []
        for values in self._columns.values():
            cells = values.tolist()
            holes = values.dtype.kind == "f" and bool(np.isnan(values).any())
            columns.append(["" if v != v else f"{v:.17g}" for v in cells] if holes else cells)
            formats.append("%.17g" if values.dtype.kind == "f" and not holes else "%s")
        line = ",".join(formats) + os.linesep
        file.writelines(line % row for row in zip(*columns, strict=True))

    def write_parquet(self, path: Path) -> None:
        """Write `table` as a Parquet file."""
        import pyarrow.parquet as pq

        pq.write_table(self.table(), path, write_page_checksum=True)

    @classmethod
    def read_parquet(cls, path: Path) -> Trajectory:
        """Read what `write_parquet` wrote."""
        import pyarrow.parquet as pq

        table = pq.read_table(path, page_checksum_verification=True)
        metadata = {f.name: f.metadata or {} for f in table.schema}
        units = {n: m.get(b"unit", b"1").decode() for n, m in metadata.items()}
        texts = {n: m[b"description"].decode() for n, m in metadata.items() if b"description" in m}
        return cls({name: table[name].to_numpy() for name in table.column_names}, units, texts)


def _typed(row: npt.NDArray[np.float64], port: Port) -> npt.NDArray[Any]:
    """Return the values of an output in its own type."""
    if port.type == "Integer":
        return row.astype(np.int64)
    if port.type == "Boolean":
        return np.asarray(row != 0.0)
    return row


def _arrow(values: npt.NDArray[Any]) -> pa.Array:
    """Return an Arrow array of Reals, integers or Booleans over the same memory; `pa.array` loads pandas."""
    import pyarrow as pa

    kind = {"f": pa.float64(), "i": pa.int64(), "b": pa.bool_()}[values.dtype.kind]
    valid = ~np.isnan(values) if values.dtype.kind == "f" else None
    holds = None if valid is None or valid.all() else pa.py_buffer(np.packbits(valid, bitorder="little"))
    packed = np.packbits(values, bitorder="little") if values.dtype.kind == "b" else values
    return pa.Array.from_buffers(kind, len(values), [holds, pa.py_buffer(np.ascontiguousarray(packed))])
