"""Read a MATPOWER case file (version 2) for its power flow."""

from __future__ import annotations

import math
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..case.case import Case, CaseError, case_of
from ..case.errors import reason

_COLUMNS = {"bus": 13, "gen": 8, "branch": 11}
#: columns that are read and must be finite; limits, costs and ratings may be Inf
_READ = {"bus": (0, 1, 2, 3, 4, 5, 6, 8, 9), "gen": (0, 1, 5, 6, 7), "branch": (0, 1, 2, 3, 4, 8, 9, 10)}


@dataclass(frozen=True)
class _Row:
    values: tuple[float, ...]
    line: int


def import_matpower(path: str | Path, *, name: str | None = None, frequency_hz: float = 60.0) -> Case:
    """Return the grid of a MATPOWER `.m` file; its machines have no dynamic data (model power_flow).

    Buses of type 4 must be free of what is in service. Generators out of service are left out and counted
    in the source of the table. Reactive limits, costs and ratings play no part. MATPOWER does not say the
    frequency.

    Raises
    ------
    CaseError : not version 2, a table that is missing or cut short, a DC line, a value the case refuses;
        each with file and line.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise CaseError(f"{path}: cannot be read: {reason(error)}") from None
    lines = [line.split("%")[0] for line in text.splitlines()]
    version = re.search(r"mpc\.version\s*=\s*['\"]?([^'\";]+)", "\n".join(lines))
    if version is None or version.group(1).strip() != "2":
        got = version.group(1).strip() if version else "none"
        raise CaseError(f"{path}: MATPOWER case version {got}, allowed: 2 (mpc.version = '2')")
    base = re.search(r"mpc\.baseMVA\s*=\s*([^;\s]+)", "\n".join(lines))
    if base is None:
        raise CaseError(f"{path}: mpc.baseMVA is missing")
    base_mva = _number(base.group(1), f"{path}: mpc.baseMVA")
    tables = {table: _table(path, lines, table) for table in _COLUMNS}
    if _table(path, lines, "dcline", needed=False):
        raise CaseError(f"{path}: mpc.dcline holds dc lines, which this model has not; take them out")
    return _case(path, tables, base_mva, name or path.stem, frequency_hz)


def _table(path: Path, lines: list[str], table: str, *, needed: bool = True) -> list[_Row]:
    start = next((k for k, line in enumerate(lines) if re.match(rf"\s*mpc\.{table}\s*=\s*\[", line)), None)
    if start is None:
        if needed:
            raise CaseError(f"{path}: mpc.{table} is missing, allowed: a case with bus, gen and branch")
        return []
    rows: list[_Row] = []
    for k in range(start, len(lines)):
        body = lines[k].split("[", 1)[1] if k == start else lines[k]
        ends = "]" in body
        for part in body.split("]")[0].split(";"):
            words = part.replace(",", " ").split()
            if not words:
                continue
            values = tuple(_number(word, f"{path}:{k + 1}: mpc.{table}") for word in words)
            if len(values) < _COLUMNS.get(table, 0):
                raise CaseError(
                    f"{path}:{k + 1}: mpc.{table}: {len(values)} columns, allowed: >= {_COLUMNS[table]}"
                )
            for column in _READ.get(table, ()):
                if not math.isfinite(values[column]):
                    raise CaseError(
                        f"{path}:{k + 1}: mpc.{table}: column {column + 1} is {words[column]!r}, "
                        "allowed: a finite number"
                    )
            rows.append(_Row(values, k + 1))
        if ends:
            return rows
    raise CaseError(
        f"{path}:{len(lines)}: mpc.{table} begins in line {start + 1} and does not end (truncated file?)"
    )


def _number(word: str, what: str) -> float:
    try:
        return float(word)
    except ValueError:
        raise CaseError(f"{what}: {word!r} is not a number") from None


def _case(path: Path, tables: dict[str, list[_Row]], base_mva: float, name: str, frequency_hz: float) -> Case:
    document: dict[str, Any] = {
        "name": re.sub(r"[^A-Za-z0-9_.-]+", "-", name),
        "source": f"imported from {path.name} (MATPOWER)",
        "frequency_hz": float(frequency_hz),
        "base_mva": base_mva,
    }
    buses: dict[str, Any] = {}
    loads: dict[str, Any] = {}
    shunts: dict[str, Any] = {}
    kinds: dict[int, int] = {}
    angle: dict[int, float] = {}
    for row in tables["bus"]:
        number, kind, area = (int(v) for v in (row.values[0], row.values[1], row.values[6]))
        if number in kinds:
            raise CaseError(f"{path}:{row.line}: bus {number} is given twice, allowed: once")
        kinds[number], angle[number] = kind, row.values[8]
        if kind == 4:
            continue
        buses[str(number)] = {"area": max(area, 1)} | ({"kv": row.values[9]} if row.values[9] > 0.0 else {})
        if row.values[2] or row.values[3]:
            loads[f"L{number}"] = {"bus": number, "P_mw": row.values[2], "Q_mvar": row.values[3]}
        if row.values[4] or row.values[5]:
            shunts[f"C{number}"] = {"bus": number, "P_mw": row.values[4], "Q_mvar": row.values[5]}
    machines = _machines(path, tables["gen"], kinds, angle, base_mva)
    branches = _branches(path, tables["branch"], kinds)
    out = len(tables["gen"]) - len(machines)
    machines["source"] = f"{path.name}, mpc.gen" + (f"; {out} out of service left out" if out else "")
    document |= {"buses": buses, "loads": loads, "shunts": shunts, "branches": branches, "machines": machines}
    return case_of(document, where=str(path))


def _machines(
    path: Path, rows: list[_Row], kinds: dict[int, int], angle: dict[int, float], base_mva: float
) -> dict[str, Any]:
    active = [row for row in rows if row.values[7] > 0.0]
    count = Counter(int(row.values[0]) for row in active)
    seen: Counter[int] = Counter()
    machines: dict[str, Any] = {}
    slack_done = False
    for row in active:
        bus = int(row.values[0])
        if kinds.get(bus) not in (2, 3):
            raise CaseError(
                f"{path}:{row.line}: generator at bus {bus} of type {kinds.get(bus)}, allowed: type 2 or 3 "
                "(a fixed injection is a negative load)"
            )
        seen[bus] += 1
        key = f"G{bus}" if count[bus] == 1 else f"G{bus}_{seen[bus]}"
        machine: dict[str, Any] = {
            "bus": bus,
            "model": "power_flow",
            "base_mva": row.values[6] if row.values[6] > 0.0 else base_mva,
            "P_mw": row.values[1],
            "V_pu": row.values[5],
        }
        if kinds[bus] == 3 and not (slack_done and seen[bus] > 1):
            machine |= {"slack": True, "angle_deg": angle[bus]}
            slack_done = True
        machines[key] = machine
    return machines


def _branches(path: Path, rows: list[_Row], kinds: dict[int, int]) -> dict[str, Any]:
    pairs = [(int(row.values[0]), int(row.values[1])) for row in rows]
    count = Counter(frozenset(pair) for pair in pairs)
    seen: Counter[frozenset[int]] = Counter()
    branches: dict[str, Any] = {}
    for row, (first, second) in zip(rows, pairs, strict=True):
        for bus in (first, second):
            if bus not in kinds:
                raise CaseError(
                    f"{path}:{row.line}: branch {first}-{second} ends at bus {bus}, which does not exist"
                )
        if 4 in (kinds[first], kinds[second]) and row.values[10] <= 0.0:
            continue
        if not row.values[3] > 0.0:
            raise CaseError(
                f"{path}:{row.line}: branch {first}-{second} has x = {row.values[3]:g}, allowed: above 0"
            )
        pair = frozenset((first, second))
        seen[pair] += 1
        name = f"{first}-{second}" + ("" if count[pair] == 1 else f" {seen[pair]}")
        tap, shift = row.values[8], row.values[9]
        branches[name] = {
            "kind": "transformer" if tap or shift else "line",
            "from": first,
            "to": second,
            "r": row.values[2],
            "x": row.values[3],
            "b": row.values[4],
            "tap": tap or 1.0,
            "shift_deg": shift,
            "in_service": row.values[10] > 0.0,
        }
    return branches
