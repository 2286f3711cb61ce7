"""The folder of a sweep, open for writing: parts of its results, a manifest of what they belong to.

    DIR/manifest.json         specification and version
    DIR/sweep.json            the plan: scenario, cases, controllers; enough to repeat any run
    DIR/runs/part-*.parquet   one row for each finished run; the name ends with a checksum
    DIR/trajectories/part-*   where the sweep keeps them, one part beside each part of rows
    DIR/summary.json          counts, once all runs are there

A part is written beside its place, forced to disk and renamed; what a killed process leaves is swept away at
the next start. A row in a part is final, and a run is in one part only; a part that is not what was written
is found at the next start and its runs are done again.
"""

from __future__ import annotations

import errno
import json
import shutil
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from interarea.models.files import locked, write_whole

from ..errors import SweepError
from .parts import (
    CURVES,
    FORKED,
    ROWS,
    check_part,
    curves_of,
    number_of,
    parts_of,
    read_json,
    summary_of,
    write_part,
)
from .plan import FORMAT, SweepPlan
from .rows import Outcome, schema_of

FULL = (errno.ENOSPC, errno.EDQUOT)
_WORK, _LOCK = ".work", ".lock"
_Kinds = list[tuple[str, type[str] | type[float] | None]]  # a column, and what makes its values fit


class SweepStore:
    """The folder of one sweep, open for writing; use as a context manager.

    Raises
    ------
    SweepError : the folder holds another specification or version, or another process writes to it.
    """

    def __init__(self, folder: Path, plan: SweepPlan) -> None:
        self.folder, self.plan = folder, plan
        self.schema = schema_of(plan)
        self._kinds = _kinds(self.schema)
        self.done = np.zeros(plan.sweep.size, dtype=bool)
        self.dropped: list[str] = []  #: parts that could not be read; their runs are done again
        try:
            folder.mkdir(parents=True, exist_ok=True)
            _check_alone(folder)
            self._lock = locked(folder / _LOCK, make=True)  # Windows: two sweeps in one folder go unnoticed
            if self._lock is None:
                raise SweepError(f"{folder}: another process is writing to this folder; wait for it")
            try:
                self._open()
            except BaseException:
                self.close()
                raise
        except OSError as error:
            self._explain(error)

    def __enter__(self) -> SweepStore:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def work(self) -> Path:
        """Folder for what goes again; emptied when the store is opened and closed."""
        return self.folder / _WORK

    def todo(self) -> Iterator[int]:
        """Yield the runs that are not there yet, in order."""
        for run in range(len(self.done)):
            if not self.done[run]:
                yield run

    @property
    def count(self) -> int:
        """Number of finished runs."""
        return int(self.done.sum())

    def append(self, outcomes: Iterable[Outcome]) -> int:
        """Write the outcomes of runs as one part; runs that are there already are left out. Return how many.

        Raises
        ------
        SweepError : disk full, or no permission; what was written before stays valid.
        """
        fresh: dict[int, Outcome] = {}
        for outcome in outcomes:
            run = outcome.row["run"]
            if not self.done[run]:
                fresh.setdefault(run, outcome)
        if not fresh:
            return 0
        chosen = [fresh[run] for run in sorted(fresh)]
        table = pa.Table.from_pylist([_fitted(o.row, self._kinds) for o in chosen], schema=self.schema)
        notes = {**(self.schema.metadata or {}), FORKED: str(sum(o.forked for o in chosen)).encode()}
        table = table.replace_schema_metadata(notes)
        curves = [o.trajectory for o in chosen if o.trajectory is not None]
        number = self._next
        try:
            if curves:
                write_part(self.folder, CURVES, number, pa.concat_tables(curves, promote_options="default"))
            write_part(self.folder, ROWS, number, table)
        except OSError as error:
            self._explain(error)
        self._next += 1
        self.done[list(fresh)] = True
        return len(chosen)

    def forget_failed(self) -> int:
        """Remove the rows of runs that failed, which are then done again; return how many.

        A part is taken away before what stays of it is written: killed in between, its runs are done again.
        """
        forgotten = 0
        try:
            for part in parts_of(self.folder):
                table = pq.read_table(part)
                failed = np.array([status == "failed" for status in table.column("status").to_pylist()])
                if not failed.any():
                    continue
                number, runs = number_of(part), table.column("run").to_numpy()
                curves = curves_of(self.folder).get(number)
                curve = None if curves is None else pq.read_table(curves)
                part.unlink()
                if curves is not None:
                    curves.unlink()
                self.done[runs] = False
                rest, missing = table.filter(pa.array(~failed)), pa.array(runs[failed])
                if curve is not None:
                    keep = pc.invert(pc.is_in(curve.column("run"), value_set=missing))
                    write_part(self.folder, CURVES, number, curve.filter(keep))
                if rest.num_rows:
                    write_part(self.folder, ROWS, number, rest)
                    self.done[runs[~failed]] = True
                forgotten += int(failed.sum())
        except OSError as error:
            self._explain(error)
        return forgotten

    def finish(self) -> dict[str, Any]:
        """Write summary.json once every run is there and return it."""
        summary = summary_of(self.folder)
        self._write("summary.json", summary)
        return summary

    def close(self) -> None:
        """Remove what is temporary and let others write here."""
        shutil.rmtree(self.work, ignore_errors=True)
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    # -- private --------------------------------------------------------------------------

    def _open(self) -> None:
        shutil.rmtree(self.work, ignore_errors=True)
        for folder in (self.folder, self.folder / ROWS, self.folder / CURVES):
            for partial in folder.glob(".*.partial") if folder.is_dir() else ():
                partial.unlink()
        manifest = self.folder / "manifest.json"
        if manifest.exists():
            _check_manifest(manifest, self.plan)
        for folder in (self.work, self.folder / ROWS):
            folder.mkdir(exist_ok=True)
        if self.plan.sweep.trajectories.keep != "none":
            (self.folder / CURVES).mkdir(exist_ok=True)
        if not manifest.exists():
            self._write("sweep.json", self.plan.document())
            self._write("manifest.json", _manifest(self.plan))
        self._next = 0
        curves = curves_of(self.folder)
        retained = set()
        for part in parts_of(self.folder):
            number = number_of(part)
            self._next = max(self._next, number + 1)
            try:
                check_part(part)
                if number in curves:
                    check_part(curves[number])
                runs = pq.read_table(part, columns=["run"]).column("run").to_numpy()
            except (OSError, pa.ArrowException, SweepError) as error:
                self.dropped.append(f"{part.name}: {error}")
                part.unlink()
                continue
            if np.any(self.done[runs]):
                raise SweepError(f"{part}: has runs that are also in another part; remove one of them")
            self.done[runs] = True
            retained.add(number)
        for number, part in curves.items():
            if number not in retained:
                part.unlink()  # its rows never came, or are gone: those runs are done again

    def _write(self, name: str, value: Any) -> None:
        try:
            write_whole(self.folder / name, json.dumps(value, indent=1, allow_nan=False) + "\n")
        except OSError as error:
            self._explain(error)

    def _explain(self, error: OSError) -> NoReturn:
        raise explained(error, self.folder, self.count, len(self.done)) from error


