"""A case and its events as rows of ANDES models [Cui2021], so that both tools get the same numbers.

How a case maps, and what does not:

round_rotor     -> GENROU (Xd2 = Xq2; saturation refused: GENROU has a quadratic one)
static, _tgr    -> SEXS when TR = 0 (limits on the state, as here), else EXST1 (limits refused: ANDES 2.0
                   compares the rate feedback with them instead of the field voltage)
dc1             -> IEEET1, its quadratic saturation fitted to the exponential one at the operating point
stabilizer      -> IEEEST, two lead-lags, no transducer;   tgov1 -> TGOV1
loads           -> PQ; constant impedance, or one mix of P and one of Q for the whole grid
events          -> Fault, Toggle
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from interarea.models.case.case import Case
from interarea.models.case.schema import Load, Machine
from interarea.models.grid.equilibrium import operating_point
from interarea.models.grid.powerflow import solve_powerflow

Row = tuple[str, dict[str, Any]]
_SHORT_S = 1e-6  #: filter times of IEEEST: with 0 the eigenvalue analysis of ANDES loses the stabilizer
FAR = 1e4  #: stands for no limit
KV = 100.0  #: one nominal voltage for everything: per unit is per unit


def rows_of(case: Case, events: Iterable[Any] = ()) -> list[Row]:
    """Return (model, parameters) of every device of `case` and of the events, in ANDES's names.

    Raises
    ------
    ValueError : something in the case that the ANDES models above do not represent.
    """
    flow = solve_powerflow(case)
    rows: list[Row] = []
    for k, bus in enumerate(case.buses):
        voltage = flow.voltages[k]
        start = {"v0": abs(voltage), "a0": math.atan2(voltage.imag, voltage.real)}
        rows.append(("Bus", {"idx": bus.number, "name": f"B{bus.number}", "Vn": KV} | start))
    for b in case.branches:
        line = {
            "idx": b.name,
            "bus1": b.from_bus,
            "bus2": b.to_bus,
            "Vn1": KV,
            "Vn2": KV,
            "Sn": case.base_mva,
        }
        line |= {"r": b.r, "x": b.x, "b": b.b, "tap": b.tap, "phi": math.radians(b.shift_deg)}
        rows.append(("Line", line | {"u": int(b.in_service), "fn": case.frequency_hz}))
    for s in case.shunts:
        admittance = {"g": s.P_mw / case.base_mva, "b": s.Q_mvar / case.base_mva}
        rows.append(
            (
                "Shunt",
                {"idx": s.name, "bus": s.bus, "Vn": KV, "Sn": case.base_mva, "u": int(s.in_service)}
                | admittance,
            )
        )
    for q in case.loads:
        power = {"p0": q.P_mw / case.base_mva, "q0": q.Q_mvar / case.base_mva}
        rows.append(("PQ", {"idx": q.name, "bus": q.bus, "Vn": KV, "u": int(q.in_service)} | power))
    for m, power, point in zip(
        case.machines, flow.generation, operating_point(case, flow).machines, strict=True
    ):
        rows += _machine(case, m, power, point.efd)
    return rows + [row for event in events for row in rows_of_event(event)]


def load_mix(case: Case) -> dict[str, float]:
    """Return ANDES's shares of constant power, current, impedance of P and Q, the same for all loads.

    Raises ValueError when the loads differ, or have an exponent other than 0, 1, 2.
    """
    share_pairs = {tuple(_shares(load, letter) for letter in "PQ") for load in case.loads if load.in_service}
    if len(share_pairs) != 1:
        raise ValueError(
            f"{case.name}: ANDES has one voltage characteristic for all loads, here {len(share_pairs)}"
        )
    (p, q) = share_pairs.pop()
    return {
        f"{letter}2{kind}": share
        for letter, mix in (("p", p), ("q", q))
        for kind, share in zip(f"zi{letter}", mix, strict=True)
    }


def _shares(load: Load, letter: str) -> tuple[float, float, float]:
    mix = getattr(load, f"{letter}_zip")
    if mix is not None:
        return tuple(mix)
    exponent = getattr(load, f"{letter}_exponent")
    if exponent not in (0.0, 1.0, 2.0):
        raise ValueError(f"loads.{load.name}: exponent {exponent:g}, ANDES's PQ knows 0, 1, 2")
    return tuple(1.0 if exponent == pure else 0.0 for pure in (2.0, 1.0, 0.0))


def _machine(case: Case, m: Machine, power: complex, efd: float) -> list[Row]:
    if m.model != "round_rotor" or m.Xd2 != m.Xq2 or (m.saturation and m.saturation.use != "none"):
        raise ValueError(f"machines.{m.name}: only round_rotor with Xd2 = Xq2 and no saturation is GENROU")
    bases = {"bus": m.bus, "Vn": KV, "Sn": m.base_mva}
    static = bases | {
        "idx": m.name,
        "p0": power.real,
        "q0": power.imag,
        "v0": m.V_pu,
        "ra": m.Ra,
        "xs": m.Xd2,
    }
    wide = {"pmax": FAR, "pmin": -FAR, "qmax": FAR, "qmin": -FAR}
    angle = {"a0": math.radians(m.angle_deg)} if m.slack else {}
    rows: list[Row] = [("Slack" if m.slack else "PV", static | wide | angle)]
    machine = bases | {
        "idx": f"{m.name} machine",
        "gen": m.name,
        "M": 2 * m.number("H"),
        "D": m.D,
        "ra": m.Ra,
    }
    machine |= {"fn": case.frequency_hz, "S10": 0.0, "S12": 1.0, "xl": m.Xl, "xd": m.Xd, "xq": m.Xq}
    machine |= {"xd1": m.Xd1, "xq1": m.Xq1, "xd2": m.Xd2, "xq2": m.Xq2}
    machine |= {"Td10": m.Td01, "Td20": m.Td02, "Tq10": m.Tq01 or 1.0, "Tq20": m.Tq02}
    rows.append(("GENROU", machine))
    if m.exciter.kind != "constant":
        rows.append(_exciter(m, efd))
    if m.stabilizer is not None:
        rows.append(_stabilizer(m))
    if m.governor.kind == "tgov1":
        g = m.governor
        limits = {"VMAX": _or(g.Vmax, FAR), "VMIN": _or(g.Vmin, -FAR)}
        times = {"R": g.R, "T1": g.T1, "T2": g.T2, "T3": g.T3, "Dt": g.Dt}
        rows.append(("TGOV1", {"idx": f"{m.name} governor", "syn": f"{m.name} machine"} | limits | times))
    elif m.governor.kind != "none":
        raise ValueError(f"machines.{m.name}.governor: {m.governor.kind} is no model of ANDES")
    return rows


def _exciter(m: Machine, efd: float) -> Row:
    e = m.exciter
    row: dict[str, Any] = {"idx": f"{m.name} exciter", "syn": f"{m.name} machine"}
    if e.kind in ("static", "static_tgr"):
        TC, TB = (e.TC, e.TB) if e.kind == "static_tgr" else (1.0, 1.0)
        if e.TR == 0.0:
            limits = {"EMAX": _or(e.Efd_max, FAR), "EMIN": _or(e.Efd_min, -FAR)}
            return "SEXS", row | {"TATB": TC / TB, "TB": TB, "K": e.KA, "TE": e.TA} | limits
        if (e.Efd_max is not None and e.Efd_max < FAR) or (e.Efd_min is not None and e.Efd_min > -FAR):
            raise ValueError(
                f"machines.{m.name}.exciter: limits with TR > 0, ANDES's EXST1 has them elsewhere"
            )
        wide = {"VIMAX": FAR, "VIMIN": -FAR, "VRMAX": FAR, "VRMIN": -FAR, "KC": 0.0, "KF": 0.0, "TF": 1.0}
        return "EXST1", row | {"TR": e.TR, "TC": TC, "TB": TB, "KA": e.KA, "TA": e.TA} | wide
    if e.kind != "dc1":
        raise ValueError(f"machines.{m.name}.exciter: {e.kind} is not represented")
    if e.TB:
        raise ValueError(f"machines.{m.name}.exciter.TB = {e.TB:g}: IEEET1 has no lead-lag, allowed: 0")
    limits = {"VRMAX": _or(e.VRmax, FAR), "VRMIN": _or(e.VRmin, -FAR)}
    times = {"TR": e.TR, "TA": e.TA, "TE": e.TE, "TF": e.TF}
    saturation = {"E1": 0.0, "SE1": 0.0, "E2": 0.0, "SE2": 0.0}
    for number, volts in ((1, 0.99 * efd), (2, 1.01 * efd)) if e.Aex else ():
        saturation |= {f"E{number}": volts, f"SE{number}": e.Aex * math.exp(e.Bex * volts)}
    KE = -e.Aex * math.exp(e.Bex * efd) if e.KE == "self-excited" else e.KE
    return "IEEET1", row | {"KA": e.KA, "KE": KE, "KF": e.KF} | times | limits | saturation


def _stabilizer(m: Machine) -> Row:
    s = m.stabilizer
    assert s is not None
    if s.TR or s.T6:
        raise ValueError(f"machines.{m.name}.stabilizer: transducer or third lead-lag, IEEEST has neither")
    row = {
        "idx": f"{m.name} stabilizer",
        "avr": f"{m.name} exciter",
        "MODE": 1,
        "KS": s.K,
        "T5": s.Tw,
        "T6": s.Tw,
    }
    row |= {f"A{k}": _SHORT_S if k in (1, 3, 5) else 0.0 for k in range(1, 7)}
    row |= {"T1": s.T1, "T2": s.T2, "T3": s.T3, "T4": s.T4}
    return "IEEEST", row | {
        "LSMAX": _or(s.Vs_max, FAR),
        "LSMIN": _or(s.Vs_min, -FAR),
        "VCU": 999.0,
        "VCL": -999.0,
    }


def rows_of_event(event: Any) -> list[Row]:
    if event.kind == "bus_fault":
        fault = {"bus": event.bus, "tf": event.start_s, "tc": event.end_s, "xf": event.x_pu, "rf": event.r_pu}
        return [("Fault", fault)]
    if event.kind == "branch_trip":
        times = [event.start_s] + ([] if event.end_s is None else [event.end_s])
        return [("Toggle", {"model": "Line", "dev": event.branch, "t": t}) for t in times]
    raise ValueError(f"event {event.kind} is not represented")


def _or(value: float | None, otherwise: float) -> float:
    return otherwise if value is None else value
