"""A case as a MATPOWER case file of version 2, with its solved voltages."""

from __future__ import annotations

import re

from ..case.case import Case
from ..grid.powerflow import PowerFlow, solve_powerflow
from .written import Written, losses_of_network, named


def matpower_of(case: Case, flow: PowerFlow | None = None) -> Written:
    """Return `case` at its power flow (solved here when not given) as a MATPOWER case file.

    Every digit of a number is kept; loads and shunts in service are added up at each bus. Reading the file
    gives the same admittances, powers and voltages.

    Raises
    ------
    PowerFlowError : the power flow has no solution.
    """
    flow = flow or solve_powerflow(case)
    losses = ["the frequency", *losses_of_network(case)]
    dynamic = [m.name for m in case.machines if m.model != "power_flow"]
    if dynamic:
        losses.append(f"dynamic data of machines ({named(dynamic)})")
    if any(bus.name for bus in case.buses):
        losses.append("names of buses")
    idle = [q.name for q in case.loads if not q.in_service] + [
        s.name for s in case.shunts if not s.in_service
    ]
    if idle:
        losses.append(f"loads and shunts out of service ({named(idle)})")
    kinds = {m.bus: 3 if m.slack else 2 for m in sorted(case.machines, key=lambda m: m.slack)}
    load, shunt = dict.fromkeys(kinds, 0j), dict.fromkeys(kinds, 0j)
    for q in case.loads:
        load[q.bus] = load.get(q.bus, 0j) + complex(q.P_mw, q.Q_mvar) * q.in_service
    for s in case.shunts:
        shunt[s.bus] = shunt.get(s.bus, 0j) + complex(s.P_mw, s.Q_mvar) * s.in_service
    lines = [f"function mpc = {re.sub(r'[^A-Za-z0-9_]', '_', 'case_' + case.name)}", "mpc.version = '2';"]
    lines += [
        f"mpc.baseMVA = {case.base_mva!r};",
        "",
        "% number type Pd Qd Gs Bs area Vm Va kV zone Vmax Vmin",
    ]
    lines.append("mpc.bus = [")
    for bus, magnitude, angle in zip(case.buses, flow.magnitudes, flow.angles_deg, strict=True):
        n, taken, given = bus.number, load.get(bus.number, 0j), shunt.get(bus.number, 0j)
        values = (n, kinds.get(n, 1), taken.real, taken.imag, given.real, given.imag, bus.area)
        lines.append(_row(*values, float(magnitude), float(angle), bus.kv or 0.0, 1, 1.1, 0.9))
    lines += ["];", "", "% bus Pg Qg Qmax Qmin Vg mBase status Pmax Pmin", "mpc.gen = ["]
    for m, power in zip(case.machines, flow.generation * case.base_mva, strict=True):
        given = complex(power)
        lines.append(_row(m.bus, given.real, given.imag, 9999.0, -9999.0, m.V_pu, m.base_mva, 1, 9999.0, 0.0))
    lines += [
        "];",
        "",
        "% from to r x b rateA rateB rateC ratio angle status angmin angmax",
        "mpc.branch = [",
    ]
    for b in case.branches:
        ratio = b.tap if b.kind == "transformer" or b.tap != 1.0 or b.shift_deg else 0.0
        ends = (b.from_bus, b.to_bus, b.r, b.x, b.b, 0, 0, 0, ratio, b.shift_deg, int(b.in_service))
        lines.append(_row(*ends, -360, 360))
    return Written("\n".join([*lines, "];", ""]), tuple(losses))


def _row(*values: float) -> str:
    return "\t" + "\t".join(repr(value) for value in values) + ";"
