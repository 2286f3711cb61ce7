"""The power flow of a case by Newton's method."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ..case.case import Case, CaseError
from ..case.checks import islands_of
from ..case.hvdc_schema import Hvdc
from ..case.vsc_schema import Vsc
from .dc_link import LinkPoint, require_link
from .network import ComplexArray, branch_stamp, bus_index, load_power, machine_bus_index, sparse_admittance
from .newton import Iterate, newton
from .series import compensated, node_voltages, series_nodes, without_series_nodes
from .vsc_link import VscPoint, point_of_link, require_lines, require_vsc

TOLERANCE_PU = 1e-10
_REPETITIONS = 60  #: of a power flow with dc links; each brings their voltages about a digit closer


class PowerFlowError(CaseError):
    """Newton's method finds no solution of the power flow.

    voltages : bus -> V in pu of the iterate with the least mismatch; empty if none is finite.
    """

    def __init__(self, *mistakes: str, voltages: Mapping[int, complex] | None = None) -> None:
        super().__init__(*mistakes)
        self.voltages = dict(voltages or {})


@dataclass(frozen=True)
class PowerFlow:
    """Solved bus voltages; arrays read-only, pu on the base of the case, in its bus and machine order."""

    case: Case
    voltages: ComplexArray  #: (buses,)
    injections: ComplexArray  #: (buses,) generation less load, shunts belong to the network
    generation: ComplexArray  #: (machines,) P + jQ of each machine
    at_buses: (
        ComplexArray  #: (devices at buses,) P + jQ of each into the network, of a dc link at its first end
    )
    inverters: ComplexArray  #: (dc links,) P + jQ of each into the network at its inverter or second end
    iterations: int
    mismatch_pu: float  #: largest |P| or |Q| mismatch left

    @property
    def magnitudes(self) -> npt.NDArray[np.float64]:
        """Voltage magnitudes, pu."""
        return np.abs(self.voltages)

    @property
    def angles_deg(self) -> npt.NDArray[np.float64]:
        """Voltage angles, degrees."""
        return np.degrees(np.angle(self.voltages))

    def voltage(self, bus: int) -> complex:
        """Return the voltage of bus number `bus`, pu; CaseError if there is no such bus."""
        index = bus_index(self.case)
        if bus not in index:
            raise CaseError(f"{self.case.name}: bus {bus} does not exist")
        return complex(self.voltages[index[bus]])

    def flow(self, branch: str, from_bus: int) -> complex:
        """Return P + jQ that enters `branch` at its end `from_bus`, pu (0 when out of service)."""
        row = self.case.branch(branch)
        if from_bus not in (row.from_bus, row.to_bus):
            raise CaseError(
                f"{self.case.name}: branch {branch!r} ends at {row.from_bus} and {row.to_bus}, got {from_bus}"
            )
        if not row.in_service:
            return 0j
        ends = np.array([self.voltage(row.from_bus), self.voltage(row.to_bus)])
        power = ends * np.conj(branch_stamp(row) @ ends)
        return complex(power[0 if from_bus == row.from_bus else 1])

    @property
    def tie_p(self) -> float:
        """Active power over the tie of the case, pu; CaseError if the case names none."""
        tie = self.case.tie
        if tie is None:
            raise CaseError(f"{self.case.name}: no [tie] in the case")
        return sum(self.flow(name, tie.from_bus).real for name in tie.branches)


def solve_powerflow(case: Case) -> PowerFlow:
    r"""Solve the power flow of `case` from the start values of its buses, flat where they have none.

    Slack, one in each connected part: voltage and angle given; other machine buses: P and voltage; the rest:
    P and Q. SVCs keep a voltage or supply Q; the power of dc links follows from their bus voltages by
    repeated solution. Loads are constant P and Q, shunts are admittances; `newton` has the equations.

    Machine reactive limits are not enforced. Machines at one bus have their own `Q_mvar` and share the rest
    of its Q by their ratings; a slack machine supplies the rest of P.

    Raises
    ------
    PowerFlowError : no convergence; names the bus with the worst mismatch.
    """
    if case.tcscs:
        return _with_capacitors(case)
    Y = sparse_admittance(case)
    machine_bus = machine_bus_index(case)
    slack = np.array([bus_index(case)[m.bus] for m in case.slacks])
    load = _load_at_buses(case)
    scheduled = -load
    np.add.at(scheduled, machine_bus, [m.P_mw / case.base_mva for m in case.machines])

    n = len(case.buses)
    magnitude = np.array([bus.V_pu or 1.0 for bus in case.buses])
    magnitude[machine_bus] = [m.V_pu for m in case.machines]
    regulated_pu = {bus_index(case)[s.bus]: s.V_pu for s in case.svcs if s.V_pu is not None}
    magnitude[list(regulated_pu)] = list(regulated_pu.values())
    start = magnitude * np.exp(1j * np.deg2rad(_start_angles(case)))
    free_angle = np.delete(np.arange(n), slack)
    free_magnitude = np.setdiff1d(np.arange(n), [*machine_bus, *regulated_pu])
    best, links = _repeated(case, Y, start, scheduled, free_angle, free_magnitude)
    if best is None or not best.converged:
        retained = (
            {}
            if best is None
            else {b.number: complex(v) for b, v in zip(case.buses, best.voltages, strict=True)}
        )
        raise PowerFlowError(_no_convergence(case, best, free_angle, free_magnitude), voltages=retained)
    _require_links(case, best, links)
    return _solved(case, best, load, slack, links)


def _require_links(case: Case, best: Iterate, links: list[LinkPoint | VscPoint]) -> None:
    """Refuse dc links that cannot rest there; CaseError."""
    for row, point in zip(case.links, links, strict=True):
        if isinstance(row, Vsc) and isinstance(point, VscPoint):
            require_vsc(case, row, point)
        elif isinstance(row, Hvdc) and isinstance(point, LinkPoint):
            require_link(case, row, point, float(np.abs(best.voltages[bus_index(case)[row.bus]])))


def _repeated(
    case: Case, Y: Any, start: ComplexArray, scheduled: ComplexArray, free_angle: Any, free_magnitude: Any
) -> tuple[Iterate | None, list[LinkPoint | VscPoint]]:
    """Newton's method with the dc links at the voltages before, until these stand."""
    links: list[LinkPoint | VscPoint] = []
    if not case.links:
        return newton(Y, start, scheduled, free_angle, free_magnitude, tolerance_pu=TOLERANCE_PU), links
    index, best, moved = bus_index(case), None, np.inf
    require_lines(case)
    at = np.array([[index[row.bus], index[row.seen_bus]] for row in case.links])
    share = np.array([[row.base_mva / case.base_mva] for row in case.links])
    for _ in range(_REPETITIONS):
        size = np.abs(start)[at]
        links = [point_of_link(row, *map(float, of)) for row, of in zip(case.links, size, strict=True)]
        slope = share * np.array([link.slope for link in links])
        constant, linear = scheduled.astype(complex), np.zeros(len(start), dtype=complex)
        np.add.at(constant, at, share * np.array([link.power for link in links]) - slope * size)
        np.add.at(linear, at, slope)
        best = newton(
            Y, start, constant, free_angle, free_magnitude, current=linear, tolerance_pu=TOLERANCE_PU
        )
        if best is None or not best.converged:
            break
        last, moved = moved, float(np.max(np.abs(np.abs(best.voltages)[at] - size)))
        start = best.voltages
        if not 1e-15 <= moved < last:
            break
    if best is not None and best.converged and not moved <= TOLERANCE_PU:
        raise PowerFlowError(
            f"{case.name}: the power flow does not converge with its dc links: voltages at their buses "
            f"change by {moved:.3g} pu, allowed: {TOLERANCE_PU:g}; support these by "
            "shunts, or lower idc_ka or P_mw",
            voltages={b.number: complex(v) for b, v in zip(case.buses, best.voltages, strict=True)},
        )
    return best, links


