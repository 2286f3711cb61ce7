"""Two-terminal and VSC dc lines at the solved voltages: rows of dc links, or what excludes that."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

from ...errors import CaseError
from ..report import Report
from ..static import StaticGrid, StaticLink, StaticVsc
from .vsc_links import CONTROL as VSC_CONTROL
from .vsc_links import vsc_line_text, vsc_row

LEAST_ALPHA, LEAST_GAMMA = 5.0, 8.0  #: deg: a valve does not fire before, a thyristor does not recover after
_USUAL_GAMMA = 15.0  #: deg, least extinction angle of a control
_ROOM = 0.5  #: deg between the extinction angle at rest and its least one
_L_S = 0.005  #: line and reactors by the base resistance, s, as in CIGRE's first benchmark
_NO_LOAD = 3.0 * math.sqrt(2.0) / math.pi  #: dc voltage of a bridge without current by its line voltage
_AS_DROP = 2.0 * math.pi / 3.0  #: reactance of the voltage drop of a commutation resistance
_NONE = (0.0, 0.0)
_CONTROL = "dc line: its control, rating and inductance are not in the file: usual values used"
_KIND = {StaticLink: "dc line", StaticVsc: "VSC line"}
_PREFIX = {StaticLink: "hvdc_", StaticVsc: "vsc_"}


def take_links(
    grid: StaticGrid, voltages: Mapping[int, complex], report: Report, *, as_power: bool = False
) -> tuple[dict[str, StaticLink], dict[str, dict[str, Any]], dict[str, str]]:
    """Return the dc lines of `grid` that a dc link can hold, by its name; their converters leave the loads.

    Lines of thyristors come as they are (`link_rows`), those with voltage-source converters as rows; the last
    value is file and line of each. The others stay constant powers, with the reason in `report`.
    voltages : of the buses, pu. as_power : all stay constant powers.
    """
    links: dict[str, StaticLink] = {}
    vscs: dict[str, dict[str, Any]] = {}
    where: dict[str, str] = {}
    left = {id(load) for load in grid.loads}
    taken: set[int] = set()
    for link in grid.links:
        loads = [load for load in link.loads if id(load) in left]
        if not loads:
            continue
        reason, row = ("as requested", {}) if as_power else _excluded(link, len(loads), grid, voltages)
        if reason:
            report.assume(
                f"{_KIND[type(link)]} modelled as constant P and Q at its converters: {reason}", link.where
            )
            continue
        name = _PREFIX[type(link)] + re.sub(r"[^A-Za-z0-9_]", "_", link.name.strip())[:40]
        while name in where:
            name += "_"
        where[name] = link.where
        taken |= {id(load) for load in loads}
        if isinstance(link, StaticVsc):
            vscs[name] = row
            report.lines.append(vsc_line_text(link, name, row))
            report.assume(VSC_CONTROL, link.where)
        else:
            links[name] = link
            report.assume(_CONTROL, link.where)
    grid.loads[:] = [load for load in grid.loads if id(load) not in taken]
    return links, vscs, where


def _excluded(
    link: StaticLink | StaticVsc, ends: int, grid: StaticGrid, voltages: Mapping[int, complex]
) -> tuple[str, dict[str, Any]]:
    """Return what excludes a link, "" if nothing does, and the row of a VSC; ends : those in the case."""
    if ends < 2 or link.loads[0].bus == link.loads[1].bus:
        return "one end is not in the case, or both are at one node; --island all keeps all islands", {}
    return vsc_row(link, grid, voltages) if isinstance(link, StaticVsc) else (_held(link, voltages)[0], {})


def link_rows(links: Mapping[str, StaticLink], voltages: Mapping[int, complex]) -> dict[str, dict[str, Any]]:
    """Return the row of each link, whose extinction angle gives the dc voltage of the file at these voltages.

    Raises
    ------
    CaseError : an angle that no converter has.
    """
    rows = {}
    for name, link in links.items():
        reason, angles = _held(link, voltages)
        if reason:
            raise CaseError(f"{link.where}: dc line {link.name.strip()!r}: {reason}")
        rows[name] = _row(link, angles)
    return rows


def _reactances(link: StaticLink) -> tuple[float, float]:
    """Commutation reactances, whose drops include those of the resistances, ohm."""
    row = link.row
    return (
        row["rectifier_xc_ohm"] + _AS_DROP * row["rectifier_rc_ohm"],
        row["inverter_xc_ohm"] - _AS_DROP * row["inverter_rc_ohm"],
    )


def _held(link: StaticLink, voltages: Mapping[int, complex]) -> tuple[str, tuple[float, float]]:
    """What excludes a link, "" if nothing does, and its angles in deg."""
    row, xc, none = link.row, _reactances(link), _NONE
    if not link.current > 0.0:
        return "it carries no power; set SETVL", none
    if row["rectifier_xcap_ohm"] or row["inverter_xcap_ohm"]:
        return "commutation capacitors (XCAP) are not modelled; set them to 0", none
    if row["rectifier_bridges"] != row["inverter_bridges"]:
        return "a link has the same number of bridges at both ends; set NB", none
    if not (row["r_ohm"] >= 0.0 and min(xc) >= 0.0):
        return "RDC, or XC less the drop of RC, is below 0; set it", none
    angles, bases = [], [abs(voltages[load.bus]) for load in link.loads]
    for end, x, base, volts in zip(("rectifier", "inverter"), xc, bases, link.volts, strict=True):
        bridges = row[f"{end}_bridges"]
        cosine = (volts / bridges + 3.0 / math.pi * x * link.current) / (_NO_LOAD * row[f"{end}_kv"] * base)
        angles.append(math.degrees(math.acos(max(min(cosine, 1.0), -1.0))))
        least, word = (LEAST_ALPHA, "delay") if end == "rectifier" else (LEAST_GAMMA + _ROOM, "extinction")
        if not angles[-1] >= least:
            return f"its {word} angle would be below {least:g} deg; set a lower TAP or VSCHD", none
        if not angles[-1] <= 80.0:
            return f"its {word} angle would be above 80 deg; set a higher TAP or VSCHD", none
    return "", (angles[0], angles[1])


def _row(link: StaticLink, angles: tuple[float, float]) -> dict[str, Any]:
    row, gamma = link.row, angles[1]
    base_mva = row["vdc_kv"] * link.current
    ohm = row["vdc_kv"] ** 2 / base_mva
    result: dict[str, Any] = {
        "rectifier_bus": link.loads[0].bus,
        "inverter_bus": link.loads[1].bus,
        "base_mva": base_mva,
        "gamma_deg": gamma,
        "gamma_min_deg": min(_USUAL_GAMMA, gamma - _ROOM),
        "bridges": int(row["rectifier_bridges"]),
        "l_mh": 1e3 * _L_S * ohm,
    }
    result |= dict(zip(("rectifier_xc_ohm", "inverter_xc_ohm"), _reactances(link), strict=True))
    result |= {key: row[key] for key in ("vdc_kv", "r_ohm", "rectifier_kv", "inverter_kv")}
    result |= {key: row[key] for key in ("P_mw", "idc_ka") if key in row}
    if 0.0 < row["margin"] < 1.0:
        result["margin"] = row["margin"]
    return result


def said(link: StaticLink, name: str, row: Mapping[str, Any], alpha_deg: float) -> str:
    """Return what becomes of a line, in words."""
    return (
        f"dc line {link.name.strip()!r}: dc link {name}, {link.volts[1]:.6g} kV at the inverter and "
        f"{link.current:.6g} kA with alpha {alpha_deg:.4g} and gamma {row['gamma_deg']:.4g} deg"
    )
