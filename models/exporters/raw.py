"""A case as a PSS/E RAW file of version 33, with its solved voltages."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

from ..case.case import Case
from ..case.schema import Branch, Machine
from ..errors import CaseError
from ..grid.dc_link import link_point
from ..grid.powerflow import PowerFlow, solve_powerflow
from ..grid.series import compensated
from .written import Written, is_transformer, losses_of_network, named, types_of_buses

_LONGEST_NAME = 12  #: characters of a bus name in PSS/E
_LARGEST_BUS = 999_997


def raw_of(case: Case, flow: PowerFlow | None = None) -> Written:
    """Return `case` at its power flow (solved here when not given) as a RAW file of version 33.

    Every digit of a number is kept. The charging of a transformer becomes shunts at its ends. Reading the
    file gives the same admittances, powers and voltages; machines and branches get their names from the
    buses.

    Raises
    ------
    CaseError : a bus number above 999997, more circuits between two buses than identifiers.
    PowerFlowError : the power flow has no solution.
    """
    flow = flow or solve_powerflow(case)
    original, case = case, compensated(case)
    for bus in case.buses:
        if bus.number > _LARGEST_BUS:
            raise CaseError(f"{case.name}: bus {bus.number}, allowed: at most {_LARGEST_BUS} in a RAW file")
    swung = [b for b in case.branches if is_transformer(b)]
    charged = [b for b in swung if b.b]
    title = case.title.replace("\n", " ")[:60]
    lines = [f"0, {case.base_mva!r}, 33, 0, 1, {case.frequency_hz!r} / {case.name}", title, case.source[:60]]
    _section(lines, "BUS", "LOAD", _buses(case, flow))
    _section(lines, "LOAD", "FIXED SHUNT", _loads(case))
    _section(lines, "FIXED SHUNT", "GENERATOR", _shunts(case, charged))
    _section(lines, "GENERATOR", "BRANCH", _machines(case, flow))
    circuit = _circuits(case)
    _section(lines, "BRANCH", "TRANSFORMER", (_line(b, circuit(b)) for b in case.branches if b not in swung))
    _section(lines, "TRANSFORMER", "AREA", (_transformer(b, circuit(b)) for b in swung))
    rest = (
        "AREA", "TWO-TERMINAL DC", "VSC DC LINE", "IMPEDANCE CORRECTION", "MULTI-TERMINAL DC",
        "MULTI-SECTION LINE", "ZONE", "INTER-AREA TRANSFER", "OWNER", "FACTS DEVICE", "SWITCHED SHUNT", "GNE",
        "INDUCTION MACHINE",
    )  # fmt: skip
    rows = {"TWO-TERMINAL DC": _links(case, flow), "VSC DC LINE": _vsc_links(case, flow)}
    for name, following in zip(rest, (*rest[1:], ""), strict=True):
        _section(lines, name, following, rows.get(name, ()))
    return Written("\n".join([*lines, "Q", ""]), tuple(_losses(original, charged)))


def _losses(case: Case, charged: list[Branch]) -> list[str]:
    losses = losses_of_network(case, links=True)
    long = [str(bus.number) for bus in case.buses if len(bus.name) > _LONGEST_NAME]
    if long:
        losses.append(f"names of buses beyond {_LONGEST_NAME} characters (bus {named(long)})")
    if any(bus.latitude_deg is not None for bus in case.buses):
        losses.append("places of the buses on the map")
    if charged:
        losses.append(f"charging of transformers, which becomes shunts ({named(b.name for b in charged)})")
    return losses


def _section(lines: list[str], name: str, following: str, rows: Iterable[str]) -> None:
    lines.extend(rows)
    begin = f", BEGIN {following} DATA" if following else ""
    lines.append(f"0 / END OF {name} DATA{begin}")


def _buses(case: Case, flow: PowerFlow) -> Iterable[str]:
    kinds = types_of_buses(case)
    voltages = zip(case.buses, flow.magnitudes, flow.angles_deg, strict=True)
    for bus, magnitude, angle in voltages:
        name = bus.name[:_LONGEST_NAME].replace("'", " ")
        yield (
            f"{bus.number},'{name:12s}',{bus.kv or 0.0!r},{kinds.get(bus.number, 1)},{bus.area},1,1,"
            f"{float(magnitude)!r},{float(angle)!r}"
        )


def _loads(case: Case) -> Iterable[str]:
    identity = _identities()
    for q in case.loads:
        on, name = int(q.in_service), identity(q.bus, q.name)
        yield f"{q.bus},'{name}',{on},1,1,{q.P_mw!r},{q.Q_mvar!r},0,0,0,0,1,1,0"


def _shunts(case: Case, charged: list[Branch]) -> Iterable[str]:
    identity = _identities()
    for s in case.shunts:
        yield f"{s.bus},'{identity(s.bus, s.name)}',{int(s.in_service)},{s.P_mw!r},{s.Q_mvar!r}"
    for b in charged:
        half = 0.5 * b.b * case.base_mva
        for bus, q in ((b.from_bus, half / b.tap**2), (b.to_bus, half)):
            yield f"{bus},'{identity(bus, b.name)}',{int(b.in_service)},0.0,{q!r}"


def _machines(case: Case, flow: PowerFlow) -> Iterable[str]:
    identity = machine_identities(case)
    for m, power in zip(case.machines, flow.generation * case.base_mva, strict=True):
        x = reactance(m)
        yield (
            f"{m.bus},'{identity[m.name]}',{float(power.real)!r},{float(power.imag)!r},9999.0,-9999.0,"
            f"{m.V_pu!r},0,{m.base_mva!r},{m.Ra!r},{x!r},0.0,0.0,1.0,1,100.0,9999.0,-9999.0,1,1.0"
        )


def reactance(machine: Machine) -> float:
    """Return ZX of a machine, pu: between its inner EMF and its terminal; 1 when it is not known."""
    value = machine.Xd2 if machine.model == "round_rotor" else machine.Xd1
    return 1.0 if value is None else value


def _line(b: Branch, circuit: str) -> str:
    on = int(b.in_service)
    return f"{b.from_bus},{b.to_bus},'{circuit}',{b.r!r},{b.x!r},{b.b!r},0,0,0,0,0,0,0,{on},1,0,1,1"


def _transformer(b: Branch, circuit: str) -> str:
    head = f"{b.from_bus},{b.to_bus},0,'{circuit}',1,1,1,0.0,0.0,2,'            ',{int(b.in_service)},1,1"
    winding = f"{b.tap!r},0.0,{b.shift_deg!r},0,0,0,0,0,1.1,0.9,1.1,0.9,33,0,0,0,0"
    return "\n".join([head, f"{b.r!r},{b.x!r},{100.0!r}", winding, "1.0,0.0"])


def _links(case: Case, flow: PowerFlow) -> Iterable[str]:
    """Three lines each; the transformers are in EBAS, the scheduled voltage is that at rest."""
    for row in case.hvdcs:
        ends = (row.rectifier_bus, row.inverter_bus)
        point = link_point(row, *(abs(flow.voltage(bus)) for bus in ends))
        mode, order = (2, 1000.0 * row.idc_ka) if row.idc_ka is not None else (1, row.P_mw)
        name = row.name.removeprefix("hvdc_")[:_LONGEST_NAME]
        yield (
            f"'{name}',{mode},{row.r_ohm!r},{order!r},{float(point.vdi * row.vdc_kv)!r},0.0,0.0,"
            f"{row.margin!r},'I',0.0,20,1.0"
        )
        of = (
            (row.alpha_min_deg, row.rectifier_kv, row.rectifier_xc_ohm),
            (row.gamma_min_deg, row.inverter_kv, row.inverter_xc_ohm),
        )
        for bus, (least, kv, xc) in zip(ends, of, strict=True):
            tap = "1.0,1.0,1.5,0.51,0.00625"
            yield f"{bus},{row.bridges},90.0,{least!r},0.0,{xc!r},{kv!r},{tap},0,0,0,'1',0.0"


def _vsc_links(case: Case, flow: PowerFlow) -> Iterable[str]:
    """Three lines each; the largest current is that of SMAX at 1 pu, the losses are those of ALOSS."""
    second = flow.inverters[len(flow.inverters) - len(case.vscs) :].real * case.base_mva
    for row, p in zip(case.vscs, second, strict=True):
        yield f"'{row.name.removeprefix('vsc_')[:_LONGEST_NAME]}',1,{row.r_ohm!r},1,1.0"
        ends = (
            (row.from_bus, row.P_mw, 2, -row.P_mw, row.from_keeps, row.from_q_mvar, row.from_loss_mw),
            (row.to_bus, float(p), 1, row.vdc_kv, row.to_keeps, row.to_q_mvar, row.to_loss_mw),
        )
        limits = ((row.from_i_max_pu, row.from_priority), (row.to_i_max_pu, row.to_priority))
        for (bus, power, kind, dc, keeps, q, loss), (limit, priority) in zip(ends, limits, strict=True):
            mode, ac = (1, float(abs(flow.voltage(bus)))) if keeps == "v" else (2, _power_factor(power, q))
            smax, pwf = limit * row.base_mva, float(priority == "p")
            yield (
                f"{bus},{kind},{mode},{dc!r},{ac!r},{1000.0 * loss!r},0.0,0.0,{smax!r},0.0,{pwf!r},"
                "9999.0,-9999.0,0,100.0"
            )


def _power_factor(p: float, q: float) -> float:
    """Return the power factor, below 0 where it draws reactive power."""
    size = math.hypot(p, q)
    return math.copysign(abs(p) / size, q) if size > 0.0 else 1.0


def machine_identities(case: Case) -> dict[str, str]:
    """Return machine name -> its identifier at its bus, the same in RAW and DYR."""
    identity = _identities()
    return {m.name: identity(m.bus, m.name) for m in case.machines}


def _circuits(case: Case) -> Callable[[Branch], str]:
    identity = _identities()
    words = {
        b.name: identity(min(b.from_bus, b.to_bus), b.name, max(b.from_bus, b.to_bus)) for b in case.branches
    }
    return lambda branch: words[branch.name]


def _identities() -> Callable[..., str]:
    """A function that numbers what stands at a bus; the last word of a name is kept if short and free."""
    used: dict[tuple[int, int], set[str]] = {}

    def identity(bus: int, name: str, other: int = 0) -> str:
        taken = used.setdefault((bus, other), set())
        last = name.replace("_", " ").split()[-1].upper()
        if len(last) > 2 or last in taken or last == name.upper() or not last.isalnum():
            last = next(word for word in _words() if word not in taken)
        taken.add(last)
        return last

    return identity


def _words() -> Iterable[str]:
    yield from (str(k) for k in range(1, 100))
    yield from (
        f"{a}{b}" for a in "ABCDEFGHIJKLMNOPQRSTUVWXYZ" for b in "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZ"
    )
    raise CaseError("more than 1035 elements at one bus, allowed: as many as identifiers of two characters")