def explained(error: OSError, folder: Path, count: int, size: int) -> SweepError:
    """Return what to tell the user when writing results failed."""
    what = "the disk is full" if error.errno in FULL else (error.strerror or str(error))
    return SweepError(
        f"{error.filename or folder}: {what}; {count} of {size} runs are safe in {folder}: "
        "make room and give the same command again"
    )


def _fitted(row: dict[str, Any], kinds: _Kinds) -> dict[str, Any]:
    """Return a row with every column of the schema, words where the column holds words."""
    fitted = {}
    for name, kind in kinds:
        value = row.get(name)
        if value is not None and kind is not None:
            value = kind(value)
        fitted[name] = value
    return fitted


def _kinds(schema: pa.Schema) -> _Kinds:
    """Return the columns with what makes their values fit, where that is needed."""
    kinds: _Kinds = []
    for column in schema:
        words, number = pa.types.is_string(column.type), pa.types.is_floating(column.type)
        kinds.append((column.name, str if words else float if number else None))
    return kinds


def _manifest(plan: SweepPlan) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "name": plan.sweep.name,
        "specification": plan.hash,
        "version": plan.version,
        "runs": plan.sweep.size,
    }


def _check_alone(folder: Path) -> None:
    """Require a folder of a sweep, or one that holds nothing else."""
    if not (folder / "manifest.json").exists() and _anything(folder):
        raise SweepError(
            f"{folder}: contains other files and no manifest.json, allowed: an empty folder, "
            "or that of the same sweep"
        )


def _check_manifest(path: Path, plan: SweepPlan) -> None:
    try:
        data, old = read_json(path), read_json(path.with_name("sweep.json"))
    except (OSError, json.JSONDecodeError, UnicodeDecodeError) as error:
        raise SweepError(f"{path}: is damaged ({error}); use another folder") from None
    new = json.loads(json.dumps(plan.document()))
    differences = list(_differences(old, new, ()))
    if data.get("specification") != plan.hash or differences:
        shown = "; ".join(differences[:5]) + (
            f"; and {len(differences) - 5} more" if len(differences) > 5 else ""
        )
        only_version = all(d.startswith("version") for d in differences)
        what = "another version of the program" if only_version else "another specification"
        raise SweepError(
            f"{path.parent}: holds results of {what} ({shown or 'manifest.json was changed'}), "
            "allowed: the same one; use another folder"
        )


def _differences(old: Any, new: Any, place: tuple[str, ...]) -> Iterator[str]:
    """Yield what differs between two plans, one line each."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted({*old, *new}):
            yield from _differences(old.get(key), new.get(key), (*place, key))
    elif old != new:
        yield f"{'.'.join(place)}: stored {_short(old)}, now {_short(new)}"


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _anything(folder: Path) -> bool:
    """Whether a folder without a manifest holds anything but what a sweep leaves that was killed at once."""
    ours = {_LOCK, _WORK, ROWS, CURVES, "sweep.json", *(p.name for p in folder.glob(".*.partial"))}
    return any(p.name not in ours for p in folder.iterdir()) or bool(parts_of(folder))
