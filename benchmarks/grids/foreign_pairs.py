"""What other people's grids come to: which RAW + DYR pairs import and stand still, which RAW files are read.

    python benchmarks/grids/foreign_pairs.py FOLDER... [--still] [--release-limits] [--stop 20] [--json FILE]
    python benchmarks/grids/foreign_pairs.py FOLDER... --raw

FOLDER is a checkout of somebody else's repository. Each DYR file that holds a machine model goes with the
RAW file whose units are most like its own (more than half of those of both): of its own folder, of a
folder `raw` or `psse_raw` beside it, or of the folder above; among equals with that of the most similar
name. The same pair of contents counts once. With --still the plant of a pair that imports runs 20 s without
an event and the largest |dw| of any machine is shown: it stands still below 1e-9 pu. --release-limits
widens limits beyond which a control would start. With --raw each RAW and RAWX file is read alone and its
power flow solved. Exit code 1: an internal error.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from difflib import SequenceMatcher
from pathlib import Path
from typing import Any

from read_grids import difference, grids, largest_slip

from interarea.models.errors import UserError
from interarea.models.grid.start import release_limits
from interarea.models.importers.dynamics import CONVERTERS, MACHINES, read_dynamics
from interarea.models.importers.file import import_grid
from interarea.models.importers.psse import import_psse
from interarea.models.importers.raw.file import read_raw

STILL_PU = 1e-9
SAME_PU = 1e-9


def units_of_dyr(path: Path) -> set[tuple[int, str]]:
    """Return bus and identifier of the machines of a DYR file; none where it cannot be read."""
    try:
        records = read_dynamics(path).records
    except UserError:
        return set()
    return {(r.bus, r.identity) for r in records if r.model in MACHINES or r.model in CONVERTERS}


def units_of_raw(path: Path) -> set[tuple[int, str]]:
    """Return bus and identifier of the units of a RAW file; none where it cannot be read."""
    try:
        return {(record.bus("I"), record.identity("ID")) for record in read_raw(path).records("generator")}
    except UserError:
        return set()


def pairs(folders: Sequence[Path]) -> list[tuple[Path, Path]]:
    """Return (RAW, DYR) of each pair, each of its contents once."""
    rows: dict[str, tuple[Path, Path]] = {}
    for dyr in (path for folder in folders for path in grids(folder, ".dyr")):
        units = units_of_dyr(dyr)
        places = (dyr.parent, dyr.parent.parent / "raw", dyr.parent.parent / "psse_raw", dyr.parent.parent)
        for place in places:
            raws = [path for path in grids(place, ".raw") if path.parent == place] if place.is_dir() else []
            if units and raws:
                shared, _, raw = max((_shared(units, units_of_raw(r)), _likeness(r, dyr), r) for r in raws)
                if shared > 0.5:
                    digest = hashlib.sha256(_content(raw) + _content(dyr)).hexdigest()
                    rows.setdefault(digest, (raw, dyr))
                    break
    return list(rows.values())


def _shared(one: set[tuple[int, str]], other: set[tuple[int, str]]) -> float:
    return len(one & other) / len(one | other)


def _likeness(one: Path, other: Path) -> float:
    return SequenceMatcher(None, one.name.lower(), other.name.lower()).ratio()


def _content(path: Path) -> bytes:
    return b"".join(path.read_bytes().split())


def try_pair(raw: Path, dyr: Path, options: argparse.Namespace) -> dict[str, Any]:
    """Return what became of a pair: refused, internal error, or machines and |dw|."""
    row: dict[str, Any] = {"raw": str(raw), "dyr": str(dyr)}
    start = time.perf_counter()
    try:
        imported = import_psse(raw, dyr)
        if options.release_limits:
            case, changed = release_limits(imported.case)
            imported, row["released"] = replace(imported, case=case), len(changed)
        row["machines"] = len(imported.case.machines)
        if options.still:
            row["dw"] = largest_slip(imported.case, options.stop)
    except UserError as error:
        row["refused"] = str(error)
    except Exception as error:
        row["internal"] = f"{type(error).__name__}: {error}"
    return row | {"s": time.perf_counter() - start}


def try_raw(path: Path) -> dict[str, Any]:
    """Return what reading a RAW or RAWX file alone gives."""
    row: dict[str, Any] = {"raw": str(path)}
    try:
        imported = import_grid(path)
        row |= {"buses": len(imported.case.buses), "differs_pu": difference(imported)}
    except UserError as error:
        row["refused"] = str(error)
    except Exception as error:
        row["internal"] = f"{type(error).__name__}: {error}"
    return row


def distinct(files: Sequence[Path]) -> list[Path]:
    """Return the files, each content once."""
    return list({hashlib.sha256(_content(path)).hexdigest(): path for path in reversed(files)}.values())[::-1]


def shown(row: dict[str, Any]) -> str:
    """Return a line on one pair or file."""
    for key in ("internal", "refused"):
        if key in row:
            return f"{key}: {row[key]}"
    if "buses" in row:
        return f"{row['buses']} buses, power flow within {row['differs_pu']:.0e} pu"
    moved = f", |dw| <= {row['dw']:.0e}" if "dw" in row else ""
    released = f", {row['released']} limits widened" if row.get("released") else ""
    return f"{row['machines']} machines{released}{moved}, {row['s']:.1f} s"


def main() -> int:
    """Print a line a pair or file and the counts; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--still", action="store_true", help="run the plant of each pair")
    parser.add_argument("--release-limits", action="store_true")
    parser.add_argument("--raw", action="store_true", help="RAW and RAWX files alone, no pairs")
    parser.add_argument("--stop", type=float, default=20.0, metavar="S")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rows = []
    if options.raw:
        kinds = (".raw", ".rawx")
        files = [path for folder in options.folders for kind in kinds for path in grids(folder, kind)]
        for path in distinct(files):
            rows.append(try_raw(path))
            print(f"{path.name}: {shown(rows[-1])}", flush=True)
    else:
        for raw, dyr in pairs(options.folders):
            rows.append(try_pair(raw, dyr, options))
            print(f"{raw.name} + {dyr.name}: {shown(rows[-1])}", flush=True)
    refused = sum("refused" in row for row in rows)
    internal = sum("internal" in row for row in rows)
    taken = len(rows) - refused - internal
    print(f"{len(rows)} tried: {taken} taken, {refused} refused, {internal} internal errors")
    if options.still:
        still = sum(row.get("dw", 1.0) <= STILL_PU for row in rows)
        print(f"stand still {options.stop:g} s within {STILL_PU:g} pu: {still}")
    if options.raw:
        print(f"power flow found again: {sum(row.get('differs_pu', 1.0) <= SAME_PU for row in rows)}")
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))
    return int(internal > 0)


if __name__ == "__main__":
    sys.exit(main())
