"""Results of a run: named series with units on one time axis."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from interarea.fmu_build.open.ports import Port

TIME = "time_s"


class Curves(Protocol):
    """What metrics need of results: one array for each column."""

    @property
    def data(self) -> Any: ...

    @property
    def time_s(self) -> npt.NDArray[np.float64]: ...

    def __getitem__(self, column: str) -> npt.NDArray[np.float64]: ...

    def reals_of(self, instance: str) -> list[str]: ...


class Records:
    """Results without a table: `data` maps columns to arrays (points,)."""

    def __init__(
        self,
        times_s: npt.NDArray[np.float64],
        values: npt.NDArray[np.float64],
        columns: Sequence[str],
        ports: Sequence[Port],
    ) -> None:
        self.data: dict[str, npt.NDArray[np.float64]] = {TIME: times_s}
        self.data |= dict(zip(columns, values, strict=True))
        self._reals = [c for c, p in zip(columns, ports, strict=True) if p.type == "Real"]

    def reals_of(self, instance: str) -> list[str]:
        """Return the columns of an instance's Real outputs."""
        return [c for c in self._reals if c.startswith(f"{instance}.")]

    @property
    def time_s(self) -> npt.NDArray[np.float64]:
        return self.data[TIME]

    def __getitem__(self, column: str) -> npt.NDArray[np.float64]:
        """Return one column."""
        return self.data[column]


@dataclass(frozen=True, repr=False)
class Trajectory:
    """`data`: column ``time_s``, then ``INSTANCE.VARIABLE``; `units` and `descriptions` by column.

    `units` are also in ``data.attrs["units"]``; `engine` says what stepped: kernel or python (`Master.ran`).
    """

    data: pd.DataFrame
    units: Mapping[str, str]
    descriptions: Mapping[str, str] = field(default_factory=dict)
    engine: str = ""

    def __repr__(self) -> str:
        time = self.time_s
        span = f"{time[0]:g} to {time[-1]:g} s" if len(time) else "empty"
        return f"Trajectory({span}, {len(time)} points, {len(self.data.columns) - 1} signals)"

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
        names = [TIME, *columns]
        units = {TIME: "s"}
        for name, port in zip(columns, ports, strict=True):
            units[name] = port.unit.name if port.unit is not None else "1"
        if all(port.type == "Real" for port in ports):
            data = pd.DataFrame(table.T, columns=names, copy=False)
        else:
            kept = [table[0], *(_typed(row, p) for row, p in zip(table[1:], ports, strict=True))]
            data = pd.DataFrame(dict(zip(names, kept, strict=True)), copy=False)
        data.attrs["units"] = dict(units)
        return cls(data, units, {n: p.description for n, p in zip(columns, ports, strict=True)}, engine)

    def __getitem__(self, column: str) -> npt.NDArray[np.float64]:
        """Return one column as an array; the error names the columns there are."""
        if column not in self.data:
            raise KeyError(f"no column {column!r}; there are {', '.join(self.data.columns)}")
        return self.data[column].to_numpy()

    def reals_of(self, instance: str) -> list[str]:
        """Return the columns of an instance that hold Reals: of a controller, its control signals."""
        return [
            str(c) for c in self.data if str(c).startswith(f"{instance}.") and self.data[c].dtype.kind == "f"
        ]

    @property
    def time_s(self) -> npt.NDArray[np.float64]:
        return self[TIME]

    def write_csv(self, path: Path) -> None:
        """Write the numbers with all their digits; the units go into the Parquet file and `units`."""
        self.data.to_csv(path, index=False, float_format="%.17g")

    def write_parquet(self, path: Path) -> None:
        """Write a Parquet file whose schema carries unit and description of each column."""
        table = pa.Table.from_pandas(pd.DataFrame(self.data), preserve_index=False)
        fields = []
        for f in table.schema:
            extra = {"unit": self.units[f.name], "description": self.descriptions.get(f.name, "")}
            fields.append(f.with_metadata({k: v for k, v in extra.items() if v}))
        notes = {**(table.schema.metadata or {}), b"units": json.dumps(dict(self.units)).encode()}
        pq.write_table(table.cast(pa.schema(fields, metadata=notes)), path)

    @classmethod
    def read_parquet(cls, path: Path) -> Trajectory:
        """Read what `write_parquet` wrote."""
        table = pq.read_table(path)
        metadata = {f.name: f.metadata or {} for f in table.schema}
        units = {n: m.get(b"unit", b"1").decode() for n, m in metadata.items()}
        texts = {n: m[b"description"].decode() for n, m in metadata.items() if b"description" in m}
        data = table.to_pandas()
        data.attrs["units"] = dict(units)
        return cls(data, units, texts)


def _typed(row: npt.NDArray[np.float64], port: Port) -> npt.NDArray[Any]:
    """Return the values of an output in its own type."""
    if port.type == "Integer":
        return row.astype(np.int64)
    if port.type == "Boolean":
        return np.asarray(row != 0.0)
    return row
