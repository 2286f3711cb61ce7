"""Equilibrium of dc links with line-commutated converters: currents and angles from both bus voltages.

Per unit on the base of the link, angles in rad; equations of plant/machine/dc_link.h.
[Kundur1994, sec. 10.2]
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from ..case.case import Case, CaseError
from ..case.hvdc_schema import Hvdc

RECTIFIER, INVERTER = 4, 5  #: CouplingKind
_NO_LOAD = 3.0 * math.sqrt(2.0) / math.pi  #: dc voltage of a bridge without current by its line voltage
_DROP = 3.0 / math.pi  #: resistance of commutation by its reactance


@dataclass(frozen=True)
class DcEnd:
    """One converter: no-load dc voltage at a bus voltage of 1 pu, and its drop by the current."""

    no_load: float
    drop: float


def ends_of(row: Hvdc) -> tuple[DcEnd, DcEnd]:
    """Return rectifier and inverter of a link."""
    at = ((row.rectifier_kv, row.rectifier_xc_ohm), (row.inverter_kv, row.inverter_xc_ohm))
    rectifier, inverter = (
        DcEnd(_NO_LOAD * row.bridges * kv / row.vdc_kv, _DROP * row.bridges * xc / row.base_ohm)
        for kv, xc in at
    )
    return rectifier, inverter


@dataclass(frozen=True)
class LinkPoint:
    """Equilibrium of a link; `alpha` is NaN if the voltage at the rectifier's bus is too low."""

    idc: float
    alpha: float
    gamma: float
    vdr: float
    vdi: float
    power: tuple[complex, complex]  #: P + jQ into the network at rectifier and inverter
    slope: tuple[complex, complex]  #: of each by the voltage of its own bus, current and gamma held

    @property
    def seen(self) -> float:
        """Input of the device in place of a voltage."""
        return self.vdr

    def output(self, kind: str, share: float) -> float:
        """Return the current."""
        return self.idc

    def signals(self, kind: str, share: float) -> dict[str, float]:
        """Return the input values of the device, and its initial states."""
        angles = {"iord": self.idc, "xr": self.alpha, "xi": self.gamma}
        return {"vdr": self.vdr, "vdi": self.vdi, "p_mod": 0.0, **angles}


def link_point(row: Hvdc, u_rectifier: float, u_inverter: float) -> LinkPoint:
    """Return the equilibrium of the link between buses of these voltages, pu."""
    rectifier, inverter = ends_of(row)
    gamma, R = math.radians(row.gamma_deg), row.r_ohm / row.base_ohm
    at_rest = inverter.no_load * u_inverter * math.cos(gamma)
    if row.idc_ka is not None:
        idc = row.idc_ka * row.vdc_kv / row.base_mva
    else:  # P = (at_rest + rise idc) idc
        power, rise = (row.P_mw or 0.0) / row.base_mva, R - inverter.drop
        idc = 2.0 * power / (at_rest + math.sqrt(max(at_rest * at_rest + 4.0 * rise * power, 0.0)))
    vdi = at_rest - inverter.drop * idc
    vdr = vdi + R * idc
    cosine = (vdr + rectifier.drop * idc) / (rectifier.no_load * u_rectifier)
    alpha = math.acos(cosine) if abs(cosine) <= 1.0 else math.nan
    full_r, full_i = rectifier.no_load * idc, inverter.no_load * idc  # current of each, link's base
    q_r, q_i = (
        _reactive(full * u, v * idc) for full, u, v in ((full_r, u_rectifier, vdr), (full_i, u_inverter, vdi))
    )
    p_slope = inverter.no_load * math.cos(gamma) * idc
    slope_r = -1j * _over(full_r**2 * u_rectifier, q_r)
    slope_i = complex(p_slope, -_over(full_i**2 * u_inverter - vdi * idc * p_slope, q_i))
    powers = (complex(-vdr * idc, -q_r), complex(vdi * idc, -q_i))
    return LinkPoint(idc, alpha, gamma, vdr, vdi, powers, (slope_r, slope_i))


def _reactive(size: float, active: float) -> float:
    return math.sqrt(max(size * size - active * active, 0.0))


def _over(a: float, b: float) -> float:
    return a / b if b > 1e-6 else 0.0


def require_link(case: Case, row: Hvdc, point: LinkPoint, u_rectifier: float) -> None:
    """Reject a link without an equilibrium there.

    Raises
    ------
    CaseError : the limit that excludes it, and what to set.
    """
    where = f"{case.name}: hvdcs.{row.name}"
    if not row.i_min_pu <= point.idc <= row.i_max_pu:
        key = "i_min_pu" if point.idc < row.i_min_pu else "i_max_pu"
        raise CaseError(
            f"{where}: its current at the equilibrium is {point.idc:.6g} pu, {key} = "
            f"{getattr(row, key):g}, allowed: within its limits; set {key}, or idc_ka or P_mw"
        )
    if row.vdcol_i_pu is not None and not point.vdr > row.vdcol_high_pu:
        raise CaseError(
            f"{where}: its dc voltage at the equilibrium is {point.vdr:.6g} pu, vdcol_high_pu = "
            f"{row.vdcol_high_pu:g}, "
            "allowed: above it, because the order would be at its limit; set a lower vdcol_high_pu"
        )
    if not point.vdi > 0.0:
        raise CaseError(
            f"{where}: the inverter's dc voltage is {point.vdi:.3g} pu at the equilibrium, allowed: above 0; "
            "set inverter_kv, or a lower idc_ka or P_mw"
        )
    if math.isnan(point.alpha):
        raise CaseError(
            f"{where}: no delay angle gives the dc voltage {point.vdr:.6g} pu at bus {row.rectifier_bus} of "
            f"{u_rectifier:.4g} pu; set a higher rectifier_kv, a lower inverter_kv or a larger gamma_deg"
        )
    alpha = math.degrees(point.alpha)
    if not row.alpha_min_deg <= alpha <= row.alpha_max_deg:
        low = alpha < row.alpha_min_deg
        key, change = ("alpha_min_deg", "higher") if low else ("alpha_max_deg", "lower")
        raise CaseError(
            f"{where}: the rectifier angle is {alpha:.6g} deg, beyond {key} = {getattr(row, key):g}, "
            f"allowed: within its limits; set a {change} rectifier_kv, or {key}"
        )


def link_ports(
    row: Hvdc,
    place: int,
    buses: tuple[int, int],
    states: Mapping[str, int],
    values: Mapping[str, float],
    at_rest: Mapping[str, float],
    share: float,
    low: float,
) -> list[list[float]]:
    """Return the rows of the ports of both ends, without the kind of port.

    buses : positions of both. states : name -> position. values, at_rest : of its device. share : its base
    over that of the case. low : voltage below which currents fall with it.
    """
    ends = ends_of(row)
    sides = (
        (RECTIFIER, "xr", ["KPR", "AMIN", "AMAX"]),
        (INVERTER, "xi", ["KPI", "GMIN", "GMAX"]),
    )
    rows = []
    for bus, end, (coupling, angle, names) in zip(buses, ends, sides, strict=True):
        start = [
            place,
            1.0,
            bus,
            states["idc"],
            share * end.no_load,
            0.0,
            coupling,
            at_rest[angle],
            place + 1.0,
            low,
        ]
        start += [states[angle], at_rest["idc"], states["iord"], end.no_load, end.drop]
        margin = (
            [values["MARGIN"], values["KM"], 1.0 / values["vref"]]
            if coupling == INVERTER
            else [0.0, 0.0, 1.0]
        )
        rows.append([*start, *(values[name] for name in names), *margin, end.drop / end.no_load])
    return rows
