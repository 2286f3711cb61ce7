"""A static grid at its solution in the form of a case file."""

from __future__ import annotations

import cmath
import math
import re
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..errors import CaseError
from .report import Report
from .static import StaticBranch, StaticGrid, StaticLoad, StaticUnit
from .stored import Solution
from .topology import live_islands

LEAST_SVC_P = 1e-6  #: of its base: active power that is rounding
_LONGEST = 64  #: characters of a name in a case file
_LONGEST_WORD = 40  #: of an identifier within such a name, which has a bus and a letter besides
_SUFFIXES = re.compile(r"(\.(raw|rawx|m))?(\.(gz|xz|bz2))?$", re.IGNORECASE)


def case_name(path: Path, report: Report) -> str:
    """Return a name for the case of a grid file: the file's without its suffixes, in the letters of a case.

    What had to be changed for that is said in `report`.
    """
    stem = _SUFFIXES.sub("", path.name, count=1)
    name = (re.sub(r"[^A-Za-z0-9_.-]+", "-", stem).lstrip("_.-") or "grid")[:_LONGEST]
    if name != stem:
        report.lines.append(
            f"the case is named {name!r}: {stem!r} is not at most {_LONGEST} letters, digits and _ . -"
        )
    return name


def unit_names(grid: StaticGrid) -> list[str]:
    """Return a name for each unit: G and its bus, and its identifier where several share the bus."""
    name_of = _names([(unit.home, unit.identity) for unit in grid.units])
    return [name_of("G", unit.home, unit.identity) for unit in grid.units]


def load_exponents(
    P_exponent: float | None, Q_exponent: float | None, grid: StaticGrid, report: Report, where: str
) -> tuple[float, float]:
    """Return how P and Q of loads follow the voltage: as given, else as constant impedance, which is said."""
    if None in (P_exponent, Q_exponent) and any(
        load.follows is None and load.law is None for load in grid.loads
    ):
        report.assume("loads are constant impedances unless exponents are given", where)
    return 2.0 if P_exponent is None else P_exponent, 2.0 if Q_exponent is None else Q_exponent


def document_of(
    grid: StaticGrid,
    solution: Solution,
    *,
    name: str,
    exponents: tuple[float, float],
    constant: Mapping[int, float] | None = None,
    converters: Collection[int] = (),
    svcs: Collection[int] = (),
) -> dict[str, Any]:
    """Return the document of the case of `grid` at `solution`; machines are without dynamic data.

    exponents : how P and Q of loads follow the voltage where the file does not say. constant : number of a
    unit -> exponent, for those that are no machine but an injection. converters, svcs : numbers of units that
    are converters or SVCs, whose controls are not given here.
    """
    constant = constant or {}
    volts = dict(solution.voltages)
    units = _with_step_up(grid, solution, volts)
    buses = {}
    for number, bus in grid.buses.items():
        row: dict[str, Any] = {"area": max(bus.area, 1), "V_pu": abs(volts[number])}
        row["angle_deg"] = math.degrees(cmath.phase(volts[number]))
        if bus.name:
            row["name"] = bus.name
        if bus.kv > 0.0:
            row["kv"] = bus.kv
        if bus.position is not None:
            row["latitude_deg"], row["longitude_deg"] = bus.position
        buses[str(number)] = row
    names = unit_names(grid)
    machines: dict[str, Any] = {}
    injections: dict[str, Any] = {}
    plants: dict[str, Any] = {}
    compensators: dict[str, Any] = {}
    for k, (unit, power) in enumerate(units):
        if k in constant:
            injections[names[k]] = {
                "bus": unit.bus,
                "P_mw": -power.real,
                "Q_mvar": -power.imag,
                "P_exponent": constant[k],
                "Q_exponent": constant[k],
            }
        elif k in converters:
            plants[names[k]] = {
                "bus": unit.bus,
                "base_mva": unit.base,
                "P_mw": power.real,
                "Q_mvar": power.imag,
            }
        elif k in svcs:
            compensators[names[k]] = _svc(unit, power)
        else:
            machines[names[k]] = _machine(grid, unit, power, abs(volts[unit.bus]))
    _mark_slack(grid, solution, machines, units, names, volts)
    return {
        "name": name,
        "source": f"imported from {grid.source}",
        "frequency_hz": grid.frequency_hz,
        "base_mva": grid.base_mva,
        "buses": buses,
        "branches": _branches(grid),
        "shunts": _shunts(grid),
        "loads": _loads(grid, solution, exponents) | injections,
        "machines": machines,
        **({"svcs": compensators} if compensators else {}),
        **({"converters": plants} if plants else {}),
    }


