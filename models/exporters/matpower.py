"""A case as a MATPOWER case file of version 2, with its solved voltages."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Mapping

from ..case.case import Case
from ..case.schema import Branch, Load, Shunt
from ..grid.powerflow import PowerFlow, solve_powerflow
from ..grid.series import compensated
from .written import Written, is_transformer, losses_of_network, named, types_of_buses


def matpower_of(case: Case, flow: PowerFlow | None = None) -> Written:
    """Return `case` at its power flow (solved here when not given) as a MATPOWER case file.

    Every digit of a number is kept; loads and shunts in service are added up at each bus. Reading the file
    gives the same admittances, powers and voltages.

    Raises
    ------
    PowerFlowError : the power flow has no solution.
    """
    flow = flow or solve_powerflow(case)
    original, case = case, compensated(case)
    lines = [
        f"function mpc = {re.sub(r'[^A-Za-z0-9_]', '_', 'case_' + case.name)}",
        "mpc.version = '2';",
        f"mpc.baseMVA = {case.base_mva!r};",
        "",
        "% number type Pd Qd Gs Bs area Vm Va kV zone Vmax Vmin",
        "mpc.bus = [",
        *_buses(case, flow),
        "];",
        "",
        "% bus Pg Qg Qmax Qmin Vg mBase status Pmax Pmin",
        "mpc.gen = [",
        *_units(case, flow),
        "];",
        "",
        "% from to r x b rateA rateB rateC ratio angle status angmin angmax",
        "mpc.branch = [",
        *map(_branch, case.branches),
        "];",
        "",
    ]
    return Written("\n".join(lines), tuple(_losses(original)))


def _losses(case: Case) -> list[str]:
    losses = ["the frequency", *losses_of_network(case)]
    dynamic = [m.name for m in case.machines if m.model != "power_flow"]
    if dynamic:
        losses.append(f"dynamic data of machines ({named(dynamic)})")
    if any(bus.name for bus in case.buses):
        losses.append("names of buses")
    elements: tuple[Load | Shunt, ...] = (*case.loads, *case.shunts)
    idle = [element.name for element in elements if not element.in_service]
    if idle:
        losses.append(f"loads and shunts out of service ({named(idle)})")
    return losses


def _buses(case: Case, flow: PowerFlow) -> Iterable[str]:
    kinds = types_of_buses(case)
    load, shunt = _at_buses(case.loads), _at_buses(case.shunts)
    for bus, magnitude, angle in zip(case.buses, flow.magnitudes, flow.angles_deg, strict=True):
        n, taken, provided = bus.number, load[bus.number], shunt[bus.number]
        values = (n, kinds.get(n, 1), taken.real, taken.imag, provided.real, provided.imag, bus.area)
        yield _row(*values, float(magnitude), float(angle), bus.kv or 0.0, 1, 1.1, 0.9)


def _at_buses(elements: Iterable[Load | Shunt]) -> Mapping[int, complex]:
    """P + jQ of the elements in service, added up at each bus."""
    total: defaultdict[int, complex] = defaultdict(complex)
    for element in elements:
        total[element.bus] += complex(element.P_mw, element.Q_mvar) * element.in_service
    return total


def _units(case: Case, flow: PowerFlow) -> Iterable[str]:
    for m, power in zip(case.machines, flow.generation * case.base_mva, strict=True):
        provided = complex(power)
        yield _row(m.bus, provided.real, provided.imag, 9999.0, -9999.0, m.V_pu, m.base_mva, 1, 9999.0, 0.0)


def _branch(b: Branch) -> str:
    ratio = b.tap if is_transformer(b) else 0.0
    ends = (b.from_bus, b.to_bus, b.r, b.x, b.b, 0, 0, 0, ratio, b.shift_deg, int(b.in_service))
    return _row(*ends, -360, 360)


def _row(*values: float) -> str:
    return "\t" + "\t".join(repr(value) for value in values) + ";"
