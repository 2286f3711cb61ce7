"""A case as the tables of tops [Haugdal2024] and a grid of tops as a case: both tools get the same numbers.

How they map, and what does not:

round_rotor   <-> GEN; tops knows no Xl (0.7 X''d when it gives the grid) and no armature resistance
static, _tgr  <-> SEXS (TR = 0, TA > 0; non-windup limits)
stabilizer    <-> STAB1, whose washout is s/(1 + sT): its K is K Tw here; two lead-lags, symmetric limits
tgov1         <-> TGOV1
loads          -> impedances; shunts without losses; transformers with a ratio and no charging
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from interarea.models.case.case import Case, case_of
from interarea.models.case.schema import Machine

Table = list[list[Any]]
KV = 100.0  #: one nominal voltage for everything: per unit is per unit
FAR = 1e4  #: stands for no limit
LEAKAGE = 0.7  #: of X''d, for the grids of tops

GEN = {
    "H": "H",
    "D": "D",
    "X_l": "Xl",
    "X_d": "Xd",
    "X_q": "Xq",
    "X_d_t": "Xd1",
    "X_q_t": "Xq1",
    "X_d_st": "Xd2",
    "X_q_st": "Xq2",
    "T_d0_t": "Td01",
    "T_q0_t": "Tq01",
    "T_d0_st": "Td02",
    "T_q0_st": "Tq02",
}


def tables_of(case: Case) -> dict[str, Any]:
    """Return tops's tables of `case`, every load an impedance.

    Raises
    ------
    ValueError : something in the case that the models above do not represent.
    """
    lines: Table = [["name", "from_bus", "to_bus", "length", "unit", "R", "X", "B"]]
    trafos: Table = [["name", "from_bus", "to_bus", "S_n", "V_n_from", "R", "X", "ratio_from", "ratio_to"]]
    for b in (b for b in case.branches if b.in_service):
        ends = [b.name, f"B{b.from_bus}", f"B{b.to_bus}"]
        if b.tap == 1.0 and b.shift_deg == 0.0:
            lines.append([*ends, 1.0, "p.u.", b.r, b.x, b.b])
        elif b.b or b.shift_deg:
            raise ValueError(f"branches.{b.name}: a transformer with charging or a phase shift")
        else:
            trafos.append([*ends, case.base_mva, KV, b.r, b.x, 1.0 / b.tap, 1.0])
    if any(s.P_mw for s in case.shunts):
        raise ValueError(f"{case.name}: a shunt with losses")
    slack = next(m for m in case.machines if m.slack)
    tables: dict[str, Any] = {
        "base_mva": case.base_mva,
        "f": case.frequency_hz,
        "slack_bus": f"B{slack.bus}",
        "buses": [["name", "V_n"], *([f"B{b.number}", KV] for b in case.buses)],
        "lines": lines,
        "transformers": trafos,
        "loads": [
            ["name", "bus", "P", "Q", "model"],
            *([q.name, f"B{q.bus}", q.P_mw, q.Q_mvar, "Z"] for q in case.loads if q.in_service),
        ],
        "shunts": [
            ["name", "bus", "V_n", "Q", "model"],
            *([s.name, f"B{s.bus}", KV, s.Q_mvar, "Z"] for s in case.shunts if s.in_service),
        ],
    }
    heads = {
        "generators": ("GEN", ["name", "bus", "S_n", "V_n", "P", "V", *GEN]),
        "avr": ("SEXS", ["name", "gen", "K", "T_a", "T_b", "T_e", "E_min", "E_max"]),
        "pss": ("STAB1", ["name", "gen", "K", "T", "T_1", "T_2", "T_3", "T_4", "H_lim"]),
        "gov": ("TGOV1", ["name", "gen", "R", "D_t", "V_min", "V_max", "T_1", "T_2", "T_3"]),
    }
    filled: dict[str, Table] = {key: [head] for key, (_, head) in heads.items()}
    for m in case.machines:
        for key, row in _machine(m).items():
            filled[key].append(row)
    # tops cannot take an empty table
    tables = {key: rows for key, rows in tables.items() if not isinstance(rows, list) or len(rows) > 1}
    return tables | {key: {heads[key][0]: rows} for key, rows in filled.items() if len(rows) > 1}


def _machine(m: Machine) -> dict[str, list[Any]]:
    """The rows of one machine and its controls, by table."""
    if m.model != "round_rotor" or m.Xd2 != m.Xq2 or m.Ra or (m.saturation and m.saturation.use != "none"):
        raise ValueError(f"machines.{m.name}: only round_rotor, Xd2 = Xq2, Ra = 0, no saturation is GEN")
    numbers = [getattr(m, key) for key in GEN.values()]
    rows = {"generators": [m.name, f"B{m.bus}", m.base_mva, KV, m.P_mw, m.V_pu, *numbers]}
    e, s, g = m.exciter, m.stabilizer, m.governor
    if e.kind in ("static", "static_tgr"):
        if e.TR or not e.TA:
            raise ValueError(f"machines.{m.name}.exciter: TR = {e.TR:g}, TA = {e.TA:g}; SEXS: TR = 0, TA > 0")
        TC, TB = (e.TC, e.TB) if e.kind == "static_tgr" else (1.0, 1.0)
        limits = [_or(e.Efd_min, -FAR), _or(e.Efd_max, FAR)]
        rows["avr"] = [f"AVR {m.name}", m.name, e.KA, TC, TB, e.TA, *limits]
    elif e.kind != "constant":
        raise ValueError(f"machines.{m.name}.exciter: {e.kind} is not represented")
    if s is not None:
        if s.TR or s.T6:
            raise ValueError(f"machines.{m.name}.stabilizer: transducer or third lead-lag")
        times = [s.T1 or 1.0, s.T3 or 1.0, s.T2 or 1.0, s.T4 or 1.0]
        # limits of different size on both sides are not tops's; they do not act at rest
        rows["pss"] = [f"PSS {m.name}", m.name, s.K * s.Tw, s.Tw, *times, _or(s.Vs_max, FAR)]
    if g.kind == "tgov1":
        limits = [_or(g.Vmin, -FAR), _or(g.Vmax, FAR)]
        rows["gov"] = [f"GOV {m.name}", m.name, g.R, g.Dt, *limits, g.T1, g.T2, g.T3]
    elif g.kind != "none":
        raise ValueError(f"machines.{m.name}.governor: {g.kind} is no model of tops")
    return rows


def case_from(name: str, tables: Mapping[str, Any]) -> Case:
    """Return a grid of tops (its tables, per unit of its base or in its PowerFactory units) as a case.

    Controls are left out: machines at constant field voltage and torque.
    """
    base = float(tables["base_mva"])
    volts = {row["name"]: float(row["V_n"]) for row in _rows(tables["buses"])}
    numbers = {bus: k for k, bus in enumerate(volts, 1)}
    branches = {row["name"]: _line(row, numbers, volts, base) for row in _rows(tables["lines"])}
    for row in _rows(tables.get("transformers", [[]])):
        branches[row["name"]] = _transformer(row, numbers, volts, base)
    machines: dict[str, Any] = {}
    for row in _rows(tables["generators"]["GEN"]):
        machines[re.sub(r"\W", "_", row["name"])] = {
            "bus": numbers[row["bus"]],
            "base_mva": float(row["S_n"]) * float(row.get("N_par", 1.0)),
            "P_mw": float(row["P"]) * float(row.get("N_par", 1.0)),
            "V_pu": float(row["V"]),
            "Xl": LEAKAGE * float(row["X_d_st"]),
        } | {ours: float(row[theirs]) for theirs, ours in GEN.items() if theirs in row}
    first = next((k for k, m in machines.items() if m["bus"] == numbers[tables["slack_bus"]]), None)
    if first is None:
        raise ValueError(f"{name}: no machine at the slack bus {tables['slack_bus']}")
    machines[first]["slack"] = True
    document = {
        "name": name,
        "title": f"{name} of tops, machines only",
        "source": "Haugdal2024",
        "frequency_hz": float(tables["f"]),
        "base_mva": base,
        "buses": {str(k): {} for k in numbers.values()},
        "branches": branches,
        "loads": {
            row["name"]: {
                "bus": numbers[row["bus"]],
                "P_mw": float(row["P"]),
                "Q_mvar": float(row["Q"]),
                "P_exponent": 2.0,
                "Q_exponent": 2.0,
            }
            for row in _rows(tables.get("loads", [[]]))
        },
        "shunts": {
            row["name"]: {"bus": numbers[row["bus"]], "Q_mvar": float(row["Q"])}
            for row in _rows(tables.get("shunts", [[]]))
        },
        "machines": machines,
    }
    return case_of(document, where=name)


def _line(
    row: Mapping[str, Any], numbers: Mapping[str, int], volts: Mapping[str, float], base: float
) -> dict[str, Any]:
    """One line in per unit of the grid's base."""
    ohms = volts[row["from_bus"]] ** 2 / base
    r, x, b = (float(row[key]) * float(row.get("length", 1.0)) for key in ("R", "X", "B"))
    if row.get("unit") == "pf":  # ohm and microsiemens
        scale, charging = 1.0 / ohms, ohms * 1e-6
    elif float(row.get("S_n") or 0.0) and float(row.get("V_n") or 0.0):
        scale = float(row["V_n"]) ** 2 / float(row["S_n"]) / ohms
        charging = 1.0 / scale
    else:
        scale = charging = 1.0
    return {
        "from": numbers[row["from_bus"]],
        "to": numbers[row["to_bus"]],
        "r": r * scale,
        "x": x * scale,
        "b": b * charging,
    }


