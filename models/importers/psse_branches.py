"""Lines and two-winding transformers of a PSS/E RAW file as branches of a case."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

from ..case.case import CaseError
from .psse_records import Record


def read_branches(
    lines: list[Record],
    transformers: list[Record],
    kinds: Mapping[int, int],
    kv: Mapping[int, float],
    base_mva: float,
    shunts: dict[str, Any],
) -> dict[str, Any]:
    """Return the rows of the branch table; magnetising shunts go into `shunts`.

    `kinds`: bus -> IDE, `kv`: bus -> base voltage. Branches out of service at an isolated bus are left out.

    Raises
    ------
    CaseError : a truncated record, a three-winding transformer, a unit code or value that is not supported.
    """
    groups = list(_groups(transformers))
    pairs = [
        frozenset((r.bus(0, "I", kinds, active=False), r.bus(1, "J", kinds, active=False))) for r in lines
    ]
    pairs += [frozenset((g[0].whole(0, "I"), g[0].whole(1, "J"))) for g in groups]
    count = Counter(pairs)
    branches: dict[str, Any] = {}
    for record in lines:
        _add(branches, record, _line(record, kinds), record.text(2, "CKT"), count, kinds)
    for group in groups:
        row = _transformer(group, kinds, kv, base_mva, shunts)
        _add(branches, group[0], row, group[0].text(3, "CKT"), count, kinds)
    return branches


def _add(
    branches: dict[str, Any],
    record: Record,
    row: dict[str, Any],
    circuit: str,
    count: Counter[frozenset[int]],
    kinds: Mapping[int, int],
) -> None:
    first, second = row["from"], row["to"]
    if 4 in (kinds[first], kinds[second]):
        return  # out of service, or record.bus had refused it
    if not row["x"] > 0.0:
        raise CaseError(
            f"{record.where}: x = {row['x']:g} between buses {first} and {second}, allowed: above 0"
        )
    name = f"{first}-{second}" + ("" if count[frozenset((first, second))] == 1 else f" {circuit}")
    if name in branches:
        raise CaseError(f"{record.where}: branch {name!r} is given twice, allowed: once")
    branches[name] = row


def _line(record: Record, kinds: Mapping[int, int]) -> dict[str, Any]:
    on = record.whole(13, "ST", 1) == 1
    first, second = record.bus(0, "I", kinds, active=on), record.bus(1, "J", kinds, active=on)
    for bus, k in ((first, 9), (second, 11)):
        g, b = record.number(k, "G", 0.0), record.number(k + 1, "B", 0.0)
        if (g or b) and on:
            raise CaseError(
                f"{record.where}: shunt {g:g} + j{b:g} pu at the end {bus} of the line, allowed: 0; "
                "give it as a fixed shunt of the bus"
            )
    return {
        "from": first,
        "to": second,
        "r": record.number(3, "R", 0.0),
        "x": record.number(4, "X"),
        "b": record.number(5, "B", 0.0),
        "in_service": on,
    }


def _groups(records: list[Record]) -> list[list[Record]]:
    groups: list[list[Record]] = []
    k = 0
    while k < len(records):
        head = records[k]
        if head.whole(2, "K", 0) != 0:
            raise CaseError(
                f"{head.where}: three-winding transformer, allowed: two windings (a star of three)"
            )
        if k + 4 > len(records):
            raise CaseError(
                f"{records[-1].where}: the transformer of {head.where} has {len(records) - k} lines, "
                "allowed: 4 (truncated?)"
            )
        groups.append(records[k : k + 4])
        k += 4
    return groups


def _transformer(
    group: list[Record],
    kinds: Mapping[int, int],
    kv: Mapping[int, float],
    base_mva: float,
    shunts: dict[str, Any],
) -> dict[str, Any]:
    head, impedance, winding1, winding2 = group
    on = head.whole(11, "STAT", 1) == 1
    first, second = head.bus(0, "I", kinds, active=on), head.bus(1, "J", kinds, active=on)
    cw, cz, cm = (head.whole(k, key, 1) for k, key in ((4, "CW"), (5, "CZ"), (6, "CM")))
    for key, code, allowed in (("CW", cw, (1, 2, 3)), ("CZ", cz, (1, 2)), ("CM", cm, (1,))):
        if code not in allowed:
            raise CaseError(f"{head.where}: {key} = {code}, allowed: {' or '.join(map(str, allowed))}")
    r, x = impedance.number(0, "R1-2", 0.0), impedance.number(1, "X1-2")
    nominal = [w.number(1, "NOMV", 0.0) or kv[bus] for w, bus in ((winding1, first), (winding2, second))]
    if cz == 2:
        scale = base_mva / impedance.number(2, "SBASE1-2", base_mva)
        if kv[first] > 0.0:
            scale *= (nominal[0] / kv[first]) ** 2
        r, x = r * scale, x * scale
    turns = []
    for winding, bus, volts in ((winding1, first, nominal[0]), (winding2, second, nominal[1])):
        ratio = winding.number(0, "WINDV", 1.0)
        if cw == 2:
            ratio /= kv[bus] if kv[bus] > 0.0 else 1.0
        elif cw == 3 and kv[bus] > 0.0:
            ratio *= volts / kv[bus]
        if not ratio > 0.0:
            raise CaseError(f"{winding.where}: WINDV gives the turns ratio {ratio:g}, allowed: above 0")
        turns.append(ratio)
    if winding1.whole(13, "TAB1", 0):
        raise CaseError(f"{winding1.where}: TAB1: impedance correction table, allowed: 0")
    g, b = head.number(7, "MAG1", 0.0), head.number(8, "MAG2", 0.0)
    if (g or b) and on:
        name = f"M{first}_{second}_{head.text(3, 'CKT')}"
        shunts[name] = {"bus": first, "P_mw": g * base_mva, "Q_mvar": b * base_mva}
    return {
        "kind": "transformer",
        "from": first,
        "to": second,
        "r": r * turns[1] ** 2,  # the ideal ratio of winding 2 moved to the other side of r + jx
        "x": x * turns[1] ** 2,
        "tap": turns[0] / turns[1],
        "shift_deg": winding1.number(2, "ANG1", 0.0),
        "in_service": on,
    }
