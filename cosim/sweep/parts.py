"""The parts of a sweep's results: files that appear whole or not at all and that prove what they hold.

`runs/part-NUMBER-CHECKSUM.parquet`, trajectories likewise. What is asked of a folder of results is read here;
`store` writes it.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from interarea.models.documents import require_regular
from interarea.models.files import settle

from ..errors import SweepError
from .plan import FORMAT, SweepPlan, plan_of_document

ROWS, CURVES = "runs", "trajectories"  #: folders of the two kinds of parts
FORKED = b"forked"  #: in the metadata of a part: how many of its runs started from a saved state
#: columns as version 0.1 wrote them -> with their units
_NAMES_BEFORE_0_2 = {"peak": "peak_pu", "energy": "energy_pu2s", "effort": "effort_pu2s"}


def parts_of(folder: Path) -> Sequence[Path]:
    """Return the parts of rows that are there."""
    return sorted((folder / ROWS).glob("part-*.parquet"))


def curves_of(folder: Path) -> dict[int, Path]:
    """Return the parts of trajectories that are there, by number."""
    return {number_of(part): part for part in sorted((folder / CURVES).glob("part-*.parquet"))}


def number_of(part: Path) -> int:
    """Return the number of a part, which those of its rows and of its trajectories share."""
    return int(part.stem.split("-")[1])


def write_part(folder: Path, kind: str, number: int, table: pa.Table) -> None:
    """Write a table as part `number` of `ROWS` or `CURVES`, beside its place first.

    Raises
    ------
    OSError : nothing of it stays then.
    """
    partial = folder / kind / f".part-{number:06d}.parquet.partial"
    try:
        pq.write_table(table, partial, compression="zstd")
        settle(partial, partial.with_name(f"part-{number:06d}-{_checksum(partial)}.parquet"))
    except OSError:
        partial.unlink(missing_ok=True)
        raise


def check_part(path: Path) -> None:
    """Raise SweepError when a part is not what its name says was written."""
    require_regular(path, "a part of a sweep's results", SweepError)
    if path.stem.split("-")[2:] != [_checksum(path)]:
        raise SweepError(f"{path}: is damaged; repeat the command of the sweep, which repeats its runs")


def _checksum(path: Path) -> str:
    """Return the CRC-32 of a file: what a disk or a copy spoils does not keep it."""
    value = 0
    with path.open("rb") as file:
        while piece := file.read(1 << 20):
            value = zlib.crc32(piece, value)
    return f"{value:08x}"


# -- what is asked of a folder of results ---------------------------------------------------


def read_json(path: Path) -> Any:
    """Return what manifest.json or sweep.json holds.

    Raises
    ------
    SweepError : no regular file. FileNotFoundError, UnicodeDecodeError, JSONDecodeError
    """
    if path.exists():
        require_regular(path, "a file of a sweep's results", SweepError)
    return json.loads(path.read_text(encoding="utf-8"))


def read_plan(folder: Path) -> SweepPlan:
    """Return the plan of a result folder.

    Raises
    ------
    SweepError : no results there, or of another format.
    """
    try:
        manifest = read_json(folder / "manifest.json")
        if manifest.get("format") != FORMAT:
            raise SweepError(f"{folder}: results of format {manifest.get('format')!r}, allowed: {FORMAT}")
        return plan_of_document(read_json(folder / "sweep.json"))
    except FileNotFoundError as error:
        name = Path(str(error.filename)).name
        raise SweepError(f"{folder}: no results of a sweep ({name} is missing)") from None
    except (json.JSONDecodeError, UnicodeDecodeError, KeyError, TypeError, AttributeError) as error:
        raise SweepError(f"{folder}: manifest.json or sweep.json is damaged ({error})") from None


def read_rows(folder: Path) -> pd.DataFrame:
    """Return the rows of a result folder, in the order of the runs.

    Raises
    ------
    SweepError : no results there, or damaged ones.
    """
    parts = parts_of(folder)
    if not parts:
        raise SweepError(f"{folder}: no finished runs")
    try:
        for part in parts:
            check_part(part)
        table = pa.concat_tables([pq.read_table(p) for p in parts])
    except (OSError, pa.ArrowException) as error:
        raise SweepError(f"{folder / ROWS}: cannot be read: {error}") from None
    rows: pd.DataFrame = table.sort_by("run").to_pandas()
    return rows.rename(columns=_NAMES_BEFORE_0_2)


def read_trajectory(folder: Path, run: int) -> pd.DataFrame | None:
    """Return the stored trajectory of a run, or None when it was not kept.

    Raises
    ------
    SweepError : a part that cannot be read.
    """
    for part in curves_of(folder).values():
        try:
            table = pq.read_table(part, filters=[("run", "=", run)])
        except (OSError, pa.ArrowException) as error:
            raise SweepError(f"{part}: cannot be read: {error}") from None
        if table.num_rows:
            curves: pd.DataFrame = table.drop_columns(["run"]).to_pandas()
            return curves
    return None


def summary_of(folder: Path) -> dict[str, Any]:
    """Return counts over the finished runs: ok, failed by kind, stable, started from a saved state."""
    failures: dict[str, int] = {}
    rows = stable = unstable = forked = 0
    for part in parts_of(folder):
        schema = pq.read_schema(part)
        names = schema.names
        forked += int((schema.metadata or {}).get(FORKED, b"0"))
        table = pq.read_table(part, columns=[c for c in ("failure", "stable") if c in names])
        rows += table.num_rows
        for kind in table.column("failure").to_pylist():
            if kind is not None:
                failures[kind] = failures.get(kind, 0) + 1
        if "stable" in table.column_names:
            flags = table.column("stable").to_pylist()
            stable += sum(f is True for f in flags)
            unstable += sum(f is False for f in flags)
    failed = sum(failures.values())
    return {
        "runs": rows,
        "ok": rows - failed,
        "failed": failed,
        "failures": dict(sorted(failures.items())),
        "stable": stable,
        "unstable": unstable,
        "forked": forked,
    }