def _machine(grid: StaticGrid, unit: StaticUnit, power: complex, volts: float) -> dict[str, Any]:
    return {
        "bus": unit.bus,
        "area": max(grid.buses[unit.bus].area, 1),
        "model": "power_flow",
        "base_mva": unit.base,
        "Ra": max(unit.r, 0.0),
        **({"Xd1": unit.x} if unit.x > 0.0 else {}),
        "P_mw": power.real,
        "Q_mvar": power.imag,
        "V_pu": volts,
    }


def _svc(unit: StaticUnit, power: complex) -> dict[str, Any]:
    if not abs(power.real) <= LEAST_SVC_P * unit.base:
        raise CaseError(
            f"{unit.where}: unit {unit.identity} at bus {unit.home} is an SVC in the DYR and gives "
            f"{power.real:g} MW, allowed: 0; set its PG to 0 and its bus to another type than 3"
        )
    return {"bus": unit.bus, "base_mva": unit.base, "Q_mvar": power.imag}


def _mark_slack(
    grid: StaticGrid,
    solution: Solution,
    machines: dict[str, Any],
    units: list[tuple[StaticUnit, complex]],
    names: list[str],
    volts: Mapping[int, complex],
) -> None:
    """The largest machine at the slack bus of an island, or of all in it, balances it."""
    islands = live_islands(grid)
    for bus in solution.slacks:
        at_slack = [
            name
            for name, unit, (moved, _) in zip(names, grid.units, units, strict=True)
            if name in machines and bus in (unit.bus, moved.bus)
        ]
        island = next(part for part in islands if bus in part)
        candidates = at_slack or [name for name, row in machines.items() if row["bus"] in island]
        if candidates:
            slack = max(candidates, key=lambda name: float(machines[name]["base_mva"]))
            angle = math.degrees(cmath.phase(volts[machines[slack]["bus"]]))
            machines[slack] |= {"slack": True, "angle_deg": angle}


def _with_step_up(
    grid: StaticGrid, solution: Solution, volts: dict[int, complex]
) -> list[tuple[StaticUnit, complex]]:
    """Units with their power; one with a transformer inside gets a bus of its own behind that."""
    result = []
    for unit, power in zip(grid.units, solution.generation, strict=True):
        if unit.step_up is None:
            result.append((unit, power))
            continue
        (impedance, ratio), high = unit.step_up, volts[unit.bus]
        z = impedance * grid.base_mva / unit.base
        current = (power / grid.base_mva / high).conjugate() * ratio
        low = high / ratio + z * current
        bus = grid.new_bus(unit.bus, unit.where, f"terminal of unit {unit.identity} at {unit.home}")
        volts[bus.number] = low
        grid.branches.append(
            StaticBranch(
                (unit.home, bus.number), unit.identity, unit.bus, bus.number, z.real, z.imag, 0.0, unit.where,
                ratio, transformer=True,
            )
        )  # fmt: skip
        inside = StaticUnit(
            bus.number, unit.identity, unit.p, unit.q, unit.v, unit.base, unit.r, unit.x, unit.where
        )
        result.append((inside, low * current.conjugate() * grid.base_mva))
    return result