def _transformer(
    row: Mapping[str, Any], numbers: Mapping[str, int], volts: Mapping[str, float], base: float
) -> dict[str, Any]:
    """One transformer; ratios f, t at both sides are one of t/f at the first and an impedance over t^2."""
    first, second = (_ratio(row.get(f"ratio_{side}")) for side in ("from", "to"))
    own = float(row.get("V_n_from") or 0.0) or volts[row["from_bus"]]
    scale = (own / volts[row["from_bus"]]) ** 2 * base / float(row["S_n"]) / float(row.get("N_par", 1.0))
    return {
        "from": numbers[row["from_bus"]],
        "to": numbers[row["to_bus"]],
        "r": float(row["R"]) * scale / second**2,
        "x": float(row["X"]) * scale / second**2,
        "tap": second / first,
    }


def _ratio(value: Any) -> float:
    """A ratio of tops; not given or not a number stands for 1."""
    return 1.0 if value is None or math.isnan(float(value)) else float(value)


def _rows(table: Sequence[Sequence[Any]]) -> list[dict[str, Any]]:
    """The rows of a table of tops, whose first row names the columns."""
    return [dict(zip(table[0], row, strict=True)) for row in table[1:]]


def _or(value: float | None, otherwise: float) -> float:
    return otherwise if value is None or not math.isfinite(value) else value