def _with_capacitors(case: Case) -> PowerFlow:
    """The power flow with series capacitors in their lines; where these have nodes, of them too."""
    nodes = series_nodes(case)
    if not nodes:
        return solve_powerflow(compensated(case))
    return with_nodes(solve_powerflow(compensated(without_series_nodes(case))), case)


def with_nodes(flow: PowerFlow, case: Case) -> PowerFlow:
    """Return `flow` for `case` with nodes of series capacitors, unless it has them already."""
    if not case.tcscs or len(flow.voltages) == len(case.buses):
        return flow
    at, power = node_voltages(case, flow.voltages)
    plain = len(case.svcs) - len(power)
    arrays = (
        np.concatenate([flow.voltages, at]),
        np.concatenate([flow.injections, power]),
        np.concatenate([flow.at_buses[:plain], power, flow.at_buses[plain:]]),
    )
    for array in arrays:
        array.flags.writeable = False
    return replace(flow, case=case, voltages=arrays[0], injections=arrays[1], at_buses=arrays[2])


def _start_angles(case: Case) -> npt.NDArray[np.float64]:
    """Angles to start from, (buses,) deg: a start far from the others' helps nobody, so they count from that
    of the slack of their part."""
    index = bus_index(case)
    angle = np.array([np.nan if bus.angle_deg is None else bus.angle_deg for bus in case.buses])
    own = {m.bus: m.angle_deg for m in case.slacks}
    for part in islands_of(case):
        rows = np.array([index[bus] for bus in part])
        slack = next(bus for bus in part if bus in own)
        provided = own[slack] if np.isnan(angle[index[slack]]) else angle[index[slack]]
        angle[rows] = np.where(np.isnan(angle[rows]), own[slack], angle[rows] - provided + own[slack])
    return angle