def _branches(grid: StaticGrid) -> dict[str, Any]:
    def ends(b: StaticBranch) -> tuple[int, ...]:
        return tuple(sorted(b.name))

    count = Counter((ends(b), b.winding) for b in grid.branches)
    unique = _Unique()
    rows: dict[str, Any] = {}
    for b in grid.branches:
        name = "-".join(map(str, b.name))
        if count[ends(b), b.winding] > 1:
            name += f" {b.circuit[: _LONGEST_WORD // 2]}"
        if b.winding:
            name += f" winding {b.winding}"
        row: dict[str, Any] = {"from": b.first, "to": b.second, "r": b.r, "x": b.x, "b": b.b}
        if b.transformer:
            row |= {"kind": "transformer", "tap": b.tap, "shift_deg": b.shift}
        if not b.on:
            row["in_service"] = False
        rows[unique(name)] = row
    return rows


def _shunts(grid: StaticGrid) -> dict[str, Any]:
    rows: dict[str, Any] = {}
    unique = _Unique()
    for letter in ("C", "S", "M", "E", "B"):
        shunts = [s for s in grid.shunts if s.letter == letter]
        name_of = _names([(s.home, s.identity) for s in shunts])
        for s in shunts:
            rows[unique(name_of(letter, s.home, s.identity))] = {"bus": s.bus, "P_mw": s.p, "Q_mvar": s.q}
    for load in grid.loads:
        if load.yp or load.yq:
            name = f"{load.letter}{load.home}_{_word(load.identity)}_Y"
            rows[unique(name)] = {"bus": load.bus, "P_mw": load.yp, "Q_mvar": -load.yq}
    return rows


def _loads(grid: StaticGrid, solution: Solution, exponents: tuple[float, float]) -> dict[str, Any]:
    name_of = {
        letter: _names([(q.home, q.identity) for q in grid.loads if q.letter == letter])
        for letter in {q.letter for q in grid.loads}
    }
    unique = _Unique()
    rows: dict[str, Any] = {}
    for load in grid.loads:
        name = name_of[load.letter](load.letter, load.home, load.identity)
        if load.p or load.q or not (load.ip or load.iq or load.yp or load.yq):
            for share_p, p, share_q, q in _terms(load, exponents):
                rows[unique(name)] = {
                    "bus": load.bus, "P_mw": share_p * load.p, "Q_mvar": share_q * load.q,
                    "P_exponent": p, "Q_exponent": q,
                }  # fmt: skip
        if load.ip or load.iq:
            volts = abs(solution.voltages[load.bus])
            rows[unique(f"{name}_I")] = {
                "bus": load.bus, "P_mw": load.ip * volts, "Q_mvar": load.iq * volts,
                "P_exponent": 1.0, "Q_exponent": 1.0,
            }  # fmt: skip
    return rows


def _terms(load: StaticLoad, exponents: tuple[float, float]) -> Sequence[tuple[float, float, float, float]]:
    """Share and exponent of P, and of Q, of each row that a load becomes."""
    if load.law is not None:
        return load.law
    p, q = exponents if load.follows is None else (load.follows, load.follows)
    return [(1.0, p, 1.0, q)]


def _names(keys: list[tuple[int, str]]) -> Callable[[str, int, str], str]:
    """A function of letter, bus and identifier: the identifier is in the name where a bus has several."""
    count = Counter(bus for bus, _ in keys)
    words: dict[tuple[int, str], str] = {}
    taken: set[tuple[int, str]] = set()
    for bus, identity in keys:
        word = _word(identity)
        while (bus, word) in taken:
            word += "_"
        taken.add((bus, word))
        words[bus, identity] = word

    def name_of(letter: str, bus: int, identity: str) -> str:
        return f"{letter}{bus}" if count[bus] == 1 else f"{letter}{bus}_{words[bus, identity]}"

    return name_of


def _word(identity: str) -> str:
    return re.sub(r"[^A-Za-z0-9_]", "_", identity)[:_LONGEST_WORD]


class _Unique:
    """Makes a name that was used already another one."""

    def __init__(self) -> None:
        self.used: set[str] = set()

    def __call__(self, name: str) -> str:
        other, k = name, 2
        while other in self.used:
            other, k = f"{name}_{k}", k + 1
        self.used.add(other)
        return other
