"""Equilibrium of dc links with voltage-source converters: powers of both ends, and their ports.

Per unit on the base of the link; equations of devices/vscs/vsc.toml, ports as those of converters
(plant/machine/bus_device.h).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from ..case.case import Case, CaseError
from ..case.hvdc_schema import Hvdc
from ..case.vsc_schema import Vsc
from .dc_link import LinkPoint, link_point

CONVERTER = 3  #: CouplingKind
FAR = 19  #: P_FAR: column of the port table that says which is the second end
#: currents of each end along and across the voltage of its bus
_CURRENTS = (("ip1", "iq1"), ("ip2", "iq2"))


@dataclass(frozen=True)
class VscPoint:
    """Equilibrium of a link between buses of these `voltages`, pu."""

    idc: float
    voltages: tuple[float, float]
    power: tuple[complex, complex]  #: P + jQ into the network at both ends
    slope: tuple[complex, complex] = (0j, 0j)  #: of each by the voltage of its own bus

    @property
    def seen(self) -> float:
        """The voltage at its first end."""
        return self.voltages[0]

    def output(self, kind: str, share: float) -> float:
        """Return the active current at its first end."""
        return self.power[0].real / self.voltages[0]

    def signals(self, kind: str, share: float) -> dict[str, float]:
        """Return the input values of the device, and its initial currents."""
        known = {"p_mod": 0.0, "q_mod1": 0.0, "q_mod2": 0.0}
        for k, (u, s, names) in enumerate(zip(self.voltages, self.power, _CURRENTS, strict=True), start=1):
            known |= {f"v{k}": u, f"p{k}": s.real}
            known |= dict(zip(names, (s.real / u, s.imag / u), strict=True))
        del known["ip1"]  # its output
        return known


def link_modulations(values: Mapping[str, float | str]) -> dict[str, str]:
    """Return the modulation inputs of a dc link of either kind: signal of its device -> name part of the
    input.

    values : parameters of its device. The input at an end of a VSC link belongs to the quantity that it
    keeps.
    """
    words = {"p_mod": "p_mod"}
    for k, end in enumerate(("from", "to"), start=1):
        if f"KEEPV{k}" in values:
            words[f"q_mod{k}"] = f"{'v' if values[f'KEEPV{k}'] == 1.0 else 'q'}_mod_{end}"
    return words


def vsc_point(row: Vsc, u_from: float, u_to: float) -> VscPoint:
    """Return the equilibrium of the link between buses of these voltages, pu."""
    taken, R = row.P_mw / row.base_mva, row.r_ohm / row.base_ohm
    into = taken - row.from_loss_mw / row.base_mva  # = (1 + R idc) idc
    idc = 2.0 * into / (1.0 + math.sqrt(max(1.0 + 4.0 * R * into, 0.0)))
    into_ac = idc - row.to_loss_mw / row.base_mva
    powers = (complex(-taken, row.from_q_mvar / row.base_mva), complex(into_ac, row.to_q_mvar / row.base_mva))
    return VscPoint(idc, (u_from, u_to), powers)


def point_of_link(row: Hvdc | Vsc, first: float, second: float) -> LinkPoint | VscPoint:
    """Return the equilibrium of a link of either kind between buses of these voltages, pu."""
    return vsc_point(row, first, second) if isinstance(row, Vsc) else link_point(row, first, second)


def require_vsc(case: Case, row: Vsc, point: VscPoint) -> None:
    """Reject a link without an equilibrium there.

    Raises
    ------
    CaseError : the line or the current limit that excludes it, and what to set.
    """
    where = f"{case.name}: vscs.{row.name}"
    for end, u, s, most in zip(
        ("from", "to"), point.voltages, point.power, (row.from_i_max_pu, row.to_i_max_pu), strict=True
    ):
        current = abs(s) / u
        if not current < most:
            raise CaseError(
                f"{where}: its current at {end}_bus is {current:.6g} pu at the equilibrium, "
                f"{end}_i_max_pu = {most:g}, "
                f"allowed: below it; set {end}_i_max_pu or base_mva, or less of P_mw or {end}_q_mvar"
            )


def require_lines(case: Case) -> None:
    """Reject a line that cannot carry the power of its link.

    Raises
    ------
    CaseError : the largest power of this direction, and what to set.
    """
    for row in case.vscs:
        least = row.from_loss_mw - row.vdc_kv**2 / (4.0 * row.r_ohm) if row.r_ohm else -math.inf
        if not row.P_mw > least:
            raise CaseError(
                f"{case.name}: vscs.{row.name}: P_mw = {row.P_mw:g}, allowed: above {least:.6g}, the most "
                f"that a line of {row.r_ohm:g} ohm brings at {row.vdc_kv:g} kV; set a smaller one or r_ohm"
            )


def vsc_ports(
    place: int,
    buses: tuple[int, int],
    states: Mapping[str, int],
    at_rest: Mapping[str, float],
    share: float,
    numbers: list[float],
) -> list[list[float]]:
    """Return the rows of the ports of both ends, without the kind of port.

    buses : positions of both. states : name -> position. at_rest : initial currents. share : its base over
    that of the case. numbers : voltage below which currents fall with it; then the voltage-dependent gains of
    converters' ports.
    """
    low, *gains = numbers
    return [
        [
            *(place, 1.0, bus, states[p], share, 0.0, CONVERTER, share * at_rest[p], place + 1.0, low),
            *(states[q], share * at_rest[q], *gains, 0.0, float(end)),
        ]
        for end, (bus, (p, q)) in enumerate(zip(buses, _CURRENTS, strict=True))
    ]
