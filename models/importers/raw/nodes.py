"""Buses of a RAW file and what is connected to one of them: loads, shunts, units, places on the map."""

from __future__ import annotations

from collections import Counter

from ...errors import CaseError
from ..report import Report
from ..static import ISOLATED, StaticBus, StaticGrid, StaticLoad, StaticShunt, StaticUnit
from .file import RawFile
from .identities import usable
from .record import Record


def read_nodes(raw: RawFile, grid: StaticGrid, report: Report) -> None:
    """Put buses, loads, shunts and units of `raw` into `grid`."""
    for record in raw.records("bus"):
        _bus(record, grid)
    for record in usable(raw.records("load"), grid, report):
        _load(record, grid)
    for record in usable(raw.records("fixed shunt"), grid, report):
        bus = grid.bus(record.bus("I"), record.where)
        on = record.code("STATUS", 1, (0, 1)) == 1
        p, q = record.number("GL", 0.0), record.number("BL", 0.0)
        shunt = StaticShunt(bus.number, "C", record.identity("ID"), p, q, record.where, on)
        grid.shunts.append(shunt)
    count: Counter[int] = Counter()
    for record in usable(raw.records("switched shunt"), grid, report):
        _switched(record, grid, count, report)
    for record in usable(raw.records("generator"), grid, report):
        _unit(record, grid)
    _places(raw, grid)
    for what, rows in (("buses", grid.buses), ("loads", grid.loads), ("units", grid.units)):
        report.read[what] = len(rows)
    report.read["fixed shunts"] = sum(s.letter == "C" for s in grid.shunts)
    report.read["switched shunts: kept at their stored state"] = sum(s.letter == "S" for s in grid.shunts)


def _bus(record: Record, grid: StaticGrid) -> None:
    number = record.bus("I")
    if number in grid.buses:
        raise CaseError(
            f"{record.where}: bus {number} is given twice, first at {grid.buses[number].where}, allowed: once"
        )
    bus = StaticBus(
        number,
        record.where,
        record.text("NAME", "-").strip("-").strip(),
        record.number("BASKV", 0.0),
        record.code("IDE", 1, (1, 2, 3, 4)),
        record.whole("AREA" if "AREA" in record.position else "IA", 1),
        record.number("VM", 1.0),
        record.number("VA", 0.0),
    )
    if bus.kind != ISOLATED and not bus.v > 0.0:
        raise record.wrong("VM", f"{bus.v:g}", "above 0 pu (or type 4, isolated)")
    if not bus.kv >= 0.0:
        raise record.wrong("BASKV", f"{bus.kv:g}", "0 (unknown) or above")
    grid.buses[number] = bus
    if "PL" in record.position and (record.number("PL", 0.0) or record.number("QL", 0.0)):
        p, q = record.number("PL", 0.0), record.number("QL", 0.0)
        grid.loads.append(StaticLoad(number, "L", "1", p, q, record.where))
    if "GL" in record.position and (record.number("GL", 0.0) or record.number("BL", 0.0)):
        g, b = record.number("GL", 0.0), record.number("BL", 0.0)
        grid.shunts.append(StaticShunt(number, "C", "1", g, b, record.where))


def _load(record: Record, grid: StaticGrid) -> None:
    bus = grid.bus(record.bus("I"), record.where)
    p, q, ip, iq, yp, yq = (record.number(key, 0.0) for key in ("PL", "QL", "IP", "IQ", "YP", "YQ"))
    if record.whole("DGENM", 0) == 1:
        p, q = p - record.number("DGENP", 0.0), q - record.number("DGENQ", 0.0)
    on = record.code("STATUS", 1, (0, 1)) == 1
    identity = record.identity("ID")
    load = StaticLoad(bus.number, "L", identity, p, q, record.where, ip, iq, yp, -yq, on)
    load.groups = (record.whole("AREA", 1), record.whole("ZONE", 1), record.whole("OWNER", 1))
    grid.loads.append(load)


def _switched(record: Record, grid: StaticGrid, count: Counter[int], report: Report) -> None:
    """Add a switched shunt; until version 34 it has no identifier, `count` tells those of one bus apart."""
    bus = grid.bus(record.bus("I"), record.where)
    on = record.code("STAT", 1, (0, 1)) == 1
    count[bus.number] += 1
    identity = record.identity("ID") if "ID" in record.position else str(count[bus.number])
    if count[bus.number] > 1 and "ID" not in record.position:
        report.assume("second switched shunt at one bus added to the first", record.where)
    q = record.number("BINIT", 0.0)
    grid.shunts.append(StaticShunt(bus.number, "S", identity, 0.0, q, record.where, on))


def _unit(record: Record, grid: StaticGrid) -> None:
    bus = grid.bus(record.bus("I"), record.where)
    base = record.number("MBASE", grid.base_mva)
    on = record.code("STAT", 1, (0, 1)) == 1
    if not base > 0.0:
        if on:
            raise record.wrong("MBASE", f"{base:g}", "above 0 MVA")
        base = grid.base_mva
    unit = StaticUnit(
        bus.number,
        record.identity("ID"),
        record.number("PG", 0.0),
        record.number("QG", 0.0),
        record.number("VS", 1.0) if record.bus("IREG", 0) in (0, bus.number) else None,
        base,
        record.number("ZR", 0.0),
        record.number("ZX", 1.0),
        record.where,
        on,
    )
    step_up = complex(record.number("RT", 0.0), record.number("XT", 0.0))
    if step_up:
        ratio = record.number("GTAP", 1.0)
        if not ratio > 0.0:
            raise record.wrong("GTAP", f"{ratio:g}", "above 0")
        unit.step_up = (step_up, ratio)
    # owners are written in one to four pairs: only whole records tell where WMOD stands
    whole = len(record.words) > record.position["WMOD"]
    unit.renewable = whole and record.whole("WMOD", 0) > 0
    grid.units.append(unit)


def _places(raw: RawFile, grid: StaticGrid) -> None:
    """Latitude and longitude of the buses, from the substations they are in."""
    for group in raw.groups.get("substation", []):
        head = raw.record("substation", group[0])
        place = (head.number("LATI", 0.0), head.number("LONG", 0.0))
        if place == (0.0, 0.0) or not (abs(place[0]) <= 90.0 and abs(place[1]) <= 180.0):
            continue
        for line in group[1:]:
            node = raw.record("substation node", line)
            if node.words[:1] == ("0",):
                break
            bus = grid.buses.get(node.bus("I", 0))
            if bus is not None:
                bus.position = place
