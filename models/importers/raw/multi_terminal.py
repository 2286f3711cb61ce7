"""Multi-terminal dc lines of a RAW file: the dc network at rest and what its converters take and give."""

from __future__ import annotations

import numpy as np

from ..report import Report
from ..static import StaticGrid, StaticLoad
from .converters import reactive_power
from .file import RawFile
from .identities import usable
from .record import Record

_STEPS = 200  #: of the fixed point between powers and dc voltages; a loaded line takes about 20


def read_multi_terminal(raw: RawFile, grid: StaticGrid, report: Report) -> None:
    """Put the multi-terminal dc lines of `raw` into `grid` as injections.

    One converter holds its dc voltage, the others their power (a rectifier's is above 0) or current; the
    links are resistors. Constant P and Q at each ac bus.
    """
    for record in usable(raw.records("multi-terminal dc"), grid, report):
        mode = record.code("MDC", 0, (0, 1, 2))
        if mode == 0:
            report.drop("multi-terminal dc line out of service", record.where)
            continue
        counts = [record.whole(name, 0) for name in ("NCONV", "NDCBS", "NDCLN")]
        kinds = ("multi-terminal converter",) * counts[0] + ("multi-terminal bus",) * counts[1]
        kinds += ("multi-terminal link",) * counts[2]
        rows = [raw.part(record, k, kind) for k, kind in enumerate(kinds)]
        converters, rest = rows[: counts[0]], rows[counts[0] :]
        volts, current = _at_rest(
            record, converters, rest[: counts[1]], rest[counts[1] :], current_mode=mode == 2
        )
        for k, converter in enumerate(converters):
            bus = grid.bus(converter.bus("IB"), converter.where)
            sign = 1.0 if current[k] >= 0.0 else -1.0
            q = reactive_power(converter, bus.v, abs(volts[k]), abs(current[k]), sign, report)
            name = f"{record.text('NAME')}_{k + 1}"
            load = StaticLoad(bus.number, "D", name, float(volts[k] * current[k]), q, converter.where)
            load.follows = 0.0
            grid.loads.append(load)
        report.assume("multi-terminal dc line modelled as constant P and Q at its converters", record.where)


def _at_rest(
    record: Record, converters: list[Record], buses: list[Record], links: list[Record], *, current_mode: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Voltage across and current from each converter, kV and kA (converters,)."""
    at = {bus.whole("IDC"): k for k, bus in enumerate(buses)}
    if not buses or len(at) < len(buses):
        raise record.refused("dc buses without numbers of their own, allowed: each number once")
    n, m = len(buses), len(converters)
    Y = _dc_admittance(buses, links, at)
    incidence = _dc_incidence(converters, buses, at)
    source = _voltage_end(record, converters)
    setting = np.array([converter.number("SETVL") for converter in converters])
    if not setting[source] > 0.0:
        raise converters[source].wrong("SETVL", f"{setting[source]:g}", "above 0 kV at the voltage end")
    others = [k for k in range(m) if k != source]
    whole = np.zeros((n + 1, n + 1))  # the network with the source's current as one more unknown
    whole[:n, :n], whole[:n, n], whole[n, :n] = Y, -incidence[:, source], incidence[:, source]
    volts, current = np.full(m, setting[source]), np.zeros(m)
    for _ in range(_STEPS):
        last = current.copy()
        current[others] = setting[others] / 1000.0 if current_mode else setting[others] / volts[others]
        try:
            solution = np.linalg.solve(
                whole, np.append(incidence[:, others] @ current[others], setting[source])
            )
        except np.linalg.LinAlgError:
            raise record.refused("the dc network is not connected, allowed: links to every dc bus") from None
        volts, current[source] = incidence.T @ solution[:n], solution[n]
        if not np.all(volts[others] * setting[source] > 0.0):
            break
        if np.allclose(current, last, rtol=1e-13, atol=1e-15):
            return volts, current
    raise record.refused(f"no dc voltages allow the powers of the converters with {setting[source]:g} kV")


def _dc_admittance(buses: list[Record], links: list[Record], at: dict[int, int]) -> np.ndarray:
    """Conductances of the links and to ground, 1/ohm (buses, buses)."""
    Y = np.zeros((len(buses), len(buses)))
    for bus in buses:
        ground = bus.number("RGRND", 0.0)
        if ground > 0.0:
            Y[at[bus.whole("IDC")], at[bus.whole("IDC")]] += 1.0 / ground
    for link in links:
        ends = [_dc_bus(link, name, at) for name in ("IDC", "JDC")]
        resistance = link.number("RDC", 0.0)
        if not resistance > 0.0:
            raise link.wrong("RDC", f"{resistance:g}", "above 0 ohm")
        Y[np.ix_(ends, ends)] += np.array([[1.0, -1.0], [-1.0, 1.0]]) / resistance
    return Y


def _dc_incidence(converters: list[Record], buses: list[Record], at: dict[int, int]) -> np.ndarray:
    """Where a converter drives its current in (1) and takes it out (-1), (buses, converters)."""
    incidence = np.zeros((len(buses), len(converters)))
    for k, converter in enumerate(converters):
        at_converter = next((bus for bus in buses if bus.bus("IB", 0) == converter.bus("IB")), None)
        if at_converter is None:
            raise converter.refused(f"no dc bus belongs to the converter at bus {converter.bus('IB')}")
        incidence[_dc_bus(at_converter, "IDC", at), k] += 1.0
        if at_converter.whole("IDC2", 0):
            incidence[_dc_bus(at_converter, "IDC2", at), k] -= 1.0
    return incidence


def _voltage_end(record: Record, converters: list[Record]) -> int:
    """The number of the converter that holds the dc voltage."""
    holder = record.bus("VCONV")
    at_holder = [k for k, converter in enumerate(converters) if converter.bus("IB") == holder]
    if not at_holder:
        raise record.wrong("VCONV", str(holder), "the bus of one of its converters")
    return at_holder[-1]


def _dc_bus(row: Record, name: str, at: dict[int, int]) -> int:
    number = row.whole(name)
    if number not in at:
        raise row.wrong(name, str(number), f"a dc bus of the line: {', '.join(map(str, at))}")
    return at[number]