def _load_at_buses(case: Case) -> ComplexArray:
    index = bus_index(case)
    load = np.zeros(len(index), dtype=complex)
    for row in case.loads:
        if row.in_service:
            load[index[row.bus]] += load_power(case, row)
    for svc in case.svcs:
        if svc.V_pu is None:
            load[index[svc.bus]] -= 1j * svc.Q_mvar / case.base_mva
    for plant in case.converters:
        load[index[plant.bus]] -= complex(plant.P_mw, plant.Q_mvar) / case.base_mva
    return load


def _no_convergence(
    case: Case, best: Iterate | None, free_angle: npt.NDArray[np.int_], free_magnitude: npt.NDArray[np.int_]
) -> str:
    start = f"{case.name}: the power flow does not converge"
    advice = "reduce the loads or the transfer, or check branches and voltages"
    if best is None:
        return f"{start} (no finite iterate); {advice}"
    size = best.at_bus(free_angle, free_magnitude)
    k = int(np.argmax(size))
    low, high = (int(f(np.abs(best.voltages))) for f in (np.argmin, np.argmax))
    ends = (f"{abs(best.voltages[j]):.3g} pu at bus {case.buses[j].number}" for j in (low, high))
    return (
        f"{start}: worst mismatch {size[k]:.3g} pu at bus {case.buses[k].number} "
        f"(best iterate: number {best.iteration}), allowed: {TOLERANCE_PU:g} pu; its voltages range from "
        f"{' to '.join(ends)}; {advice}"
    )


def _solved(
    case: Case,
    best: Iterate,
    load: ComplexArray,
    slack: npt.NDArray[np.int_],
    links: list[LinkPoint | VscPoint],
) -> PowerFlow:
    V = best.voltages
    injections: ComplexArray = V * np.conj(sparse_admittance(case) @ V)
    ends = np.array(
        [
            [s * row.base_mva / case.base_mva for s in link.power]
            for row, link in zip(case.links, links, strict=True)
        ],
        dtype=complex,
    ).reshape(-1, 2)
    index = bus_index(case)
    at_bus = injections + load
    for row, of in zip(case.links, ends, strict=True):
        at_bus[[index[row.bus], index[row.seen_bus]]] -= of
    machine_bus = machine_bus_index(case)
    rating = np.array([m.base_mva for m in case.machines])
    total = np.zeros(len(V))
    np.add.at(total, machine_bus, rating)
    own_q = np.array([(m.Q_mvar or 0.0) / case.base_mva for m in case.machines])
    left = at_bus.imag.copy()
    np.subtract.at(left, machine_bus, own_q)
    q = own_q + left[machine_bus] * rating / total[machine_bus]
    generation = np.array([m.P_mw / case.base_mva for m in case.machines]) + 1j * q
    own = np.array([k for k, m in enumerate(case.machines) if m.slack])
    generation[own] = 1j * generation[own].imag
    scheduled = np.zeros(len(V))
    np.add.at(scheduled, machine_bus, generation.real)
    generation[own] += at_bus[slack].real - scheduled[slack]
    converter_power = np.array(
        [complex(c.P_mw, c.Q_mvar) / case.base_mva for c in case.converters], dtype=complex
    )
    at_buses, inverters = (
        np.concatenate([1j * _svc_q(case, at_bus.imag), converter_power, ends[:, 0]]),
        ends[:, 1],
    )
    for array in (V, injections, generation, at_buses, inverters):
        array.flags.writeable = False
    return PowerFlow(case, V, injections, generation, at_buses, inverters, best.iteration, best.mismatch_pu)


def _svc_q(case: Case, at_bus: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Q of each SVC: given, or a share by rating of the rest at a bus whose voltage it controls."""
    index = bus_index(case)
    q = np.array([s.Q_mvar / case.base_mva for s in case.svcs], dtype=float)
    for k, svc in enumerate(case.svcs):
        if svc.V_pu is not None:
            total = sum(s.base_mva for s in case.svcs if s.bus == svc.bus and s.V_pu is not None)
            q[k] = at_bus[index[svc.bus]] * svc.base_mva / total
    return q
